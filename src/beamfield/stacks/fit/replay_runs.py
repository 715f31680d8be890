"""Settings of a stack's filter, and their runs on stretches of a log."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from beamfield.calibration.pose_windows import WindowOptions
from beamfield.localization.replay_comparison import ReplayTrials
from beamfield.localization.replay_trials import run_trials
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog
from beamfield.stacks.files.filter_file import FilterSettings
from beamfield.stacks.fit.kept_runs import KeptRuns

Progress = Callable[[str, int, int], None]

# A run starts as a filter that tracks, with the windows' prior, metres and radians. From nav2's 0.5 m and 15 degrees a
# lead-in along a corridor is too short to gather particles, and errors tell of that more than of tracking.
SPREAD = WindowOptions.spread, WindowOptions.turn_spread


class Key(NamedTuple):
    """What tells settings apart."""

    sensor: str
    """Name of the sensor's values."""
    motion: str
    """Name of the motion's values."""
    origin: float
    """Shift of the map's origin, metres."""


@dataclass(frozen=True, eq=False)
class ReplaySetting:
    """One setting of everything that is chosen.

    Parameters
    ----------
    sensor, motion
        Where its parameters come from: "before" for the user's.
    shift
        What is added to the map's x and y origin, metres.
    filter
        All parameters.
    """

    sensor: str
    motion: str
    shift: float
    filter: FilterSettings

    @property
    def key(self) -> Key:
        """What tells it from others."""
        return Key(self.sensor, self.motion, self.shift)


class Replays:
    """Runs of settings on all stretches, none made twice."""

    def __init__(
        self, stretches: Sequence[SensorLog], grid: OccupancyGrid, n_seeds: int, first_seed: int, kept: KeptRuns
    ) -> None:
        self._stretches, self._grid, self._first, self._kept = stretches, grid, first_seed, kept
        self.n_seeds = n_seeds
        self._runs: dict[Key, list[ReplayTrials]] = {}

    def of(
        self, settings: Iterable[ReplaySetting], n_seeds: int, stage: str = "", progress: Progress | None = None
    ) -> dict[Key, list[ReplayTrials]]:
        """Return the runs of settings with so many seeds on each stretch."""
        chosen = list(settings)
        for done, one in enumerate(chosen):
            if progress is not None and stage:
                progress(f"replay: {stage}", done, len(chosen))
            self._run(one, n_seeds)
        return {one.key: [_first_of(trials, n_seeds) for trials in self._runs[one.key]] for one in chosen}

    def _run(self, setting: ReplaySetting, n_seeds: int) -> None:
        """Run the seeds that are missing."""
        known = self._runs.get(setting.key, [])
        seeds = range(self._first + (len(known[0]) if known else 0), self._first + n_seeds)
        if not seeds:
            return
        replayed = setting.filter.filter(shifted_map(self._grid, setting.shift))
        named = {f"stretch {i + 1}": log for i, log in enumerate(self._stretches)}
        new = [
            self._kept.of(
                (name, setting.key, seeds), partial(run_trials, replayed, log, seeds, name=name, spread=SPREAD)
            )
            for name, log in named.items()
        ]
        self._runs[setting.key] = [_joined(*pair) for pair in zip(known, new, strict=True)] if known else new


def _first_of(trials: ReplayTrials, n: int) -> ReplayTrials:
    return replace(trials, seeds=trials.seeds[:n], errors=trials.errors[:n])


def _joined(one: ReplayTrials, other: ReplayTrials) -> ReplayTrials:
    return replace(one, seeds=one.seeds + other.seeds, errors=one.errors + other.errors)


def shifted_map(grid: OccupancyGrid, shift: float) -> OccupancyGrid:
    """Return the map with another origin."""
    return replace(grid, origin=grid.origin + np.array([shift, shift, 0.0])) if shift else grid
