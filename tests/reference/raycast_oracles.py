"""Two slow ways to cast rays that share nothing with the caster, and nothing with each other.

Both work in cells (x along columns, y along rows) on a boolean grid, and follow the convention in the docstring of
`beamfield.maps.raycast.RayCaster`: off-map space is free, cell = floor, crossings within 1e-9 cells of each other
along the ray are a corner, which blocks if the cell behind it or both cells beside it are occupied.
"""

from __future__ import annotations

import numba
import numpy as np

TOLERANCE = 1e-9
PARALLEL = 1e-12


@numba.njit(error_model="numpy")
def traverse(x, y, direction_x, direction_y, occupied, max_cells):
    """Step from cell to cell.

    Parameters
    ----------
    x, y, direction_x, direction_y
        (n,) starts in cells and unit directions.
    occupied
        (rows, cols) bool.
    max_cells
        Longest range.

    Returns
    -------
    (n,) ranges in cells, (n, 2) row and column of the cell that was hit (-1: none), and (n,) whether it was a corner
    between two occupied cells that stopped the ray.
    """
    rows, cols = occupied.shape
    n = len(x)
    ranges = np.full(n, max_cells)
    cells = np.full((n, 2), -1)
    pinched = np.zeros(n, np.bool_)
    for r in range(n):
        px, py = x[r], y[r]
        if abs(px - np.rint(px)) <= TOLERANCE:
            px = np.rint(px)
        if abs(py - np.rint(py)) <= TOLERANCE:
            py = np.rint(py)
        dx = direction_x[r] if abs(direction_x[r]) >= PARALLEL else 0.0
        dy = direction_y[r] if abs(direction_y[r]) >= PARALLEL else 0.0
        col, row = int(np.floor(px)), int(np.floor(py))
        t = 0.0
        while t < max_cells:
            if 0 <= col < cols and 0 <= row < rows and occupied[row, col]:
                ranges[r] = t
                cells[r, 0], cells[r, 1] = row, col
                break
            # Nothing can follow once the ray has left the map for good.
            if (dx >= 0 and col >= cols) or (dx <= 0 and col < 0) or (dy >= 0 and row >= rows) or (dy <= 0 and row < 0):
                break
            t_col = np.inf
            if dx > 0:
                t_col = (col + 1 - px) / dx
            elif dx < 0:
                t_col = (col - px) / dx
            t_row = np.inf
            if dy > 0:
                t_row = (row + 1 - py) / dy
            elif dy < 0:
                t_row = (row - py) / dy
            step_col, step_row = (1 if dx > 0 else -1), (1 if dy > 0 else -1)
            if abs(t_col - t_row) <= TOLERANCE:
                t = max(t_col, t_row)
                beside = 0
                if 0 <= col + step_col < cols and 0 <= row < rows and occupied[row, col + step_col]:
                    beside += 1
                if 0 <= col < cols and 0 <= row + step_row < rows and occupied[row + step_row, col]:
                    beside += 1
                if beside == 2 and t < max_cells:
                    ranges[r] = t
                    cells[r, 0], cells[r, 1] = row, col + step_col
                    pinched[r] = True
                    break
                col += step_col
                row += step_row
            elif t_col < t_row:
                t = t_col
                col += step_col
            else:
                t = t_row
                row += step_row
    return ranges, cells, pinched


def intersect_boxes(x, y, direction_x, direction_y, occupied, max_cells):
    """Intersect every ray with the square of every occupied cell, and with every corner between two of them.

    Parameters and the first result as for `traverse`; for small grids.
    """
    x, y = (np.where(np.abs(v - np.rint(v)) <= TOLERANCE, np.rint(v), v)[:, None] for v in (x, y))
    dx, dy = (np.where(np.abs(v) >= PARALLEL, v, 0.0)[:, None] for v in (direction_x, direction_y))
    start_col, start_row = np.floor(x), np.floor(y)
    ranges = np.full(len(x), max_cells)

    rows, cols = np.nonzero(occupied)
    near_x, far_x = _interval(x, dx, cols, start_col)
    near_y, far_y = _interval(y, dy, rows, start_row)
    enter, leave = np.maximum(near_x, near_y), np.minimum(far_x, far_y)
    starts_here = (cols == start_col) & (rows == start_row)
    # A chord shorter than the tolerance is a touch at a corner.
    hit = starts_here | (leave - enter > TOLERANCE)
    entered = np.where(starts_here, 0.0, enter)
    if entered.shape[1]:
        ranges = np.minimum(ranges, np.where(hit, entered, np.inf).min(axis=1))

    # Corners (i, j) whose cells lower left and upper right, or upper left and lower right, are both occupied. A ray can
    # only slip between the two if it crosses from one of the other two cells into the last.
    lower_left, upper_right = occupied[:-1, :-1], occupied[1:, 1:]
    upper_left, lower_right = occupied[1:, :-1], occupied[:-1, 1:]
    for pair, sign in ((lower_left & upper_right, -1.0), (upper_left & lower_right, 1.0)):
        j, i = np.nonzero(pair)
        i, j = i + 1, j + 1
        if not len(i):
            continue
        with np.errstate(divide="ignore", invalid="ignore"):
            t_x, t_y = (i - x) / dx, (j - y) / dy
        ahead = np.where(dx > 0, i > start_col, i <= start_col) & np.where(dy > 0, j > start_row, j <= start_row)
        between = (dx * dy * sign > 0) & ahead & (np.abs(t_x - t_y) <= TOLERANCE)
        ranges = np.minimum(ranges, np.where(between, np.maximum(t_x, t_y), np.inf).min(axis=1))
    return np.clip(ranges, 0.0, max_cells)


def _interval(start, direction, cell, start_cell):
    """Return where rays (n, 1) enter and leave the strips of cells (m,) of one axis; never if the strip is behind."""
    with np.errstate(divide="ignore", invalid="ignore"):
        low, high = (cell - start) / direction, (cell + 1 - start) / direction
    near, far = np.where(direction >= 0, low, high), np.where(direction >= 0, high, low)
    parallel = direction == 0
    inside = cell == start_cell
    near = np.where(parallel, np.where(inside, -np.inf, np.inf), near)
    far = np.where(parallel, np.where(inside, np.inf, -np.inf), far)
    behind = np.where(direction > 0, cell < start_cell, cell > start_cell) & ~parallel
    return np.where(behind, np.inf, near), np.where(behind, -np.inf, far)
