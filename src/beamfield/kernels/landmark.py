"""The landmark model's formula (6.40), Table 6.4, for one feature and one landmark, and loops over many poses.

Notation: ``d`` is the distance from the sensor to the landmark, ``r`` and ``phi`` are what was measured, without bias.
Features come as rows (r, cos phi, sin phi, 1 / sigma_r, 1 / sigma_phi); a value that was not measured has the weight 0
in place of 1 / sigma. ``base`` is the logarithm of all constants and of the signature's density.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.elementary import arc_tangent_2
from beamfield.kernels.jit import inlined_kernel, kernel

Floats = NDArray[np.float64]

# Position of the sensor, and its heading's cosine and sine.
Sensor = tuple[float, float, float, float]
# Measured range, cosine and sine of the measured bearing, and what residuals of range and bearing count.
Measured = tuple[float, float, float, float, float]

LOG_2PI = math.log(2.0 * math.pi)


class Noise(NamedTuple):
    """What is known of the sensor: `LandmarkParameters`, as logarithms and weights."""

    range_bias: float
    range_scale: float
    bearing_bias: float
    range_weight: float  # range_scale / sigma_r
    bearing_weight: float  # 1 / sigma_phi
    log_range: float  # logarithm of the constants of range and of bearing
    log_bearing: float
    max_range: float  # of features of no landmark; infinite if there are none with a range
    log_max_range: float


# Poses of one pass of the vectorised loop: five columns of doubles stay in the nearest cache.
BLOCK = 512

# The square of a chord, times the one and less the other, is below the square of the angle as computed.
CHORD, CHORD_ERROR = 1.0 - 1e-6, 1e-14


@inlined_kernel
def log_value(sensor: Sensor, landmark_x: float, landmark_y: float, feature: Measured, base: float) -> float:
    """Return the log density of one feature, given its landmark: line 5 of Table 6.4.

    The bearing's residual is the angle of the landmark after turning by heading and measured bearing, so it comes out
    wrapped. A landmark at the sensor itself counts as straight ahead.
    """
    x, y, cos, sin = sensor
    r, cos_phi, sin_phi, range_weight, bearing_weight = feature
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
def describe_features(ranges: Floats, bearings: Floats, noise: Noise, features: Floats, logs: Floats) -> None:
    """Turn what was measured into what the other kernels need; NaN was not measured.

    Parameters
    ----------
    ranges, bearings
        (k,) metres and radians.
    noise
        Of the sensor.
    features
        (k, 5) overwritten.
    logs
        (k, N + 1) log densities of the signatures given each landmark and given none; what ranges and bearings add
        to them is added: the constants given a landmark, all of the log density given none.
    """
    for k in range(ranges.size):
        has_range, has_bearing = not math.isnan(ranges[k]), not math.isnan(bearings[k])
        phi = bearings[k] - noise.bearing_bias if has_bearing else 0.0
        features[k, 0] = (ranges[k] - noise.range_bias) / noise.range_scale if has_range else 0.0
        features[k, 1], features[k, 2] = math.cos(phi), math.sin(phi)
        features[k, 3] = noise.range_weight if has_range else 0.0
        features[k, 4] = noise.bearing_weight if has_bearing else 0.0
        constant = (noise.log_range if has_range else 0.0) + (noise.log_bearing if has_bearing else 0.0)
        last = logs.shape[1] - 1
        for j in range(last):
            logs[k, j] += constant
        outside = has_range and not 0.0 <= ranges[k] <= noise.max_range
        none = (-noise.log_max_range if has_range else 0.0) - (LOG_2PI if has_bearing else 0.0)
        logs[k, last] += -math.inf if outside else none


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
            x[i], y[i], cos[i], sin[i] = _sensor(poses[start + i], mount)
            total[i] = 0.0
        for k in range(features.shape[0]):
            lx, ly, constant, feature = landmarks[k, 0], landmarks[k, 1], base[k], _measured(features[k])
            for i in range(m):
                total[i] += log_value((x[i], y[i], cos[i], sin[i]), lx, ly, feature, constant)
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
        sensor = _sensor(poses[i], mount)
        for k in range(features.shape[0]):
            feature, constants, row = _measured(features[k]), base[k], out[i, k]
            for j in range(across.size):
                row[j] = _never_nan(log_value(sensor, across[j], along[j], feature, constants[j]))


@kernel
def fill_nearest(
    poses: Floats, mount: Floats, features: Floats, landmarks: Floats, base: Floats, log_landmark: float,
    log_spurious: Floats, out: Floats, chosen: NDArray[np.int64],
) -> None:  # fmt: skip
    """Fill in the most probable correspondence of each feature: the first of the largest values of `fill_candidates`.

    Candidates whose bound is below the best value so far need no angle; the result has the same bits.

    Parameters
    ----------
    poses, mount, features, landmarks, base
        As for `fill_candidates`, of N landmarks.
    log_landmark, log_spurious
        Logarithms of each landmark's share, and (k,) of the density given none times its probability.
    out
        (n, k) the value of the best, its share included.
    chosen
        (n, k) its index; N where none is more probable, N + 1 where nothing is possible.
    """
    across, along = landmarks[0], landmarks[1]
    bounds = np.empty(across.size)
    for i in range(poses.shape[0]):
        sensor = _sensor(poses[i], mount)
        for k in range(features.shape[0]):
            feature, constants = _measured(features[k]), base[k]
            for j in range(across.size):
                bounds[j] = _bound(sensor, across[j], along[j], feature, constants[j])
            first, largest = 0, bounds[0]
            for j in range(1, across.size):
                if bounds[j] > largest:
                    first, largest = j, bounds[j]
            which, best = first, _never_nan(log_value(sensor, across[first], along[first], feature, constants[first]))
            for j in range(across.size):
                # A bound that is NaN says nothing.
                if not bounds[j] < best and j != first:
                    value = _never_nan(log_value(sensor, across[j], along[j], feature, constants[j]))
                    if value > best or (value == best and j < which):
                        which, best = j, value
            best += log_landmark
            out[i, k] = max(best, log_spurious[k])
            chosen[i, k] = which if best >= log_spurious[k] else across.size
            if out[i, k] == -math.inf:
                chosen[i, k] = across.size + 1


@inlined_kernel
def _bound(sensor: Sensor, landmark_x: float, landmark_y: float, feature: Measured, base: float) -> float:
    """Return a bound on `log_value` by the chord, which is shorter than the angle by more than either is rounded."""
    x, y, cos, sin = sensor
    r, cos_phi, sin_phi, range_weight, bearing_weight = feature
    dx, dy = landmark_x - x, landmark_y - y
    square = dx * dx + dy * dy
    distance = math.sqrt(square)
    ahead, left = dx * cos + dy * sin, dy * cos - dx * sin
    chord = CHORD * (2.0 - 2.0 * (ahead * cos_phi + left * sin_phi) / distance) - CHORD_ERROR
    a = (distance - r) * range_weight
    b = max(chord, 0.0) * bearing_weight * bearing_weight
    return base - 0.5 * (a * a + b)


@inlined_kernel
def _sensor(pose: Floats, mount: Floats) -> Sensor:
    """Return where the sensor of a robot is."""
    heading = pose[2] + mount[2]
    cos, sin = math.cos(heading), math.sin(heading)
    return pose[0] + cos * mount[0] - sin * mount[1], pose[1] + sin * mount[0] + cos * mount[1], cos, sin


@inlined_kernel
def _measured(feature: Floats) -> Measured:
    """Return a row of features."""
    return feature[0], feature[1], feature[2], feature[3], feature[4]


@inlined_kernel
def _never_nan(value: float) -> float:
    """Return -inf for NaN: only coordinates beyond 1e150 m lead there."""
    return value if value == value else -math.inf
