"""How much is replayed before a choice."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil, sqrt

import numpy as np

from beamfield.calibration.odometry.windows import update_scans
from beamfield.localization.replay_comparison import FEWEST_SEEDS
from beamfield.sensors import SensorLog
from beamfield.stacks.files.filter_file import FilterSettings
from beamfield.stacks.fit.replay_segments import USUAL_DISTANCES
from beamfield.stacks.registry import model_named


@dataclass(frozen=True)
class ReplayOptions:
    """How much is replayed.

    Parameters
    ----------
    runs
        Of each setting that comes into the last round, over stretches and seeds: at least so many.
    most_stretches, longest
        Stretches of the log, and updates of one, at most.
    seed
        The first seed.
    """

    runs: int = 60
    most_stretches: int = 8
    longest: int = 40
    seed: int = 0

    def seeds(self, n_stretches: int) -> int:
        """Return how many seeds make so many runs on these stretches, and not too few to be sure of anything."""
        return max(FEWEST_SEEDS, ceil(self.runs / n_stretches))


# By the model's kind: a cast ray costs some twenty times a look-up in a field.
OF_FIELDS = ReplayOptions()
OF_RAYS = ReplayOptions(runs=30, most_stretches=4)
# Where a filter takes more scans than so many for each update of amcl, there are fewer runs, and shorter ones.
AFFORDABLE_SCANS = 2.0


def replay_options(settings: FilterSettings, log: SensorLog, seed: int) -> ReplayOptions:
    """Return how much a filter can afford on a log: fewer and shorter runs if updates are costly or many."""
    usual = OF_FIELDS if model_named(settings.stack, settings.model).weight.of_field else OF_RAYS
    less = max(1.0, sqrt(_scans_per_update(settings, log) / AFFORDABLE_SCANS))
    return replace(usual, runs=ceil(usual.runs / less), longest=ceil(usual.longest / less), seed=seed)


def _scans_per_update(settings: FilterSettings, log: SensorLog) -> float:
    """Return how many scans a filter takes where amcl takes one."""
    if settings.update_distances != (0.0, 0.0):
        return 1.0
    taken = settings.at_ticks(log).odometry
    return float(np.isfinite(taken).all(axis=1).sum() / max(1, len(update_scans(taken, *USUAL_DISTANCES))))
