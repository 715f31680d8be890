"""Solids whose inside no beam reaches."""

from __future__ import annotations

import numpy as np

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.solids import hollowed


def test_only_cells_deep_in_a_solid_become_unknown():
    cells = np.zeros((30, 40), np.float32)
    cells[:, 10:] = 1.0
    cells[3, 3] = np.nan
    grid = OccupancyGrid(cells, 0.1, (1.0, 2.0, 0.3))
    hollow = hollowed(grid)
    # The wall's first column is 10; half a metre behind it, in column 15, is the last that a hit may lie in.
    assert np.argwhere(hollow.unknown & ~grid.unknown)[:, 1].min() == 16
    assert hollow.unknown[:, 16:].all()
    assert np.array_equal(hollow.probability[:, :16], grid.probability[:, :16], equal_nan=True)
    assert hollow.resolution == grid.resolution
    assert np.array_equal(hollow.origin, grid.origin)


def test_a_map_with_thin_walls_or_nothing_but_walls_stays_itself():
    thin = np.zeros((30, 30), np.float32)
    thin[10:20] = 1.0
    for cells in (thin, np.ones_like(thin), np.zeros_like(thin)):
        grid = OccupancyGrid(cells, 0.1)
        assert hollowed(grid) is grid
