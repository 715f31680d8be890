"""One filter replayed over a log with many seeds."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from beamfield.arguments import checked
from beamfield.localization.parallel_runs import run_each
from beamfield.localization.replay import PoseBelief, ReplayedFilter, ReplayErrors, judge_replay, reference_start
from beamfield.localization.replay_comparison import ReplayTrials
from beamfield.sensors import SensorLog

Progress = Callable[[int, int], None]


@checked
def run_trials(
    replayed: ReplayedFilter,
    log: SensorLog,
    seeds: Sequence[int],
    *,
    name: str = "log",
    spread: tuple[float, float] = (0.5, np.pi / 12),
    progress: Progress | None = None,
) -> ReplayTrials:
    """Replay a filter from the first scan that has a reference pose on, once per seed, and judge each run.

    Parameters
    ----------
    replayed
        The filter.
    log
        With odometry and reference poses.
    seeds
        Of the runs. The same seed gives the same run.
    name
        What to call the log.
    spread
        Standard deviations of the normal belief around the reference pose that every run starts from: of x and of y,
        metres, and of the heading, radians. By default nav2's and ROS 1's.
    progress
        Called with the number of runs done and in all.

    Returns
    -------
    The runs, in the order of the seeds.

    Raises
    ------
    TooLittleDataError
        If no scan has both odometry and a reference pose.
    """
    first, start = reference_start(log, sd_position=spread[0], sd_heading=spread[1])
    part = log[first:]
    errors = run_each(partial(_errors, replayed, part, start), seeds, progress)
    return ReplayTrials(name, tuple(seeds), tuple(errors))


def _errors(replayed: ReplayedFilter, log: SensorLog, start: PoseBelief, seed: int) -> ReplayErrors:
    return judge_replay(replayed.run(log, start, np.random.default_rng(seed)), log.poses)
