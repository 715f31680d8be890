"""Masses and means of what is cut off: a normal hit in [0, z_max], an exponential short in [0, z*].

x = lambda z* for shorts; the rest as in `intrinsics`.
"""

from __future__ import annotations

import math

from beamfield.kernels.jit import kernel, shared

HALF_LOG_2PI = 0.9189385332046727
# Beyond this many sigma the tail of a normal distribution comes from its asymptotic series.
_DEEP_SIGMAS = 25.0


@shared
def log_cut_mass(mean: float, s: float, max_range: float) -> tuple[float, float, float, float, float, float]:
    """Return log C and its derivatives in mean, v, mean mean, v mean, v v."""
    # C solves the heat equation: dC/dv = C'' / 2.
    low = -mean / s
    high = (max_range - mean) / s
    log_c = log_mass(low, high)
    phi_low = math.exp(-0.5 * low * low - HALF_LOG_2PI - log_c)
    phi_high = math.exp(-0.5 * high * high - HALF_LOG_2PI - log_c)
    d1 = (phi_low - phi_high) / s
    d2 = (low * phi_low - high * phi_high) / s**2
    d3 = ((low * low - 1.0) * phi_low - (high * high - 1.0) * phi_high) / s**3
    d4 = ((low**3 - 3.0 * low) * phi_low - (high**3 - 3.0 * high) * phi_high) / s**4
    return log_c, d1, 0.5 * d2, d2 - d1 * d1, 0.5 * d3 - 0.5 * d1 * d2, 0.25 * d4 - 0.25 * d2 * d2


@shared
def log_mass(low: float, high: float) -> float:
    """Return the log of the standard normal's mass in [low, high]."""
    if low > 0.0:  # differences of the smaller tails keep their digits
        near, far = low, high
    elif high < 0.0:
        near, far = -high, -low
    else:
        return math.log1p(-0.5 * (math.erfc(-low / math.sqrt(2.0)) + math.erfc(high / math.sqrt(2.0))))
    log_near = _log_tail(near)
    return log_near + math.log(-math.expm1(_log_tail(far) - log_near))


@kernel
def _log_tail(x: float) -> float:
    """Return the log of the standard normal's mass beyond x > 0."""
    if x < _DEEP_SIGMAS:
        return math.log(0.5 * math.erfc(x / math.sqrt(2.0)))
    y = 1.0 / (x * x)
    series = 1.0 - y * (1.0 - y * (3.0 - y * (15.0 - y * (105.0 - y * (945.0 - y * 10395.0)))))
    return -0.5 * x * x - math.log(x) - HALF_LOG_2PI + math.log(series)


@shared
def relative_rate(x: float) -> float:
    """Return x / (1 - e^-x): a short's density at z = 0 relative to the uniform one on [0, z*]; 1 at x = 0."""
    if x < 1e-5:
        return 1.0 + 0.5 * x + x * x / 12.0
    return x / -math.expm1(-x)


@shared
def mean_share(x: float) -> tuple[float, float]:
    """Return 1/x - 1/(e^x - 1), the mean of a short over z*, and its derivative; 1/2 and -1/12 at x = 0.

    The derivative is minus the variance of a short over z*^2.
    """
    if x < 0.1:
        y = x * x
        share = 1.0 / 12.0 - y * (1.0 / 720.0 - y * (1.0 / 30240.0 - y * (1.0 / 1209600.0 - y / 47900160.0)))
        slope = 1.0 / 12.0 - y * (1.0 / 240.0 - y * (1.0 / 6048.0 - y * (1.0 / 172800.0 - y / 5322240.0)))
        return 0.5 - x * share, -slope
    if x > 700.0:
        return 1.0 / x, -1.0 / (x * x)
    e = 1.0 / math.expm1(x)
    return 1.0 / x - e, (1.0 + e) * e - 1.0 / (x * x)
