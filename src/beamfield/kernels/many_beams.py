"""Sums over many beams of the beam model's formulas (`beam`), in a form that vectorises.

Densities are computed by arithmetic alone, blocks of beams at a time; where they are too small for that, the full
formulas take over.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.beam import (
    INV_SQRT_2PI,
    SHORTEST_SUPPORT,
    SQRT_HALF,
    WHOLE_SIGMAS,
    BeamView,
    hit_normaliser,
    hit_sigma,
    log_mixture,
)
from beamfield.kernels.elementary import LOG2_E, ROUNDING, fast_log, fused_exp_2
from beamfield.kernels.jit import fused_kernel, inlined_fused_kernel, kernel, wide_vectors

Floats = NDArray[np.float64]

# exp(-u^2 / 2) = 2^(HALF_LOG2_E u^2); below 2^LEAST_BITS a hit does not count, and products of it stay normal numbers.
HALF_LOG2_E, LEAST_BITS = -0.5 * LOG2_E, -700.0
# Products of densities are turned into logarithms before they leave these bounds.
SMALL_PRODUCT, LARGE_PRODUCT = 1e-150, 1e150
# Eight factors from here on have a product that keeps its digits.
SMALLEST_FACTOR = 1e-37

# Beams of one pass of the vectorised loops: their densities stay in the nearest cache.
BLOCK = 512
# Loops over multiples of so many beams are vectorised to their end.
LANES = 32
# The normal distribution function and its derivative at every 1/32 sigma from 0 to WHOLE_SIGMAS.
NODES_PER_SIGMA = 32.0
NODE_MASK = 511
_BELOW = np.array([0.5 * math.erfc(-n / 32.0 * SQRT_HALF) for n in range(267)])
_SLOPE = np.array([INV_SQRT_2PI * math.exp(-0.5 * (n / 32.0) ** 2) for n in range(267)])


@inlined_fused_kernel
def _quick_normal_below(t: float) -> float:
    """Return the standard normal distribution function for 0 <= t, within 4e-16; that of the nearer limit outside.

    A Taylor series of order 6 around the nearest node: the next term is below 3e-16.
    """
    t = t if t < WHOLE_SIGMAS else WHOLE_SIGMAS
    t = t if t > 0.0 else 0.0
    rounded = t * NODES_PER_SIGMA + ROUNDING
    i = np.float64(rounded).view(np.int64) & NODE_MASK
    n = (rounded - ROUNDING) * (1.0 / NODES_PER_SIGMA)
    d = t - n
    m = n * n
    series = 1.0 / 120.0 * (m * (m - 6.0) + 3.0) - d / 720.0 * n * (m * (m - 10.0) + 15.0)
    series = (m - 1.0) / 6.0 - d * (n * (m - 3.0) / 24.0 - d * series)
    below: float = _BELOW[i] + _SLOPE[i] * d * (1.0 - d * (0.5 * n - d * series))
    return below


@kernel
def _limit_factor(view: BeamView) -> float:
    """Return the factor of `hit_normaliser` for z* = max_range (rays that hit nothing); -1 if it has an edge."""
    sigma = hit_sigma(view.max_range, view)
    factor, edge = hit_normaliser(view.max_range + view.range_offset, sigma, view.max_range)
    return factor if edge == 0.0 else -1.0


@inlined_fused_kernel
def _quick_mixture(
    z: float, decay: float, z_star: float, scale: float, cut_once: bool, at_limit: float, view: BeamView
) -> float:
    """Return `mixture`; 0 if it is below SMALLEST_FACTOR or needs the full formulas, 1 where there is no measurement.

    `decay` is exp(-lambda z) and `scale` 1 / sigma; `cut_once` says that a normal reaches one of the limits at most.
    """
    known = (z >= 0.0) & (z_star >= 0.0)
    z_star = z_star if z_star < view.max_range else view.max_range
    at_end = z_star == view.max_range
    mean = z_star + view.range_offset
    rest = view.max_range - mean
    near, far = (mean, rest) if mean < rest else (rest, mean)
    # With the mean in [0, max_range] at least half of the mass is, so that this sum keeps its digits unless the
    # interval is a narrow slice of the normal.
    mass = _quick_normal_below(near * scale)
    if not cut_once:
        mass = mass + (_quick_normal_below(far * scale) - 1.0)
    # hit / mass is p_hit. A negative at_limit comes with a mean beyond the limits.
    mass = 1.0 if at_end else mass
    sound = ((near >= 0.0) & (mass > 0.4)) | (at_end & (at_limit >= 0.0))
    u = (z - mean) * scale
    peak = view.z_hit * (at_limit if at_end else INV_SQRT_2PI * scale)
    hit = peak * fused_exp_2(max(HALF_LOG2_E * u * u, LEAST_BITS))
    # short / support is p_short: lambda / (1 - exp(-x)) exp(-lambda z) with x = lambda z*. For small x the difference
    # loses digits; the series' next term is below the last one.
    support = z_star if z_star > SHORTEST_SUPPORT else SHORTEST_SUPPORT
    x = view.lambda_short * support
    y = x * x
    series = 1.0 + 0.5 * x + y * (1.0 / 12.0 - y * (1.0 / 720.0 - y * (1.0 / 30240.0)))
    short = view.z_short * decay * (view.lambda_short if x > 0.1 else series)
    short = short if z <= support else 0.0
    share = 1.0 - fused_exp_2(-LOG2_E * x)
    support = share if x > 0.1 else support
    p = (hit * support + short * mass) / (mass * support) + view.z_rand / view.max_range
    p = p if sound & (p > SMALLEST_FACTOR) else 0.0
    p = p if z < view.max_range else view.z_max
    return p if known else 1.0


@fused_kernel
def _fill_quick(ranges: Floats, decay: Floats, expected: Floats, at_limit: float, view: BeamView, out: Floats) -> None:
    """Fill out (n,) with `_quick_mixture`; n is a multiple of LANES."""
    wide_vectors()
    widest = hit_sigma(view.max_range, view)
    # Given as a literal, Numba would compile the callee once for each.
    cut_once = view.sigma_slope == 0.0 and 2.0 * WHOLE_SIGMAS * widest < view.max_range
    if cut_once:
        scale = 1.0 / view.sigma_hit
        for i in range(out.size):
            out[i] = _quick_mixture(ranges[i], decay[i], expected[i], scale, cut_once, at_limit, view)
    else:
        for i in range(out.size):
            slope = view.sigma_slope * (view.min_range + min(expected[i], view.max_range))
            scale = 1.0 / math.sqrt(view.sigma_hit * view.sigma_hit + slope * slope)
            out[i] = _quick_mixture(ranges[i], decay[i], expected[i], scale, cut_once, at_limit, view)


@fused_kernel
def _fill_decay(ranges: Floats, view: BeamView, out: Floats) -> None:
    """Fill out (n,) with exp(-lambda z), z up to max_range; n is a multiple of LANES."""
    for i in range(out.size):
        # lambda may be 0 and a range infinite, whose product is no number.
        z = ranges[i] if ranges[i] < view.max_range else view.max_range
        out[i] = fused_exp_2(-LOG2_E * view.lambda_short * z)


@kernel
def _whole_vectors(n: int) -> int:
    """Return the least multiple of LANES from n on."""
    return (n + LANES - 1) // LANES * LANES


@kernel
def fill_log_density(ranges: Floats, expected: Floats, view: BeamView, out: Floats) -> None:
    """Fill out (n,) with `log_mixture` of ranges (n,) and expected (n,)."""
    at_limit = _limit_factor(view)
    size = _whole_vectors(min(BLOCK, ranges.size))
    z, z_star, decay, density = np.zeros(size), np.zeros(size), np.empty(size), np.empty(size)
    for start in range(0, ranges.size, BLOCK):
        n = min(BLOCK, ranges.size - start)
        for i in range(n):
            z[i], z_star[i] = ranges[start + i], expected[start + i]
        _fill_decay(z, view, decay)
        _fill_quick(z, decay, z_star, at_limit, view, density)
        for i in range(n):
            out[start + i] = fast_log(density[i])
        for i in range(n):
            if density[i] < SMALLEST_FACTOR:
                out[start + i] = _log_of(density[i], z[i], z_star[i], view)


@kernel
def fill_scan_log_likelihood(ranges: Floats, expected: Floats, view: BeamView, out: Floats) -> None:
    """Fill out (n,) with the sum over beams of `log_mixture`: (6.2) in log space, for one scan at n poses.

    `ranges` (k,) and `expected` (n, k). Densities are multiplied while the product stays far from the limits of a
    double and only then turned into a logarithm: a rounding error per factor is all it costs, less than adding
    logarithms does.
    """
    # Several poses per pass, because a pass is made of whole vectors.
    k = ranges.size
    n_together = max(1, min(BLOCK // k, expected.shape[0]))
    size = _whole_vectors(n_together * k)
    z, z_star, decay, density = np.zeros(size), np.zeros(size), np.empty(size), np.empty(size)
    for i in range(n_together):
        for b in range(k):
            z[i * k + b] = ranges[b]
    _fill_decay(z, view, decay)
    at_limit = _limit_factor(view)
    each = expected.reshape(-1)
    for start in range(0, expected.shape[0], n_together):
        n = min(n_together, expected.shape[0] - start)
        for j in range(n * k):
            z_star[j] = each[start * k + j]
        _fill_quick(z, decay, z_star, at_limit, view, density)
        _fill_sums_of_logs(density, ranges, z_star, view, out[start : start + n])


@kernel
def _fill_sums_of_logs(density: Floats, ranges: Floats, z_star: Floats, view: BeamView, out: Floats) -> None:
    """Fill out (n,) with the sum of the logarithms of the densities (n k,) at each pose, one for each range.

    `log_mixture` stands for those that are 0. All poses in one call: to count who holds the arrays that are handed over
    takes longer than the sum of a few.
    """
    k = ranges.size
    whole = k // 8 * 8
    for i in range(out.size):
        total, product, at = 0.0, 1.0, i * k
        # Eight at a time: one test for all, and they need not wait for each other.
        for j in range(at, at + whole, 8):
            a = (density[j] * density[j + 1]) * (density[j + 2] * density[j + 3])
            b = (density[j + 4] * density[j + 5]) * (density[j + 6] * density[j + 7])
            # 0 if one of them is: they are at least SMALLEST_FACTOR, so that products of eight do not vanish.
            factor = a * b
            if not SMALL_PRODUCT < factor < LARGE_PRODUCT:
                for m in range(j, j + 8):
                    total += _log_of(density[m], ranges[m - at], z_star[m], view)
                continue
            product *= factor
            if not SMALL_PRODUCT < product < LARGE_PRODUCT:
                total += math.log(product)
                product = 1.0
        for j in range(at + whole, at + k):
            p = density[j]
            if not SMALL_PRODUCT < p * product < LARGE_PRODUCT:
                total += _log_of(p, ranges[j - at], z_star[j], view)
            else:
                product *= p
        # Kept for the next loop, which is vectorised, where no later pose looks.
        out[i], density[i] = total, product
    for i in range(out.size):
        out[i] += fast_log(density[i])


@kernel
def _log_of(density: float, z: float, z_star: float, view: BeamView) -> float:
    """Return the logarithm of what `_quick_mixture` found, `log_mixture` if that is nothing."""
    return math.log(density) if density > 0.0 else log_mixture(z, min(z_star, view.max_range), view)
