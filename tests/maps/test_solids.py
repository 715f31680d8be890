"""Solids whose inside no beam reaches."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.solids import has_fill, hollowed


@pytest.mark.parametrize(
    # In cells of 0.1 m: half a metre of a thick wall stays on either side, and 0.1 m of what is painted black.
    ("last", "is_fill", "unknown"),
    [(24, False, range(16, 19)), (39, True, range(12, 40))],
)
def test_only_cells_deep_in_a_solid_become_unknown(last, is_fill, unknown):
    cells = np.zeros((30, 40), np.float32)
    cells[:, 10 : last + 1] = 1.0
    cells[3, 3] = np.nan
    grid = OccupancyGrid(cells, 0.1, (1.0, 2.0, 0.3))
    hollow = hollowed(grid)
    assert has_fill(grid) is is_fill
    changed = hollow.unknown & ~grid.unknown
    assert sorted(set(np.argwhere(changed)[:, 1])) == list(unknown)
    assert changed.sum() == 30 * len(unknown)
    assert np.array_equal(hollow.probability[~changed], grid.probability[~changed], equal_nan=True)
    assert hollow.resolution == grid.resolution
    assert np.array_equal(hollow.origin, grid.origin)
    assert not has_fill(hollow)


def test_a_map_with_thin_walls_or_nothing_but_walls_stays_itself():
    thin = np.zeros((30, 30), np.float32)
    thin[10:20] = 1.0
    for cells in (thin, np.ones_like(thin), np.zeros_like(thin)):
        grid = OccupancyGrid(cells, 0.1)
        assert hollowed(grid) is grid
        assert not has_fill(grid)
