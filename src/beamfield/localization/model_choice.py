"""Choose among measurement models by what our own filter does with them on a log."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from beamfield.arguments import as_count, checked, require
from beamfield.localization.replay_comparison import ReplayTrials
from beamfield.localization.replay_trials import run_trials
from beamfield.localization.scan_localizer import ScanLocalizer
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.base import MeasurementModel
from beamfield.models.gaussian_motion import USUAL_MOTION
from beamfield.models.motion import MotionModel
from beamfield.sensors import Scan, SensorLog
from beamfield.short_repr import short_repr

Progress = Callable[[int, int], None]

# Of a longer way so many stretches of so many metres count, the first and the last among them.
STRETCHES, STRETCH = 5, 40.0


@dataclass(frozen=True, eq=False)
class ModelChoice:
    """How far off a filter is with each of some models.

    Parameters
    ----------
    trials
        The runs of each model, over all stretches, by its name.
    """

    trials: Mapping[str, ReplayTrials]

    __repr__ = short_repr

    @property
    def best(self) -> str:
        """The model with the smallest mean position error."""
        return min(self.trials, key=lambda name: self.trials[name].mean("mean"))

    def summary(self) -> str:
        """Return one line per model for people, the best one first."""
        by_error = sorted(self.trials, key=lambda name: self.trials[name].mean("mean"))
        return "\n".join(self.trials[name].summary() for name in by_error)


@checked
def choose_model(
    models: Mapping[str, MeasurementModel[Scan]],
    grid: OccupancyGrid,
    log: SensorLog,
    motion: MotionModel = USUAL_MOTION,
    *,
    n_seeds: int = 3,
    progress: Progress | None = None,
) -> ModelChoice:
    """Return how far off our own filter is on a log with each of some models.

    Likelihoods of held-out readings, and posteriors around reference poses, tell less: docs/evidence/localization.md
    compares these ways to choose on other drives.

    Parameters
    ----------
    models
        By name: any that weigh scans.
    grid
        The map.
    log
        With odometry and reference poses. Beyond 200 m of way, five stretches of 40 m count.
    motion
        Moves particles.
    n_seeds
        Runs of each model on each stretch, from a start within 0.5 m and 15 degrees (standard deviations).
    progress
        Called with the number of stretches done and in all.

    Raises
    ------
    InvalidInputError
        If there is no model, or n_seeds < 1.
    TooLittleDataError
        If no scan has both odometry and a reference pose.
    """
    require(len(models) > 0, "models", "at least one", len(models))
    n_seeds = as_count(n_seeds, "n_seeds", least=1, most=10_000)
    stretches = _stretches(log)
    asked = [(name, stretch) for name in models for stretch in stretches]
    found: dict[str, list[ReplayTrials]] = {name: [] for name in models}
    for i, (name, stretch) in enumerate(asked):
        if progress is not None:
            progress(i, len(asked))
        found[name].append(run_trials(ScanLocalizer(grid, models[name], motion), stretch, range(n_seeds), name=name))
    return ModelChoice({name: _joined(name, runs) for name, runs in found.items()})


def _joined(name: str, runs: Sequence[ReplayTrials]) -> ReplayTrials:
    seeds = tuple(seed for run in runs for seed in run.seeds)
    return ReplayTrials(name, seeds, tuple(error for run in runs for error in run.errors))


def _stretches(log: SensorLog) -> list[SensorLog]:
    known = log[np.flatnonzero(np.isfinite(log.odometry).all(axis=1))]
    steps = np.hypot(*np.diff(known.odometry[:, :2], axis=0).T)
    way = np.append(0.0, np.cumsum(steps))[: len(known)]
    if not len(known) or way[-1] <= STRETCHES * STRETCH:
        return [known]
    begins = np.linspace(0.0, way[-1] - STRETCH, STRETCHES)
    cut = [known[slice(*np.searchsorted(way, [begin, begin + STRETCH]))] for begin in begins]
    return [stretch for stretch in cut if np.isfinite(stretch.poses).all(axis=1).any()] or [known]
