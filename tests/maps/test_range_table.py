"""Pre-cached ranges: equal to exact casting where they were cast, near it elsewhere, and as near as the table says."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.range_table import RangeTable
from beamfield.maps.range_table_plan import RangeTablePlan, map_key
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder
from tests.threads import forced_threads

ORIGIN = (2.0, -3.0, 0.6)


@pytest.fixture(scope="module")
def rooms() -> OccupancyGrid:
    """Two rooms with a door, clutter, and unknown space behind a wall; 8.05 m x 6.05 m, turned in the map frame."""
    rng = np.random.default_rng(1)
    cells = np.zeros((121, 161))
    cells[:, 90:93], cells[50:70, 90:93] = 100, 0
    for row, col in zip(rng.integers(5, 115, 25), rng.integers(5, 155, 25), strict=True):
        cells[row : row + 3, col : col + 2] = 100
    cells[:, 140:142], cells[:, 142:] = 100, -1
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    return OccupancyGrid.from_ros(cells, 0.05, ORIGIN)


@pytest.fixture(scope="module")
def table(rooms: OccupancyGrid) -> RangeTable:
    return RangeTable.build(rooms, headings=90)


def free_rays(grid: OccupancyGrid, n: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    cells = np.argwhere(grid.free)[:, ::-1]
    points = grid.to_map(cells[rng.integers(0, len(cells), n)] + rng.random((n, 2)))
    return np.column_stack([points, rng.uniform(-7.0, 7.0, n)])


# A side that is whole cells, one that is not, one larger than the map; and squares smaller than a cell.
@pytest.mark.parametrize(("resolution", "headings"), [(0.15, 90), (0.13, 8), (50.0, 360), (0.03, 8)])
def test_ranges_are_exact_to_half_a_quantum_where_they_were_cast(rooms, resolution, headings):
    plan = RangeTablePlan(rooms, 5.0, resolution, headings)
    table = RangeTable.build(rooms, max_range=5.0, resolution=resolution, headings=headings)
    finder = RangeFinder.from_bearings(np.linspace(0.0, 2.0 * np.pi, headings, endpoint=False), 5.0)
    poses = plan.start_poses(0, plan.n_places)
    assert rooms.look_up(rooms.free, poses[:, :2]).all()
    exact = RayCaster(rooms).expected_ranges(poses, finder)
    assert exact.min() < 1.0
    np.testing.assert_allclose(table.expected_ranges(poses, finder), exact, atol=0.502 * plan.quantum + 2e-6)


def test_every_free_cell_has_a_place_and_the_size_is_known_before(rooms, table):
    plan = table.plan
    in_cells = (np.argwhere(rooms.free)[:, ::-1] + 0.5) / plan.side
    assert (plan.places[in_cells[:, 1].astype(int), in_cells[:, 0].astype(int)] != -1).all()
    assert plan.n_bytes == table.codes.nbytes == 2 * plan.n_places * 90
    # Squares of 0.15 m over the 6.95 m x 5.95 m that are not unknown.
    assert 0.9 * 47 * 40 < plan.n_places <= 47 * 41


def test_the_error_that_a_table_states_is_that_of_other_poses(rooms, table):
    rays = free_rays(rooms, 100_000, 7)
    reach = table.plan.reach
    error = np.abs(table.cast(rays, reach) - RayCaster(rooms).cast(rays, reach))
    stated = table.error
    assert np.median(error) == pytest.approx(stated.median, rel=0.05)
    assert np.mean(error > rooms.resolution) == pytest.approx(stated.share_off_by_a_cell, rel=0.05)
    # Quantiles of heavy tails: by the share of rays beyond them.
    for percentile, value in ((95, stated.percentile_95), (99, stated.percentile_99)):
        assert np.mean(error > value) == pytest.approx(1.0 - percentile / 100.0, rel=0.1)
    assert stated.percentile_99 < stated.largest <= reach


def test_along_one_wall_ranges_are_those_of_geometry():
    cells = np.zeros((120, 120))
    cells[:, 100:] = 100
    table = RangeTable.build(OccupancyGrid.from_ros(cells, 0.05))
    rng = np.random.default_rng(3)
    rays = np.column_stack([rng.uniform(0.5, 4.0, 5000), rng.uniform(2.0, 4.0, 5000), rng.uniform(-0.6, 0.6, 5000)])
    rays = rays[np.abs(rays[:, 1] + (5.0 - rays[:, 0]) * np.tan(rays[:, 2]) - 3.0) < 2.8]
    error = np.abs(table.cast(rays, 20.0) - (5.0 - rays[:, 0]) / np.cos(rays[:, 2]))
    # The nearest square and heading alone, as the chapter has it, leave several centimetres.
    assert error.max() < 0.015
    assert error.mean() < 0.002


def test_what_has_no_place_is_cast_exactly_and_walls_are_0(rooms, table):
    caster = RayCaster(rooms)
    rng = np.random.default_rng(5)
    anywhere = np.column_stack([rng.uniform(-20.0, 20.0, (20_000, 2)), rng.uniform(-3.0, 3.0, 20_000)])
    unknown = np.argwhere(rooms.unknown)[:200, ::-1] + 0.5
    behind = np.column_stack([rooms.to_map(unknown), rng.uniform(-3.0, 3.0, len(unknown))])
    far = [[1e13, 0.0, 3.0], [1e300, -1e300, 1e300], [-1.7e308, 0.0, 0.0]]
    finder = RangeFinder.from_bearings([-0.3, 0.0, 2.0], max_range=30.0)
    poses = np.concatenate([anywhere, behind, far])
    inside = rooms.look_up(rooms.free, poses[:, :2])
    assert 100 < inside.sum() < 5000
    found, exact = table.expected_ranges(poses, finder), caster.expected_ranges(poses, finder)
    np.testing.assert_array_equal(found[~inside], exact[~inside])
    in_wall = rooms.look_up(rooms.occupied, poses[:, :2])
    assert in_wall.any()
    assert (found[in_wall] == 0.0).all()
    blocked = RangeTable.build(rooms, headings=8, unknown="occupied")
    assert (blocked.expected_ranges(behind, finder) == 0.0).all()


def test_on_the_border_of_a_free_cell_a_pose_is_in_it(rooms, table):
    """As the poses of a lattice are whose step is twice the map's; rounding may put them into the wall beside."""
    corners = rooms.to_map(np.argwhere(rooms.free)[:, ::-1].astype(float))
    poses = np.column_stack([corners, np.zeros(len(corners))])
    finder = RangeFinder.from_bearings([0.1, 1.6, 3.2, 4.8], 20.0)
    assert (RayCaster(rooms).expected_ranges(poses, finder).max(axis=1) > 0.0).all()
    assert (table.expected_ranges(poses, finder).max(axis=1) > 0.0).all()


def test_mounts_of_their_own_and_thread_counts_change_nothing(rooms, table):
    poses = free_rays(rooms, 600, 9)
    finder = RangeFinder.from_bearings(np.linspace(-2.0, 2.0, 31), 8.0, mount=(0.2, -0.1, 0.5))
    together = table.expected_ranges(poses, finder)
    # Another beam elsewhere makes each beam start for itself.
    for elsewhere in ([0.0, 0.0, 1.0], [0.201, -0.1, 1.0], [0.2, -0.101, 1.0]):
        apart = RangeFinder(np.vstack([elsewhere, finder.mounts]), 8.0)
        np.testing.assert_allclose(table.expected_ranges(poses, apart)[:, 1:], together, atol=2e-5)
    with forced_threads(4):
        np.testing.assert_array_equal(RangeTable.build(rooms, headings=90).codes, table.codes)
    assert pickle.loads(pickle.dumps(table)).error == table.error
    assert len(repr(table)) < 600


# Single precision holds none of these; it would round 5.6 down, 8.1 up.
@pytest.mark.parametrize("max_range", [0.7, 2.3, 5.6, 8.1])
def test_what_meets_nothing_has_the_longest_range_to_the_last_bit(rooms, table, max_range):
    finder = RangeFinder.from_bearings(np.linspace(-3.0, 3.0, 40), max_range)
    poses = free_rays(rooms, 300, 11)
    found, exact = table.expected_ranges(poses, finder), RayCaster(rooms).expected_ranges(poses, finder)
    assert found.max() == max_range
    assert np.mean((found == max_range) != (exact == max_range)) < 0.05


def test_the_map_is_known_by_its_cells_and_not_by_its_place(rooms):
    moved = replace(rooms, origin=(0.0, 0.0, 0.0))
    assert map_key(moved) == map_key(rooms)
    changed = np.array(rooms.probability)
    changed[60, 30] = 1.0
    assert map_key(replace(rooms, probability=changed)) != map_key(rooms)
    changed[60, 30] = np.nan
    assert map_key(replace(rooms, probability=changed)) != map_key(rooms)
    assert map_key(replace(rooms, resolution=0.0500001)) != map_key(rooms)
    assert map_key(replace(rooms, probability=rooms.probability.T)) != map_key(rooms)


def test_what_cannot_be_a_table_is_refused(rooms, table):
    for options, message in (
        ({"max_gigabytes": 1e-4}, r"max_gigabytes: the table takes 0\.000\d+ GB, more than 0\.0001"),
        ({"headings": 7}, "headings: expected 8 to 3600, got 7"),
        ({"resolution": 1e-4}, "resolution: 0.0001 m makes 60500 x 80500 squares"),
        ({"resolution": 0.0}, "resolution"),
        ({"max_range": np.inf}, "max_range"),
        ({"unknown": "skip"}, "unknown"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            RangeTable.build(rooms, **options)
    with pytest.raises(InvalidInputError, match="no free cell"):
        RangeTable.build(OccupancyGrid(np.ones((3, 3)), 0.1))
    short = RangeTable.build(rooms, max_range=3.0, headings=8)
    with pytest.raises(InvalidInputError, match=r"max_range: the range table was built for at most 3 m, got 3\.5"):
        short.cast([3.0, 1.0, 0.0], 3.5)
    with pytest.raises(InvalidInputError, match=r"codes: expected shape \("):
        RangeTable(table.plan, table.codes[:, :-1], table.error)
    with pytest.raises(InvalidInputError, match="codes: expected uint16, got int32"):
        RangeTable(table.plan, table.codes.astype(np.int32), table.error)
