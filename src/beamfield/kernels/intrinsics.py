"""Passes over beams for learning the intrinsic parameters (6.3.2, 6.3.3).

Beams are sorted by their expected range z* and cut into bins (`narrow_bins`) so narrow that every normaliser of the
model, a smooth function of z*, is a polynomial there to rounding. Two things follow. A beam costs two exponentials and
one logarithm, whatever the truncation; and the M-steps see the responsibilities through their Chebyshev moments per
bin, which give sum_i e_i F(z*_i) to rounding for every such F: exact one-dimensional M-steps without a second pass.

Symbols: z measured range, zs expected range z*, r = z - z*, b range offset, v = sigma^2 + q z*^2 variance of a hit with
q = sigma_slope^2, C the mass of a hit inside [0, z_max], x = lambda z*. Of a sensor that measures nothing below some
min_range, z, z* and z_max are counted from there, the `origin`; the variance is then v + q (origin + z*)^2.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.cuts import HALF_LOG_2PI, log_cut_mass, log_mass, mean_share, relative_rate
from beamfield.kernels.elementary import fast_exp, fast_log
from beamfield.kernels.jit import inlined_fast_kernel, inlined_kernel, kernel
from beamfield.kernels.narrow_bins import BIN_BEAMS, NODES, POWERS, SHORTEST_SUPPORT, TERMS, Bins, Mixture

FloatArray = NDArray[np.float64]

# Mixtures below this are computed again in log space; squares of a density over its mixture must not overflow.
TINY_DENSITY = 1e-140
# Order of the derivatives: (w_hit, w_short, w_rand, v, q, b, lambda).
N_DERIVATIVES = 7


class Beams(NamedTuple):
    """Beams sorted by expected range; `counts` says how often each counts, or is empty for once."""

    ranges: FloatArray
    expected: FloatArray
    counts: FloatArray


class Scratch(NamedTuple):
    """Columns for the beams of one bin: t = (z* - centre) / half width, r, how often each counts, three densities.

    Where a mixture underflows, its densities are divided by e^shift.
    """

    t: FloatArray
    r: FloatArray
    repeats: FloatArray
    hit: FloatArray
    short: FloatArray
    rand: FloatArray
    shift: FloatArray


@kernel
def em_pass(beams: Beams, mixture: Mixture, bins: Bins, all_moments: bool, first: int, last: int,
            sums: FloatArray, moments: FloatArray) -> None:  # fmt: skip
    """E-step over the bins [first, last): log-likelihood and sufficient statistics per bin.

    ``sums[bin]`` = (log-likelihood, sum e_hit, sum e_short, sum e_rand, sum of e_short z); ``moments[bin, kind]`` =
    Chebyshev moments in z* of e_hit, e_hit r, e_hit r^2, e_short. Without `all_moments` and off the edges only the
    moment 0 of hit is filled, which is all that a constant variance needs.
    """
    polynomials = np.empty((3, TERMS))
    scratch = _scratch()
    for j in range(first, last):
        part = _beams_between(beams, bins.starts[j], bins.stops[j])
        _normalisers(bins, j, mixture, polynomials)
        n = _fill_densities(part, mixture, bins, j, polynomials, scratch)
        _responsibilities(n, mixture, part.ranges, scratch, sums[j])
        sums[j, 0] += _shift_sum(n, scratch)
        if all_moments or bins.edge[j]:
            _moments_of_hit(n, scratch, moments[j])
        else:
            _first_moments_of_hit(n, scratch.r, scratch.hit, moments[j])
        _chebyshev_moments(n, scratch.t, scratch.short, moments[j, 3])


@kernel
def newton_pass(beams: Beams, mixture: Mixture, bins: Bins, first: int, last: int, out: FloatArray) -> None:
    """Log-likelihood, gradient and Hessian over the bins [first, last).

    ``out[bin]`` = log-likelihood, 7 first and 28 second derivatives (lower triangle, row by row), in the order (w_hit,
    w_short, w_rand, v, q, b, lambda), the weights taken as independent.
    """
    polynomials = np.empty((3, TERMS))
    slopes = np.empty((7, TERMS))
    scores = np.empty((N_DERIVATIVES, BIN_BEAMS))
    scratch = _scratch()
    for j in range(first, last):
        part = _beams_between(beams, bins.starts[j], bins.stops[j])
        _normalisers(bins, j, mixture, polynomials)
        _slopes(bins, j, mixture, slopes)
        n = _fill_densities(part, mixture, bins, j, polynomials, scratch)
        _derivatives(n, part.ranges, part.expected, mixture, scratch, polynomials[1], slopes, scores, out[j])
        out[j, 0] += _shift_sum(n, scratch)
        _outer_products(n, scratch.repeats, scores, out[j])


@kernel
def _scratch() -> Scratch:
    n = BIN_BEAMS
    return Scratch(np.empty(n), np.empty(n), np.ones(n), np.empty(n), np.empty(n), np.empty(n), np.empty(n))


@inlined_kernel
def _beams_between(beams: Beams, start: int, stop: int) -> Beams:
    return Beams(beams.ranges[start:stop], beams.expected[start:stop], beams.counts[start:stop])


@inlined_kernel
def _fill_densities(
    part: Beams, mixture: Mixture, bins: Bins, j: int, polynomials: FloatArray, scratch: Scratch
) -> int:
    # Densities of beams of bin j, all or some, into `scratch`; returns how many they are.
    n = part.ranges.size
    # A slice assigned to a slice would have Numba compile the text of its error, for a second.
    for i in range(part.counts.size):
        scratch.repeats[i] = part.counts[i]
    _densities(part.ranges, part.expected, bins.centres[j], 1.0 / bins.half_widths[j], mixture, polynomials, scratch)
    if _least_mixture(n, mixture, scratch) < TINY_DENSITY:
        _rescale(part.ranges, part.expected, n, mixture, polynomials, scratch)
    return int(n)


@inlined_fast_kernel
def _polynomial(c: FloatArray, t: float) -> float:
    return float(((((((c[7] * t + c[6]) * t + c[5]) * t + c[4]) * t + c[3]) * t + c[2]) * t + c[1]) * t + c[0])


@kernel
def _normalisers(bins: Bins, j: int, mixture: Mixture, out: FloatArray) -> None:
    # Polynomials in t = (z* - centre) / half width: log of a hit's density at its mean, 1 / variance, x / (1 - e^-x).
    out[:] = 0.0
    for k in range(TERMS):
        expected = bins.centres[j] + bins.half_widths[j] * NODES[k]
        distance = mixture.origin + expected
        s = math.sqrt(mixture.v + mixture.q * distance * distance)
        log_peak = -math.log(s) - HALF_LOG_2PI
        if bins.edge[j]:
            log_peak -= log_mass(-(expected + mixture.b) / s, (mixture.max_range - expected - mixture.b) / s)
        inverse = 1.0 / (s * s)
        rate = relative_rate(mixture.rate * max(expected, SHORTEST_SUPPORT))
        for m in range(TERMS):
            out[0, m] += log_peak * POWERS[k, m]
            out[1, m] += inverse * POWERS[k, m]
            out[2, m] += rate * POWERS[k, m]
    if mixture.q == 0.0:  # so that the common case holds without rounding
        out[1, :] = 0.0
        out[1, 0] = 1.0 / mixture.v


@kernel
def _slopes(bins: Bins, j: int, mixture: Mixture, out: FloatArray) -> None:
    # Polynomials of the derivatives: of log C in b, v, bb, vb, vv; the mean share of a short and its slope in x.
    out[:] = 0.0
    for k in range(TERMS):
        expected = bins.centres[j] + bins.half_widths[j] * NODES[k]
        share, slope = mean_share(mixture.rate * expected)
        for m in range(TERMS):
            out[5, m] += share * POWERS[k, m]
            out[6, m] += slope * POWERS[k, m]
        if bins.edge[j]:
            distance = mixture.origin + expected
            s = math.sqrt(mixture.v + mixture.q * distance * distance)
            _, l_m, l_v, l_mm, l_vm, l_vv = log_cut_mass(expected + mixture.b, s, mixture.max_range)
            for m in range(TERMS):
                out[0, m] += l_m * POWERS[k, m]
                out[1, m] += l_v * POWERS[k, m]
                out[2, m] += l_mm * POWERS[k, m]
                out[3, m] += l_vm * POWERS[k, m]
                out[4, m] += l_vv * POWERS[k, m]


@inlined_fast_kernel
def _densities(z: FloatArray, zs: FloatArray, centre: float, inverse_half_width: float, mixture: Mixture,
               polynomials: FloatArray, out: Scratch) -> None:  # fmt: skip
    # Component densities of one bin, (6.5), (6.7), (6.11), with their normalisers.
    log_peak, inverse_variance, relative_rate = polynomials[0], polynomials[1], polynomials[2]
    uniform = 1.0 / mixture.max_range
    for i in range(z.size):
        t = (zs[i] - centre) * inverse_half_width
        r = z[i] - zs[i]
        d = r - mixture.b
        out.t[i], out.r[i] = t, r
        out.hit[i] = fast_exp(_polynomial(log_peak, t) - 0.5 * d * d * _polynomial(inverse_variance, t))
    for i in range(z.size):
        support = max(zs[i], SHORTEST_SUPPORT)
        short = _polynomial(relative_rate, out.t[i]) / support * fast_exp(-mixture.rate * z[i])
        out.short[i] = short if z[i] <= support else 0.0
    for i in range(z.size):
        out.rand[i], out.shift[i] = uniform, 0.0


@inlined_fast_kernel
def _least_mixture(n: int, mixture: Mixture, scratch: Scratch) -> float:
    hit, short, rand, least = scratch.hit, scratch.short, scratch.rand, 1e300
    for i in range(n):
        least = min(least, mixture.w_hit * hit[i] + mixture.w_short * short[i] + mixture.w_rand * rand[i])
    return least


@kernel
def _rescale(
    z: FloatArray, expected: FloatArray, n: int, mixture: Mixture, polynomials: FloatArray, out: Scratch
) -> None:
    # Where the mixture underflows, divide all densities by e^shift, the largest weighted one.
    w_hit, w_short, w_rand = mixture.w_hit, mixture.w_short, mixture.w_rand
    for i in range(n):
        if w_hit * out.hit[i] + w_short * out.short[i] + w_rand * out.rand[i] >= TINY_DENSITY:
            continue
        d = out.r[i] - mixture.b
        t = out.t[i]
        log_hit = _polynomial(polynomials[0], t) - 0.5 * d * d * _polynomial(polynomials[1], t)
        log_short = -math.inf
        support = max(expected[i], SHORTEST_SUPPORT)
        if z[i] <= support:
            log_short = math.log(_polynomial(polynomials[2], t) / support) - mixture.rate * z[i]
        log_rand = -math.log(mixture.max_range)
        top = -math.inf
        if w_hit > 0.0:
            top = max(top, log_hit + math.log(w_hit))
        if w_short > 0.0 and log_short > -math.inf:
            top = max(top, log_short + math.log(w_short))
        if w_rand > 0.0:
            top = max(top, log_rand + math.log(w_rand))
        if top == -math.inf:  # no component explains it: likelihood 0
            out.hit[i], out.short[i], out.rand[i], out.shift[i] = 0.0, 0.0, 0.0, -math.inf
            continue
        # A component of weight 0 may be far denser than the mixture; its gain is kept finite.
        out.hit[i] = math.exp(min(log_hit - top, 300.0))
        out.short[i] = math.exp(min(log_short - top, 300.0))
        out.rand[i] = math.exp(min(log_rand - top, 300.0))
        out.shift[i] = top


@inlined_fast_kernel
def _responsibilities(n: int, mixture: Mixture, z: FloatArray, scratch: Scratch, out: FloatArray) -> None:
    # Turns densities into responsibilities times counts; fills in the sums of log p, e_hit, e_short, e_rand, e_short z.
    hit, short, rand, count = scratch.hit, scratch.short, scratch.rand, scratch.repeats
    w_hit, w_short, w_rand = mixture.w_hit, mixture.w_short, mixture.w_rand
    log_sum, sum_hit, sum_short, sum_rand, sum_short_z = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(n):
        p = max(w_hit * hit[i] + w_short * short[i] + w_rand * rand[i], 1e-300)
        c = count[i]
        log_sum += c * fast_log(p)
        share = c / p
        e_hit = w_hit * hit[i] * share
        e_short = w_short * short[i] * share
        hit[i] = e_hit
        short[i] = e_short
        sum_hit += e_hit
        sum_short += e_short
        sum_rand += w_rand * rand[i] * share
        sum_short_z += e_short * z[i]
    out[0], out[1], out[2], out[3], out[4] = log_sum, sum_hit, sum_short, sum_rand, sum_short_z


@kernel
def _shift_sum(n: int, scratch: Scratch) -> float:
    # Not in the fast loops: a shift may be -inf. A beam of count 0 counts for nothing even then.
    total = 0.0
    for i in range(n):
        if scratch.shift[i] != 0.0 and scratch.repeats[i] > 0.0:
            total += scratch.repeats[i] * scratch.shift[i]
    return total


@inlined_fast_kernel
def _chebyshev_moments(n: int, t: FloatArray, e: FloatArray, out: FloatArray) -> None:
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
    out[0], out[1], out[2], out[3], out[4], out[5], out[6], out[7] = m0, m1, m2, m3, m4, m5, m6, m7


@inlined_kernel
def _moments_of_hit(n: int, scratch: Scratch, out: FloatArray) -> None:
    for kind in range(3):
        _chebyshev_moments(n, scratch.t, scratch.hit, out[kind])
        for i in range(n):
            scratch.hit[i] *= scratch.r[i]


@inlined_fast_kernel
def _first_moments_of_hit(n: int, r: FloatArray, e: FloatArray, out: FloatArray) -> None:
    m0, m1, m2 = 0.0, 0.0, 0.0
    for i in range(n):
        y = e[i] * r[i]
        m0 += e[i]
        m1 += y
        m2 += y * r[i]
    out[0, 0], out[1, 0], out[2, 0] = m0, m1, m2


@inlined_fast_kernel
def _derivatives(n: int, z: FloatArray, zs: FloatArray, mixture: Mixture, scratch: Scratch,
                 inverse_variance: FloatArray, slopes: FloatArray, scores: FloatArray, out: FloatArray
                 ) -> None:  # fmt: skip
    # Scores per beam, and the part of the Hessian that is not their outer product; see (6.24) with c summed out.
    w_hit, w_short, w_rand, origin, b = mixture.w_hit, mixture.w_short, mixture.w_rand, mixture.origin, mixture.b
    t, r, count, hit, short, rand = scratch.t, scratch.r, scratch.repeats, scratch.hit, scratch.short, scratch.rand
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
        log_sum += c * fast_log(p)
        u_hit = hit[i] / p
        u_short = short[i] / p
        u_rand = rand[i] / p
        x = t[i]
        d = r[i] - b
        z2 = (origin + zs[i]) * (origin + zs[i])
        inverse = _polynomial(inverse_variance, x)
        scaled = d * d * inverse
        a_v = 0.5 * inverse * (scaled - 1.0) - _polynomial(slopes[1], x)
        a_b = d * inverse - _polynomial(slopes[0], x)
        a_vv = inverse * inverse * (0.5 - scaled) - _polynomial(slopes[4], x)
        a_vb = -d * inverse * inverse - _polynomial(slopes[3], x)
        a_bb = -inverse - _polynomial(slopes[2], x)
        a_l = zs[i] * _polynomial(slopes[5], x) - z[i]
        a_ll = zs[i] * zs[i] * _polynomial(slopes[6], x)
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
    out[17], out[21], out[22], out[26], out[27], out[28] = vv, qv, qq, bv, bq, bb
    out[30], out[35] = sl, ll


@inlined_fast_kernel
def _outer_products(n: int, count: FloatArray, scores: FloatArray, out: FloatArray) -> None:
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
