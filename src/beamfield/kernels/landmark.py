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

from beamfield.kernels.elementary import arc_tangent_2, never_nan
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


class Block(NamedTuple):
    """Columns for some poses: sensor, unit vector along a bearing, least costs with an index in their last bits."""

    x: Floats
    y: Floats
    cos: Floats
    sin: Floats
    ahead_x: Floats
    ahead_y: Floats
    first: Floats
    second: Floats
    third: Floats


class Candidates(NamedTuple):
    """One landmark for each pose: position, constant, and the log density of a feature given it."""

    x: Floats
    y: Floats
    base: Floats
    value: Floats


# Poses of one pass of the vectorised loops: their columns of doubles stay in the nearest cache.
BLOCK = 512
# The square of a chord, times the one and less the other, is below the square of the angle as computed.
CHORD, CHORD_ERROR = 1.0 - 1e-6, 1e-14
# Bounds of costs are wider by a relative slack, and by what rounding makes of angles in radians and of ranges by their
# own length.
SLACK, ROUNDED = 1e-6, 1e-13
# Bits of an index that takes the place of a cost's last ones, and a cost that is no subnormal number with it.
INDEX_MASK, LEAST_COST = np.int64(2**20 - 1), 1e-300


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
                    out[start + i, k] += never_nan(total[i])
                    total[i] = 0.0
        if not each:
            for i in range(m):
                out[start + i, 0] += never_nan(total[i])


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
                row[j] = never_nan(log_value(sensor, across[j], along[j], feature, constants[j]))


@kernel
def fill_nearest(
    poses: Floats, mount: Floats, features: Floats, landmarks: Floats, base: Floats, log_landmark: float,
    log_spurious: Floats, out: Floats, chosen: Indices,
) -> None:  # fmt: skip
    """Fill in the most probable correspondence of each feature: the first of the largest values of `fill_candidates`.

    Two landmarks of the least cost are tried, the others only where a third could win; the result has the same bits.

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
    n = landmarks.shape[1]
    most, lack = _most_and_lack(base)
    at, one, two = Block(*_columns(), *_columns(), np.empty(BLOCK)), Candidates(*_columns()), Candidates(*_columns())
    cost = np.empty(max(n, BLOCK))
    for start in range(0, poses.shape[0], BLOCK):
        m = min(BLOCK, poses.shape[0] - start)
        for i in range(m):
            at.x[i], at.y[i], at.cos[i], at.sin[i] = _sensor(poses[start + i], mount)
        for k in range(features.shape[0]):
            feature, none, room = _measured(features[k]), log_spurious[k], _room_for_rounding(_measured(features[k]))
            _find_least(m, at, feature, landmarks, lack[k], cost)
            _fill_values(m, at, feature, landmarks, base[k], at.first, one)
            _fill_values(m, at, feature, landmarks, base[k], at.second, two)
            for i in range(m):
                which, best = _better(_index(at.first[i]), one.value[i], _index(at.second[i]), two.value[i])
                limit = (1.0 + SLACK) * 2.0 * (most[k] - max(best, none - log_landmark)) + room
                # A limit that is NaN says nothing.
                if not at.third[i] > limit:
                    which, best = _best_of_all(i, at, feature, landmarks, base[k], lack[k], limit, cost, which, best)
                best += log_landmark
                out[start + i, k] = max(best, none)
                chosen[start + i, k] = which if best >= none else n
                if out[start + i, k] == -math.inf:
                    chosen[start + i, k] = n + 1


@kernel
def _most_and_lack(base: Floats) -> tuple[Floats, Floats]:
    """Return the largest constant of each feature (k,), and twice what each landmark's is below it (k, N)."""
    most, lack = np.empty(base.shape[0]), np.empty(base.shape)
    for k in range(base.shape[0]):
        most[k] = base[k].max()
        for j in range(base.shape[1]):
            lack[k, j] = 2.0 * (most[k] - base[k, j])
    return most, lack


@kernel
def _find_least(m: int, at: Block, feature: Measured, landmarks: Floats, lack: Floats, cost: Floats) -> None:
    """Fill in where a feature's bearing points and its three least costs, at m poses; `cost` is overwritten.

    With range and bearing, no root or quotient is needed: see `_scale_of_places`.
    """
    r, cos_phi, sin_phi, _, _ = feature
    across, along, scale = landmarks[0], landmarks[1], _scale_of_places(feature)
    for i in range(m):
        at.ahead_x[i] = at.cos[i] * cos_phi - at.sin[i] * sin_phi
        at.ahead_y[i] = at.sin[i] * cos_phi + at.cos[i] * sin_phi
        at.first[i] = at.second[i] = math.inf
        # Beyond what an index can say, nothing is known of the others.
        at.third[i] = math.inf if across.size <= INDEX_MASK else 0.0
    for j in range(across.size):
        if scale > 0.0:
            for i in range(m):
                dx, dy = across[j] - at.x[i], along[j] - at.y[i]
                ex, ey = dx - r * at.ahead_x[i], dy - r * at.ahead_y[i]
                cost[i] = scale * (ex * ex + ey * ey) + lack[j]
        else:
            for i in range(m):
                dx, dy = across[j] - at.x[i], along[j] - at.y[i]
                cost[i] = _cost(dx, dy, at.ahead_x[i], at.ahead_y[i], feature) + lack[j]
        for i in range(m):
            c = _with_index(cost[i], j)
            at.first[i], at.second[i], at.third[i] = _three_least(c, at.first[i], at.second[i], at.third[i])


@inlined_kernel
def _three_least(cost: float, first: float, second: float, third: float) -> tuple[float, float, float]:
    """Return the three least of four, of which the last three ascend; a cost that is NaN is none of them."""
    least = cost if cost < first else first
    cost = first if cost < first else cost
    middle = cost if cost < second else second
    cost = second if cost < second else cost
    # The sum changes nothing but what LLVM makes of it: not a store under a mask, which takes twice as long.
    return least + 0.0, middle, cost if cost < third else third


@inlined_kernel
def _with_index(cost: float, j: int) -> float:
    """Return a cost, or a little less, with an index in its last bits; least for NaN, NaN for infinity."""
    bits = np.float64(cost if cost > LEAST_COST else LEAST_COST).view(np.int64)
    return float(np.int64((bits & ~INDEX_MASK) | (np.int64(j) & INDEX_MASK)).view(np.float64))


@inlined_kernel
def _index(cost: float) -> int:
    """Return the index in the last bits of a cost."""
    return int(np.float64(cost).view(np.int64) & INDEX_MASK)


@kernel
def _fill_values(
    m: int, at: Block, feature: Measured, landmarks: Floats, base: Floats, least: Floats, out: Candidates
) -> None:
    """Fill in the log density of a feature given the landmark of a least cost, at m poses."""
    # Apart from the look-ups, so that the second loop is vectorised.
    for i in range(m):
        j = _index(least[i])
        out.x[i], out.y[i], out.base[i] = landmarks[0, j], landmarks[1, j], base[j]
    for i in range(m):
        sensor = at.x[i], at.y[i], at.cos[i], at.sin[i]
        out.value[i] = never_nan(log_value(sensor, out.x[i], out.y[i], feature, out.base[i]))


@inlined_kernel
def _best_of_all(
    i: int, at: Block, feature: Measured, landmarks: Floats, base: Floats, lack: Floats, limit: float, cost: Floats,
    which: int, best: float,
) -> tuple[int, float]:  # fmt: skip
    """Return the best landmark for a pose and its value: `which` or one whose ranges and bearings cost no more."""
    across, along, sensor = landmarks[0], landmarks[1], (at.x[i], at.y[i], at.cos[i], at.sin[i])
    for j in range(across.size):
        dx, dy = across[j] - at.x[i], along[j] - at.y[i]
        cost[j] = _cost(dx, dy, at.ahead_x[i], at.ahead_y[i], feature) + lack[j]
    for j in range(across.size):
        # A cost that is NaN says nothing.
        if not cost[j] > limit:
            value = never_nan(log_value(sensor, across[j], along[j], feature, base[j]))
            which, best = _better(which, best, j, value)
    return which, best


@inlined_kernel
def _better(which: int, best: float, other: int, value: float) -> tuple[int, float]:
    """Return the better of two landmarks with its value, the first of equal ones."""
    if value > best or (value == best and other < which):
        return other, value
    return which, best


@inlined_kernel
def _cost(dx: float, dy: float, ahead_x: float, ahead_y: float, feature: Measured) -> float:
    """Return what a landmark costs at least: its squared Mahalanobis distance with a chord for the bearing's angle.

    The chord is shorter than the angle by more than either is rounded.
    """
    r, _, _, range_weight, bearing_weight = feature
    distance = math.sqrt(dx * dx + dy * dy)
    chord = CHORD * (2.0 - 2.0 * (dx * ahead_x + dy * ahead_y) / distance) - CHORD_ERROR
    a = (distance - r) * range_weight
    return a * a + max(chord, 0.0) * bearing_weight * bearing_weight


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


@kernel
def _columns() -> tuple[Floats, Floats, Floats, Floats]:
    return np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)


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
