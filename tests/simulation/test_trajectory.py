from __future__ import annotations

import tracemalloc
from functools import cache

import numpy as np
import pytest
from scipy import ndimage

from beamfield.errors import InvalidInputError
from beamfield.geometry import compose, wrap_angle
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import Track
from beamfield.simulation.trajectory import DriveOptions, clearance_map, drive_through
from tests.simulation.plans import plan

STAMPS = 50.0 + np.arange(0.0, 120.0, 0.1)


@cache
def drive(seed: int) -> Track:
    """Return what many tests look at; to drive it takes half a second."""
    return drive_through(plan(seed), STAMPS, seed=seed)


def distance_to_obstacles(grid: OccupancyGrid, points: np.ndarray) -> np.ndarray:
    """Exact distance from points to the nearest cell that is not free: to boxes, not to their centres."""
    # The nearest of them is beside a free cell.
    rows, cols = np.nonzero(~grid.free & ndimage.binary_dilation(grid.free))
    at = grid.to_cells(points)
    nearest = np.empty(len(points))
    for i, (x, y) in enumerate(at):
        near = (np.abs(cols - x) < 40) & (np.abs(rows - y) < 40)
        dx = np.maximum(np.abs(cols[near] + 0.5 - x) - 0.5, 0.0)
        dy = np.maximum(np.abs(rows[near] + 0.5 - y) - 0.5, 0.0)
        nearest[i] = np.hypot(dx, dy).min() if near.any() else 40.0
    return nearest * grid.resolution


def box_world(*, origin: tuple[float, float, float] = (0.0, 0.0, 0.0), resolution: float = 0.1) -> OccupancyGrid:
    """A hall of 12 x 8 m with a wall that leaves a gap of 1.2 m."""
    cells = np.zeros((round(8 / resolution), round(12 / resolution)))
    cells[[0, -1]] = 100
    cells[:, [0, -1]] = 100
    middle = round(6 / resolution)
    cells[:, middle : middle + 2] = 100
    cells[round(3 / resolution) : round(4.2 / resolution), middle : middle + 2] = 0
    return OccupancyGrid.from_ros(cells, resolution, origin)


@pytest.mark.parametrize("seed", range(4))
def test_the_robot_never_comes_closer_to_a_wall_than_its_radius(seed: int) -> None:
    assert distance_to_obstacles(plan(seed), drive(seed).poses[::2, :2]).min() >= 0.25


def test_a_larger_robot_keeps_a_larger_distance() -> None:
    grid = plan(1)
    poses = drive_through(grid, STAMPS, seed=1, options=DriveOptions(robot_radius=0.32)).poses
    assert distance_to_obstacles(grid, poses[::2, :2]).min() >= 0.32


@pytest.mark.parametrize("seed", range(2))
def test_speed_and_turn_rate_stay_within_their_limits(seed: int) -> None:
    options = DriveOptions(speed=0.7)
    poses = drive_through(plan(seed), STAMPS, seed=seed, options=options).poses
    speed = np.hypot(*np.diff(poses[:, :2], axis=0).T) / 0.1
    turn = np.abs(wrap_angle(np.diff(poses[:, 2]))) / 0.1
    assert speed.max() <= 0.7 * (1 + 1e-9)
    assert turn.max() <= 1.0 * (1 + 1e-9)
    assert np.median(speed) > 0.4, "it drives most of the time"
    assert turn.max() > 0.5, "and turns"


def test_the_robot_moves_forward_along_its_heading() -> None:
    poses = drive(0).poses
    step = np.diff(poses[:, :2], axis=0)
    moving = np.hypot(*step.T) > 0.02
    middle = poses[:-1, 2] + 0.5 * wrap_angle(np.diff(poses[:, 2]))
    off_course = np.abs(wrap_angle(np.arctan2(step[:, 1], step[:, 0]) - middle))[moving]
    assert np.quantile(off_course, 0.99) < 0.05
    assert off_course.max() < 0.3


def test_stamps_are_those_asked_for_and_poses_are_finite_with_wrapped_headings() -> None:
    track = drive(0)
    np.testing.assert_array_equal(track.stamps, STAMPS)
    assert np.isfinite(track.poses).all()
    assert np.abs(track.poses[:, 2]).max() <= np.pi


def test_a_drive_starts_at_rest_and_does_not_depend_on_when_it_starts_or_ends() -> None:
    long = drive(3).poses
    short = drive_through(plan(3), STAMPS[:300] + 1000.0, seed=3).poses
    np.testing.assert_allclose(short, long[:300], atol=1e-9)
    assert np.hypot(*(long[1] - long[0])[:2]) < 0.1 * DriveOptions().speed


def test_the_same_seed_drives_the_same_way_and_another_seed_another() -> None:
    first, again, other = (drive_through(plan(0), STAMPS[:600], seed=s).poses for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1.0


def test_a_long_drive_sees_most_of_the_building() -> None:
    grid = plan(0)
    poses = drive_through(grid, np.arange(0.0, 700.0, 0.5), seed=0).poses
    rows, cols = np.nonzero(clearance_map(grid) > 0.6)
    places = grid.to_map(np.column_stack([cols, rows]) + 0.5)[::37]
    near = [np.hypot(*(poses[:, :2] - place).T).min() < 3.0 for place in places]
    assert np.mean(near) > 0.9


def test_the_drive_goes_through_the_gap_and_turns_with_the_map() -> None:
    stamps = np.arange(0.0, 90.0, 0.25)
    plain = drive_through(box_world(), stamps, seed=4).poses
    assert plain[:, 0].min() < 5.0
    assert plain[:, 0].max() > 7.0
    origin = (3.0, -20.0, 0.7)
    turned = drive_through(box_world(origin=origin), stamps, seed=4).poses
    expected = compose(origin, plain)
    np.testing.assert_allclose(turned[:, :2], expected[:, :2], atol=1e-9)
    np.testing.assert_allclose(wrap_angle(turned[:, 2] - expected[:, 2]), 0.0, atol=1e-9)


@pytest.mark.parametrize("resolution", [0.025, 0.05, 0.1])
def test_clearance_is_a_close_lower_bound_of_the_distance_to_obstacles(
    resolution: float, rng: np.random.Generator
) -> None:
    grid = box_world(resolution=resolution)
    rows, cols = np.nonzero(grid.free)
    chosen = rng.integers(0, len(rows), 200)
    points = grid.to_map(np.column_stack([cols, rows])[chosen] + 0.5)
    exact = distance_to_obstacles(grid, points)
    bound = clearance_map(grid)[rows[chosen], cols[chosen]]
    near = exact < 30 * resolution
    assert (bound <= exact + 1e-9)[near].all()
    assert (bound >= exact - resolution)[near].all()


def test_space_beyond_the_map_is_no_free_space() -> None:
    open_field = OccupancyGrid(np.zeros((60, 80)), 0.1)
    assert clearance_map(open_field)[0].max() < 0.1
    poses = drive_through(open_field, np.arange(0.0, 30.0, 0.5)).poses
    assert (poses[:, :2] > 0.25).all()
    assert (poses[:, :2] < [7.75, 5.75]).all()


def test_a_map_without_room_for_the_robot_is_refused() -> None:
    narrow = np.full((20, 60), 100)
    narrow[9:12, 5:55] = 0
    with pytest.raises(InvalidInputError, match=r"no free place for a robot of radius 0\.25 m"):
        drive_through(OccupancyGrid.from_ros(narrow, 0.1), STAMPS)
    with pytest.raises(InvalidInputError, match=r"no free place for a robot of radius 0\.25 m"):
        drive_through(OccupancyGrid.from_ros(narrow, 1e-12), STAMPS)


def test_a_map_with_a_single_small_room_is_refused() -> None:
    cell = np.full((40, 40), 100)
    cell[14:26, 14:26] = 0
    with pytest.raises(InvalidInputError, match="too small to drive through"):
        drive_through(OccupancyGrid.from_ros(cell, 0.1), STAMPS)


@pytest.mark.parametrize("stamps", [[], [[0.0, 1.0]], [0.0, 0.0], [1.0, 0.5], [0.0, np.nan]])
def test_stamps_that_do_not_increase_are_refused(stamps: list[float]) -> None:
    with pytest.raises(InvalidInputError, match="stamps: expected increasing"):
        drive_through(box_world(), np.array(stamps))


@pytest.mark.parametrize("bad", [{"robot_radius": 0.0}, {"speed": -1.0}, {"speed": np.nan}])
def test_impossible_drive_options_are_refused(bad: dict[str, float]) -> None:
    with pytest.raises(InvalidInputError, match=next(iter(bad))):
        DriveOptions(**bad)


def test_planning_in_a_wide_map_takes_memory_for_its_cells_not_for_cells_times_places() -> None:
    hall = np.zeros((240, 240), np.int8)
    hall[::24, ::24] = 100  # pillars, between which there are many places to visit
    grid = OccupancyGrid.from_ros(hall, 0.1)
    tracemalloc.start()
    try:
        drive_through(grid, np.arange(0.0, 2.0, 0.5))
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 500 * hall.size
