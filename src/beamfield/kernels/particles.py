"""What a particle filter does with its particles between two calls of the models: weigh, draw, count bins, average."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.bins import slot_of
from beamfield.kernels.elementary import quick_sin_cos
from beamfield.kernels.jit import kernel

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

# The fractional part of the golden ratio: multiples of it, modulo 1, are spread evenly however many are taken.
GOLDEN = 0.6180339887498949
# Numbers of bins along x and y fit into so many, so that three of them make one integer.
MOST_BINS = 1 << 20
# Radians within which headings are averaged as they are.
_WRAP = 2.0 * math.pi


@kernel
def fill_weights(weights: FloatArray, log_likelihood: FloatArray, power: float, out: FloatArray) -> tuple[float, float]:
    """Multiply weights by the power of a likelihood, and normalise them.

    Parameters
    ----------
    weights
        (n,) at least 0, with the sum 1.
    log_likelihood
        (n,) nats; -inf where impossible, never NaN.
    power
        Above 0.
    out
        (n,) overwritten, may be `weights`; with the sum 1. Left as it is where all are impossible, or one is +inf.

    Returns
    -------
    log sum_i w_i p_i^power, -inf where all are impossible, +inf where one is; and the effective number of the new
    weights, 0 in both cases.
    """
    top = -math.inf
    for i in range(len(weights)):
        if weights[i] > 0.0 and log_likelihood[i] > top:
            top = log_likelihood[i]
    if top == -math.inf or top == math.inf:
        return top, 0.0
    # The likeliest particle keeps its weight, so that the sum is not 0 however small the others become.
    total = 0.0
    for i in range(len(weights)):
        # A particle of no weight may be likelier still, by more than a float holds.
        out[i] = weights[i] * math.exp(power * (log_likelihood[i] - top)) if weights[i] > 0.0 else 0.0
        total += out[i]
    squares = 0.0
    for i in range(len(weights)):
        out[i] /= total
        squares += out[i] * out[i]
    return power * top + math.log(total), 1.0 / squares


@kernel
def draw_systematically(weights: FloatArray, offset: float, out: IndexArray) -> None:
    """Draw indices by equally spaced points on the cumulated weights: low-variance resampling.

    Parameters
    ----------
    weights
        (n,) with the sum 1.
    offset
        Uniform in [0, 1).
    out
        (m,) overwritten with indices that do not fall.
    """
    last = _last_positive(weights)
    i, reached = 0, weights[0]
    for j in range(len(out)):
        point = (j + offset) / len(out)
        while point >= reached and i < last:
            i += 1
            reached += weights[i]
        out[j] = i


@kernel
def draw_until_enough(
    weights: FloatArray, bins: IndexArray, n_bins: int, enough: IndexArray, offset: float, out: IndexArray
) -> int:
    """Draw indices one by one until there are enough for the number of bins that they fall into (KLD sampling).

    Parameters
    ----------
    weights
        (n,) with the sum 1.
    bins
        (n,) bin of each particle, from 0 on.
    n_bins
        How many bins there are.
    enough
        (n_bins + 1,) how many draws are enough for 0, 1, 2 ... bins.
    offset
        Uniform in [0, 1): the first point. The others follow at the golden ratio, modulo 1, and are spread evenly at
        every length.
    out
        (m,) the first of them overwritten.

    Returns
    -------
    How many were drawn, at most m.
    """
    last = _last_positive(weights)
    cumulated = np.cumsum(weights)
    seen = np.zeros(n_bins, np.bool_)
    k = 0
    for j in range(len(out)):
        point = offset + j * GOLDEN
        i = min(int(np.searchsorted(cumulated, point - math.floor(point), side="right")), last)
        out[j] = i
        if not seen[bins[i]]:
            seen[bins[i]] = True
            k += 1
        if j + 1 >= enough[k]:
            return j + 1
    return len(out)


@kernel
def find_points(cumulated: FloatArray, points: FloatArray, out: IndexArray) -> None:
    """Find the particles in which points lie, by a table of as many equal parts as there are particles.

    From where its part begins, a point drawn at random is half a particle away, whatever the weights; bisection takes
    ten times as long.

    Parameters
    ----------
    cumulated
        (n,) sums of the weights. Points are shares of the last, which rounding may leave below 1.
    points
        (m,) in [0, 1).
    out
        (m,) overwritten with the first index whose sum exceeds the point's.
    """
    n, last, total = len(cumulated), len(cumulated) - 1, cumulated[-1]
    begins = np.empty(n, np.int64)
    i = 0
    for part in range(n):
        while i < last and cumulated[i] <= total * (part / n):
            i += 1
        begins[part] = i
    for j in range(len(points)):
        # Rounding may make a product of what is just below 1.
        i = begins[min(int(points[j] * n), last)]
        while i < last and cumulated[i] <= total * points[j]:
            i += 1
        out[j] = i


@kernel
def _last_positive(weights: FloatArray) -> int:
    """Return the last particle that can be drawn: rounding may leave the sum of the weights below a point."""
    last = len(weights) - 1
    while last > 0 and weights[last] == 0.0:
        last -= 1
    return last


@kernel
def number_bins(
    poses: FloatArray, cell: float, n_headings: int, slots: NDArray[np.int32], keys: IndexArray, bins: IndexArray
) -> int:
    """Number the bins of poses in the order of appearance.

    Parameters
    ----------
    poses
        (n, 3) finite poses.
    cell
        Side of a bin, metres.
    n_headings
        Bins of the heading around the circle.
    slots
        Hash table, a power of two long and at least 2 n: -1 throughout, then bin numbers.
    keys
        (n,) the first of them overwritten with what `_key` makes of each bin.
    bins
        (n,) overwritten.

    Returns
    -------
    How many bins there are.
    """
    count = 0
    # Counted from the first pose: a map's origin may be 5000 km away.
    first_col, first_row = np.floor(poses[0, 0] / cell), np.floor(poses[0, 1] / cell)
    for i in range(len(poses)):
        key = _key(
            _position_bin(poses[i, 0], cell, first_col),
            _position_bin(poses[i, 1], cell, first_row),
            int((poses[i, 2] / _WRAP - np.floor(poses[i, 2] / _WRAP)) * n_headings) % n_headings,
        )
        slot = slot_of(key, slots, keys)
        if slots[slot] < 0:
            slots[slot] = count
            keys[count] = key
            count += 1
        bins[i] = slots[slot]
    return count


@kernel
def join_neighbours(keys: IndexArray, n_headings: int, slots: NDArray[np.int32], clusters: IndexArray) -> int:
    """Number the groups of bins that touch, at faces, edges or corners.

    Parameters
    ----------
    keys
        (b,) what `number_bins` found.
    n_headings, slots
        As there, the table filled.
    clusters
        (b,) overwritten with the group of each bin, from 0 on.

    Returns
    -------
    How many groups there are.
    """
    for b in range(len(keys)):
        clusters[b] = b
    for b in range(len(keys)):
        col, row, heading = keys[b] >> 42, (keys[b] >> 21) & (2 * MOST_BINS - 1), keys[b] & (2 * MOST_BINS - 1)
        for step in range(14, 27):  # the other half of the neighbours sees this bin as its neighbour
            near = _key(
                col + step // 9 - 1, row + step // 3 % 3 - 1, (heading + step % 3 - 1 + n_headings) % n_headings
            )
            other = slots[slot_of(near, slots, keys)]
            if other >= 0:
                first, second = _root(b, clusters), _root(other, clusters)
                clusters[max(first, second)] = min(first, second)
    count = 0
    for b in range(len(keys)):
        # Roots come before the bins that point to them.
        if clusters[b] == b:
            clusters[b] = -1 - count
            count += 1
        else:
            clusters[b] = clusters[_first(b, clusters)]
    for b in range(len(keys)):
        clusters[b] = -1 - clusters[b]
    return count


@kernel
def _root(b: int, parents: IndexArray) -> int:
    while parents[b] != b:
        parents[b] = parents[parents[b]]
        b = parents[b]
    return b


@kernel
def _first(b: int, parents: IndexArray) -> int:
    """Return the bin before this one that is numbered already."""
    while parents[b] >= 0:
        b = parents[b]
    return b


@kernel
def _position_bin(value: float, cell: float, first: float) -> int:
    # The floor of NumPy, as that of `math` is an integer, which a large number overflows.
    return int(min(max(np.floor(value / cell) - first, -MOST_BINS + 2.0), MOST_BINS - 2.0)) + MOST_BINS


@kernel
def _key(col: int, row: int, heading: int) -> int:
    return (col << 42) | (row << 21) | heading


@kernel
def fill_moments(
    poses: FloatArray, weights: FloatArray, group: IndexArray, which: int, mean: FloatArray, covariance: FloatArray
) -> float:
    """Average weighted poses, headings on the circle.

    Parameters
    ----------
    poses, weights
        (n, 3) and (n,).
    group, which
        (n,) group of each particle, and the one that counts; without any element, all count.
    mean
        (3,) overwritten. The heading is that of the mean of unit vectors, in (-pi, pi].
    covariance
        (3, 3) overwritten, of the deviations from the mean, the heading's the short way round.

    Returns
    -------
    The weight of those that count; where it is 0 the outputs are left as they are.
    """
    everything = len(group) == 0
    total = x = y = c = s = 0.0
    for i in range(len(poses)):
        if everything or group[i] == which:
            w = weights[i]
            total += w
            x += w * (poses[i, 0] - poses[0, 0])
            y += w * (poses[i, 1] - poses[0, 1])
            sine, cosine = quick_sin_cos(poses[i, 2])
            c += w * cosine
            s += w * sine
    if total == 0.0:
        return 0.0
    mean[0], mean[1], mean[2] = poses[0, 0] + x / total, poses[0, 1] + y / total, math.atan2(s, c)
    covariance[:] = 0.0
    for i in range(len(poses)):
        if everything or group[i] == which:
            w = weights[i] / total
            dx, dy = poses[i, 0] - mean[0], poses[i, 1] - mean[1]
            turn = poses[i, 2] - mean[2]
            turn -= _WRAP * math.floor(turn / _WRAP + 0.5)
            covariance[0, 0] += w * dx * dx
            covariance[0, 1] += w * dx * dy
            covariance[0, 2] += w * dx * turn
            covariance[1, 1] += w * dy * dy
            covariance[1, 2] += w * dy * turn
            covariance[2, 2] += w * turn * turn
    covariance[1, 0], covariance[2, 0], covariance[2, 1] = covariance[0, 1], covariance[0, 2], covariance[1, 2]
    return total
