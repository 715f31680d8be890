"""The nearest occupied cell in a cone, exactly, row by row over a map of bits.

All lengths are in cells, seen from the cone's apex; u is the direction of the cone's right edge and v that of its left
one. What is nearest in the cone needs no test of visibility: whatever stood before it would be nearer, and in the cone
too. So the range of a cone is the distance to the intersection of occupied cells with the sector, and it is found
without any ray but the two edges:

- The half of the sector above the apex meets a row of cells in a convex polygon, so the cells of the row that it meets
  are a run of columns. The half below is the same, mirrored.
- In that run, cells farther left and right of the apex are farther away. Only the first occupied one on either side
  counts; a word of 32 bits skips 32 free cells.
- Rows farther away than the nearest cell so far are never looked at, and eight rows together are passed over if nothing
  in them is in the cone.

The two edges are cast as rays beforehand, so that a cone is never longer than they are, and a cone without width is a
ray. A cell that reaches into the cone by less than `TIE` beside an edge is not seen by the rows.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.elementary import FAR, HUGE, PARALLEL, TIE, split
from beamfield.kernels.jit import inlined_kernel, kernel

Floats = NDArray[np.float64]
Bits = NDArray[np.uint32]

# Rows that are looked at together first; a power of 2.
BAND = 8


class Cones(NamedTuple):
    """The cones of a sensor in the robot frame, (k,) each: apex in cells, directions of both edges."""

    x: Floats
    y: Floats
    right_cos: Floats
    right_sin: Floats
    left_cos: Floats
    left_sin: Floats


class Bitmap(NamedTuple):
    """Occupied cells, as from `pack_rows`, and the number of columns."""

    bits: Bits
    bands: Bits
    cols: int


class Half(NamedTuple):
    """The half of a cone on one side of the apex's row, as if it were the upper side."""

    right: float  # cot of the right edge, HUGE along the row
    left: float  # cot of the left edge, -HUGE along the row
    right_slope: float  # slope of the right edge where x > 0, 0 if it is never the lower bound
    left_slope: float  # slope of the left edge where x < 0, likewise


class Nearest(NamedTuple):
    """The nearest point so far, in cells from the apex, and its cell; -1: none that the rows found."""

    square: float
    x: float
    y: float
    col: int
    row: int


@kernel
def pack_rows(stops: NDArray[np.bool_], bits: Bits, bands: Bits) -> None:
    """Pack a map into bits.

    Parameters
    ----------
    stops
        (rows, cols) bool: occupied cells.
    bits
        (rows, (cols + 31) // 32) uint32, overwritten: bit c % 32 of word c // 32 is set where the cell is occupied.
    bands
        ((rows + BAND - 1) // BAND, (cols + 31) // 32) uint32, overwritten: BAND rows of `bits` in one.
    """
    rows, cols = stops.shape
    bands[:] = 0
    for row in range(rows):
        for word in range(bits.shape[1]):
            value = np.int64(0)
            for c in range(32 * word, min(32 * word + 32, cols)):
                value |= np.int64(stops[row, c]) << np.int64(c - 32 * word)
            bits[row, word] = np.uint32(value)
            bands[row // BAND, word] |= np.uint32(value)


@kernel
def shorten_to_cells(poses: Floats, frame: tuple[float, float, float], resolution: float, cones: Cones,
                     bitmap: Bitmap, ranges: Floats, points: Floats, cells: NDArray[np.int32]) -> None:  # fmt: skip
    """Shorten ranges to the nearest occupied cell in each cone.

    Parameters
    ----------
    poses
        (n, 3) robot poses in the map frame, metres and radians.
    frame
        (x, y, yaw) of the grid's origin in the map frame.
    resolution
        Side of a cell, metres.
    cones
        The sensor.
    bitmap
        Occupied cells.
    ranges
        (n, k) metres, changed: on entry no longer than both edges of the cone and the sensor's limit.
    points, cells
        (n, k, 2) in the grid's frame in cells, row and column: overwritten where a range is shortened. Empty if they
        are not asked for.
    """
    for i in range(poses.shape[0]):
        x, y, c, s = _place(poses[i, 0], poses[i, 1], poses[i, 2], frame, resolution)
        for b in range(ranges.shape[1]):
            nearest = _nearest(x, y, c, s, cones, b, bitmap, ranges[i, b] / resolution)
            metres = math.sqrt(nearest.square) * resolution
            if nearest.col >= 0 and metres < ranges[i, b]:
                ranges[i, b] = metres
                if points.size > 0:
                    points[i, b, 0] = x + (c * cones.x[b] - s * cones.y[b]) + nearest.x
                    points[i, b, 1] = y + (s * cones.x[b] + c * cones.y[b]) + nearest.y
                    cells[i, b, 0], cells[i, b, 1] = nearest.row, nearest.col


@inlined_kernel
def _place(
    pose_x: float, pose_y: float, theta: float, frame: tuple[float, float, float], resolution: float
) -> tuple[float, float, float, float]:
    """Return x, y in cells, cos and sin of a pose in the grid's frame."""
    frame_x, frame_y, yaw = frame
    frame_c, frame_s = math.cos(yaw), math.sin(yaw)
    dx, dy = pose_x - frame_x, pose_y - frame_y
    heading = theta - yaw
    return (
        (frame_c * dx + frame_s * dy) / resolution,
        (frame_c * dy - frame_s * dx) / resolution,
        math.cos(heading),
        math.sin(heading),
    )


@kernel
def _nearest(x: float, y: float, c: float, s: float, cones: Cones, b: int, bitmap: Bitmap, limit: float) -> Nearest:
    """Return the nearest point of an occupied cell in one cone of a placed robot, if nearer than `limit`."""
    cell_x, offset_x = split(x + (c * cones.x[b] - s * cones.y[b]))
    cell_y, offset_y = split(y + (s * cones.x[b] + c * cones.y[b]))
    nearest = Nearest(limit * limit, 0.0, 0.0, -1, -1)
    if not (abs(cell_x) < FAR and abs(cell_y) < FAR):
        return nearest
    col, row = int(cell_x), int(cell_y)
    rc, rs = c * cones.right_cos[b] - s * cones.right_sin[b], s * cones.right_cos[b] + c * cones.right_sin[b]
    lc, ls = c * cones.left_cos[b] - s * cones.left_sin[b], s * cones.left_cos[b] + c * cones.left_sin[b]
    rs = rs if abs(rs) >= PARALLEL else 0.0
    ls = ls if abs(ls) >= PARALLEL else 0.0
    if rs > 0.0 or ls > 0.0:
        nearest = _search(nearest, _half(rc, rs, lc, ls), col, offset_x, row, 1, 1.0 - offset_y, bitmap)
    if rs < 0.0 or ls < 0.0:
        half = _half(lc, -ls, rc, -rs)
        if offset_y > 0.0:
            nearest = _search(nearest, half, col, offset_x, row, -1, offset_y, bitmap)
        else:
            # On the lower border of its row: what lies below begins with a whole row.
            nearest = _search(nearest, half, col, offset_x, row - 1, -1, 1.0, bitmap)
    return nearest


@inlined_kernel
def _half(rc: float, rs: float, lc: float, ls: float) -> Half:
    """Return what lies above the apex of the sector from (rc, rs) counter-clockwise to (lc, ls), less than a half turn.

    An edge below the apex is replaced by the row itself: the right one by the direction 0, the left one by pi.
    """
    return Half(
        rc / rs if rs > 0.0 else HUGE,
        lc / ls if ls > 0.0 else -HUGE,
        rs / rc if rs > 0.0 and rc > 0.0 else 0.0,
        ls / lc if ls > 0.0 and lc < 0.0 else 0.0,
    )


@kernel
def _search(nearest: Nearest, half: Half, col: int, offset: float, row: int, step: int, first_top: float,
            bitmap: Bitmap) -> Nearest:  # fmt: skip
    """Return the nearest point on one side of the apex, if it is nearer than the one known.

    `col` and `offset` place the apex along the rows. The first row is `row`, its far border `first_top` away; the next
    rows follow in steps of `step`.
    """
    bits, bands, cols = bitmap
    rows = bits.shape[0]
    square, found_x, found_y, found_col, found_row = nearest
    reach = math.sqrt(square)
    bottom, top = 0.0, first_top
    # An apex off the map goes on to the first row of the map, or sees none.
    skip = -row if step > 0 else row - (rows - 1)
    if skip > 0:
        row += step * skip
        bottom, top = first_top + (skip - 1), first_top + skip
    lowest, highest = -col, cols - 1 - col
    while 0 <= row < rows and bottom < reach:
        if row & (BAND - 1) == (0 if step > 0 else BAND - 1):
            # A band of rows begins here. Mostly, nothing in it is in the cone.
            band_top = top + (BAND - 1)
            left, right = _extent(half, bottom, band_top)
            first, last = _columns(left, right, reach, offset, lowest, highest)
            if _first_set(bands, row // BAND, col + first, col + last) < 0:
                row += step * BAND
                bottom, top = band_top, band_top + 1.0
                continue
        left, right = _extent(half, bottom, top)
        first, last = _columns(left, right, reach, offset, lowest, highest)
        if first <= last:
            right_cell = _first_set(bits, row, col + max(first, 0), col + last)
            left_cell = _last_set(bits, row, col + first, col + min(last, -1))
            for side in range(2):
                cell = right_cell if side == 0 else left_cell
                if cell >= 0:
                    # The nearest point along the row, then across it.
                    x = min(max(0.0, max(cell - col - offset, left)), min(cell - col - offset + 1.0, right))
                    y = max(bottom, x * (half.right_slope if x > 0.0 else half.left_slope))
                    distance = x * x + y * y
                    if distance < square:
                        square, found_x, found_y, found_col, found_row = distance, x, step * y, cell, row
                        reach = math.sqrt(square)
        row += step
        bottom, top = top, top + 1.0
    return Nearest(square, found_x, found_y, found_col, found_row)


@inlined_kernel
def _extent(half: Half, bottom: float, top: float) -> tuple[float, float]:
    """Return where the sector begins and ends along the rows, between two distances across them."""
    return half.left * (top if half.left < 0.0 else bottom), half.right * (top if half.right > 0.0 else bottom)


@inlined_kernel
def _columns(left: float, right: float, reach: float, offset: float, lowest: int, highest: int) -> tuple[int, int]:
    """Return the first and last column, from the apex's, of that extent within reach and on the map; (0, -1): none."""
    begin = max(left, -reach) + offset + TIE
    end = min(right, reach) + offset - TIE
    if begin < highest + 1.0 and end > lowest:
        return max(int(np.floor(begin)), lowest), min(int(np.ceil(end)) - 1, highest)
    return 0, -1


@inlined_kernel
def _first_set(bits: Bits, row: int, first: int, last: int) -> int:
    """Return the first set column of a row in [first, last], -1 if there is none."""
    if first > last:
        return -1
    word, end = first >> 5, last >> 5
    value = np.int64(bits[row, word]) >> (first & 31) << (first & 31)
    while value == 0 and word < end:
        word += 1
        value = np.int64(bits[row, word])
    if value == 0:
        return -1
    cell = (word << 5) + _log_2(value & -value)
    return cell if cell <= last else -1


@inlined_kernel
def _last_set(bits: Bits, row: int, first: int, last: int) -> int:
    """Return the last set column of a row in [first, last], -1 if there is none."""
    if first > last:
        return -1
    word, end = last >> 5, first >> 5
    value = np.int64(bits[row, word]) & ((np.int64(2) << (last & 31)) - 1)
    while value == 0 and word > end:
        word -= 1
        value = np.int64(bits[row, word])
    if value == 0:
        return -1
    cell = (word << 5) + _log_2(value)
    return cell if cell >= first else -1


@inlined_kernel
def _log_2(value: int | np.int64) -> int:
    """Return the number of the highest bit of 0 < value < 2^53: the exponent of the double."""
    return int(np.float64(value).view(np.int64) >> 52) - 1023
