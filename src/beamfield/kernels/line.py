"""The density of one measured line given one mapped line, and loops over many poses.

Notation: a mapped line is (cos a, sin a, r, a); seen from the sensor it lies at the signed distance d = r - x cos a -
y sin a, in the direction a - theta. The same line is at -d, half a turn away. A measured line is (rho, alpha, w_rr, 2
w_ra, w_aa) with the inverse w of its covariance; ``base`` is the logarithm of all constants.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.elementary import never_nan
from beamfield.kernels.jit import inlined_kernel, kernel

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

# What squares and products of the residuals in rho and alpha count: of rho^2, 2 rho alpha, alpha^2.
Weights = tuple[float, float, float]

# Poses of one pass of the vectorised loop: its columns of doubles stay in the nearest cache.
BLOCK = 512
PI, TWO_PI, TURNS_PER_RADIAN = math.pi, 2.0 * math.pi, 0.5 / math.pi
# The second of the two pairs counts nothing when its exponent is so much smaller: exp(-40) = 4e-18.
NEGLIGIBLE = 40.0


@inlined_kernel
def _both_squares(d: float, turn: float, rho: float, weights: Weights) -> tuple[float, float]:
    """Return the squared Mahalanobis distances to (d, direction) and to (-d, direction + pi).

    `turn` is the measured minus the expected direction, radians, not wrapped.
    """
    one = turn - TWO_PI * np.floor(turn * TURNS_PER_RADIAN + 0.5)
    other = one - PI if one > 0.0 else one + PI
    e, f = rho - d, rho + d
    w_rr, two_w_ra, w_aa = weights
    return e * (w_rr * e + two_w_ra * one) + w_aa * one * one, f * (w_rr * f + two_w_ra * other) + w_aa * other * other


@kernel
def _fill_exponents(d: Floats, turn: Floats, alpha: float, rho: float, weights: Weights, best: Floats, gap: Floats
                    ) -> None:  # fmt: skip
    """Fill in the larger exponent of the two pairs, and how much smaller the other is, of mapped lines seen alike.

    A mapped line lies d (n,) from the sensor, in a direction of alpha - turn (n,) off the measured one.
    """
    for i in range(d.size):
        one, other = _both_squares(d[i], alpha - turn[i], rho, weights)
        best[i] = -0.5 * (one if one < other else other)
        gap[i] = 0.5 * abs(one - other)


@kernel
def _add_other_pair(best: Floats, gap: Floats) -> None:
    """Add the smaller of the two densities where it counts, which is rare."""
    for i in range(best.size):
        if gap[i] < NEGLIGIBLE:
            best[i] += math.log1p(math.exp(-gap[i]))


@kernel
def add_known(
    poses: Floats, mount: Floats, features: Floats, lines: Floats, base: Floats, known: Indices, which: Indices,
    each: bool, out: Floats,
) -> None:  # fmt: skip
    """Do what `landmark.add_known` does for measured lines (k, 5) and mapped ones (N, 4); base is (k,)."""
    x, y, turn, total = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    d, best, gap = np.empty(BLOCK), np.empty(BLOCK), np.empty(BLOCK)
    for start in range(0, poses.shape[0], BLOCK):
        m = min(BLOCK, poses.shape[0] - start)
        for i in range(m):
            x[i], y[i], heading, _, _ = _sensor(poses[start + i], mount)
            turn[i], total[i] = -heading, 0.0
        for f in range(known.size):
            k, j = known[f], which[f]
            cos, sin, r, a = lines[j, 0], lines[j, 1], lines[j, 2], lines[j, 3]
            for i in range(m):
                d[i] = r - x[i] * cos - y[i] * sin
            weights = features[k, 2], features[k, 3], features[k, 4]
            _fill_exponents(d[:m], turn[:m], features[k, 1] - a, features[k, 0], weights, best[:m], gap[:m])
            _add_other_pair(best[:m], gap[:m])
            for i in range(m):
                best[i] += base[k]
            if each:
                for i in range(m):
                    out[start + i, k] += never_nan(best[i])
            else:
                for i in range(m):
                    total[i] += best[i]
        if not each:
            for i in range(m):
                out[start + i, 0] += never_nan(total[i])


@kernel
def fill_candidates(poses: Floats, mount: Floats, features: Floats, lines: Floats, base: Floats, out: Floats) -> None:
    """Fill in the log density of each measured line given each mapped line.

    `lines` is (4, N), so that the loop over them reads neighbours; base is (k,), out (n, k, N).
    """
    cos, sin, r, a = lines[0], lines[1], lines[2], lines[3]
    n_lines = r.size
    d, gap = np.empty(n_lines), np.empty(n_lines)
    for i in range(poses.shape[0]):
        x, y, heading, _, _ = _sensor(poses[i], mount)
        for j in range(n_lines):
            d[j] = r[j] - x * cos[j] - y * sin[j]
        for k in range(features.shape[0]):
            weights = features[k, 2], features[k, 3], features[k, 4]
            row = out[i, k]
            _fill_exponents(d, a, features[k, 1] + heading, features[k, 0], weights, row, gap)
            _add_other_pair(row, gap)
            for j in range(n_lines):
                row[j] = never_nan(row[j] + base[k])


@kernel
def exclude_apart(
    poses: Floats, mount: Floats, ends: Floats, lines: Floats, extents: Floats, min_overlap: float, out: Floats
) -> None:
    """Set out (n, k, N) to -inf where too little of a measured segment lies beside a mapped one.

    `ends` is (k, 4) in the sensor's frame, `lines` (4, N), `extents` (2, N) along the mapped lines; `min_overlap` is
    the least share of the measured segment's length.
    """
    cos, sin, a = lines[0], lines[1], lines[3]
    for i in range(poses.shape[0]):
        x, y, _, c, s = _sensor(poses[i], mount)
        for k in range(ends.shape[0]):
            x1, y1 = x + c * ends[k, 0] - s * ends[k, 1], y + s * ends[k, 0] + c * ends[k, 1]
            x2, y2 = x + c * ends[k, 2] - s * ends[k, 3], y + s * ends[k, 2] + c * ends[k, 3]
            row = out[i, k]
            for j in range(a.size):
                one, two = y1 * cos[j] - x1 * sin[j], y2 * cos[j] - x2 * sin[j]
                low, high = (one, two) if one < two else (two, one)
                beside = min(high, extents[1, j]) - max(low, extents[0, j])
                row[j] = row[j] if beside >= min_overlap * (high - low) else -math.inf


@inlined_kernel
def _sensor(pose: Floats, mount: Floats) -> tuple[float, float, float, float, float]:
    """Return position and heading of the sensor of a robot, and the heading's cosine and sine."""
    heading = pose[2] + mount[2]
    cos, sin = math.cos(heading), math.sin(heading)
    return pose[0] + cos * mount[0] - sin * mount[1], pose[1] + sin * mount[0] + cos * mount[1], heading, cos, sin
