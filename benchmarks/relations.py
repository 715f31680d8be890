"""Relations between scans: relative poses that people have verified, as in the SLAM benchmark of Kuemmerle et al."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beamfield.geometry import FloatArray, compose, invert


@dataclass(frozen=True, eq=False)
class Relations:
    """Relative poses between moments of a drive.

    Parameters
    ----------
    stamps
        (n, 2) seconds: from when, to when.
    poses
        (n, 3) pose at the second moment seen from the first, metres and radians.
    """

    stamps: FloatArray
    poses: FloatArray

    def __len__(self) -> int:
        return len(self.stamps)

    def steps(self) -> tuple[FloatArray, FloatArray]:
        """Return all moments in order, (m,), and the relative pose from each to the next, (m - 1, 3).

        NaN where no relation joins two neighbouring moments. Of several, the last in the file counts.
        """
        moments, which = np.unique(self.stamps, return_inverse=True)
        first, second = which.reshape(-1, 2).T
        steps: FloatArray = np.full((max(len(moments) - 1, 0), 3), np.nan)
        forward, backward = second - first == 1, second - first == -1
        steps[first[forward]] = self.poses[forward]
        steps[second[backward]] = invert(self.poses[backward])
        return moments, steps


def chain(steps: FloatArray) -> FloatArray:
    """Return the composition of relative poses (n, 3), from first to last."""
    pose: FloatArray = np.zeros(3)
    for step in steps:
        pose = compose(pose, step)
    return pose


def read_relations(path: Path) -> Relations:
    """Read lines ``from to x y z roll pitch yaw``, plain or gzip; height, roll and pitch are not used."""
    table = np.loadtxt(path, ndmin=2)
    return Relations(table[:, :2], table[:, [2, 3, 7]])
