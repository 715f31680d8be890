"""The loop that all filters share: which scans update the particles, and what is said in between."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.localization.replay import Replay
from beamfield.sensors import Scan, SensorLog
from beamfield.stacks.filters.recording import Recording


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


def run_loop(log: SensorLog, cloud: Cloud, has_moved: Callable[[FloatArray, FloatArray], bool]) -> Replay:
    """Run a log through a filter.

    The first scan updates the particles, and then every scan at which odometry has moved enough since the last update.

    Parameters
    ----------
    log
        Scans without odometry are left out.
    cloud
        The particles.
    has_moved
        Whether two odometry poses (3,), at the last update and now, are far enough apart.

    Raises
    ------
    TooLittleDataError
        If no scan has odometry.
    """
    recording = Recording(log)
    last: FloatArray | None = None
    for i in recording.scans:
        odometry = log.odometry[i]
        if last is not None and not has_moved(last, odometry):
            continue
        recording.start_update()
        if last is not None:
            cloud.move(np.stack([last, odometry]))
        cloud.weigh(log.scan(i))
        answer = cloud.resample_when_due()
        recording.updated(i, cloud.poses, cloud.weights)
        if answer is not None:
            recording.published(i, answer)
        last = odometry
    return recording.replay()
