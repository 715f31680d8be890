"""The landmark model's formula (6.40), Table 6.4, for one feature and one landmark, and loops over many poses.

Notation: ``d`` is the distance from the sensor to the landmark, ``r`` and ``phi`` are what was measured, without bias.
Features come as rows (r, cos phi, sin phi, 1 / sigma_r, 1 / sigma_phi); a value that was not measured has the weight 0
in place of 1 / sigma. ``base`` is the logarithm of all constants and of the signature's density.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.elementary import arc_tangent_2
from beamfield.kernels.jit import inlined_kernel, kernel

Floats = NDArray[np.float64]

# Poses of one pass of the vectorised loop: five columns of doubles stay in the nearest cache.
BLOCK = 512


@inlined_kernel
def log_value(x: float, y: float, cos: float, sin: float, landmark_x: float, landmark_y: float, r: float,
              cos_phi: float, sin_phi: float, range_weight: float, bearing_weight: float, base: float
              ) -> float:  # fmt: skip
    """Return the log density of one feature, given its landmark: line 5 of Table 6.4.

    The bearing's residual is the angle of the landmark after turning by heading and measured bearing, so it comes out
    wrapped. A landmark at the sensor itself counts as straight ahead.
    """
    dx, dy = landmark_x - x, landmark_y - y
    square = dx * dx + dy * dy
    dx = cos if square == 0.0 else dx
    dy = sin if square == 0.0 else dy
    ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
    bearing_error = arc_tangent_2(left * cos_phi - ahead * sin_phi, ahead * cos_phi + left * sin_phi)
    a = (math.sqrt(square) - r) * range_weight
    b = bearing_error * bearing_weight
    return base - 0.5 * (a * a + b * b)


@kernel
def fill_known(
    poses: Floats, mount: Floats, features: Floats, landmarks: Floats, base: Floats, first: int, out: Floats
) -> None:
    """Add up the log densities of features whose landmarks are known.

    Parameters
    ----------
    poses
        (n, 3) of the robot.
    mount
        (3,) position of the sensor on the robot in the *sensor's* axes, and its heading on the robot.
    features, landmarks, base
        (k, 5), (k, 2) and (k,).
    first
        Keep each feature in its own column of `out` from this one on; negative adds all features up in column 0.
    out
        (n, ...) the result.
    """
    x, y, cos, sin, total = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, poses.shape[0], BLOCK):
        m = min(BLOCK, poses.shape[0] - start)
        for i in range(m):
            heading = poses[start + i, 2] + mount[2]
            cos[i], sin[i] = math.cos(heading), math.sin(heading)
            x[i] = poses[start + i, 0] + cos[i] * mount[0] - sin[i] * mount[1]
            y[i] = poses[start + i, 1] + sin[i] * mount[0] + cos[i] * mount[1]
            total[i] = 0.0
        for k in range(features.shape[0]):
            lx, ly, constant = landmarks[k, 0], landmarks[k, 1], base[k]
            r, cos_phi, sin_phi = features[k, 0], features[k, 1], features[k, 2]
            w_r, w_phi = features[k, 3], features[k, 4]
            for i in range(m):
                total[i] += log_value(x[i], y[i], cos[i], sin[i], lx, ly, r, cos_phi, sin_phi, w_r, w_phi, constant)
            if first >= 0:
                for i in range(m):
                    out[start + i, first + k] = _never_nan(total[i])
                    total[i] = 0.0
        if first < 0:
            for i in range(m):
                out[start + i, 0] = _never_nan(total[i])


@kernel
def fill_candidates(
    poses: Floats, mount: Floats, features: Floats, landmarks: Floats, base: Floats, out: Floats
) -> None:
    """Fill in the log density of each feature given each landmark.

    `landmarks` is (2, N), so that the loop over them reads neighbours; base is (k, N), out (n, k, N).
    """
    across, along = landmarks[0], landmarks[1]
    for i in range(poses.shape[0]):
        heading = poses[i, 2] + mount[2]
        cos, sin = math.cos(heading), math.sin(heading)
        x = poses[i, 0] + cos * mount[0] - sin * mount[1]
        y = poses[i, 1] + sin * mount[0] + cos * mount[1]
        for k in range(features.shape[0]):
            r, cos_phi, sin_phi = features[k, 0], features[k, 1], features[k, 2]
            w_r, w_phi = features[k, 3], features[k, 4]
            constants, row = base[k], out[i, k]
            for j in range(across.size):
                row[j] = _never_nan(
                    log_value(x, y, cos, sin, across[j], along[j], r, cos_phi, sin_phi, w_r, w_phi, constants[j])
                )


@inlined_kernel
def _never_nan(value: float) -> float:
    """Return -inf for NaN: only coordinates beyond 1e150 m lead there."""
    return value if value == value else -math.inf
