"""Passes over beams for learning the intrinsic parameters (6.3.2, 6.3.3).

Beams are sorted by their expected range z* and cut into *bins* so narrow that every normaliser of the model, a smooth
function of z*, is a polynomial there to rounding. Two things follow. A beam costs two exponentials and one logarithm,
whatever the truncation; and the M-steps see the responsibilities through their Chebyshev moments per bin, which give
sum_i e_i F(z*_i) to rounding for every such F: exact one-dimensional M-steps without a second pass over beams.

Symbols: z measured range, zs expected range z*, r = z - z*, b range offset, v = sigma^2 + q z*^2 variance of a hit with
q = sigma_slope^2, C the mass of a hit inside [0, z_max], x = lambda z*.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import fast_kernel, kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

# Terms of the polynomials in a bin, and most beams in a bin: its scratch arrays stay in the first-level cache.
TERMS = 8
BIN_BEAMS = 1024
# Beyond this many standard deviations from 0 and z_max the cut of a hit changes no bit (1 - Phi(9) = 1e-19).
EDGE_SIGMAS = 9.0
# Support of p_short when z* is shorter, metres; the same as in kernels/beam.py.
SHORTEST_SUPPORT = 1e-6
# Densities below this are computed again in log space.
TINY_DENSITY = 1e-290
# Order of the derivatives: (w_hit, w_short, w_rand, v, q, b, lambda).
N_DERIVATIVES = 7

_NODES = np.cos(np.pi * (np.arange(TERMS) + 0.5) / TERMS)
# Row k: Chebyshev polynomials T_m at node k.
_CHEBYSHEV = np.cos(np.outer(np.pi * (np.arange(TERMS) + 0.5) / TERMS, np.arange(TERMS)))
# Values at the nodes times this: coefficients of 1, t, t^2 ...
_POWERS = np.linalg.inv(np.vander(_NODES, TERMS, increasing=True)).T.copy()
# Chebyshev moments times this: weights at the nodes.
NODE_WEIGHTS = np.ascontiguousarray((_CHEBYSHEV * np.where(np.arange(TERMS) == 0, 1.0, 2.0) / TERMS).T)

_LOG2_E = 1.4426950408889634
_LN2_HIGH = 6.93145751953125e-1
_LN2_LOW = 1.42860682030941723212e-6
_LN2 = 0.6931471805599453
_HALF_LOG_2PI = 0.9189385332046727


@kernel
def cut_into_bins(zs, max_range, v, q, b, lam, starts, stops, centres, half_widths, edge):  # type: ignore[no-untyped-def]
    """Cut beams sorted by `zs` into bins where all normalisers are polynomials to rounding; returns their number.

    A Chebyshev interpolant with 8 nodes over a half width h errs by about (2 a)^-8, a the distance to the nearest
    singularity over h: x / (1 - e^-x) has its at 2 pi i, 1 / v at i sigma / sqrt(q); log C is entire and sigma / 12 is
    narrow enough. Filled: first and last + 1 beam, centre, half width, whether the cut matters. If the arrays are too
    short for all bins, the number tells how long they must be.
    """
    n = zs.size
    n_bins = 0
    i = 0
    while i < n:
        low = zs[i]
        s = math.sqrt(v + q * low * low)
        width = 0.05 * max_range
        if lam * low < 40.0:
            width = min(width, 0.5 / lam) if lam > 0.0 else width
        if q > 0.0:
            width = min(width, 0.08 * math.sqrt(low * low + v / q))
        upper = max_range - b - EDGE_SIGMAS * math.sqrt(v + q * max_range * max_range)
        is_edge = low + b < EDGE_SIGMAS * s or low >= upper
        if is_edge:
            width = min(width, s / 6.0)
        elif low + width > upper:
            width = upper - low
        high = low + width
        stop = min(i + BIN_BEAMS, n)
        if zs[stop - 1] > high:  # the last beam of the bin is the last with zs <= high
            below, above = i, stop - 1
            while above - below > 1:
                middle = (below + above) // 2
                if zs[middle] > high:
                    above = middle
                else:
                    below = middle
            stop = above
        if n_bins < starts.size:
            starts[n_bins] = i
            stops[n_bins] = stop
            centres[n_bins] = 0.5 * (zs[i] + zs[stop - 1])
            half = 0.5 * (zs[stop - 1] - zs[i])
            half_widths[n_bins] = max(half, 1e-9 * max_range)
            edge[n_bins] = is_edge
        n_bins += 1
        i = stop
    return n_bins


@kernel
def em_pass(  # type: ignore[no-untyped-def]
    z, zs, counts, max_range, w_hit, w_short, w_rand, v, q, b, lam,
    starts, stops, centres, half_widths, edge, all_moments, first, last, sums, moments,
):  # fmt: skip
    """E-step over the bins [first, last): log-likelihood and sufficient statistics per bin.

    `counts` weighs beams, or is empty. ``sums[bin]`` = (log-likelihood, sum e_hit, sum e_short, sum e_rand, sum of
    e_short z); ``moments[bin, kind]`` = Chebyshev moments in z* of e_hit, e_hit r, e_hit r^2, e_short. Without
    `all_moments` and off the edges only the moment 0 of hit is filled, which is all that a constant variance needs.
    """
    coefficients = np.empty((3, TERMS))
    t = np.empty(BIN_BEAMS)
    r = np.empty(BIN_BEAMS)
    count = np.ones(BIN_BEAMS)
    shift = np.empty(BIN_BEAMS)
    hit = np.empty(BIN_BEAMS)
    short = np.empty(BIN_BEAMS)
    rand = np.empty(BIN_BEAMS)
    for j in range(first, last):
        start, stop = starts[j], stops[j]
        n = stop - start
        _normalisers(centres[j], half_widths[j], edge[j], max_range, v, q, b, lam, coefficients)
        if counts.size:
            count[:n] = counts[start:stop]
        _densities(z[start:stop], zs[start:stop], centres[j], 1.0 / half_widths[j], b, lam, coefficients,
                   1.0 / max_range, t, r, hit, short, rand, shift)  # fmt: skip
        least = _least_mixture(n, w_hit, w_short, w_rand, hit, short, rand)
        if least < TINY_DENSITY:
            _rescale(z[start:stop], zs[start:stop], n, b, lam, coefficients, max_range, w_hit, w_short, w_rand,
                     t, r, hit, short, rand, shift)  # fmt: skip
        _responsibilities(n, w_hit, w_short, w_rand, z[start:stop], count, hit, short, rand, shift, sums[j])
        if all_moments or edge[j]:
            _moments_of_hit(n, t, r, hit, moments[j])
        else:
            _first_moments_of_hit(n, r, hit, moments[j])
        _moments_of_short(n, t, short, moments[j, 3])


@kernel
def newton_pass(  # type: ignore[no-untyped-def]
    z, zs, counts, max_range, w_hit, w_short, w_rand, v, q, b, lam,
    starts, stops, centres, half_widths, edge, first, last, out,
):  # fmt: skip
    """Log-likelihood, gradient and Hessian over the bins [first, last).

    ``out[bin]`` = log-likelihood, 7 first and 28 second derivatives (lower triangle, row by row), in the order (w_hit,
    w_short, w_rand, v, q, b, lambda), the weights taken as independent.
    """
    coefficients = np.empty((3, TERMS))
    slopes = np.empty((7, TERMS))
    t = np.empty(BIN_BEAMS)
    r = np.empty(BIN_BEAMS)
    count = np.ones(BIN_BEAMS)
    shift = np.empty(BIN_BEAMS)
    hit = np.empty(BIN_BEAMS)
    short = np.empty(BIN_BEAMS)
    rand = np.empty(BIN_BEAMS)
    scores = np.empty((N_DERIVATIVES, BIN_BEAMS))
    for j in range(first, last):
        start, stop = starts[j], stops[j]
        n = stop - start
        _normalisers(centres[j], half_widths[j], edge[j], max_range, v, q, b, lam, coefficients)
        _slopes(centres[j], half_widths[j], edge[j], max_range, v, q, b, lam, slopes)
        if counts.size:
            count[:n] = counts[start:stop]
        _densities(z[start:stop], zs[start:stop], centres[j], 1.0 / half_widths[j], b, lam, coefficients,
                   1.0 / max_range, t, r, hit, short, rand, shift)  # fmt: skip
        least = _least_mixture(n, w_hit, w_short, w_rand, hit, short, rand)
        if least < TINY_DENSITY:
            _rescale(z[start:stop], zs[start:stop], n, b, lam, coefficients, max_range, w_hit, w_short, w_rand,
                     t, r, hit, short, rand, shift)  # fmt: skip
        _derivatives(n, w_hit, w_short, w_rand, z[start:stop], zs[start:stop], b, count, t, r, hit, short, rand, shift,
                     coefficients[1], slopes, scores, out[j])  # fmt: skip
        _outer_products(n, count, scores, out[j])


@kernel
def score_pass(  # type: ignore[no-untyped-def]
    z, zs, max_range, w_hit, w_short, w_rand, v, q, b, lam, starts, stops, centres, half_widths, edge, first, last, out
):  # fmt: skip
    """First derivatives of each beam's log-density, ``out[beam]``, in the order of `newton_pass`."""
    coefficients = np.empty((3, TERMS))
    slopes = np.empty((7, TERMS))
    t = np.empty(BIN_BEAMS)
    r = np.empty(BIN_BEAMS)
    count = np.ones(BIN_BEAMS)
    shift = np.empty(BIN_BEAMS)
    hit = np.empty(BIN_BEAMS)
    short = np.empty(BIN_BEAMS)
    rand = np.empty(BIN_BEAMS)
    scores = np.empty((N_DERIVATIVES, BIN_BEAMS))
    totals = np.empty(1 + N_DERIVATIVES + N_DERIVATIVES * (N_DERIVATIVES + 1) // 2)
    for j in range(first, last):
        start, stop = starts[j], stops[j]
        n = stop - start
        _normalisers(centres[j], half_widths[j], edge[j], max_range, v, q, b, lam, coefficients)
        _slopes(centres[j], half_widths[j], edge[j], max_range, v, q, b, lam, slopes)
        _densities(z[start:stop], zs[start:stop], centres[j], 1.0 / half_widths[j], b, lam, coefficients,
                   1.0 / max_range, t, r, hit, short, rand, shift)  # fmt: skip
        if _least_mixture(n, w_hit, w_short, w_rand, hit, short, rand) < TINY_DENSITY:
            _rescale(z[start:stop], zs[start:stop], n, b, lam, coefficients, max_range, w_hit, w_short, w_rand,
                     t, r, hit, short, rand, shift)  # fmt: skip
        _derivatives(n, w_hit, w_short, w_rand, z[start:stop], zs[start:stop], b, count, t, r, hit, short, rand, shift,
                     coefficients[1], slopes, scores, totals)  # fmt: skip
        for a in range(N_DERIVATIVES):
            for i in range(n):
                out[start + i, a] = scores[a, i]


@kernel
def hit_objective(zs, weights, weights_r, weights_r2, max_range, v, q, b, out):  # type: ignore[no-untyped-def]
    """Expected log-likelihood of the hits, from node weights: ``out`` = value, d/d(v, q, b), and vv qv qq bv bq bb."""
    out[:] = 0.0
    for k in range(zs.size):
        w = weights[k]
        z2 = zs[k] * zs[k]
        var = v + q * z2
        s = math.sqrt(var)
        mean = zs[k] + b
        log_c, l_m, l_v, l_mm, l_vm, l_vv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if mean < EDGE_SIGMAS * s or max_range - mean < EDGE_SIGMAS * s:
            log_c, l_m, l_v, l_mm, l_vm, l_vv = _log_cut_mass(mean, s, max_range)
        square = weights_r2[k] - 2.0 * b * weights_r[k] + b * b * w
        linear = weights_r[k] - b * w
        first = 0.5 * square / (var * var) - 0.5 * w / var - w * l_v
        second = -square / (var * var * var) + 0.5 * w / (var * var) - w * l_vv
        cross = -linear / (var * var) - w * l_vm
        out[0] += -0.5 * square / var - w * (math.log(s) + _HALF_LOG_2PI + log_c)
        out[1] += first
        out[2] += first * z2
        out[3] += linear / var - w * l_m
        out[4] += second
        out[5] += second * z2
        out[6] += second * z2 * z2
        out[7] += cross
        out[8] += cross * z2
        out[9] += -w / var - w * l_mm


@kernel
def short_objective(zs, weights, sum_z, lam):  # type: ignore[no-untyped-def]
    """Expected log-likelihood of the shorts up to a constant, from node weights, and its two derivatives in lambda."""
    value, first, second = -lam * sum_z, -sum_z, 0.0
    for k in range(zs.size):
        x = lam * zs[k]
        value += weights[k] * math.log(_relative_rate(x))
        first += weights[k] * zs[k] * _mean_share(x)
        second += weights[k] * zs[k] * zs[k] * _mean_share_slope(x)
    return value, first, second


@kernel
def _exp(x):  # type: ignore[no-untyped-def]
    # Written out because a call of the C library's exp keeps LLVM from vectorising the loop: 1 ns instead of 4.
    # Relative error below 5e-16 on [-708, 709]; clamped outside.
    x = min(max(x, -708.0), 709.0)
    k = math.floor(x * _LOG2_E + 0.5)
    y = (x - k * _LN2_HIGH) - k * _LN2_LOW
    p = 1.6059043836821613e-10
    p = p * y + 2.08767569878681e-09
    p = p * y + 2.505210838544172e-08
    p = p * y + 2.755731922398589e-07
    p = p * y + 2.7557319223985893e-06
    p = p * y + 2.48015873015873e-05
    p = p * y + 0.0001984126984126984
    p = p * y + 0.001388888888888889
    p = p * y + 0.008333333333333333
    p = p * y + 0.041666666666666664
    p = p * y + 0.16666666666666666
    p = p * y + 0.5
    p = p * y + 1.0
    p = p * y + 1.0
    return p * np.int64((np.int64(k) + np.int64(1023)) << np.int64(52)).view(np.float64)


@kernel
def _log(x):  # type: ignore[no-untyped-def]
    # As _exp: vectorises. Positive normal numbers only; absolute error below 5e-16 near 1, relative elsewhere.
    bits = np.float64(x).view(np.int64)
    e = (bits - np.int64(0x3FE6A09E667F3BCD)) >> np.int64(52)
    m = np.int64(bits - (e << np.int64(52))).view(np.float64)
    s = (m - 1.0) / (m + 1.0)
    y = s * s
    p = 1.0 / 21.0
    p = p * y + 1.0 / 19.0
    p = p * y + 1.0 / 17.0
    p = p * y + 1.0 / 15.0
    p = p * y + 1.0 / 13.0
    p = p * y + 1.0 / 11.0
    p = p * y + 1.0 / 9.0
    p = p * y + 1.0 / 7.0
    p = p * y + 1.0 / 5.0
    p = p * y + 1.0 / 3.0
    return e * _LN2 + 2.0 * s * (1.0 + p * y)


@kernel
def _polynomial(c, t):  # type: ignore[no-untyped-def]
    p = c[7]
    p = p * t + c[6]
    p = p * t + c[5]
    p = p * t + c[4]
    p = p * t + c[3]
    p = p * t + c[2]
    p = p * t + c[1]
    return p * t + c[0]


@kernel
def _normalisers(centre, half_width, edge, max_range, v, q, b, lam, out):  # type: ignore[no-untyped-def]
    # Polynomials in t = (z* - centre) / half_width: log of a hit's density at its mean, 1 / variance, x / (1 - e^-x).
    out[:] = 0.0
    for k in range(TERMS):
        zs = centre + half_width * _NODES[k]
        var = v + q * zs * zs
        s = math.sqrt(var)
        log_peak = -math.log(s) - _HALF_LOG_2PI
        if edge:
            log_peak -= math.log(_cut_mass(zs + b, s, max_range))
        inverse = 1.0 / var
        rate = _relative_rate(lam * max(zs, SHORTEST_SUPPORT))
        for m in range(TERMS):
            out[0, m] += log_peak * _POWERS[k, m]
            out[1, m] += inverse * _POWERS[k, m]
            out[2, m] += rate * _POWERS[k, m]
    if q == 0.0:  # so that the common case holds without rounding
        out[1, :] = 0.0
        out[1, 0] = 1.0 / v


@kernel
def _slopes(centre, half_width, edge, max_range, v, q, b, lam, out):  # type: ignore[no-untyped-def]
    # Polynomials of the derivatives: of log C in b, v, bb, vb, vv; the mean share of a short and its slope in x.
    out[:] = 0.0
    for k in range(TERMS):
        zs = centre + half_width * _NODES[k]
        mean_share = _mean_share(lam * zs)
        mean_share_slope = _mean_share_slope(lam * zs)
        for m in range(TERMS):
            out[5, m] += mean_share * _POWERS[k, m]
            out[6, m] += mean_share_slope * _POWERS[k, m]
        if edge:
            _, l_m, l_v, l_mm, l_vm, l_vv = _log_cut_mass(zs + b, math.sqrt(v + q * zs * zs), max_range)
            for m in range(TERMS):
                out[0, m] += l_m * _POWERS[k, m]
                out[1, m] += l_v * _POWERS[k, m]
                out[2, m] += l_mm * _POWERS[k, m]
                out[3, m] += l_vm * _POWERS[k, m]
                out[4, m] += l_vv * _POWERS[k, m]


@kernel
def _cut_mass(mean, s, max_range):  # type: ignore[no-untyped-def]
    # C, the mass of N(mean, s^2) in [0, max_range]; not below 1e-300 (a mean 37 sigma outside).
    low = -mean / (s * math.sqrt(2.0))
    high = (max_range - mean) / (s * math.sqrt(2.0))
    if low > 0.0:  # differences of the smaller tails keep their digits
        mass = 0.5 * (math.erfc(low) - math.erfc(high))
    elif high < 0.0:
        mass = 0.5 * (math.erfc(-high) - math.erfc(-low))
    else:
        mass = 1.0 - 0.5 * (math.erfc(-low) + math.erfc(high))
    return max(mass, 1e-300)


@kernel
def _log_cut_mass(mean, s, max_range):  # type: ignore[no-untyped-def]
    # log C and its derivatives in mean, v, mean mean, v mean, v v. C solves the heat equation: dC/dv = C'' / 2.
    mass = _cut_mass(mean, s, max_range)
    low = -mean / s
    high = (max_range - mean) / s
    phi_low = math.exp(-0.5 * low * low - _HALF_LOG_2PI)
    phi_high = math.exp(-0.5 * high * high - _HALF_LOG_2PI)
    d1 = (phi_low - phi_high) / s / mass
    d2 = (low * phi_low - high * phi_high) / s**2 / mass
    d3 = ((low * low - 1.0) * phi_low - (high * high - 1.0) * phi_high) / s**3 / mass
    d4 = ((low**3 - 3.0 * low) * phi_low - (high**3 - 3.0 * high) * phi_high) / s**4 / mass
    return (
        math.log(mass),
        d1,
        0.5 * d2,
        d2 - d1 * d1,
        0.5 * d3 - 0.5 * d1 * d2,
        0.25 * d4 - 0.25 * d2 * d2,
    )


@kernel
def _relative_rate(x):  # type: ignore[no-untyped-def]
    # x / (1 - e^-x): a short's density at z = 0 relative to the uniform one on [0, z*]; 1 at x = 0.
    if x < 1e-5:
        return 1.0 + 0.5 * x + x * x / 12.0
    return x / -math.expm1(-x)


@kernel
def _mean_share(x):  # type: ignore[no-untyped-def]
    # 1/x - 1/(e^x - 1): the mean of a short over z*; 1/2 at x = 0.
    if x < 0.01:
        return 0.5 - x / 12.0 + x**3 / 720.0 - x**5 / 30240.0
    if x > 700.0:
        return 1.0 / x
    return 1.0 / x - 1.0 / math.expm1(x)


@kernel
def _mean_share_slope(x):  # type: ignore[no-untyped-def]
    # Its derivative: minus the variance of a short over z*^2; -1/12 at x = 0.
    if x < 0.1:
        x2 = x * x
        return -1.0 / 12.0 + x2 * (1.0 / 240.0 - x2 * (1.0 / 6048.0 - x2 * (1.0 / 172800.0 - x2 / 5322240.0)))
    if x > 700.0:
        return -1.0 / (x * x)
    e = math.expm1(x)
    return (1.0 + 1.0 / e) / e - 1.0 / (x * x)


@fast_kernel
def _densities(  # type: ignore[no-untyped-def]
    z, zs, centre, inverse_half_width, b, lam, coefficients, uniform, t, r, hit, short, rand, shift
):  # fmt: skip
    # Component densities of one bin, (6.5), (6.7), (6.11), with their normalisers.
    log_peak = coefficients[0]
    inverse_variance = coefficients[1]
    rate = coefficients[2]
    for i in range(z.size):
        t_i = (zs[i] - centre) * inverse_half_width
        r_i = z[i] - zs[i]
        d = r_i - b
        t[i] = t_i
        r[i] = r_i
        hit[i] = _exp(_polynomial(log_peak, t_i) - 0.5 * d * d * _polynomial(inverse_variance, t_i))
    for i in range(z.size):
        support = max(zs[i], SHORTEST_SUPPORT)
        s = _polynomial(rate, t[i]) / support * _exp(-lam * z[i])
        short[i] = s if z[i] <= support else 0.0
    for i in range(z.size):
        rand[i] = uniform
        shift[i] = 0.0


@fast_kernel
def _least_mixture(n, w_hit, w_short, w_rand, hit, short, rand):  # type: ignore[no-untyped-def]
    least = 1e300
    for i in range(n):
        least = min(least, w_hit * hit[i] + w_short * short[i] + w_rand * rand[i])
    return least


@kernel
def _rescale(  # type: ignore[no-untyped-def]
    z, zs, n, b, lam, coefficients, max_range, w_hit, w_short, w_rand, t, r, hit, short, rand, shift
):  # fmt: skip
    # Where the mixture underflows, divide all densities by e^shift, the largest weighted one.
    for i in range(n):
        if w_hit * hit[i] + w_short * short[i] + w_rand * rand[i] >= TINY_DENSITY:
            continue
        d = r[i] - b
        log_hit = _polynomial(coefficients[0], t[i]) - 0.5 * d * d * _polynomial(coefficients[1], t[i])
        log_short = -math.inf
        support = max(zs[i], SHORTEST_SUPPORT)
        if z[i] <= support:
            log_short = math.log(_polynomial(coefficients[2], t[i]) / support) - lam * z[i]
        log_rand = -math.log(max_range)
        top = -math.inf
        if w_hit > 0.0:
            top = max(top, log_hit + math.log(w_hit))
        if w_short > 0.0 and log_short > -math.inf:
            top = max(top, log_short + math.log(w_short))
        if w_rand > 0.0:
            top = max(top, log_rand + math.log(w_rand))
        if top == -math.inf:  # no component explains it: likelihood 0
            hit[i], short[i], rand[i], shift[i] = 0.0, 0.0, 0.0, -math.inf
            continue
        # A component of weight 0 may be far denser than the mixture; its gain is kept finite.
        hit[i] = math.exp(min(log_hit - top, 600.0))
        short[i] = math.exp(min(log_short - top, 600.0))
        rand[i] = math.exp(min(log_rand - top, 600.0))
        shift[i] = top


@fast_kernel
def _mixture_sums(n, w_hit, w_short, w_rand, z, count, hit, short, rand):  # type: ignore[no-untyped-def]
    # Turns densities into responsibilities times counts; returns the sums of log p, e_hit, e_short, e_rand, e_short z.
    log_sum = 0.0
    sum_hit = 0.0
    sum_short = 0.0
    sum_rand = 0.0
    sum_short_z = 0.0
    for i in range(n):
        p = max(w_hit * hit[i] + w_short * short[i] + w_rand * rand[i], 1e-300)
        c = count[i]
        log_sum += c * _log(p)
        share = c / p
        e_hit = w_hit * hit[i] * share
        e_short = w_short * short[i] * share
        hit[i] = e_hit
        short[i] = e_short
        sum_hit += e_hit
        sum_short += e_short
        sum_rand += w_rand * rand[i] * share
        sum_short_z += e_short * z[i]
    return log_sum, sum_hit, sum_short, sum_rand, sum_short_z


@kernel
def _shift_sum(n, count, shift):  # type: ignore[no-untyped-def]
    # Not in the fast loop: a shift may be -inf. A beam of count 0 counts for nothing even then.
    total = 0.0
    for i in range(n):
        if shift[i] != 0.0 and count[i] > 0.0:
            total += count[i] * shift[i]
    return total


@kernel
def _responsibilities(n, w_hit, w_short, w_rand, z, count, hit, short, rand, shift, sums):  # type: ignore[no-untyped-def]
    log_sum, sum_hit, sum_short, sum_rand, sum_short_z = _mixture_sums(
        n, w_hit, w_short, w_rand, z, count, hit, short, rand
    )
    sums[0] = log_sum + _shift_sum(n, count, shift)
    sums[1] = sum_hit
    sums[2] = sum_short
    sums[3] = sum_rand
    sums[4] = sum_short_z


@fast_kernel
def _chebyshev_moments(n, t, e):  # type: ignore[no-untyped-def]
    m0, m1, m2, m3, m4, m5, m6, m7 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        x = t[i]
        y = 2.0 * x
        t2 = y * x - 1.0
        t3 = y * t2 - x
        t4 = y * t3 - t2
        t5 = y * t4 - t3
        t6 = y * t5 - t4
        t7 = y * t6 - t5
        m0 += e[i]
        m1 += e[i] * x
        m2 += e[i] * t2
        m3 += e[i] * t3
        m4 += e[i] * t4
        m5 += e[i] * t5
        m6 += e[i] * t6
        m7 += e[i] * t7
    return m0, m1, m2, m3, m4, m5, m6, m7


@kernel
def _moments_of_short(n, t, e, out):  # type: ignore[no-untyped-def]
    out[0], out[1], out[2], out[3], out[4], out[5], out[6], out[7] = _chebyshev_moments(n, t, e)


@kernel
def _moments_of_hit(n, t, r, e, out):  # type: ignore[no-untyped-def]
    for kind in range(3):
        o = out[kind]
        o[0], o[1], o[2], o[3], o[4], o[5], o[6], o[7] = _chebyshev_moments(n, t, e)
        if kind < 2:
            for i in range(n):
                e[i] *= r[i]


@fast_kernel
def _first_moments_of_hit(n, r, e, out):  # type: ignore[no-untyped-def]
    m0, m1, m2 = 0.0, 0.0, 0.0
    for i in range(n):
        y = e[i] * r[i]
        m0 += e[i]
        m1 += y
        m2 += y * r[i]
    out[0, 0] = m0
    out[1, 0] = m1
    out[2, 0] = m2


@fast_kernel
def _derivative_sums(  # type: ignore[no-untyped-def]
    n, w_hit, w_short, w_rand, z, zs, b, count, t, r, hit, short, rand, inverse_variance, slopes, scores, out
):  # fmt: skip
    # Scores per beam, and the part of the Hessian that is not their outer product; see (6.24) with c summed out.
    g_hit, g_short, g_rand, g_v, g_q, g_b, g_lam = (
        scores[0], scores[1], scores[2], scores[3], scores[4], scores[5], scores[6],
    )  # fmt: skip
    log_sum = 0.0
    s0, s1, s2, s3, s4, s5, s6 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    hv, hq, hb, sl = 0.0, 0.0, 0.0, 0.0
    vv, qv, qq, bv, bq, bb, ll = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        p = max(w_hit * hit[i] + w_short * short[i] + w_rand * rand[i], 1e-300)
        c = count[i]
        log_sum += c * _log(p)
        u_hit = hit[i] / p
        u_short = short[i] / p
        u_rand = rand[i] / p
        x = t[i]
        d = r[i] - b
        z2 = zs[i] * zs[i]
        inverse = _polynomial(inverse_variance, x)
        scaled = d * d * inverse
        a_v = 0.5 * inverse * (scaled - 1.0) - _polynomial(slopes[1], x)
        a_b = d * inverse - _polynomial(slopes[0], x)
        a_vv = inverse * inverse * (0.5 - scaled) - _polynomial(slopes[4], x)
        a_vb = -d * inverse * inverse - _polynomial(slopes[3], x)
        a_bb = -inverse - _polynomial(slopes[2], x)
        a_l = zs[i] * _polynomial(slopes[5], x) - z[i]
        a_ll = z2 * _polynomial(slopes[6], x)
        e_hit = w_hit * u_hit
        e_short = w_short * u_short
        g_hit[i] = u_hit
        g_short[i] = u_short
        g_rand[i] = u_rand
        g_v[i] = e_hit * a_v
        g_q[i] = e_hit * a_v * z2
        g_b[i] = e_hit * a_b
        g_lam[i] = e_short * a_l
        s0 += c * u_hit
        s1 += c * u_short
        s2 += c * u_rand
        s3 += c * e_hit * a_v
        s4 += c * e_hit * a_v * z2
        s5 += c * e_hit * a_b
        s6 += c * e_short * a_l
        hv += c * u_hit * a_v
        hq += c * u_hit * a_v * z2
        hb += c * u_hit * a_b
        sl += c * u_short * a_l
        second = c * e_hit * (a_v * a_v + a_vv)
        vv += second
        qv += second * z2
        qq += second * z2 * z2
        cross = c * e_hit * (a_v * a_b + a_vb)
        bv += cross
        bq += cross * z2
        bb += c * e_hit * (a_b * a_b + a_bb)
        ll += c * e_short * (a_l * a_l + a_ll)
    out[0] = log_sum
    out[1], out[2], out[3], out[4], out[5], out[6], out[7] = s0, s1, s2, s3, s4, s5, s6
    out[8:] = 0.0
    out[14], out[18], out[23] = hv, hq, hb
    out[30] = sl
    out[17] = vv
    out[21], out[22] = qv, qq
    out[26], out[27], out[28] = bv, bq, bb
    out[35] = ll


@kernel
def _derivatives(  # type: ignore[no-untyped-def]
    n, w_hit, w_short, w_rand, z, zs, b, count, t, r, hit, short, rand, shift, inverse_variance, slopes, scores, out
):  # fmt: skip
    _derivative_sums(
        n, w_hit, w_short, w_rand, z, zs, b, count, t, r, hit, short, rand, inverse_variance, slopes, scores, out
    )
    out[0] += _shift_sum(n, count, shift)


@fast_kernel
def _outer_products(n, count, scores, out):  # type: ignore[no-untyped-def]
    k = 1 + N_DERIVATIVES
    for a in range(N_DERIVATIVES):
        left = scores[a]
        for c in range(a + 1):
            right = scores[c]
            total = 0.0
            for i in range(n):
                total += count[i] * left[i] * right[i]
            out[k] -= total
            k += 1
