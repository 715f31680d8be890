"""Elementary functions by arithmetic alone: calls of the C library would keep loops from being vectorised.

Kernels of many files call these; these call no others.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numpy as np

from beamfield.kernels.jit import FUSED, inlined_shared, shared

# exp is 0 or inf in double precision a little beyond these.
SMALLEST_EXPONENT, LARGEST_EXPONENT = -708.0, 709.0
LOG2_E, LOG_2 = 1.4426950408889634, 0.6931471805599453
LOG_2_HIGH, LOG_2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10
LEAST_POWER = -1020.0
# Added to a number, it leaves it rounded to a whole one, in the last bits.
ROUNDING = 6755399441055744.0
TAYLOR = tuple(math.log(2.0) ** i / math.factorial(i) for i in range(12))

# pi / 2 in three parts: n times the first and the second is exact for |n| < 2^20.
_HALF_PI = Fraction("1.5707963267948966192313216916397514420985846996875529")
HALF_PI_1 = math.floor(_HALF_PI * 2**32) / 2.0**32
HALF_PI_2 = math.floor((_HALF_PI - Fraction(HALF_PI_1)) * 2**65) / 2.0**65
HALF_PI_3 = float(_HALF_PI - Fraction(HALF_PI_1) - Fraction(HALF_PI_2))
# Angles beyond this, in radians, need the C library.
MANY_TURNS = 1e6
# In two parts, which lose digits beyond 1e5.
TWO_OVER_PI = 0.6366197723675814
HALF_PI_HIGH, HALF_PI_LOW = 1.5707963267341256, 6.077100506506192e-11

QUARTER_PI, HALF_PI = 0.7853981633974483, 1.5707963267948966
TAN_PI_8 = 0.41421356237309503

# Coordinates closer than this to a cell border, in cells, are on it.
SNAP = 1e-9
# Crossings of a column and a row edge closer than this, in cells, are one crossing of a corner.
TIE = 1e-9
# Direction components smaller than this are 0: cos(pi / 2) is 6e-17.
PARALLEL = 1e-12
# Rays that start farther away than this, in cells, see nothing.
FAR = 1e12
# Stands for 1 / 0: its product with 0 is 0, and with the length of a cell farther than anything.
HUGE = 1e300


def _exp(x: float) -> float:
    """Return exp(x) for -708 <= x <= 709, that of the nearer limit outside, exp(-708) for NaN.

    It is within 3e-16 for x <= 0, relatively. x = n log 2 + r with |r| <= log(2) / 2; a Taylor polynomial gives exp(r),
    the exponent's bits give 2^n.
    """
    x = x if x > SMALLEST_EXPONENT else SMALLEST_EXPONENT
    x = x if x < LARGEST_EXPONENT else LARGEST_EXPONENT
    rounded = x * LOG2_E + ROUNDING
    n = rounded - ROUNDING
    r = (x - n * LOG_2_HIGH) - n * LOG_2_LOW
    p = 1.0 / 6227020800.0
    p = p * r + 1.0 / 479001600.0
    p = p * r + 1.0 / 39916800.0
    p = p * r + 1.0 / 3628800.0
    p = p * r + 1.0 / 362880.0
    p = p * r + 1.0 / 40320.0
    p = p * r + 1.0 / 5040.0
    p = p * r + 1.0 / 720.0
    p = p * r + 1.0 / 120.0
    p = p * r + 1.0 / 24.0
    p = p * r + 1.0 / 6.0
    p = p * r + 0.5
    p = p * r + 1.0
    p = p * r + 1.0
    # From the bits of the sum: processors without AVX-512 turn doubles into integers of 64 bits one by one.
    power: float = np.int64((np.float64(rounded).view(np.int64) + 1023) << 52).view(np.float64)
    return p * power


def _log(x: float) -> float:
    """Return log(x) of positive normal numbers; the error is below 5e-16, absolutely near 1, relatively elsewhere."""
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
    return e * LOG_2 + 2.0 * s * (1.0 + p * y)


# Not with all of `fastmath`, which would cancel ROUNDING.
fast_exp = shared(_exp, fast=FUSED)
# May reorder sums: less exact by some 3e-17, quicker.
fast_log = shared(_log, fast=True)


def _exp_2(x: float) -> float:
    """Return 2^x for -1020 <= x <= 0, 2^-1020 for anything below and NaN; within 2e-14, relatively.

    The nearest whole number becomes the exponent's bits, a Taylor polynomial of degree 11 does the rest. It is quicker
    than `exp`, as few of its terms wait for others.
    """
    x = x if x > LEAST_POWER else LEAST_POWER
    rounded = x + ROUNDING
    r = x - (rounded - ROUNDING)
    c, r2 = TAYLOR, r * r
    r4 = r2 * r2
    p = (c[0] + c[1] * r) + r2 * (c[2] + c[3] * r) + r4 * ((c[4] + c[5] * r) + r2 * (c[6] + c[7] * r))
    p = p + r4 * r4 * ((c[8] + c[9] * r) + r2 * (c[10] + c[11] * r))
    power: float = np.int64((np.float64(rounded).view(np.int64) + 1023) << 52).view(np.float64)
    return p * power


exp_2 = inlined_shared(_exp_2)
fused_exp_2 = inlined_shared(_exp_2, fast=FUSED)


@inlined_shared
def cos_sin(angle: float) -> tuple[float, float]:
    """Return cosine and sine within 2^-52 for |angle| <= MANY_TURNS."""
    turns = np.floor(angle * (2.0 / math.pi) + 0.5)
    r = ((angle - turns * HALF_PI_1) - turns * HALF_PI_2) - turns * HALF_PI_3
    r2 = r * r
    # Taylor's series about 0 for |r| <= pi / 4; the first term left out is below 1e-17.
    s = 1.0 / 1307674368000.0 - r2 * (1.0 / 355687428096000.0)
    s = 1.0 / 6227020800.0 - r2 * s
    s = 1.0 / 39916800.0 - r2 * s
    s = 1.0 / 362880.0 - r2 * s
    s = 1.0 / 5040.0 - r2 * s
    s = 1.0 / 120.0 - r2 * s
    s = 1.0 / 6.0 - r2 * s
    sine = r - r * r2 * s
    c = 1.0 / 87178291200.0 - r2 * (1.0 / 20922789888000.0)
    c = 1.0 / 479001600.0 - r2 * c
    c = 1.0 / 3628800.0 - r2 * c
    c = 1.0 / 40320.0 - r2 * c
    c = 1.0 / 720.0 - r2 * c
    c = 1.0 / 24.0 - r2 * c
    cosine = 1.0 - (0.5 * r2 - r2 * r2 * c)
    quarter = turns - 4.0 * np.floor(turns * 0.25)
    swap = (quarter == 1.0) | (quarter == 3.0)
    a = sine if swap else cosine
    b = cosine if swap else sine
    return (-a if (quarter == 1.0) | (quarter == 2.0) else a), (-b if quarter >= 2.0 else b)


@inlined_shared
def quick_sin_cos(angle: float) -> tuple[float, float]:
    """Return sine and cosine within 1e-12 for |angle| < 1e5: for single precision, and quicker than `cos_sin`."""
    quarters = np.floor(angle * TWO_OVER_PI + 0.5)
    r = (angle - quarters * HALF_PI_HIGH) - quarters * HALF_PI_LOW
    z = r * r
    s = -2.505210838544172e-08 + z * 1.6059043836821613e-10
    s = r + r * z * (-1.0 / 6.0 + z * (1.0 / 120.0 + z * (-1.0 / 5040.0 + z * (1.0 / 362880.0 + z * s))))
    c = -2.755731922398589e-07 + z * (2.08767569878681e-09 - z * 1.1470745597729725e-11)
    c = 1.0 + z * (-0.5 + z * (1.0 / 24.0 + z * (-1.0 / 720.0 + z * (1.0 / 40320.0 + z * c))))
    # 0, 1/4, 1/2 or 3/4 of a turn. One comparison each: `or` would be a branch, and branches are not vectorised.
    turn = 0.25 * quarters - np.floor(0.25 * quarters)
    swapped = abs(turn - 0.5) == 0.25
    sine, cosine = c if swapped else s, s if swapped else c
    return -sine if turn >= 0.5 else sine, -cosine if abs(turn - 0.375) < 0.25 else cosine


@inlined_shared
def arc_tangent_2(v: float, u: float) -> float:
    """Return atan2(v, u); NaN for (0, 0).

    The ratio is reduced to |t| <= tan(pi / 8). There atan(t) / t is a polynomial in t^2 that interpolates its series at
    the Chebyshev nodes; the whole is within 5e-16 of the exact angle.
    """
    across, along = abs(v), abs(u)
    high, low = max(across, along), min(across, along)
    wide = low > TAN_PI_8 * high
    t = (low - high if wide else low) / (low + high if wide else high)
    s = t * t
    p = 0.02113537315769327
    p = p * s - 0.04348052215716471
    p = p * s + 0.05688349226809016
    p = p * s - 0.06640233930429411
    p = p * s + 0.07689953496306857
    p = p * s - 0.09090773074808414
    p = p * s + 0.11111106180455946
    p = p * s - 0.14285714180976467
    p = p * s + 0.1999999999885511
    p = p * s - 0.3333333333332844
    angle = (QUARTER_PI if wide else 0.0) + (t + t * s * p)
    angle = HALF_PI - angle if across > along else angle
    angle = 2.0 * HALF_PI - angle if u < 0.0 else angle
    return -angle if v < 0.0 else angle


@inlined_shared
def split(x: float) -> tuple[float, float]:
    """Return the cell of a coordinate and the offset in it; coordinates near a border are on it."""
    nearest = np.floor(x + 0.5)
    x = nearest if abs(x - nearest) <= SNAP else x
    cell = np.floor(x)
    return cell, x - cell


@inlined_shared
def never_nan(value: float) -> float:
    """Return -inf for NaN: only coordinates beyond 1e150 m lead there."""
    return value if value == value else -math.inf
