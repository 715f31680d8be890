"""The loop that all filters share: which scans update the particles, and what is said in between."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Protocol

import numpy as np

from beamfield.errors import TooLittleDataError
from beamfield.geometry import FloatArray, compose, invert
from beamfield.localization.replay import Replay
from beamfield.sensors import Scan, SensorLog
from beamfield.stacks.filters.particles import particle_moments


class Cloud(Protocol):
    """The particles of one run, and what a program remembers of earlier scans."""

    poses: FloatArray
    """(n, 3)."""
    weights: FloatArray
    """(n,) that sum to 1."""

    def move(self, odometry: FloatArray) -> None:
        """Move by an odometry step (2, 3)."""

    def weigh(self, scan: Scan) -> None:
        """Multiply weights by those of a scan, and normalise them."""

    def resample_when_due(self) -> FloatArray | None:
        """Resample if the program does now; return its answer, if it has a new one."""


# Called after each update: the index of its scan, the particles (n, 3) and their weights (n,).
WatchCloud = Callable[[int, FloatArray, FloatArray], None]


def run_loop(log: SensorLog, cloud: Cloud, scans: Iterable[int], watch: WatchCloud | None) -> Replay:
    """Run a log through a filter: its particles are updated by these scans, which all have odometry."""
    updates: list[tuple[int, FloatArray, FloatArray, int, float]] = []
    answers: list[tuple[int, FloatArray]] = []
    last: FloatArray | None = None
    for i in scans:
        odometry = log.odometry[i]
        started = time.thread_time()
        if last is not None:
            cloud.move(np.stack([last, odometry]))
        cloud.weigh(log.scan(i))
        answer = cloud.resample_when_due()
        seconds = time.thread_time() - started
        updates.append((i, *particle_moments(cloud.poses, cloud.weights), len(cloud.poses), seconds))
        if watch is not None:
            watch(i, cloud.poses, cloud.weights)
        if answer is not None:
            answers.append((i, answer))
        last = odometry
    return Replay(_continued(answers, log.odometry), *(np.array(column) for column in zip(*updates, strict=True)))


def _continued(answers: Sequence[tuple[int, FloatArray]], odometry: FloatArray) -> FloatArray:
    """Return the pose at each scan, (t, 3): a filter's answers (scan and pose), each continued by odometry (t, 3)."""
    scans, poses = (np.array(column) for column in zip(*answers, strict=True))
    # All at once: one by one takes a sixth of a replay's time.
    map_from_odom = compose(poses, invert(odometry[scans]))
    whole = np.full(odometry.shape, np.nan)
    held = np.repeat(map_from_odom, np.diff(scans, append=len(whole)), axis=0)
    whole[scans[0] :] = compose(held, odometry[scans[0] :])
    return whole


def scans_with_odometry(log: SensorLog) -> list[int]:
    """Return the scans by which a filter can move its particles; TooLittleDataError if there are none."""
    if not log.has_odometry:
        raise TooLittleDataError("log: no scan has an odometry pose, by which the filter moves its particles")
    return np.flatnonzero(np.isfinite(log.odometry).all(axis=1)).tolist()


def scans_after_motion(log: SensorLog, has_moved: Callable[[FloatArray, FloatArray], bool]) -> list[int]:
    """Return the first scan with odometry, and then each at which it has moved enough since the last one returned.

    `has_moved` compares two odometry poses (3,), then and now. TooLittleDataError if no scan has odometry.
    """
    first, *others = scans_with_odometry(log)
    chosen = [first]
    for i in others:
        if has_moved(log.odometry[chosen[-1]], log.odometry[i]):
            chosen.append(i)
    return chosen


def scans_at_ticks(log: SensorLog, rate: float) -> list[int]:
    """Return the newest scan with odometry at every tick of a clock that starts with the first; the rate is per second.

    TooLittleDataError if no scan has odometry.
    """
    scans = scans_with_odometry(log)
    stamps = log.stamps[scans]
    # Rounding must not put a scan behind the tick that it comes with.
    ticks = np.ceil((stamps - stamps[0]) * rate - 1e-9)
    newest = np.append(ticks[1:] != ticks[:-1], True)
    return [scan for scan, is_newest in zip(scans, newest.tolist(), strict=True) if is_newest]
