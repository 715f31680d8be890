"""Directions of a map's walls, cell by cell: what angles of incidence are measured against."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beamfield.maps.occupancy import OccupancyGrid

# A line is fitted to the surface cells within so many cells in each direction that hang together.
REACH = 4
# They are a wall if they scatter across the line by less than this share of their scatter along it: a corner is none.
FLATNESS = 0.45
FEWEST_CELLS = 4
CELLS_AT_ONCE = 50_000


def wall_normals(grid: OccupancyGrid) -> NDArray[np.float32]:
    """Return the direction of the normal of each cell's wall, radians in the map's frame, up to half a turn.

    Cells stop rays at their own sides, which all lie along the grid: the wall's direction is that of a line through the
    surface cells around, which are those with a neighbour that is not occupied. NaN where no cell is on a surface, and
    where it has no direction: at corners, ends and in clutter.

    >>> grid = OccupancyGrid([[0.0] * 9, [1.0] * 9, [0.0] * 9], resolution=0.1)
    >>> float(np.degrees(wall_normals(grid)[1, 4])) % 180.0
    90.0
    """
    occupied = grid.occupied
    surface = occupied & ~ndimage.binary_erosion(occupied, np.ones((3, 3), bool), border_value=1)
    rows, cols = np.nonzero(surface)
    size = 2 * REACH + 1
    around = np.lib.stride_tricks.sliding_window_view(np.pad(surface, REACH), (size, size))
    normals = np.full(grid.shape, np.nan, np.float32)
    for start in range(0, len(rows), CELLS_AT_ONCE):
        part = slice(start, start + CELLS_AT_ONCE)
        normals[rows[part], cols[part]] = _normals(around[rows[part], cols[part]]) + float(grid.origin[2])
    return normals


def _normals(windows: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the normals (n,) of the cells in the middle of windows (n, size, size) in the grid's frame."""
    middle = np.zeros_like(windows)
    middle[:, REACH, REACH] = True
    # Within its window, and not into the next one.
    cells = ndimage.binary_propagation(middle, np.ones((1, 3, 3), bool), mask=windows).astype(np.float64)
    away = np.arange(-REACH, REACH + 1.0)
    n = cells.sum(axis=(1, 2))
    x, y = (cells.sum(axis=1) @ away) / n, (cells.sum(axis=2) @ away) / n
    xx, yy = (cells.sum(axis=1) @ away**2) / n - x * x, (cells.sum(axis=2) @ away**2) / n - y * y
    xy = (cells @ away @ away) / n - x * y
    half, root = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    is_wall = (n >= FEWEST_CELLS) & (half - root <= FLATNESS**2 * (half + root))
    return np.where(is_wall, 0.5 * np.arctan2(2.0 * xy, xx - yy) + 0.5 * np.pi, np.nan)
