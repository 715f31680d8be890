"""Maps from wide cones: what one reading says, what two say together, and a room from simulated cones."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import compose
from beamfield.maps.cone import ConeCaster
from beamfield.maps.mapping import InverseSensorModel, build_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder
from tests.maps.test_mapping import as_log

ODDS = InverseSensorModel(hit=0.8, passed=0.4)
CONE = RangeFinder.from_bearings([0.0], max_range=6.0, opening_angle=np.radians(40.0))


# A reading of 3 m on cells of 0.1 m.
ARC = 3.05


def on_arc(grid, bearing_deg):
    """Return the probability at points of the arc, NaN off the map."""
    x, y = ARC * np.cos(np.radians(bearing_deg)), ARC * np.sin(np.radians(bearing_deg))
    col, row = np.floor(grid.to_cells(np.stack([x, y], axis=-1))).astype(int).T
    inside = (col >= 0) & (row >= 0) & (col < grid.shape[1]) & (row < grid.shape[0])
    found = np.full(len(col), np.nan)
    found[inside] = grid.probability[row[inside], col[inside]]
    return found


def in_polar(grid):
    """Return distance and bearing of all cell centres from the map's zero."""
    row, col = np.indices(grid.shape)
    x, y = np.moveaxis(grid.to_map(np.stack([col + 0.5, row + 0.5], axis=-1)), -1, 0)
    return np.hypot(x, y), np.abs(np.arctan2(y, x))


def test_cells_of_the_cone_before_the_reading_are_passed_and_those_of_the_arc_hit():
    grid = build_map(as_log([[3.0]], [[0.0, 0.0, 0.0]], CONE), resolution=0.1, inverse_model=ODDS)
    distance, bearing = in_polar(grid)
    value = grid.probability
    inside = bearing < np.radians(20.0) - 0.08 / np.maximum(distance, 0.1)
    np.testing.assert_allclose(value[inside & (distance < 2.92) & (distance > 0.2)], 0.4, rtol=1e-6)
    outside = (bearing > np.radians(20.0) + 0.08 / np.maximum(distance, 0.1)) | (distance > ARC + 0.08)
    assert np.isnan(value[outside]).all()
    # Points of the arc, half a cell behind the reading, lie in cells that are hit, unless the rays that fill the cone
    # miss the tip of one.
    assert (np.abs(on_arc(grid, np.linspace(-19, 19, 400)) - 0.8) < 1e-6).mean() > 0.97


def test_the_part_of_an_arc_that_other_cones_pass_is_no_obstacle():
    # From the side, a cone passes the upper half of the arc and sees something far behind it.
    first, second = [0.0, 0.0, 0.0], [3.0, 2.5, -np.pi / 2]
    grid = build_map(as_log([[3.0], [2.0]], [first, second], CONE), resolution=0.1, inverse_model=ODDS)
    low, high = on_arc(grid, np.linspace(-18, -3, 50)), on_arc(grid, np.linspace(13, 18, 50))
    assert np.median(low) == pytest.approx(0.8)
    # One pass more than the least on the arc: a hit of weight 0.4 / 0.6, and that pass.
    log_odds = np.log(0.8 / 0.2) * (0.4 / 0.6) + np.log(0.4 / 0.6)
    assert np.median(high) == pytest.approx(1.0 / (1.0 + np.exp(-log_odds)), rel=1e-5)
    assert high.max() < 0.65 < low.max()


def test_cones_of_one_scan_do_not_clear_each_others_arcs():
    finder = RangeFinder.from_bearings([0.0, 0.2], max_range=6.0, opening_angle=np.radians(40.0))
    grid = build_map(as_log([[3.0, 3.3]], [[0.0, 0.0, 0.0]], finder), resolution=0.1, inverse_model=ODDS)
    assert (on_arc(grid, np.linspace(-18, 18, 400)) > 0.75).mean() > 0.97


@pytest.mark.parametrize("z", [np.nan, -np.inf, np.inf, 6.0])
def test_readings_without_an_end_mark_nothing_unless_asked(z):
    assert np.isnan(build_map(as_log([[z]], [[0.0, 0.0, 0.0]], CONE), resolution=0.1).probability).all()
    clear = InverseSensorModel(hit=0.8, passed=0.4, clear_without_return=1.0)
    grid = build_map(as_log([[z]], [[0.0, 0.0, 0.0]], CONE), resolution=0.1, inverse_model=clear)
    if z == np.inf or z == 6.0:
        distance, bearing = in_polar(grid)
        np.testing.assert_allclose(grid.probability[(bearing < 0.25) & (distance < 0.9)], 0.4, rtol=1e-6)
        assert not (grid.probability > 0.5).any()
    else:
        assert np.isnan(grid.probability).all()


def test_far_readings_may_clear_without_a_hit():
    model = InverseSensorModel(hit=0.8, passed=0.4, longest_hit=1.0)
    grid = build_map(as_log([[3.0]], [[0.0, 0.0, 0.0]], CONE), resolution=0.1, inverse_model=model)
    assert not (grid.probability > 0.5).any()
    assert in_polar(grid)[0][~np.isnan(grid.probability)].max() < 1.1


@pytest.fixture(scope="module")
def room():
    """Return a room of 5 m x 4 m with a pillar, and a log of perfect cones in it."""
    occupied = np.zeros((80, 100), bool)
    occupied[[0, 1, -2, -1]] = occupied[:, [0, 1, -2, -1]] = True
    occupied[36:40, 60:64] = True
    grid = OccupancyGrid(occupied.astype(np.float32), 0.05)
    rng = np.random.default_rng(3)
    poses = np.column_stack([rng.uniform([0.3, 0.3], [4.7, 3.7], (900, 2)), rng.uniform(-3, 3, 900)])
    poses = poses[np.hypot(poses[:, 0] - 3.1, poses[:, 1] - 1.9) > 0.4]
    finder = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 8, endpoint=False), 6.0, opening_angle=0.4)
    return grid, as_log(ConeCaster(grid).expected_ranges(poses, finder), poses, finder)


def test_a_room_comes_back_from_its_cones(room):
    grid, log = room
    drawn = build_map(log, resolution=0.05)
    row, col = np.indices(grid.shape)
    centres = grid.to_map(np.stack([col + 0.5, row + 0.5], axis=-1))
    free = drawn.look_up(drawn.free, centres)
    occupied = drawn.look_up(drawn.occupied, centres)
    inside = ~grid.occupied
    # Surfaces that a cone can see across: the inner row of cells of each wall.
    surface = [occupied[1, 10:-10], occupied[-2, 10:-10], occupied[10:-10, 1], occupied[10:-10, -2]]
    assert np.concatenate(surface).mean() > 0.98
    assert free[inside].mean() > 0.97
    assert occupied[inside].mean() < 0.01


def test_cones_in_the_map_have_the_ranges_that_drew_it_and_beams_do_not(room):
    _, log = room
    drawn = build_map(log, resolution=0.05, scans=np.arange(0, len(log), 2))
    others = log.select(np.arange(1, len(log), 2))
    error = ConeCaster(drawn).expected_ranges(others.poses, log.finder) - others.ranges
    beams = RayCaster(drawn).expected_ranges(others.poses, log.finder) - others.ranges
    assert np.quantile(np.abs(error), 0.9) < 0.005
    assert np.quantile(np.abs(beams), 0.9) > 0.5


def test_the_order_of_scans_and_the_frame_do_not_matter(room):
    _, log = room
    part = log.select(np.arange(200))
    drawn = build_map(part, resolution=0.05)
    turned = build_map(part.select(np.arange(200)[::-1]), resolution=0.05)
    np.testing.assert_allclose(turned.probability, drawn.probability, atol=1e-5)
    moved = build_map(part.with_poses(compose([3.0, -2.0, np.pi / 2], part.poses)), resolution=0.05)
    assert moved.shape == drawn.shape[::-1]
    assert (np.rot90(moved.occupied, 1) == drawn.occupied).mean() > 0.98


def test_progress_is_reported_to_the_end(room):
    _, log = room
    calls: list[tuple[int, int]] = []
    build_map(log.select(np.arange(300)), resolution=0.1, progress=lambda done, total: calls.append((done, total)))
    assert calls[-1] == (300, 300)
    assert [done for done, _ in calls] == sorted(done for done, _ in calls)


def test_maps_that_are_too_large_and_bad_resolutions_are_errors():
    with pytest.raises(InvalidInputError, match="cells, and the limit is 1000"):
        build_map(as_log([[3.0]], [[0.0, 0.0, 0.0]], CONE), resolution=0.05, max_cells=1000)
    with pytest.raises(InvalidInputError, match=r"resolution: expected a positive number .*, got 0"):
        build_map(as_log([[3.0]], [[0.0, 0.0, 0.0]], CONE), resolution=0.0)
