"""Branch and bound over translations, for every heading, on a pyramid of maxima.

The score of a candidate is the sum of the field's values in the cells of its points. Level h of the pyramid holds, for
each cell, the greatest value among the 2^h x 2^h cells from it towards growing columns and rows. So the same sum taken
from level h, at a block's first candidate, is at least the score of every candidate of the block. Values are integers:
sums are exact, and bounds hold without any allowance for rounding.

A candidate's key is its place in the order (heading, row, column). Of equal scores the one with the least key counts,
so that neither the order of the search nor the number of threads changes the result.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel

Bytes = NDArray[np.uint8]
Integers = NDArray[np.int64]
Points = NDArray[np.int32]

# Levels of blocks on the stack, four children each.
STACK = 128


@kernel
def fill_pyramid(field: Bytes, pyramid: Bytes) -> None:
    """Fill the pyramid of maxima.

    Parameters
    ----------
    field
        (rows, cols) values.
    pyramid
        (levels, at least rows + 2 side, at least cols + 2 side) overwritten, with side 2^(levels - 1): cell (0, 0) of
        the field is at [side, side]; off the field values are 0.
    """
    rows, cols = field.shape
    levels, tall, wide = pyramid.shape
    pad = 1 << (levels - 1)
    pyramid[0] = 0
    for r in range(rows):
        for c in range(cols):
            pyramid[0, pad + r, pad + c] = field[r, c]
    for h in range(1, levels):
        half = 1 << (h - 1)
        below, here = pyramid[h - 1], pyramid[h]
        for r in range(tall):
            above = min(r + half, tall - 1)
            for c in range(wide - half):
                here[r, c] = max(max(below[r, c], below[r, c + half]), max(below[above, c], below[above, c + half]))
            for c in range(wide - half, wide):
                here[r, c] = max(below[r, c], below[above, c])


@kernel
def fill_coarse_bounds(points: Points, top: Bytes, bounds: Integers) -> None:
    """Bound the score of every block of the coarsest level.

    Parameters
    ----------
    points
        (n, 2, p) rows and columns, in the pyramid's cells, of the points at each heading's first candidate.
    top
        (side, side, tall, wide): [p, q, a, b] is the coarsest level's value at row a side + p, column b side + q. What
        neighbouring blocks take for one point lies side by side in it, and is added for many of them at once.
    bounds
        (n, block rows, block columns) overwritten.
    """
    side, _, tall, wide = top.shape
    n_rows, n_cols = bounds.shape[1:]
    for k in range(points.shape[0]):
        into = bounds[k]
        into[:] = 0
        for b in range(points.shape[2]):
            r, c = points[k, 0, b] // side, points[k, 1, b] // side
            values = top[points[k, 0, b] % side, points[k, 1, b] % side]
            first, last = max(0, -c), min(n_cols, wide - c)
            if first < last:
                for j in range(max(0, -r), min(n_rows, tall - r)):
                    sums, more = into[j, first:last], values[r + j, c + first : c + last]
                    for i in range(len(sums)):
                        sums[i] += more[i]


@kernel
def search_blocks(blocks: Integers, bounds: Integers, points: Points, pyramid: Bytes, n_rows: int, n_cols: int,
                  excluded: Integers, best: int, best_key: int, out: Integers) -> None:  # fmt: skip
    """Find the best candidate of each block that beats the best one known.

    Parameters
    ----------
    blocks
        (m,) indices of blocks of the coarsest level, each once.
    bounds
        (n, block rows, block columns) of all blocks; those of the blocks searched fall to what they were found to hold
        at most outside the disc.
    points
        See `fill_coarse_bounds`.
    pyramid
        See `fill_pyramid`.
    n_rows, n_cols
        Candidates of a heading.
    excluded
        (4,) + (headings,) first row, column, squared radius of a disc of candidates that do not count, and a 0; then 1
        for the headings at which they do not.
    best, best_key
        The best candidate known: its score and key; -1 and the number of candidates for none.
    out
        (m, 3) overwritten: score and key of the best candidate, -1 if it does not beat the best known; number of sums
        that were taken.
    """
    levels, tall, wide = pyramid.shape
    side = 1 << (levels - 1)
    block_rows, block_cols = bounds.shape[1:]
    stack = np.empty((STACK, 4), np.int64)
    child = np.empty((4, 3), np.int64)
    sums = np.empty(4, np.int64)
    places = np.empty(points.shape[2], np.int64)
    for m in range(blocks.shape[0]):
        rest, block_col = blocks[m] // block_cols, blocks[m] % block_cols
        k, block_row = rest // block_rows, rest % block_rows
        first_row, first_col, bound = block_row * side, block_col * side, bounds[k, block_row, block_col]
        has_hole = excluded[4 + k] == 1
        out[m, 0], out[m, 1] = -1, -1
        taken = 0
        top, most = 0, bound
        if _beats(bound, (k * n_rows + first_row) * n_cols + first_col, best, best_key):
            top, most = 1, 0
            stack[0, 0], stack[0, 1], stack[0, 2], stack[0, 3] = levels - 1, first_row, first_col, bound
            _fill_places(points[k], first_row, first_col, tall - side, wide - side, wide, places)
        while top > 0:
            top -= 1
            level, row, col, bound = stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3]
            if not _beats(bound, (k * n_rows + row) * n_cols + col, best, best_key):
                most = max(most, bound)
                continue
            size = 1 << level
            if has_hole and _inside(row, col, min(row + size, n_rows) - 1, min(col + size, n_cols) - 1, excluded):
                continue
            if level == 0:
                best, best_key = bound, (k * n_rows + row) * n_cols + col
                out[m, 0], out[m, 1] = best, best_key
                most = max(most, bound)
                continue
            level -= 1
            half = 1 << level
            _four_sums(places, pyramid[level], row - first_row, col - first_col, half, sums)
            taken += 4
            n = 0
            for quarter in range(4):
                r, c, value = row + half * (quarter >> 1), col + half * (quarter & 1), sums[quarter]
                if r >= n_rows or c >= n_cols:
                    continue
                if not _beats(value, (k * n_rows + r) * n_cols + c, best, best_key):
                    most = max(most, value)
                    continue
                # The best child goes on top, to be searched first: insert by (bound, falling key).
                place = n
                while place > 0 and not _beats(value, quarter, child[place - 1, 2], child[place - 1, 0] & 3):
                    for j in range(3):  # a row copied as a whole takes 2 s to compile
                        child[place, j] = child[place - 1, j]
                    place -= 1
                child[place, 0], child[place, 1], child[place, 2] = r * 4 + quarter, c, value
                n += 1
            for q in range(n):
                stack[top, 0], stack[top, 1], stack[top, 2], stack[top, 3] = (
                    level,
                    child[q, 0] >> 2,
                    child[q, 1],
                    child[q, 2],
                )
                top += 1
        out[m, 2] = taken
        bounds[k, block_row, block_col] = most


@kernel
def _beats(score: int, key: int, best: int, best_key: int) -> bool:
    """Say whether a candidate, or the best that a block may hold, comes before the best one known."""
    return score > best or (score == best and key < best_key)


@kernel
def _inside(row: int, col: int, last_row: int, last_col: int, excluded: Integers) -> bool:
    """Say whether all candidates of a block lie in the disc that does not count."""
    dr = max(abs(row - excluded[0]), abs(last_row - excluded[0]))
    dc = max(abs(col - excluded[1]), abs(last_col - excluded[1]))
    return bool(dr * dr + dc * dc <= excluded[2])


@kernel
def _fill_places(points: Points, row: int, col: int, last_row: int, last_col: int, wide: int, places: Integers) -> None:
    """Fill in the places in a flat level of the points moved by (row, col); those off the field move to its zeros."""
    for b in range(points.shape[1]):
        r, c = points[0, b] + row, points[1, b] + col
        places[b] = min(max(r, 0), last_row) * wide + min(max(c, 0), last_col)


@kernel
def _four_sums(places: Integers, level: Bytes, row: int, col: int, half: int, sums: Integers) -> None:
    """Fill sums (4,) of a level at places moved by (row, col), (row, col + half), (row + half, col) and both halves."""
    wide = level.shape[1]
    flat = level.reshape(-1)
    s0, s1, s2, s3 = 0, 0, 0, 0
    first = row * wide + col
    for b in range(places.shape[0]):
        at = np.uint64(places[b] + first)  # unsigned, which spares asking whether it counts from the end
        s0 += flat[at]
        s1 += flat[at + np.uint64(half)]
        s2 += flat[at + np.uint64(half * wide)]
        s3 += flat[at + np.uint64(half * wide + half)]
    sums[0], sums[1], sums[2], sums[3] = s0, s1, s2, s3
