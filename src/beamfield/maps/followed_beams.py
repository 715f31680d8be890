"""Beams of scans as mapping follows them: where each starts, how far it is followed, and what its last cell is."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses
from beamfield.kernels import mapping as kernels
from beamfield.maps.inverse_sensor import InverseSensorModel
from beamfield.maps.log_odds import lengths_and_kinds
from beamfield.sensors import RangeFinder


class FollowedBeams(NamedTuple):
    """Beams of t scans as the kernel takes them; lengths in cells, from the map's zero.

    Parameters
    ----------
    starts
        (t, 4) x, y, cos and sin of each robot.
    fan
        (4, k) x, y, cos and sin of each beam in the robot's frame.
    lengths
        (t, k) how far each beam is followed.
    kinds
        (t, k) `kernels.mapping.HIT`, `PASS` or `SKIP`.
    """

    starts: FloatArray
    fan: FloatArray
    lengths: FloatArray
    kinds: NDArray[np.uint8]

    def rays(self) -> FloatArray:
        """Return x, y, cos and sin of every beam, shape (4, t, k)."""
        x, y, c, s = (self.starts[:, i, None] for i in range(4))
        u, v, cos, sin = self.fan
        return np.stack([x + c * u - s * v, y + s * u + c * v, c * cos - s * sin, s * cos + c * sin])

    def extent(self) -> tuple[FloatArray, FloatArray] | None:
        """Return lowest and highest (col, row) that the beams can touch, as whole floats; None if they touch none."""
        used = self.kinds != kernels.SKIP
        if not used.any():
            return None
        x, y, c, s = self.rays()[:, used]
        ends = x + self.lengths[used] * c, y + self.lengths[used] * s
        # One cell more on each side, for end points on a border.
        low = np.array([min(a.min(), b.min()) for a, b in zip((x, y), ends, strict=True)])
        high = np.array([max(a.max(), b.max()) for a, b in zip((x, y), ends, strict=True)])
        return np.floor(low) - 1.0, np.floor(high) + 1.0


def followed_beams(
    ranges: ArrayLike, finder: RangeFinder, poses: ArrayLike, resolution: float, model: InverseSensorModel
) -> FollowedBeams:
    """Return where beams start, how far they are followed, and what their last cell is.

    Ranges (t, k) are in the conventions of `Scan`, poses (t, 3) the robot's. InvalidInputError if shapes do not fit or
    poses are not finite.
    """
    robots = as_poses(poses)
    z, kinds = lengths_and_kinds(ranges, finder, model)
    if robots.ndim != 2 or z.shape != (len(robots), finder.n_beams):
        raise InvalidInputError(
            f"scans: expected ranges (t, {finder.n_beams}) and poses (t, 3), got {z.shape} and {robots.shape}"
        )
    mounts = finder.mounts
    starts = np.column_stack([robots[:, :2] / resolution, np.cos(robots[:, 2]), np.sin(robots[:, 2])])
    fan = np.stack([mounts[:, 0] / resolution, mounts[:, 1] / resolution, np.cos(mounts[:, 2]), np.sin(mounts[:, 2])])
    return FollowedBeams(starts, fan, z / resolution, kinds)
