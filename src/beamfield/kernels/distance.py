"""The exact Euclidean distance transform: along columns, then along rows (after Meijster, Roerdink and Hesselink).

The square of the distance to the nearest obstacle is the least (u - i)^2 + h_i^2 over the columns i of a row, where the
height h_i counts the cells up or down to the nearest obstacle of column i. All of these are whole numbers, and exact.

The second pass has two ways to find them. Where no obstacle is far, all columns in reach are tried, for many cells at a
time in 16 bits. Elsewhere the lower envelope of the parabolas is built, in double precision, which holds whole numbers
up to 2^53 exactly. The row before tells which way to go: from row to row, a distance changes by at most one cell.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import fast_kernel, kernel

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Heights = NDArray[np.int32]
Squares = NDArray[np.uint16]

# Sums of two squares of such numbers are at most 2^53.
MAX_SIDE_CELLS = 2**26
# The least height in a column without obstacles. A column's length can be added to it.
NO_OBSTACLE = 2**30
# Columns whose heights are found together: what is carried from row to row stays in the nearest cache.
STRIP = 1024
# Columns whose distances are found together: the farthest of them decides how many columns are tried.
BLOCK = 256
# Distances up to which columns are tried, a multiple of GROUP; heights are cut off at CAP, so that sums fit 16 bits.
NEAR, CAP = 180, 181
# Columns on either side that are tried in one go.
GROUP = 4


@kernel
def fill_heights(obstacles: NDArray[np.bool_], start: int, stop: int, out: Heights) -> None:
    """Fill columns [start, stop) of out (rows, cols) with the number of cells to the nearest obstacle in the column.

    It is NO_OBSTACLE or more where there is none.
    """
    for first in range(start, stop, STRIP):
        last = min(first + STRIP, stop)
        height = np.empty(last - first, np.int32)
        height[:] = NO_OBSTACLE  # np.full takes longer to compile
        for r in range(out.shape[0]):
            occupied, row = obstacles[r, first:last], out[r, first:last]
            for c in range(height.size):
                height[c] = np.int32(0) if occupied[c] else np.int32(height[c] + 1)
                row[c] = height[c]
        height[:] = NO_OBSTACLE
        for r in range(out.shape[0] - 1, -1, -1):
            row = out[r, first:last]
            for c in range(height.size):
                height[c] = min(np.int32(height[c] + 1), row[c])
                row[c] = height[c]


@kernel
def fill_metres(reach: int, resolution: float, limit: float, out: Singles) -> None:
    """Replace the heights in the memory of out (rows, cols) by distances in metres, at most `limit`.

    Distances are found up to `reach` cells; those beyond come out at least as large as that, and as `limit`.
    """
    rows, cols = out.shape
    all_heights = out.view(np.int32)
    heights, squares, envelope = np.empty(cols, np.int32), np.empty(cols), np.empty((3, cols))
    near, best = np.empty(cols + 2 * NEAR, np.uint16), np.empty(BLOCK, np.uint16)
    farthest = np.empty((cols + BLOCK - 1) // BLOCK, np.int64)
    near[:], farthest[:] = CAP**2, reach
    for r in range(rows):
        for c in range(cols):
            heights[c] = all_heights[r, c]
        _fill_near_squares(heights, near[NEAR : NEAR + cols])
        b = 0
        while b < farthest.size:
            # A single block that is near, or all blocks in a row that are not.
            first, far = b * BLOCK, farthest[b]
            b += 1
            while far > NEAR and b < farthest.size and farthest[b] > NEAR:
                far = max(far, farthest[b])
                b += 1
            last = min(b * BLOCK, cols)
            if far <= NEAR:
                _try_columns(near[first : last + 2 * NEAR], far, best, squares[first:last])
            else:
                _find_envelope(heights, far, first, last, envelope, squares)
        for b in range(farthest.size):
            largest = _largest_of(squares[b * BLOCK : min((b + 1) * BLOCK, cols)])
            farthest[b] = min(reach, int(math.sqrt(largest)) + 1)
        _write_metres(squares, resolution, limit, out[r])


@kernel
def _fill_near_squares(heights: Heights, out: Squares) -> None:
    """Fill out (n,) with the squares of heights, cut off at CAP^2."""
    for i in range(out.size):
        height = min(heights[i], np.int32(CAP))
        out[i] = np.uint16(np.int32(height * height))


@kernel
def _try_columns(near: Squares, reach: int, best: Squares, out: Floats) -> None:
    """Fill out (n,) with the squares of the distances, none of which is more than `reach`, up to NEAR.

    `near` (n + 2 NEAR,) holds the squares of the heights, also of the columns beside; best (>= n,) is overwritten.
    """
    for i in range(out.size):
        best[i] = near[NEAR + i]
    for k in range(1, reach + 1, GROUP):
        left, right = near[NEAR - k - 3 :], near[NEAR + k :]
        k0, k1, k2, k3 = k**2, (k + 1) ** 2, (k + 2) ** 2, (k + 3) ** 2
        for i in range(out.size):
            s0 = np.uint16(min(left[i + 3], right[i]) + k0)
            s1 = np.uint16(min(left[i + 2], right[i + 1]) + k1)
            s2 = np.uint16(min(left[i + 1], right[i + 2]) + k2)
            s3 = np.uint16(min(left[i], right[i + 3]) + k3)
            best[i] = min(best[i], min(min(s0, s1), min(s2, s3)))
    for i in range(out.size):
        out[i] = best[i]


@kernel
def _find_envelope(heights: Heights, reach: int, first: int, last: int, envelope: Floats, out: Floats) -> None:
    """Fill out[first:last] with the squares of the distances in a row, none of which is more than `reach`.

    Other distances, and all if no obstacle is in reach, come out as `reach` or more. In `envelope` (3, cols), which is
    overwritten, a parabola (u - i)^2 + h^2 is held as i, i^2 + h^2, and the first u where it is the lowest; u and i are
    counted from the first column in reach.
    """
    left, right = max(first - reach, 0), min(last + reach, heights.size)
    centres, constants, starts = envelope[0], envelope[1], envelope[2]
    n = 0
    for i in range(left, right):
        if heights[i] > reach:
            continue
        centre, height, start = np.float64(i - left), np.float64(heights[i]), 0.0
        constant = centre * centre + height * height
        while n > 0 and constant - constants[n - 1] < 2.0 * starts[n - 1] * (centre - centres[n - 1]):
            n -= 1
        if n > 0:
            start = 1.0 + np.floor((constant - constants[n - 1]) / (2.0 * (centre - centres[n - 1])))
        if start < right - left:
            centres[n], constants[n], starts[n] = centre, constant, start
            n += 1
    out[first:last] = np.float64(reach) ** 2
    for p in range(n):
        begin = max(left + int(starts[p]), first)
        end = min(left + int(starts[p + 1]), last) if p + 1 < n else last
        column, square = left + centres[p], constants[p] - centres[p] ** 2
        for u in range(begin, end):
            out[u] = (u - column) ** 2 + square


@fast_kernel
def _largest_of(squares: Floats) -> float:
    """Return the largest square."""
    largest = 0.0
    for i in range(squares.size):
        largest = max(largest, squares[i])
    return largest


@kernel
def _write_metres(squares: Floats, resolution: float, limit: float, out: Singles) -> None:
    """Fill out (n,) with the roots of squares of cells, in metres, at most `limit`."""
    for i in range(out.size):
        metres = math.sqrt(squares[i]) * resolution
        out[i] = np.float32(metres if metres < limit else limit)
