"""Odometry from the scans alone, for logs that have none."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from beamfield.geometry import FloatArray, compose
from beamfield.localization.alignment import align
from beamfield.sensors import SensorLog

# Beams of each scan that are aligned.
BEAMS = 180


def odometry_from_scans(log: SensorLog, progress: Callable[[int, int], None]) -> FloatArray:
    """Return odometry (t, 3) that starts at (0, 0, 0): each scan aligned with the one before.

    The first guess is that the robot moves on as it did; where an alignment fails, that is what is kept.
    """
    poses = np.zeros((len(log), 3))
    step, before = np.zeros(3), log.scan(0).every(BEAMS)
    for i in range(1, len(log)):
        scan = log.scan(i).every(BEAMS)
        found = align(scan, before, step)
        # What a corridor leaves undetermined keeps the guess; heading and distance from the walls do not.
        step = found.pose if found.problem in ("", "undetermined") else step
        poses[i] = compose(poses[i - 1], step)
        before = scan
        progress(i, len(log) - 1)
    return poses
