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
    # Its corners are at (0, 0), (2, 2) / sqrt(2), (1, 3) / sqrt(2) and (-1, 1) / sqrt(2).
    oblique = OccupancyGrid(np.zeros((2, 4)), resolution=0.5, origin=(0.0, 0.0, np.pi / 4.0))
    assert oblique.bounds == pytest.approx((-np.sqrt(0.5), 0.0, np.sqrt(2.0), 3.0 * np.sqrt(0.5)))


def test_a_point_is_in_the_cell_whose_lower_edges_it_reaches():
    table, shape = np.array([[1, 2, 3], [4, 5, 6]]), np.zeros((2, 3))
    grid = OccupancyGrid(shape, 0.5, (1.0, -1.0, 0.0))
    points = [(1.0, -1.0), (2.4, -1.0), (2.5, -1.0), (1.0, -0.5), (1.0, -0.01), (1.0, 0.0), (0.99, -1.0), (1.0, -1.01)]
    assert grid.look_up(table, points, outside=-7).tolist() == [1, 3, -7, 4, 4, -7, -7, -7]
    turned = OccupancyGrid(shape, 0.5, (1.0, -1.0, np.pi / 2.0))
    assert turned.look_up(table, [(0.25, 0.25), (0.75, -0.75), (1.25, -0.75), (-1e200, 0.0)]).tolist() == [6, 1, 0, 0]
    np.testing.assert_allclose(turned.to_cells([0.25, 0.25]), [2.5, 1.5])


def test_a_probability_at_a_threshold_is_on_its_side():
    grid = OccupancyGrid([[0.65, 0.6499, 0.2, 0.2001, np.nan]], 0.1, occupied_thresh=0.65, free_thresh=0.2)
    assert grid.occupied.tolist() == [[True, False, False, False, False]]
    assert grid.free.tolist() == [[False, False, True, False, False]]
    assert grid.unknown.tolist() == [[False, True, False, True, True]]
    with pytest.raises(InvalidInputError, match="free_thresh < occupied_thresh"):
        OccupancyGrid([[0.5]], 0.1, occupied_thresh=0.3, free_thresh=0.3)
    with pytest.raises(InvalidInputError, match=r"origin: expected numbers up to 1e\+09, got \[0.0, 1e\+30, 0.0\]"):
        OccupancyGrid([[0.5]], 0.1, origin=(0.0, 1e30, 0.0))


def test_cells_that_are_masked_are_not_taken_for_what_lies_below_the_mask():
    cells = np.ma.array([[0, 100]], np.int8, mask=[[False, True]])
    with pytest.raises(InvalidInputError, match=r"^data: .* with 1 of 2 masked: \.astype\(float\)\.filled\(np\.nan\)"):
        OccupancyGrid.from_ros(cells, 0.1)
    assert np.isnan(OccupancyGrid.from_ros(cells.astype(float).filled(np.nan), 0.1).probability[0, 1])


@pytest.mark.parametrize("bad", [-2, 101])
def test_a_value_that_no_message_has_is_named(bad):
    with pytest.raises(InvalidInputError, match=f"data: expected -1 or 0 to 100, got {bad}"):
        OccupancyGrid.from_ros([[0, -1, 100], [0, bad, 0]], 0.1)
