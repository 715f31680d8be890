"""The beam model's formulas (section 6.3) for one beam, and plain loops over many; `many_beams` has quicker ones.

The scalar functions come in the order of the chapter. With the JIT switched off (NUMBA_DISABLE_JIT=1) all of this is
plain Python and gives the same numbers.

Notation: ``z`` is the measured range, ``z_star`` the expected one, both in metres. A range in [0, max_range) has a
density; max_range itself ("no return") has the point mass of (6.10) and nothing else. Other ranges (NaN, negative) are
no measurements; so is any range whose expected range is NaN. Of a sensor that measures nothing below some min_range,
both ranges and max_range are counted from there; only the noise of a hit grows with the whole expected range.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel, shared

Floats = NDArray[np.float64]

INV_SQRT_2PI = 0.3989422804014327
SQRT_HALF_PI = 1.2533141373155003
SQRT_HALF = 0.7071067811865476

# A normal cut off further than this many sigma from its mean keeps all of its mass in double precision: each tail
# holds 5.2e-17, half of the spacing of doubles below 1.
WHOLE_SIGMAS = 8.3
# Beyond this many sigma the normal density nears underflow, and integrals are scaled by its largest value.
DEEP_SIGMAS = 25.0
# p_short lives on [0, z*]; as z* -> 0 its density diverges and tends to a point mass at 0. Its support is never taken
# shorter than a micrometre, which no range finder resolves: the density stays finite and still integrates to 1.
SHORTEST_SUPPORT = 1e-6
# Below this density the mixture is summed in log space instead, so that no possible range gets -inf.
SMALL_DENSITY = 1e-290

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(32)


class BeamView(NamedTuple):
    """What the kernels need to know: the intrinsic parameters (6.3.2) and the sensor's limits.

    All ranges, `max_range` too, are counted from `min_range`.
    """

    z_hit: float
    z_short: float
    z_max: float
    z_rand: float
    sigma_hit: float
    lambda_short: float
    range_offset: float
    sigma_slope: float
    max_range: float
    min_range: float = 0.0


@shared
def normal_interval(low: float, high: float) -> tuple[float, float]:
    """Return (v, e) with v = integral of exp(-(t^2 - e^2) / 2) from low to high: (6.6) without its constants.

    ``e`` is 0 unless the interval lies deep in a tail or is a narrow slice beside the mean, where differences of erf
    would lose digits; then it is the end nearest to the mean.
    """
    if high <= low:
        return 0.0, 0.0
    if low <= 0.0 <= high:
        return SQRT_HALF_PI * (math.erf(high * SQRT_HALF) + math.erf(-low * SQRT_HALF)), 0.0
    near, far = (low, high) if low > 0.0 else (-high, -low)
    width = far - near
    if width >= 1.0 and near < DEEP_SIGMAS:
        return SQRT_HALF_PI * (math.erfc(near * SQRT_HALF) - math.erfc(far * SQRT_HALF)), 0.0
    # What lies further than this falls below exp(-45) of the value at the near end. 32 nodes integrate
    # exp(-near t - t^2 / 2) over such a stretch to the last digits.
    half = 0.5 * min(width, 90.0 / (near + math.sqrt(near * near + 90.0)))
    total = 0.0
    for i in range(_NODES.size):
        t = half * (1.0 + _NODES[i])
        total += _WEIGHTS[i] * math.exp(-t * (near + 0.5 * t))
    return half * total, near


@shared
def hit_sigma(z_star: float, view: BeamView) -> float:
    """Return the standard deviation of a hit; it may grow with the expected range."""
    if view.sigma_slope == 0.0:
        return view.sigma_hit
    return math.hypot(view.sigma_hit, view.sigma_slope * (view.min_range + z_star))


@shared
def hit_normaliser(mean: float, sigma: float, max_range: float) -> tuple[float, float]:
    """Return (f, e) so that p_hit(z) = f exp(-(u^2 - e^2) / 2) with u = (z - mean) / sigma: (6.5) and (6.6)."""
    if mean > WHOLE_SIGMAS * sigma and mean < max_range - WHOLE_SIGMAS * sigma:
        return INV_SQRT_2PI / sigma, 0.0
    mass, edge = normal_interval(-mean / sigma, (max_range - mean) / sigma)
    return 1.0 / (sigma * mass), edge


@shared
def hit_density(z: float, z_star: float, view: BeamView) -> float:
    """Return p_hit (6.4), a density on [0, max_range); its mean is the expected range plus the range offset."""
    if not 0.0 <= z < view.max_range:
        return 0.0
    sigma = hit_sigma(z_star, view)
    mean = z_star + view.range_offset
    factor, edge = hit_normaliser(mean, sigma, view.max_range)
    u = (z - mean) / sigma
    return factor * math.exp(-0.5 * (u - edge) * (u + edge))


@shared
def short_factor(z_star: float, lambda_short: float) -> float:
    """Return eta lambda of (6.7), with eta from (6.9): lambda / (1 - exp(-lambda z*)); 1 / z* for lambda = 0."""
    support = max(z_star, SHORTEST_SUPPORT)
    x = lambda_short * support
    if x < 1e-8:
        return (1.0 + 0.5 * x) / support  # the series' next term is x^2 / 12: below the last digit
    return lambda_short / -math.expm1(-x)


@shared
def short_density(z: float, z_star: float, view: BeamView) -> float:
    """Return p_short (6.7), a density on [0, z*], or on the first micrometre if z* is shorter."""
    if not 0.0 <= z < view.max_range or z > max(z_star, SHORTEST_SUPPORT):
        return 0.0
    return short_factor(z_star, view.lambda_short) * math.exp(-view.lambda_short * z)


@shared
def max_mass(z: float, max_range: float) -> float:
    """Return p_max (6.10): a probability, not a density."""
    return 1.0 if z >= max_range else 0.0


@shared
def rand_density(z: float, max_range: float) -> float:
    """Return p_rand (6.11), a density on [0, max_range)."""
    return 1.0 / max_range if 0.0 <= z < max_range else 0.0


@shared
def mixture(z: float, z_star: float, view: BeamView) -> float:
    """Return (6.12): a density for z in [0, max_range), a probability for z >= max_range."""
    if z >= view.max_range:
        return view.z_max
    return (
        view.z_hit * hit_density(z, z_star, view)
        + view.z_short * short_density(z, z_star, view)
        + view.z_rand * rand_density(z, view.max_range)
    )


@kernel
def _is_measurement(z: float, z_star: float) -> bool:
    """Whether a beam says anything: its range is not NaN, not negative, and its expected range is known."""
    return z >= 0.0 and z_star >= 0.0


@kernel
def _log_or_minus_infinity(x: float) -> float:
    """Return log x, and -inf for 0."""
    return math.log(x) if x > 0.0 else -math.inf


@kernel
def _log_parts(z: float, z_star: float, view: BeamView) -> tuple[float, float, float, float]:
    """Return the logarithms of the four weighted parts of (6.12), which do not underflow."""
    if z >= view.max_range:
        return -math.inf, -math.inf, _log_or_minus_infinity(view.z_max), -math.inf
    sigma = hit_sigma(z_star, view)
    mean = z_star + view.range_offset
    factor, edge = hit_normaliser(mean, sigma, view.max_range)
    u = (z - mean) / sigma
    log_hit = _log_or_minus_infinity(view.z_hit) + math.log(factor) - 0.5 * (u - edge) * (u + edge)
    log_short = -math.inf
    if z <= max(z_star, SHORTEST_SUPPORT):
        log_short = (
            _log_or_minus_infinity(view.z_short)
            + math.log(short_factor(z_star, view.lambda_short))
            - view.lambda_short * z
        )
    return log_hit, log_short, -math.inf, _log_or_minus_infinity(view.z_rand / view.max_range)


@shared
def log_mixture(z: float, z_star: float, view: BeamView) -> float:
    """Return the logarithm of (6.12); 0 where there is no measurement, -inf only where the range is impossible."""
    if not _is_measurement(z, z_star):
        return 0.0
    p = mixture(z, z_star, view)
    if p > SMALL_DENSITY:
        return math.log(p)
    return log_sum(_log_parts(z, z_star, view))


@shared
def log_sum(logs: tuple[float, float, float, float]) -> float:
    """Return log(sum(exp(logs))) without underflow."""
    largest = max(max(logs[0], logs[1]), max(logs[2], logs[3]))
    if largest == -math.inf:
        return largest
    total = 0.0
    for i in range(4):
        total += math.exp(logs[i] - largest)
    return largest + math.log(total)


@shared
def responsibilities(z: float, z_star: float, view: BeamView) -> tuple[float, float, float, float]:
    """Return the posterior probabilities of hit, short, max and rand given z: the weighted parts of (6.12), scaled.

    All four are 0 where there is no measurement and where the range is impossible.
    """
    if not _is_measurement(z, z_star):
        return 0.0, 0.0, 0.0, 0.0
    if z >= view.max_range:
        return 0.0, 0.0, (1.0 if view.z_max > 0.0 else 0.0), 0.0
    hit = view.z_hit * hit_density(z, z_star, view)
    short = view.z_short * short_density(z, z_star, view)
    rand = view.z_rand * rand_density(z, view.max_range)
    p = hit + short + rand
    if p > SMALL_DENSITY:
        return hit / p, short / p, 0.0, rand / p
    logs = _log_parts(z, z_star, view)
    total = log_sum(logs)
    if total == -math.inf:
        return 0.0, 0.0, 0.0, 0.0
    return math.exp(logs[0] - total), math.exp(logs[1] - total), 0.0, math.exp(logs[3] - total)


@kernel
def _hit_cdf(z: float, z_star: float, view: BeamView) -> float:
    """Return the integral of p_hit from 0 to z."""
    if z <= 0.0:
        return 0.0
    if z >= view.max_range:
        return 1.0
    sigma = hit_sigma(z_star, view)
    mean = z_star + view.range_offset
    low = -mean / sigma
    part, part_edge = normal_interval(low, (z - mean) / sigma)
    whole, edge = normal_interval(low, (view.max_range - mean) / sigma)
    return min(1.0, part / whole * math.exp(-0.5 * (part_edge - edge) * (part_edge + edge)))


@shared
def short_cdf(z: float, z_star: float, view: BeamView) -> float:
    """Return the integral of p_short from 0 to z."""
    if z <= 0.0:
        return 0.0
    support = min(max(z_star, SHORTEST_SUPPORT), view.max_range)
    if z >= support:
        return 1.0
    if view.lambda_short * support < 1e-8:
        # (1 - exp(-a)) / (1 - exp(-b)) = a / b (1 + (b - a) / 2 + ...): the next terms are below the last digit.
        return z / support * (1.0 + 0.5 * view.lambda_short * (support - z))
    return math.expm1(-view.lambda_short * z) / math.expm1(-view.lambda_short * support)


@shared
def mixture_cdf(z: float, z_star: float, view: BeamView) -> float:
    """Return P(range <= z): continuous on [0, max_range), then a step of z_max to 1; NaN without measurement."""
    if not _is_measurement(z, z_star):
        return math.nan
    if z >= view.max_range:
        return 1.0
    return (
        view.z_hit * _hit_cdf(z, z_star, view)
        + view.z_short * short_cdf(z, z_star, view)
        + view.z_rand * z / view.max_range
    )


@kernel
def fill_responsibilities(ranges: Floats, expected: Floats, view: BeamView, out: Floats) -> None:
    """Fill out (n, 4) with `responsibilities`."""
    for i in range(ranges.size):
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = responsibilities(ranges[i], min(expected[i], view.max_range), view)


@kernel
def fill_components(ranges: Floats, expected: Floats, view: BeamView, out: Floats) -> None:
    """Fill out (n, 4) with p_hit, p_short, p_max and p_rand, without weights."""
    for i in range(ranges.size):
        z, z_star = ranges[i], min(expected[i], view.max_range)
        if _is_measurement(z, z_star):
            out[i, 0] = hit_density(z, z_star, view)
            out[i, 1] = short_density(z, z_star, view)
            out[i, 2] = max_mass(z, view.max_range)
            out[i, 3] = rand_density(z, view.max_range)
        else:
            out[i, 0] = out[i, 1] = out[i, 2] = out[i, 3] = 0.0


@kernel
def fill_cdf(ranges: Floats, expected: Floats, view: BeamView, out: Floats) -> None:
    """Fill out (n,) with `mixture_cdf`."""
    for i in range(ranges.size):
        out[i] = mixture_cdf(ranges[i], min(expected[i], view.max_range), view)
