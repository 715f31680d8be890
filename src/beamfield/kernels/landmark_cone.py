"""The nearest landmark in a cone: points, or discs of a radius."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel

Floats = NDArray[np.float64]


@kernel
def nearest_in_cones(
    poses: Floats, mounts: Floats, landmarks: Floats, half: float, max_range: float, ranges: Floats
) -> None:
    """Find the nearest landmark in each cone.

    Parameters
    ----------
    poses
        (n, 3) robot poses in the map frame, metres and radians.
    mounts
        (k, 4) x, y, cos and sin of each cone's apex and axis in the robot frame.
    landmarks
        (m, 3) x, y and radius, metres.
    half
        Half the opening angle, below a quarter turn.
    max_range
        The sensor's limit, metres.
    ranges
        (n, k) metres, overwritten: at most max_range.
    """
    half_cos, half_sin = math.cos(half), math.sin(half)
    for i in range(poses.shape[0]):
        c, s = math.cos(poses[i, 2]), math.sin(poses[i, 2])
        for b in range(mounts.shape[0]):
            apex_x = poses[i, 0] + c * mounts[b, 0] - s * mounts[b, 1]
            apex_y = poses[i, 1] + s * mounts[b, 0] + c * mounts[b, 1]
            axis_x, axis_y = c * mounts[b, 2] - s * mounts[b, 3], s * mounts[b, 2] + c * mounts[b, 3]
            best = max_range
            for m in range(landmarks.shape[0]):
                dx, dy = landmarks[m, 0] - apex_x, landmarks[m, 1] - apex_y
                # Along the axis, and beside it; the cone is the same on both sides.
                along, beside = axis_x * dx + axis_y * dy, abs(axis_x * dy - axis_y * dx)
                best = min(best, _cone_range(along, beside, landmarks[m, 2], half_cos, half_sin))
            ranges[i, b] = best


@kernel
def _cone_range(along: float, beside: float, radius: float, half_cos: float, half_sin: float) -> float:
    """Return the distance from the apex to the part of a disc that is in the cone; inf if none is.

    `along` and `beside` >= 0 place the disc's centre along the cone's axis and beside it.
    """
    distance = math.hypot(along, beside)
    if distance <= radius:
        return 0.0
    # How far along the nearer edge of the cone the centre is, and how far outside the cone.
    on_edge, outside = along * half_cos + beside * half_sin, beside * half_cos - along * half_sin
    if on_edge <= 0.0 or outside > radius:
        return math.inf
    if outside <= 0.0:
        return distance - radius
    # Where the edge enters the disc: (1 - x)(1 + x) keeps the digits that 1 - x^2 loses.
    return on_edge - math.sqrt((radius - outside) * (radius + outside))
