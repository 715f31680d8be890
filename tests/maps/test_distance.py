"""Distances to obstacles against two independent computations, and by what must hold for every map."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy import ndimage

from beamfield.errors import InvalidInputError
from beamfield.maps.distance import DistanceField, distance_to_obstacles
from beamfield.maps.occupancy import OccupancyGrid
from tests.reference.field_tables import distance_to_nearest_obstacle

MAPS = arrays.arrays(
    np.bool_, st.tuples(st.integers(1, 12), st.integers(1, 12)), elements=st.integers(0, 7).map(lambda n: n == 0)
)


def grid_of(occupied, resolution=0.05, **options):
    return OccupancyGrid.from_ros(np.where(occupied, 100, 0), resolution, **options)


@settings(max_examples=60)
@given(MAPS, st.integers(0, 3))
def test_every_cell_has_the_distance_of_the_nearest_obstacle(occupied, margin):
    distance = distance_to_obstacles(grid_of(occupied), margin_cells=margin)
    for (row, col), value in np.ndenumerate(distance):
        expected = distance_to_nearest_obstacle(occupied, 0.05, row - margin, col - margin)
        assert value == np.float32(expected)


@settings(max_examples=100)
@given(MAPS)
def test_neighbours_differ_by_at_most_a_cell(occupied):
    distance = distance_to_obstacles(grid_of(occupied))
    if occupied.any():
        for axis in (0, 1):
            assert np.abs(np.diff(distance, axis=axis)).max(initial=0.0) <= 0.05 * (1 + 1e-6)
        assert ((distance == 0.0) == occupied).all()


@settings(max_examples=100)
@given(MAPS, st.data())
def test_another_obstacle_never_makes_anything_further(occupied, data):
    more = occupied.copy()
    more[data.draw(st.integers(0, occupied.shape[0] - 1)), data.draw(st.integers(0, occupied.shape[1] - 1))] = True
    assert (distance_to_obstacles(grid_of(more)) <= distance_to_obstacles(grid_of(occupied))).all()


@settings(max_examples=100)
@given(MAPS, st.integers(0, 3), st.booleans(), st.floats(0.01, 1.0))
def test_every_option_leaves_the_other_distances_exact(occupied, margin, only_boundaries, max_distance):
    """Squares by brute force in whole numbers."""
    counted = np.zeros_like(occupied)
    for row, col in np.argwhere(occupied):
        beside = [(row - 1, col), (row + 1, col), (row, col - 1), (row, col + 1)]
        on_map = [cell for cell in beside if 0 <= cell[0] < occupied.shape[0] and 0 <= cell[1] < occupied.shape[1]]
        counted[row, col] = not only_boundaries or not all(occupied[cell] for cell in on_map)
    distance = distance_to_obstacles(
        grid_of(occupied), max_distance=max_distance, only_boundaries=only_boundaries, margin_cells=margin
    )
    for (row, col), value in np.ndenumerate(distance):
        squares = [(row - margin - r) ** 2 + (col - margin - c) ** 2 for r, c in np.argwhere(counted).tolist()]
        expected = math.sqrt(min(squares)) * 0.05 if squares else math.inf
        assert value == min(np.float32(expected), np.float32(max_distance))


def walls(shape, *, every):
    occupied = np.zeros(shape, np.bool_)
    occupied[:: every[0]] = occupied[:, :: every[1]] = True
    return occupied


def large_map(kind, rng):
    """Maps with distances on both sides of 180 cells, up to which columns are tried, and beside each other."""
    shape = (600, 1000)
    occupied = np.zeros(shape, np.bool_)
    match kind:
        case "rooms":
            return walls(shape, every=(97, 140))
        case "halls":
            return walls(shape, every=(450, 620))
        case "clutter beside a hall":
            occupied[:, :400] = rng.random((600, 400)) < 0.1
        case "clutter below a hall":
            occupied[:200] = rng.random((200, 1000)) < 0.3
        case "sparse":
            occupied = rng.random(shape) < 2e-5
        case "half":
            occupied = rng.random(shape) < 0.5
        case "one obstacle":
            occupied[421, 77] = True
        case "one free cell":
            occupied[:] = True
            occupied[300, 500] = False
        case "empty room":
            occupied = walls(shape, every=(599, 999))
    return occupied


KINDS = [
    "rooms",
    "halls",
    "clutter beside a hall",
    "clutter below a hall",
    "sparse",
    "half",
    "one obstacle",
    "one free cell",
    "empty room",
]


@pytest.mark.parametrize("kind", KINDS)
def test_agrees_with_scipy_in_every_cell_of_a_large_map(kind, rng):
    occupied = large_map(kind, rng)
    expected = (ndimage.distance_transform_edt(~occupied) * 0.05).astype(np.float32)
    assert np.array_equal(distance_to_obstacles(grid_of(occupied)), expected)
    for cells in (1.0, 30.5, 178.0, 179.0, 180.0, 181.0, 400.0):
        cut = distance_to_obstacles(grid_of(occupied), max_distance=cells * 0.05)
        assert np.array_equal(cut, np.minimum(expected, np.float32(cells * 0.05)))


@pytest.mark.parametrize("shape", [(1, 200_000), (200_000, 1), (3, 200_000), (200_000, 3)])
def test_sides_of_many_cells_stay_exact(shape):
    occupied = np.zeros(shape, np.bool_)
    occupied[-1, -1] = True
    rows, cols = np.ogrid[: shape[0], : shape[1]]
    squares = (rows - shape[0] + 1) ** 2 + (cols - shape[1] + 1) ** 2
    assert np.array_equal(distance_to_obstacles(grid_of(occupied, 0.05)), (np.sqrt(squares) * 0.05).astype(np.float32))


@pytest.mark.parametrize("parts", [2, 3, 7])
def test_any_number_of_blocks_gives_the_same_bits(parts, rng, monkeypatch):
    occupied = large_map("clutter beside a hall", rng)
    expected = distance_to_obstacles(grid_of(occupied))
    works = []

    def in_parts(work, n_rows, *, work_per_row):
        works.append(work_per_row)
        for i in reversed(range(parts)):
            work(n_rows * i // parts, n_rows * (i + 1) // parts)

    monkeypatch.setattr("beamfield.maps.distance.run_in_blocks", in_parts)
    assert np.array_equal(distance_to_obstacles(grid_of(occupied)), expected)
    assert len(works) == 2


@pytest.mark.parametrize("order", ["C", "F"])
def test_the_order_of_the_cells_in_memory_changes_nothing(order, rng):
    occupied = rng.random((60, 90)) < 0.02
    probability = np.zeros((120, 180), np.float32, order=order)
    probability[::2, ::2] = occupied
    grid = OccupancyGrid(probability[::2, ::2], 0.05)
    for options in ({}, {"margin_cells": 3}, {"only_boundaries": True}, {"only_boundaries": True, "margin_cells": 3}):
        distance = distance_to_obstacles(grid, **options)
        assert np.array_equal(distance, distance_to_obstacles(grid_of(occupied), **options))
        assert distance.flags.c_contiguous


def test_obstacles_on_the_border_and_in_the_corners_count():
    occupied = np.zeros((5, 7), np.bool_)
    occupied[0, 0] = occupied[4, 6] = True
    distance = distance_to_obstacles(grid_of(occupied, 1.0))
    assert distance[0, 0] == distance[4, 6] == 0.0
    assert distance[2, 3] == np.float32(math.sqrt(13))


def test_unknown_cells_are_no_obstacles():
    grid = OccupancyGrid.from_ros([[100, -1, -1, 0]], 1.0)
    assert distance_to_obstacles(grid).tolist() == [[0.0, 1.0, 2.0, 3.0]]


@pytest.mark.parametrize("value", [0, -1])
def test_without_obstacles_everything_is_infinitely_far(value):
    grid = OccupancyGrid.from_ros(np.full((4, 6), value), 0.1)
    assert (distance_to_obstacles(grid) == np.inf).all()
    assert (distance_to_obstacles(grid, max_distance=2.5) == 2.5).all()
    assert distance_to_obstacles(grid, margin_cells=2).shape == (8, 10)


def test_distances_are_cut_off_at_the_longest():
    distance = distance_to_obstacles(OccupancyGrid.from_ros([[100, 0, 0, 0]], 1.0), max_distance=1.5)
    assert distance.tolist() == [[0.0, 1.0, 1.5, 1.5]]


def test_only_the_surface_of_a_thick_wall_counts_if_asked_for():
    occupied = np.zeros((7, 9), np.bool_)
    occupied[1:6, 2:7] = True
    distance = distance_to_obstacles(grid_of(occupied, 1.0), only_boundaries=True)
    assert distance[3].tolist() == [2.0, 1.0, 0.0, 1.0, 2.0, 1.0, 0.0, 1.0, 2.0]
    assert (distance_to_obstacles(grid_of(occupied, 1.0))[1:6, 2:7] == 0.0).all()


def test_a_thick_wall_at_the_edge_of_the_map_has_its_surface_inside():
    occupied = np.zeros((3, 6), np.bool_)
    occupied[:, :3] = True
    distance = distance_to_obstacles(grid_of(occupied, 1.0), only_boundaries=True)
    assert distance.tolist() == [[2.0, 1.0, 0.0, 1.0, 2.0, 3.0]] * 3


def test_a_map_that_is_all_wall_has_no_surface():
    assert (distance_to_obstacles(grid_of(np.ones((4, 4))), only_boundaries=True) == np.inf).all()


def test_thin_walls_are_all_surface(rng):
    occupied = rng.random((30, 30)) < 0.1
    thin = occupied & ~ndimage.binary_erosion(occupied, border_value=1)
    assert (thin == occupied).all()
    grid = grid_of(occupied)
    assert (distance_to_obstacles(grid, only_boundaries=True) == distance_to_obstacles(grid)).all()


def test_the_map_is_left_alone(rng):
    occupied = rng.random((10, 10)) < 0.2
    grid = grid_of(occupied)
    distance_to_obstacles(grid, max_distance=0.2, only_boundaries=True)
    assert (grid.occupied == occupied).all()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"max_distance": 0.0}, "max_distance: expected a positive, finite number of metres or None, got 0.0"),
        ({"max_distance": math.nan}, "max_distance: .* got nan"),
        ({"max_distance": math.inf}, "max_distance: .* got inf"),
        ({"margin_cells": -1}, "margin_cells: expected a number >= 0, got -1"),
        (
            {"margin_cells": 2**15},
            r"grid: expected .* a side and 4294967296 in all with margin, got \(65537, 65537\)",
        ),
    ],
)
def test_options_that_make_no_sense_are_refused(options, message):
    with pytest.raises(InvalidInputError, match=message):
        distance_to_obstacles(grid_of(np.ones((1, 1))), **options)


def test_a_side_whose_squares_would_be_rounded_is_refused(monkeypatch):
    monkeypatch.setattr("beamfield.maps.distance.MAX_SIDE_CELLS", 20)
    assert distance_to_obstacles(grid_of(np.ones((1, 20)))).shape == (1, 20)
    with pytest.raises(InvalidInputError, match=r"expected at most 20 cells a side .* got \(1, 21\)"):
        distance_to_obstacles(grid_of(np.ones((1, 21))))


def test_a_field_extends_past_the_map_by_whole_cells():
    field = DistanceField.from_grid(grid_of(np.ones((1, 1)), 0.5), margin=0.7)
    assert field.margin_cells == 2
    assert field.distance[2].tolist() == [1.0, 0.5, 0.0, 0.5, 1.0]
    assert field.max_distance == math.inf
    with pytest.raises(ValueError, match="read-only"):
        field.distance[0, 0] = 1.0


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((np.zeros((2, 3)),), r"distance: expected shape \(2, 2\) for the map and a margin of 0 cells, got \(2, 3\)"),
        ((np.zeros((2, 2)), -1), "distance: expected shape .* margin of -1 cells"),
        ((np.full((2, 2), -0.1),), "distance: expected metres >= 0, got -0.1"),
        ((np.full((2, 2), np.nan),), "distance: expected metres >= 0, got nan"),
        ((np.zeros((2, 2)), 0, 0.0), "max_distance: expected a positive number of metres, got 0.0"),
    ],
)
def test_a_field_that_does_not_fit_its_map_is_refused(arguments, message):
    with pytest.raises(InvalidInputError, match=message):
        DistanceField(grid_of(np.ones((2, 2))), *arguments)


def test_a_margin_that_is_no_length_is_refused():
    with pytest.raises(InvalidInputError, match="margin: expected metres >= 0 and at most 67108864 cells, got inf"):
        DistanceField.from_grid(grid_of(np.ones((2, 2))), margin=math.inf)


@pytest.mark.oracle
def test_other_programs_agree(oracle_case):
    book = oracle_case.answers("book")["edt_row_major"]
    distance = distance_to_obstacles(oracle_case.grid, max_distance=float(book.max()))
    np.testing.assert_allclose(distance.ravel(), book, rtol=1e-6, atol=0)
