"""Occupancy grids: what they keep of the caller's array, and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid


def test_a_grid_does_not_change_with_the_array_it_was_made_of():
    values = np.zeros((2, 3), np.float32)
    view = values[:]
    view.flags.writeable = False
    grids = [OccupancyGrid(values, 0.1), OccupancyGrid(view, 0.1)]
    values[:] = 1.0
    assert not any(grid.occupied.any() for grid in grids)
    assert values.flags.writeable


def test_an_array_that_nobody_can_write_is_shared():
    values = np.zeros((2, 3), np.float32)
    values.flags.writeable = False
    assert OccupancyGrid(values, 0.1).probability is values


@pytest.mark.parametrize("bad", [-1e-6, 1.0001, np.inf, -np.inf])
def test_a_value_that_is_no_probability_is_named_with_its_place(bad):
    values = np.full((3, 4), np.nan)
    OccupancyGrid(values, 0.1)
    values[0], values[2, 1] = (0.0, 1.0, 0.5, np.nan), bad
    with pytest.raises(InvalidInputError, match=r"got .* at \(row, col\) = \(2, 1\)"):
        OccupancyGrid(values, 0.1)


@pytest.mark.parametrize("resolution", [0.0, -0.05, 1.7e308, 1e-300, np.nan])
def test_cells_whose_area_cannot_be_computed_are_refused(resolution):
    with pytest.raises(InvalidInputError, match="resolution: expected a positive number from 1e-12 to 1e"):
        OccupancyGrid(np.zeros((2, 3)), resolution)


def test_bounds_are_those_of_the_turned_map():
    grid = OccupancyGrid(np.zeros((2, 4)), resolution=0.5, origin=(1.0, -1.0, np.pi / 2.0))
    assert grid.bounds == pytest.approx((0.0, -1.0, 1.0, 1.0))
