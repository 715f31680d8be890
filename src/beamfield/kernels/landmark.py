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
Indices = NDArray[np.int64]

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
# Bounds of costs are wider by a relative slack, and by what rounding makes of angles in radians and of ranges by their
# own length.
SLACK, ROUNDED = 1e-6, 1e-13
# More candidates than this take longer than finding out which of them their bearings rule out.
FEW = 8
# Bits of an index that takes the place of a cost's last ones.
INDEX_MASK = np.int64(2**20 - 1)


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
def add_known(
    poses: Floats, mount: Floats, features: Floats, landmarks: Floats, base: Floats, known: Indices, which: Indices,
    each: bool, out: Floats,
) -> None:  # fmt: skip
    """Add up the log densities of features whose landmarks are known.

    Parameters
    ----------
    poses
        (n, 3) of the robot.
    mount
        (3,) position of the sensor on the robot in the *sensor's* axes, and its heading on the robot.
    features, landmarks, base
        (k, 5), (N, 2) and (k, N).
    known, which
        Indices of these features and of their landmarks.
    each
        Whether each feature has its own column of `out`; else all are added up in column 0.
    out
        (n, ...) added to.
    """
    x, y, cos, sin, total = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, poses.shape[0], BLOCK):
        m = min(BLOCK, poses.shape[0] - start)
        for i in range(m):
            x[i], y[i], cos[i], sin[i] = _sensor(poses[start + i], mount)
            total[i] = 0.0
        for f in range(known.size):
            k, j = known[f], which[f]
            lx, ly, constant, feature = landmarks[j, 0], landmarks[j, 1], base[k, j], _measured(features[k])
            for i in range(m):
                total[i] += log_value((x[i], y[i], cos[i], sin[i]), lx, ly, feature, constant)
            if each:
                for i in range(m):
                    out[start + i, k] += _never_nan(total[i])
                    total[i] = 0.0
        if not each:
            for i in range(m):
                out[start + i, 0] += _never_nan(total[i])


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
    log_spurious: Floats, out: Floats, chosen: Indices,
) -> None:  # fmt: skip
    """Fill in the most probable correspondence of each feature: the first of the largest values of `fill_candidates`.

    Only candidates whose least cost lets them win need an angle; the result has the same bits.

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
    lack, cost = np.empty(base.shape), np.empty(across.size)
    scales, most, room = np.empty(features.shape[0]), np.empty(features.shape[0]), np.empty(features.shape[0])
    for k in range(features.shape[0]):
        scales[k], room[k] = _scale_of_places(_measured(features[k])), _room_for_rounding(_measured(features[k]))
        most[k] = base[k, 0]
        for j in range(across.size):
            most[k] = max(most[k], base[k, j])
        for j in range(across.size):
            lack[k, j] = 2.0 * (most[k] - base[k, j])
    for i in range(poses.shape[0]):
        sensor = _sensor(poses[i], mount)
        for k in range(features.shape[0]):
            feature, constants = _measured(features[k]), base[k]
            # Where costs of places leave many candidates, those of ranges and bearings leave fewer.
            by_place = scales[k] > 0.0
            while True:
                if by_place:
                    _fill_costs_of_places(sensor, feature, scales[k], across, along, lack[k], cost)
                else:
                    _fill_costs(sensor, feature, across, along, lack[k], cost)
                first = _least(cost)
                best = _never_nan(log_value(sensor, across[first], along[first], feature, constants[first]))
                gain = most[k] - max(best, log_spurious[k] - log_landmark)
                limit = (1.0 + SLACK) * 2.0 * gain + room[k]
                # A cost that is NaN says nothing, nor does a limit that is.
                others = 0
                for j in range(across.size):
                    others += 0 if (cost[j] > limit) | (j == first) else 1
                if others <= FEW or not by_place:
                    break
                by_place = False
            which = first
            for j in range(across.size if others else 0):
                if not cost[j] > limit and j != first:
                    value = _never_nan(log_value(sensor, across[j], along[j], feature, constants[j]))
                    if value > best or (value == best and j < which):
                        which, best = j, value
            best += log_landmark
            out[i, k] = max(best, log_spurious[k])
            chosen[i, k] = which if best >= log_spurious[k] else across.size
            if out[i, k] == -math.inf:
                chosen[i, k] = across.size + 1


@inlined_kernel
def _fill_costs(sensor: Sensor, feature: Measured, across: Floats, along: Floats, lack: Floats, cost: Floats) -> None:
    """Fill in what each landmark costs at least: its squared Mahalanobis distance, and what its constant lacks.

    The chord is shorter than the angle by more than either is rounded.
    """
    x, y, cos, sin = sensor
    r, cos_phi, sin_phi, range_weight, bearing_weight = feature
    ahead_x, ahead_y = cos * cos_phi - sin * sin_phi, sin * cos_phi + cos * sin_phi
    for j in range(cost.size):
        dx, dy = across[j] - x, along[j] - y
        distance = math.sqrt(dx * dx + dy * dy)
        chord = CHORD * (2.0 - 2.0 * (dx * ahead_x + dy * ahead_y) / distance) - CHORD_ERROR
        a = (distance - r) * range_weight
        cost[j] = a * a + max(chord, 0.0) * bearing_weight * bearing_weight + lack[j]


@inlined_kernel
def _fill_costs_of_places(
    sensor: Sensor, feature: Measured, scale: float, across: Floats, along: Floats, lack: Floats, cost: Floats
) -> None:
    """Do so for a feature with range and bearing, without a root or a quotient; see `_scale_of_places`."""
    x, y, cos, sin = sensor
    r, cos_phi, sin_phi, _, _ = feature
    measured_x, measured_y = r * (cos * cos_phi - sin * sin_phi), r * (sin * cos_phi + cos * sin_phi)
    for j in range(cost.size):
        ex, ey = across[j] - x - measured_x, along[j] - y - measured_y
        cost[j] = scale * (ex * ex + ey * ey) + lack[j]


@kernel
def _scale_of_places(feature: Measured) -> float:
    """Return 1 / (sigma_r^2 + r^2 sigma_phi^2), 0 for a feature without range or bearing.

    A landmark at the distance d, off by the angle delta, is e <= |d - r| + r |delta| away from where it was measured.
    By the inequality of Cauchy and Schwarz, e^2 is at most the squared Mahalanobis distance divided by this.
    """
    r, _, _, range_weight, bearing_weight = feature
    if not (range_weight > 0.0 and bearing_weight > 0.0):
        return 0.0
    ratio = max(r, 0.0) * range_weight / bearing_weight
    return range_weight * range_weight / (1.0 + ratio * ratio)


@kernel
def _room_for_rounding(feature: Measured) -> float:
    """Return what a squared Mahalanobis distance may be beyond a limit, SLACK times the limit apart, by rounding."""
    r, _, _, range_weight, bearing_weight = feature
    rounded = ROUNDED * (bearing_weight + abs(r) * range_weight)
    # (m + rounded)^2 <= (1 + SLACK) m^2 + (1 + 1 / SLACK) rounded^2.
    return SLACK + (1.0 + 1.0 / SLACK) * rounded * rounded


@inlined_kernel
def _least(cost: Floats) -> int:
    """Return where the least cost is, or nearly; costs are not negative."""
    least = np.int64(2**63 - 1)
    for j in range(cost.size):
        # Doubles that are not negative are in the order of their bits; the last bits make room for the index.
        least = min(least, (np.float64(cost[j]).view(np.int64) & ~INDEX_MASK) | (np.int64(j) & INDEX_MASK))
    return int(least & INDEX_MASK)


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
