from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder
from beamfield.simulation.drawing import Arc, Box, Canvas, Thing
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.trajectory import clearance_map
from tests.simulation.plans import plan

SEEDS = range(4)


@pytest.mark.parametrize("seed", SEEDS)
def test_every_free_cell_can_be_reached_from_every_other(seed: int) -> None:
    _, n_regions = ndimage.label(plan(seed).free)
    assert n_regions == 1


@pytest.mark.parametrize("seed", SEEDS)
def test_a_robot_fits_through_the_doors_into_most_rooms(seed: int) -> None:
    grid = plan(seed)
    room = clearance_map(grid) >= 0.35
    labels, _ = ndimage.label(room, structure=np.ones((3, 3)))
    largest = np.bincount(labels[room]).max()
    assert largest > 0.95 * room.sum()


@pytest.mark.parametrize("seed", SEEDS)
def test_only_occupied_cells_lie_between_free_and_unknown_space(seed: int) -> None:
    grid = plan(seed)
    beside_free = ndimage.binary_dilation(grid.free, structure=np.ones((3, 3)))
    assert not (beside_free & grid.unknown).any()


@pytest.mark.parametrize("seed", SEEDS)
def test_no_ray_from_inside_leaves_the_building(seed: int, rng: np.random.Generator) -> None:
    grid = plan(seed)
    rows, cols = np.nonzero(grid.free)
    chosen = rng.integers(0, len(rows), 500)
    points = grid.to_map(np.column_stack([cols[chosen] + 0.5, rows[chosen] + 0.5]))
    poses = np.column_stack([points, rng.uniform(-np.pi, np.pi, len(points))])
    finder = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 90), max_range=100.0)
    through = RayCaster(grid, unknown="free").expected_ranges(poses, finder)
    assert through.max() < np.hypot(40.0, 24.0)
    np.testing.assert_array_equal(RayCaster(grid, unknown="occupied").expected_ranges(poses, finder), through)


def test_the_same_seed_draws_the_same_plan_and_another_seed_another() -> None:
    first, again, other = (draw_floor_plan(seed=s).probability for s in (5, 5, 6))
    np.testing.assert_array_equal(first, again)
    assert (np.nan_to_num(first, nan=0.5) != np.nan_to_num(other, nan=0.5)).mean() > 0.01


def test_the_plan_has_the_size_asked_for_and_unknown_space_around_it() -> None:
    grid = draw_floor_plan(width=30.0, height=20.0, resolution=0.1)
    assert grid.shape == (220, 320)
    known = np.argwhere(~grid.unknown)
    # A margin of 1 m and a facade of 0.3 m, of which one cell is seen from inside.
    assert known.min(axis=0).tolist() == [12, 12]
    assert known.max(axis=0).tolist() == [207, 307]
    assert grid.unknown[:10].all()
    assert grid.unknown[:, -10:].all()


def test_corridors_are_longer_than_a_common_sensor_reaches() -> None:
    grid = draw_floor_plan(seed=0)
    runs = [run for row in grid.free for run in np.diff(np.flatnonzero(np.diff(np.pad(row, 1).astype(int))))[::2]]
    assert max(runs) * grid.resolution > 30.0


def test_furniture_takes_floor_but_leaves_most_of_it() -> None:
    bare, furnished = (draw_floor_plan(seed=2, furnished=f) for f in (False, True))
    lost = bare.free & ~furnished.free
    assert 0.02 < lost.sum() / bare.free.sum() < 0.15
    assert not (furnished.free & ~bare.free).any()


def test_the_outline_is_an_l() -> None:
    grid = draw_floor_plan(seed=1)
    rows, cols = grid.shape
    assert grid.unknown[int(0.9 * rows), int(0.9 * cols)]
    assert not grid.unknown[int(0.9 * rows), int(0.1 * cols) : int(0.5 * cols)].all()


@pytest.mark.parametrize("size", [{"width": 20.0}, {"height": 10.0}, {"width": np.nan}, {"width": 1e6}])
def test_a_building_too_small_or_too_large_is_refused(size: dict[str, float]) -> None:
    with pytest.raises(InvalidInputError, match="building: expected 26 x 20"):
        draw_floor_plan(**size)


def test_a_negative_seed_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="seed: expected at least 0, got -1"):
        draw_floor_plan(seed=-1)


@pytest.mark.parametrize("resolution", [0.0, 0.2, np.nan])
def test_cells_too_large_for_walls_are_refused(resolution: float) -> None:
    with pytest.raises(InvalidInputError, match="resolution: expected"):
        draw_floor_plan(resolution=resolution)


def _picture(canvas: Canvas) -> list[str]:
    """Top row first, as one looks at a map."""
    return ["".join(".#"[int(cell)] for cell in row) for row in canvas.solid[::-1]]


def test_shapes_turn_with_the_pose_of_their_thing() -> None:
    canvas = Canvas(6.0, 4.0, 1.0)
    canvas.carve(Box(0.0, 0.0, 6.0, 4.0))
    canvas.build(Box(0.0, 0.0, 3.0, 1.0), np.array([2.0, 1.0, np.pi / 2]))
    assert _picture(canvas) == [".#....", ".#....", ".#....", "......"]


def test_half_a_ring_is_open_on_the_other_side() -> None:
    canvas = Canvas(5.0, 5.0, 1.0)
    canvas.carve(Box(0.0, 0.0, 5.0, 5.0))
    canvas.build(Arc(2.5, 2.5, 2.3, 1.5, 0.0, np.pi))
    assert _picture(canvas) == [".###.", "#...#", "#...#", ".....", "....."]


def test_a_thing_is_put_only_where_its_footprint_is_free() -> None:
    thing = Thing((Box(-0.5, 0.0, 0.5, 1.0),), Box(-1.0, 0.0, 1.0, 2.0))
    canvas = Canvas(6.0, 4.0, 1.0)
    canvas.carve(Box(1.0, 1.0, 5.0, 4.0))
    before = canvas.solid.copy()
    assert not canvas.put(thing, np.array([1.0, 1.0, 0.0]))
    np.testing.assert_array_equal(canvas.solid, before)
    assert canvas.put(thing, np.array([2.0, 1.0, 0.0]))
    assert not canvas.put(thing, np.array([3.0, 1.0, 0.0])), "the floor in front of the first thing is taken"


def test_the_plan_is_a_grid_of_free_occupied_and_unknown_only() -> None:
    grid = draw_floor_plan()
    assert isinstance(grid, OccupancyGrid)
    assert set(np.unique(np.nan_to_num(grid.probability, nan=0.5))) == {0.0, 0.5, 1.0}
