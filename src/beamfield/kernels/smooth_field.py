"""Likelihood fields (section 6.4) by interpolated distance: continuous in the pose, with a gradient.

Pairs of pose and beam go through short passes, some hundred at a time and pose by pose, so that one pose with many
beams is as quick as many poses. The compiler vectorises all passes but the one that loads from the table: loads from
here and there beside stores keep a loop from being vectorised.

The table holds the distances, metres in single precision, in a frame of one cell that repeats the field's edge: across
the edge, where there is no second centre, the distance stays constant. Above the frame lie OFF_ROWS more, all alike,
for what lies off the field. Positions are (col, row) from the centre of the table's first cell.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.elementary import MANY_TURNS, cos_sin, exp_2
from beamfield.kernels.field import FrameView
from beamfield.kernels.jit import inlined_fast_kernel, inlined_kernel, kernel

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Cells = NDArray[np.uint64]
Mask = NDArray[np.bool_]

OFF_ROWS = 2
# Pairs of one pass: they stay in the nearest cache. 256 to 1024 are equally fast.
PAIRS = 512
# exp underflows to 0 below this: Table 6.3 in double precision calls such a reading impossible, and so do we.
SMALLEST_EXPONENT = -745.0
# Logarithm up to which gains are computed, and multiplied with each other; that of a double ends at 709.
LARGEST_LOG = 600.0

# Added to a whole number from 0 on, it leaves it in the last bits.
WHOLE = 4503599627370496.0
WHOLE_BITS = np.float64(WHOLE).view(np.int64)


class Table(NamedTuple):
    """What end points are looked up in."""

    rows: int
    cols: int
    distance: Singles
    """(rows * cols,) metres."""
    uniform: Mask
    """(rows * cols,) cells, and what lies off the field, that have a constant value; empty if there is none."""


class SmoothView(NamedTuple):
    """What one beam's value depends on besides the distance: peak exp(steep dist^2 / 2) + rand."""

    log_peak: float
    log_rand: float
    """-inf for 0."""
    log_off: float
    """Value off the field, and in cells that are marked as uniform."""
    ratio: float
    """peak / rand; inf without rand."""
    quotient: float
    """rand / peak; inf without hits."""
    steep: float
    """-1 / sigma_hit^2."""
    bits: float
    """The same for powers of 2: the hit is peak 2^(bits dist^2)."""
    reach: float
    """Distance from which on a hit cannot be told from nothing; inf to compute it everywhere."""


class Pairs(NamedTuple):
    """Room for pairs of pose and beam that are worked on together, pose by pose; the first n are in use."""

    a: Floats
    """Where the end point lies between the left and the right of four centres, 0 to 1."""
    b: Floats
    """Where between the lower and the upper ones."""
    cell: Cells
    """Index of the lower left one in the table; that of the first of the OFF_ROWS if the distance is not asked for."""
    lower: Singles
    """Distances at the two lower ones, twice as many."""
    upper: Singles
    """Distances at the two upper ones."""


def n_factors(view: SmoothView) -> int:
    """Return how many gains `fill_sums` may multiply before it takes the logarithm; 0 if one alone may be too large."""
    if view.log_rand == -math.inf:
        return 0
    return int(LARGEST_LOG / max(math.log1p(view.ratio), view.log_off - view.log_rand, 1.0))


# --- one beam ---------------------------------------------------------------------------------------------------------


@inlined_kernel
def interpolate(lower: Singles, upper: Singles, i: int, a: float, b: float) -> tuple[float, float, float]:
    """Return (d, dd/da, dd/db) between the neighbours of pair i; d is inf or NaN if one of them is infinitely far."""
    d00, d10 = np.float64(lower[2 * i]), np.float64(upper[2 * i])
    below, above = np.float64(lower[2 * i + 1]) - d00, np.float64(upper[2 * i + 1]) - d10
    low = d00 + a * below
    rise = d10 + a * above - low
    return low + b * rise, below + b * (above - below), rise


@kernel
def log_beam(distance: float, view: SmoothView) -> float:
    """Return line 8 of Table 6.3 as a logarithm, with next to no rand or none; -inf where it is 0."""
    if not distance < view.reach:
        return view.log_rand
    exponent = 0.5 * view.steep * distance * distance
    hit = view.log_peak + exponent if exponent > SMALLEST_EXPONENT else -math.inf
    low, high = min(hit, view.log_rand), max(hit, view.log_rand)
    return high + math.log1p(math.exp(low - high)) if low > -math.inf else high


@inlined_kernel
def gain(distance: float, view: SmoothView) -> float:
    """Return a beam's value divided by rand, at least 1; 1 for NaN."""
    value = 1.0 + view.ratio * exp_2(view.bits * distance * distance)
    return value if distance < view.reach else 1.0


@inlined_kernel
def log_slope(distance: float, view: SmoothView) -> float:
    """Return the derivative of `log_beam` with respect to the distance."""
    hit = exp_2(view.bits * distance * distance)
    slope = view.steep * distance * (hit / (hit + view.quotient))
    return slope if distance < view.reach else 0.0


# --- passes over pairs ------------------------------------------------------------------------------------------------


@inlined_kernel
def fill_positions(poses: Floats, i: int, frame: FrameView, ends: Floats, first: int, u: Floats, v: Floats
                   ) -> tuple[float, float]:  # fmt: skip
    """Fill u and v from `first` on with the positions (6.32) of end points (2, k), in cells, seen from pose number i.

    Return the pose's cosine and sine. Numba counts who holds an array at each call and each slice, hence none per pose.
    """
    dx, dy, heading = poses[i, 0] - frame.x, poses[i, 1] - frame.y, poses[i, 2] - frame.yaw
    x = (dx * frame.cos + dy * frame.sin) * frame.cells_per_metre + frame.offset
    y = (dy * frame.cos - dx * frame.sin) * frame.cells_per_metre + frame.offset
    c, s = cos_sin(heading) if abs(heading) <= MANY_TURNS else (math.cos(heading), math.sin(heading))
    # LLVM vectorises only if it knows that no index is negative.
    to, n = np.uintp(first), np.uintp(ends.shape[1])
    for j in range(n):
        u[to + j] = x + c * ends[0, j] - s * ends[1, j]
        v[to + j] = y + s * ends[0, j] + c * ends[1, j]
    return c, s


@kernel
def fill_corners(n: int, rows: int, cols: int, u: Floats, v: Floats, cell: Cells) -> None:
    """Fill in the lower left of the four centres around each position, and turn u and v into what is beyond it.

    Off the field, and where poses beyond all numbers lead to NaN, it is the first of the OFF_ROWS.
    """
    # Whole numbers are kept as doubles: there are no vector instructions to convert them everywhere.
    stride, off = np.float64(cols), np.float64(rows - OFF_ROWS) * np.float64(cols)
    right, top = np.nextafter(cols - 1.5, 0.0), np.nextafter(rows - OFF_ROWS - 1.5, 0.0)
    for i in range(n):
        p = u[i] if u[i] > 0.5 else 0.5
        q = v[i] if v[i] > 0.5 else 0.5
        p = p if p < right else right
        q = q if q < top else top
        on = (p == u[i]) & (q == v[i])
        col, row = np.floor(p), np.floor(q)
        index = row * stride + col if on else off
        cell[i] = np.uint64(np.float64(index + WHOLE).view(np.int64) - WHOLE_BITS)
        u[i], v[i] = p - col, q - row


@kernel
def leave_out_uniform(n: int, uniform: Mask, stride: int, off: np.uint64, a: Floats, b: Floats, cell: Cells) -> None:
    """Move end points in marked cells off the field; the cell is that of the nearest of the four centres."""
    up, one = np.uint64(stride), np.uint64(1)
    for i in range(n):
        nearest = cell[i] + one if a[i] >= 0.5 else cell[i]
        nearest = nearest + up if b[i] >= 0.5 else nearest
        cell[i] = off if uniform[nearest] else cell[i]


@kernel
def fill_neighbours(n: int, table: Singles, stride: int, cell: Cells, lower: Singles, upper: Singles) -> None:
    """Fill lower and upper with two distances from each cell on, and two from the one above it."""
    up, one = np.uint64(stride), np.uint64(1)
    for i in range(n):
        left = cell[i]
        # All loads come before the stores, so that two become one.
        d00, d01 = table[left], table[left + one]
        d10, d11 = table[left + up], table[left + up + one]
        lower[2 * i], lower[2 * i + 1] = d00, d01
        upper[2 * i], upper[2 * i + 1] = d10, d11


@kernel
def fill_interpolated(n: int, pairs: Pairs, off: np.uint64, off_value: float, out: Floats) -> None:
    """Fill out (n,) with the interpolated distance: inf beside an infinite one, off_value off the field."""
    for i in range(n):
        d = interpolate(pairs.lower, pairs.upper, i, pairs.a[i], pairs.b[i])[0]
        d = d if d < math.inf else math.inf
        out[i] = off_value if pairs.cell[i] == off else d


@kernel
def fill_gains(n: int, pairs: Pairs, off: np.uint64, view: SmoothView, off_gain: float, out: Floats) -> None:
    """Fill out with `gain` of the interpolated distance, and with off_gain off the field."""
    for i in range(n):
        g = gain(interpolate(pairs.lower, pairs.upper, i, pairs.a[i], pairs.b[i])[0], view)
        # Two names, because a call in a condition is a branch, and branches are not vectorised.
        out[i] = off_gain if pairs.cell[i] == off else g


@kernel
def turn_into_slopes(n: int, lower: Singles, upper: Singles, view: SmoothView, a: Floats, b: Floats) -> None:
    """Turn a and b into the derivatives of each beam's value along them; 0 off the field and by infinite distances."""
    for i in range(n):
        d, da, db = interpolate(lower, upper, i, a[i], b[i])
        slope, near = log_slope(d, view), d < view.reach
        a[i], b[i] = slope * da if near else 0.0, slope * db if near else 0.0


@inlined_kernel
def log_product(factors: Floats, first: int, stop: int) -> float:
    """Return the logarithm of a product of positive numbers, which must not overflow."""
    whole = first + (stop - first) // 4 * 4
    p, q, r, s = 1.0, 1.0, 1.0, 1.0
    for j in range(first, whole, 4):
        p, q, r, s = p * factors[j], q * factors[j + 1], r * factors[j + 2], s * factors[j + 3]
    for j in range(whole, stop):
        p *= factors[j]
    return math.log((p * q) * (r * s))


@inlined_fast_kernel
def sum_slopes(a: Floats, b: Floats, ends: Floats) -> tuple[float, float, float, float]:
    """Return the sums of slopes (k,) along the table's axes, and of those of end points (2, k) across and along.

    The latter two, times cosine and minus sine of the heading, are the derivative by the heading.
    """
    along, across, turning, outwards = 0.0, 0.0, 0.0, 0.0
    for j in range(a.size):
        along += a[j]
        across += b[j]
        turning += ends[0, j] * b[j] - ends[1, j] * a[j]
        outwards += ends[0, j] * a[j] + ends[1, j] * b[j]
    return along, across, turning, outwards


# --- whole calls ------------------------------------------------------------------------------------------------------


@kernel
def room_for(n: int, k: int) -> tuple[Pairs, Floats]:
    """Return room for pairs of some of n poses with k beams, and for the directions of these poses."""
    m = max(1, min(n, PAIRS // max(1, k)))
    lower, upper = np.empty(2 * m * k, np.float32), np.empty(2 * m * k, np.float32)
    return Pairs(np.empty(m * k), np.empty(m * k), np.empty(m * k, np.uint64), lower, upper), np.empty((m, 2))


@kernel
def fill_pairs(poses: Floats, start: int, m: int, frame: FrameView, ends: Floats, table: Table, pairs: Pairs,
               directions: Floats) -> np.uint64:  # fmt: skip
    """Fill in all about pairs of m poses of (n, 3) and end points (2, k); return the cell that means off the field."""
    k, n = ends.shape[1], m * ends.shape[1]
    off = np.uint64((table.rows - OFF_ROWS) * table.cols)
    for i in range(m):
        directions[i, 0], directions[i, 1] = fill_positions(poses, start + i, frame, ends, i * k, pairs.a, pairs.b)
    fill_corners(n, table.rows, table.cols, pairs.a, pairs.b, pairs.cell)
    if table.uniform.size > 0:
        leave_out_uniform(n, table.uniform, table.cols, off, pairs.a, pairs.b, pairs.cell)
    fill_neighbours(n, table.distance, table.cols, pairs.cell, pairs.lower, pairs.upper)
    return off


@kernel
def fill_distances(poses: Floats, frame: FrameView, ends: Floats, table: Table, off_value: float, out: Floats) -> None:
    """Fill out (n, k) with the interpolated distance at end points (2, k) in the robot frame, in cells.

    Off the field, and in marked cells, it is off_value.
    """
    n, k = out.shape
    pairs, directions = room_for(n, k)
    for start in range(0, n, len(directions)):
        m = min(len(directions), n - start)
        off = fill_pairs(poses, start, m, frame, ends, table, pairs, directions)
        fill_interpolated(m * k, pairs, off, off_value, out[start : start + m].reshape(-1))


@kernel
def fill_values(view: SmoothView, out: Floats) -> None:
    """Turn distances into the value of each beam, (n, k), and NaN into that off the field."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = view.log_off if math.isnan(out[i, j]) else log_beam(out[i, j], view)


@kernel
def fill_sums(poses: Floats, frame: FrameView, ends: Floats, table: Table, view: SmoothView, n_factors: int, out: Floats
              ) -> None:  # fmt: skip
    """Fill out (n,) with the sum over beams of the values.

    Gains are multiplied; only products of so many of them are turned into a logarithm.
    """
    n, k = poses.shape[0], ends.shape[1]
    pairs, directions = room_for(n, k)
    gains, off_gain = np.empty(len(directions) * k), math.exp(view.log_off - view.log_rand)
    for start in range(0, n, len(directions)):
        m = min(len(directions), n - start)
        off = fill_pairs(poses, start, m, frame, ends, table, pairs, directions)
        fill_gains(m * k, pairs, off, view, off_gain, gains)
        for i in range(m):
            total = k * view.log_rand
            for j in range(0, k, n_factors):
                total += log_product(gains, i * k + j, i * k + min(j + n_factors, k))
            out[start + i] = total


@kernel
def fill_gradient(poses: Floats, frame: FrameView, ends: Floats, table: Table, view: SmoothView, out: Floats) -> None:
    """Fill out (n, 3) with the derivative of the sum over beams by x, y (1/m, map frame) and theta (1/rad)."""
    n, k = poses.shape[0], ends.shape[1]
    pairs, directions = room_for(n, k)
    for start in range(0, n, len(directions)):
        m = min(len(directions), n - start)
        fill_pairs(poses, start, m, frame, ends, table, pairs, directions)
        turn_into_slopes(m * k, pairs.lower, pairs.upper, view, pairs.a, pairs.b)
        for i in range(m):
            a, b = pairs.a[i * k : (i + 1) * k], pairs.b[i * k : (i + 1) * k]
            along, across, turning, outwards = sum_slopes(a, b, ends)
            out[start + i, 0] = (along * frame.cos - across * frame.sin) * frame.cells_per_metre
            out[start + i, 1] = (along * frame.sin + across * frame.cos) * frame.cells_per_metre
            out[start + i, 2] = directions[i, 0] * turning - directions[i, 1] * outwards
