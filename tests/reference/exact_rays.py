"""Ray casting in twice the precision of float64: an oracle whose own rounding never matters.

It shares nothing with the caster. Every number is an unevaluated sum of two float64 (Dekker 1971), some 31 digits. The
direction's cosine and sine come from Taylor series, the start is taken into the grid's frame, and the ray steps from
cell to cell by the convention in the docstring of `beamfield.maps.raycast.RayCaster`. Which edge comes next is decided
without a division: a column edge at the distance a along x comes before a row edge at b along y if a |sin| < b |cos|.
"""

from __future__ import annotations

import math
from fractions import Fraction

import numba
import numpy as np

TOLERANCE = 1e-9
PARALLEL = 1e-12

# pi / 2 to 70 digits, cut into pieces of 26 bits or less, so that multiples below 2^26 are exact.
_HALF_PI = Fraction("1.570796326794896619231321691639751442098584699687552910487472296153908203143104499314")


def _pieces(value: Fraction, bits: int, count: int) -> tuple[float, ...]:
    pieces = []
    for i in range(1, count + 1):
        piece = Fraction(math.floor(value * 2 ** (bits * i)), 2 ** (bits * i))
        pieces.append(float(piece))
        value -= piece
    return tuple(pieces)


HALF_PI = _pieces(_HALF_PI, 26, 6)


def _double_double(value: Fraction) -> tuple[float, float]:
    high = float(value)
    return high, float(value - Fraction(high))


# 1 / n! for the Taylor series.
FACTORIALS = np.array([_double_double(Fraction(1, math.factorial(n))) for n in range(29)])

jit = numba.njit(error_model="numpy", cache=True)


@jit
def two_sum(a, b):
    """Return a + b and its rounding error."""
    total = a + b
    part = total - a
    return total, (a - (total - part)) + (b - part)


@jit
def two_product(a, b):
    """Return a b and its rounding error."""
    product = a * b
    big = 134217729.0 * a
    a_high = big - (big - a)
    a_low = a - a_high
    big = 134217729.0 * b
    b_high = big - (big - b)
    b_low = b - b_high
    return product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low


@jit
def add(a, b):
    """Return the sum of two double-doubles."""
    high, low = two_sum(a[0], b[0])
    other, rest = two_sum(a[1], b[1])
    low += other
    high, low = two_sum(high, low)
    return two_sum(high, low + rest)


@jit
def minus(a):
    """Return -a."""
    return -a[0], -a[1]


@jit
def times(a, b):
    """Return the product of two double-doubles."""
    high, low = two_product(a[0], b[0])
    return two_sum(high, low + (a[0] * b[1] + a[1] * b[0]))


@jit
def over(a, b):
    """Return the quotient of two double-doubles."""
    first = a[0] / b[0]
    rest = add(a, minus(times(b, (first, 0.0))))
    second = rest[0] / b[0]
    rest = add(rest, minus(times(b, (second, 0.0))))
    high, low = two_sum(first, second)
    return two_sum(high, low + rest[0] / b[0])


@jit
def cos_sin(angle):
    """Return cosine and sine of a double-double angle below 10^7 rad in size."""
    turns = np.rint(angle[0] / HALF_PI[0])
    r = angle
    for piece in HALF_PI:
        # Exact: turns has at most 23 bits, a piece 27.
        r = add(r, (-turns * piece, 0.0))
    square = times(r, r)
    sine, cosine = (0.0, 0.0), (0.0, 0.0)
    for n in range(27, 0, -2):
        sign = -1.0 if n % 4 == 3 else 1.0
        sine = add(times(sine, square), (sign * FACTORIALS[n, 0], sign * FACTORIALS[n, 1]))
        sign = -1.0 if (n - 1) % 4 == 2 else 1.0
        cosine = add(times(cosine, square), (sign * FACTORIALS[n - 1, 0], sign * FACTORIALS[n - 1, 1]))
    sine = times(sine, r)
    quarter = int(turns) % 4
    if quarter == 0:
        return cosine, sine
    if quarter == 1:
        return minus(sine), cosine
    if quarter == 2:
        return minus(cosine), minus(sine)
    return sine, minus(cosine)


@jit
def snapped(value):
    """Return a coordinate, on the border if it is within the tolerance of one."""
    nearest = np.rint(value[0])
    off = add(value, (-nearest, 0.0))
    return (nearest, 0.0) if abs(off[0]) <= TOLERANCE else value


@jit
def floor(value):
    """Return the largest whole number that is not above a double-double."""
    whole = np.floor(value[0])
    return whole - 1.0 if whole == value[0] and value[1] < 0.0 else whole


@jit
def turned(cosine, sine, x, y):
    """Return (x, y) turned by an angle."""
    return add(times(cosine, x), minus(times(sine, y))), add(times(sine, x), times(cosine, y))


@jit
def start_and_direction(ray, origin, resolution):
    """Return a ray, as `trace` takes it, in the grid's frame: column, row, cosine, sine."""
    frame_cos, frame_sin = cos_sin((origin[2], 0.0))
    x = add(two_sum(ray[0], -origin[0]), (ray[6], 0.0))
    y = add(two_sum(ray[1], -origin[1]), (ray[7], 0.0))
    x, y = turned(frame_cos, minus(frame_sin), x, y)
    cosine, sine = cos_sin(add(two_sum(ray[2], -origin[2]), (ray[8], 0.0)))
    mount_x, mount_y = turned(cosine, sine, (ray[3], 0.0), (ray[4], 0.0))
    scale = (resolution, 0.0)
    mount_cos, mount_sin = cos_sin((ray[5], 0.0))
    cosine, sine = turned(cosine, sine, mount_cos, mount_sin)
    return over(add(x, mount_x), scale), over(add(y, mount_y), scale), cosine, sine


@jit
def is_occupied(occupied, row, col):
    """Return whether there is such a cell and it stops a ray."""
    return 0 <= row < occupied.shape[0] and 0 <= col < occupied.shape[1] and occupied[row, col]


@jit
def trace(ray, occupied, origin, resolution, max_range):
    """Follow one ray: x, y, theta of the robot in the map, of the beam's mount on it, and of a shift of the robot.

    The shift is added exactly, so that a ray can be moved by less than float64 resolves.

    Returns
    -------
    The range in metres; row and column of the cell that was hit, -1 if none; which edge was crossed into it (0 none, 1
    of columns, 2 of rows, 3 a corner, 4 a corner between two occupied cells); |cos| and |sin|.
    """
    rows, cols = occupied.shape
    x, y, cosine, sine = start_and_direction(ray, origin, resolution)
    x, y = snapped(x), snapped(y)
    c = cosine if cosine[0] >= 0 else minus(cosine)
    s = sine if sine[0] >= 0 else minus(sine)
    step_col = 0 if c[0] < PARALLEL else (1 if cosine[0] > 0 else -1)
    step_row = 0 if s[0] < PARALLEL else (1 if sine[0] > 0 else -1)
    speed_x = c[0] if step_col else 0.0
    speed_y = s[0] if step_row else 0.0
    col, row = int(floor(x)), int(floor(y))
    if is_occupied(occupied, row, col):
        return 0.0, row, col, 0, speed_x, speed_y
    # Distances to the next edges along x and y, and both times the other axis's speed: the order of the crossings.
    a = add((float(col + 1), 0.0), minus(x)) if step_col > 0 else add(x, (-float(col), 0.0))
    b = add((float(row + 1), 0.0), minus(y)) if step_row > 0 else add(y, (-float(row), 0.0))
    to_col, to_row = times(a, s), times(b, c)
    tie = times(times(c, s), (TOLERANCE, 0.0))
    longest = max_range / resolution + 1.0
    while True:
        if (step_col >= 0 and col >= cols) or (step_col <= 0 and col < 0):
            break
        if (step_row >= 0 and row >= rows) or (step_row <= 0 and row < 0):
            break
        edge = 2
        if step_row == 0:
            edge = 1
        elif step_col != 0:
            later = add(to_col, minus(to_row))
            size = later if later[0] >= 0 else minus(later)
            if add(size, minus(tie))[0] <= 0.0:
                edge = 3
            elif later[0] < 0.0:
                edge = 1
        if edge == 3:
            length = over(a, c) if add(to_col, minus(to_row))[0] >= 0 else over(b, s)
        else:
            length = over(a, c) if edge == 1 else over(b, s)
        if length[0] > longest:
            break
        beside_col, beside_row = col + step_col, row + step_row
        if edge == 3 and is_occupied(occupied, row, beside_col) and is_occupied(occupied, beside_row, col):
            return _metres(length, resolution, max_range, row, beside_col, 4, speed_x, speed_y)
        if edge != 2:
            col = beside_col
            a, to_col = add(a, (1.0, 0.0)), add(to_col, s)
        if edge != 1:
            row = beside_row
            b, to_row = add(b, (1.0, 0.0)), add(to_row, c)
        if is_occupied(occupied, row, col):
            return _metres(length, resolution, max_range, row, col, edge, speed_x, speed_y)
    return max_range, -1, -1, 0, speed_x, speed_y


@jit
def _metres(length, resolution, max_range, row, col, edge, speed_x, speed_y):
    metres = times(length, (resolution, 0.0))
    if add(metres, (-max_range, 0.0))[0] >= 0.0:
        return max_range, -1, -1, 0, speed_x, speed_y
    return max(metres[0], 0.0), row, col, edge, speed_x, speed_y


@numba.njit(error_model="numpy", cache=True, nogil=True)
def trace_rays(rays, occupied, origin, resolution, max_range, ranges, cells, edges, speeds):
    """Follow rays (n, 9); fills ranges (n,), cells (n, 2), edges (n,) and speeds (n, 2) as `trace` returns them."""
    for i in range(len(rays)):
        metres, row, col, edge, speed_x, speed_y = trace(rays[i], occupied, origin, resolution, max_range)
        ranges[i], cells[i, 0], cells[i, 1], edges[i] = metres, row, col, edge
        speeds[i, 0], speeds[i, 1] = speed_x, speed_y
