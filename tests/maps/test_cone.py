"""Cones on maps small enough to check by eye, and beside two independent ways to find their ranges."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import compose, transform_points
from beamfield.maps.cone import ConeCaster, make_caster
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder
from tests.maps import test_raycast
from tests.maps.test_raycast import EAST, NORTH, SOUTH, WEST
from tests.reference.cone_oracles import clip_cells, fan_out

draw = partial(test_raycast.draw, caster=ConeCaster)


def deg(angle):
    return np.radians(angle)


def test_a_wall_across_is_seen_at_the_foot_of_the_perpendicular():
    caster = draw("....#", "....#", "....#", "....#", "....#")
    assert caster.cast([0.5, 2.3, EAST], deg(30), 10.0) == 3.5
    # Turned by 10 degrees the perpendicular is still in a cone of 30, but not in one of 10.
    assert caster.cast([0.5, 2.3, deg(10)], deg(30), 10.0) == 3.5
    assert caster.cast([0.5, 2.3, deg(10)], deg(10), 10.0) == pytest.approx(3.5 / np.cos(deg(5)), rel=1e-15)


@pytest.mark.parametrize("axis", [EAST, NORTH, WEST, SOUTH])
def test_a_corner_beside_the_axis_is_seen(axis):
    caster = draw("#...#", ".....", ".....", ".....", "#...#")
    # From the middle, the corners of the four cells are 1.5 cells along and 1.5 cells beside each axis.
    wide, narrow = deg(92), deg(88)
    assert caster.cast([2.5, 2.5, axis], wide, 10.0) == pytest.approx(1.5 * np.sqrt(2), rel=1e-15)
    # The edge of a cone of 88 degrees enters the same cells a little farther away, through their sides.
    assert caster.cast([2.5, 2.5, axis], narrow, 10.0) == pytest.approx(1.5 / np.sin(deg(44)), rel=1e-14)
    assert caster.cast([2.5, 2.5, axis], deg(30), 10.0) == 10.0


def test_only_what_is_in_the_cone_counts():
    caster = draw(".....", "#...#", ".....")
    assert caster.cast([2.5, 1.5, EAST], deg(10), 10.0) == 1.5
    assert caster.cast([2.2, 1.5, EAST], deg(170), 10.0) == pytest.approx(1.8)
    assert caster.cast([2.5, 1.5, NORTH], deg(100), 10.0) == 10.0


def test_the_nearest_of_many_is_seen_wherever_it_is():
    caster = draw(
        "....#..",
        "..#....",
        ".......",
        ".......",
    )
    # Nearest corner of the lower cell: (2, 2) from (0.5, 0.5).
    assert caster.cast([0.5, 0.5, deg(45)], deg(60), 10.0) == pytest.approx(np.hypot(1.5, 1.5))
    # A cone that passes below it enters the upper one from below, along its left edge.
    assert caster.cast([0.5, 0.5, deg(28)], deg(5), 10.0) == pytest.approx(2.5 / np.sin(deg(30.5)))


def test_ranges_are_in_metres_and_the_origin_counts():
    caster = draw("....#", "....#", resolution=0.05, origin=(10.0, -3.0, deg(90)))
    # The grid's x axis points north.
    assert caster.cast([9.95, -2.9, NORTH], deg(20), 5.0) == pytest.approx(0.1, abs=1e-12)


def test_nothing_nearer_than_max_range_gives_max_range():
    caster = draw("....#")
    assert caster.cast([0.5, 0.5, EAST], deg(20), 3.5) == 3.5
    assert caster.cast([0.5, 0.5, EAST], deg(20), 3.51) == 3.5
    assert caster.cast([0.5, 0.5, WEST], deg(170), 7.0) == 7.0


def test_an_apex_in_an_occupied_cell_has_range_0():
    caster = draw(".#.")
    for heading in np.linspace(-4, 4, 33):
        assert caster.cast([1.3, 0.7, heading], deg(15), 10.0) == 0.0


def test_an_apex_off_the_map_sees_the_map():
    caster = draw("#..", "...", "#.#")
    assert caster.cast([1.5, -10.0, NORTH], deg(30), 50.0) == pytest.approx(np.hypot(10.0, 0.5))
    assert caster.cast([1.5, -10.0, NORTH], deg(3), 50.0) == 50.0
    assert caster.cast([-4.0, 1.5, EAST], deg(40), 50.0) == pytest.approx(np.hypot(4.0, 0.5))
    assert caster.cast([14.0, 1.5, WEST], deg(20), 50.0) == pytest.approx(np.hypot(11.0, 0.5))
    assert caster.cast([1e9, 1e9, WEST], deg(20), 50.0) == 50.0
    assert caster.cast([1e300, -1e300, WEST], deg(20), 50.0) == 50.0


def test_what_the_edge_only_touches_is_not_seen():
    # The right edge runs along the border between the rows; the cell below it is not in the cone.
    caster = draw("....", "..#.")
    assert caster.cast([0.5, 1.0, deg(15)], deg(30), 20.0) == 20.0
    assert caster.cast([0.5, 1.0, deg(15)], deg(30.01), 20.0) == pytest.approx(1.5)


def test_unknown_cells_end_a_cone_only_if_asked_to():
    lines = ("....", "..?.", "...#")
    assert draw(*lines).cast([0.5, 1.5, EAST], deg(60), 20.0) == pytest.approx(np.hypot(2.5, 0.5))
    assert draw(*lines, unknown="occupied").cast([0.5, 1.5, EAST], deg(60), 20.0) == 1.5
    with pytest.raises(InvalidInputError, match="unknown: expected 'free' or 'occupied', got 'wall'"):
        draw("..", unknown="wall")


def test_a_cone_without_width_is_a_ray_bit_for_bit(rng):
    grid = OccupancyGrid((rng.random((30, 40)) < 0.1).astype(np.float32), 0.1, (0.3, -1.0, 0.4))
    poses = np.column_stack([rng.uniform(-1, 4, (500, 2)), rng.uniform(-4, 4, 500)])
    finder = RangeFinder([[0.1, 0.05, 0.3], [-0.1, 0.0, 2.0]], 6.0)
    np.testing.assert_array_equal(
        ConeCaster(grid).expected_ranges(poses, finder), RayCaster(grid).expected_ranges(poses, finder)
    )


def test_every_cone_starts_at_its_own_mount(rng):
    grid = OccupancyGrid((rng.random((30, 40)) < 0.1).astype(np.float32), 0.1, (0.3, -1.0, 0.4))
    caster, poses = ConeCaster(grid), np.column_stack([rng.uniform(-1, 4, (7, 2)), rng.uniform(-4, 4, 7)])
    finder = RangeFinder([[0.1, 0.05, 0.3], [-0.1, 0.0, 2.0], [0.0, 0.2, -1.0]], 6.0, opening_angle=0.4)
    together = caster.expected_ranges(poses.reshape(1, 7, 3), finder)
    assert together.shape == (1, 7, 3)
    for i, pose in enumerate(poses):
        for b, mount in enumerate(finder.mounts):
            assert together[0, i, b] == pytest.approx(caster.cast(compose(pose, mount), 0.4, 6.0), abs=1e-12)


def test_cones_agree_with_clipped_squares(rng):
    for density, width in [(0.003, 30.0), (0.01, 12.0), (0.002, 70.0), (0.2, 25.0), (0.02, 150.0), (0.6, 5.0)]:
        occupied = rng.random((45, 70)) < density
        caster = ConeCaster(OccupancyGrid(occupied.astype(np.float32), 1.0))
        origins = np.column_stack([rng.uniform(-4, [74, 49], (20, 2)), rng.uniform(-4, 4, 20)])
        ranges = caster.cast(origins, deg(width), 40.0)
        wanted = [clip_cells(*origin, deg(width) / 2, occupied, 40.0) for origin in origins]
        # An apex in a free cell is off all squares; in an occupied one, both say 0.
        np.testing.assert_allclose(ranges, wanted, rtol=1e-12, atol=1e-12)
        assert len(np.unique(ranges)) > 5 or density == 0.6


def test_cones_agree_with_clipped_squares_where_edges_meet_corners_and_borders(rng):
    """There a closed and an open sector differ; the range lies between those of slightly narrower and wider ones."""
    for _ in range(6):
        occupied = rng.random((9, 11)) < 0.1
        caster = ConeCaster(OccupancyGrid(occupied.astype(np.float32), 1.0))
        origins = np.column_stack(
            [rng.integers(-4, 48, 50) / 4, rng.integers(-4, 40, 50) / 4, rng.integers(-8, 9, 50) * np.pi / 8]
        )
        for half in (np.pi / 8, np.pi / 4, np.arctan2(1, 2)):
            ranges = caster.cast(origins, 2 * half, 20.0)
            for origin, cone in zip(origins, ranges, strict=True):
                at_most = clip_cells(*(origin + np.array([1e-7, 1e-7, 0.0])), half - 1e-6, occupied, 20.0)
                at_least = clip_cells(*origin, half + 1e-6, occupied, 20.0)
                assert at_least - 1e-4 <= cone <= at_most + 1e-4, (origin, half)


def test_many_rays_come_close_from_above(rng):
    occupied = rng.random((15, 20)) < 0.05
    caster = ConeCaster(OccupancyGrid(occupied.astype(np.float32), 1.0))
    origins = np.column_stack([rng.uniform(0, [20, 15], (40, 2)), rng.uniform(-4, 4, 40)])
    ranges = caster.cast(origins, deg(30), 25.0)
    fans = np.array([fan_out(*origin, deg(15), occupied, 25.0, 3001) for origin in origins])
    assert (ranges <= fans + 1e-9).all()
    # A corner between two rays, deg(30) / 3000 apart, on a side that runs at up to 45 degrees past them.
    np.testing.assert_allclose(ranges, fans, atol=25.0 * deg(30) / 3000 * 1.5)


def test_points_lie_at_the_range_on_the_border_of_their_cell(rng):
    occupied = rng.random((30, 40)) < 0.03
    grid = OccupancyGrid(occupied.astype(np.float32), 0.1, (0.3, -1.0, 0.4))
    caster = ConeCaster(grid)
    poses = np.column_stack([rng.uniform(-1, 4, (300, 2)), rng.uniform(-4, 4, 300)])
    for angle in (0.0, 0.1, 0.7):
        finder = RangeFinder([[0.1, 0.05, 0.3], [-0.1, 0.0, 2.0]], 2.0, opening_angle=angle)
        ranges = caster.expected_ranges(poses, finder)
        points, cells = caster.expected_points(poses, finder)
        seen = ranges < 2.0
        assert 100 < seen.sum() < seen.size
        np.testing.assert_array_equal(np.isnan(points), np.repeat(~seen[..., None], 2, axis=-1))
        np.testing.assert_array_equal(cells >= 0, np.repeat(seen[..., None], 2, axis=-1))
        apex = compose(poses[:, None], finder.mounts)
        np.testing.assert_allclose(np.hypot(*(points - apex[..., :2])[seen].T), ranges[seen], atol=1e-12)
        bearing = np.angle(np.exp(1j * (np.arctan2(*(points - apex[..., :2])[..., ::-1].T).T - apex[..., 2])))
        assert (np.abs(bearing[seen & (ranges > 0)]) <= angle / 2 + 1e-9).all()
        assert occupied[tuple(cells[seen].T)].all()
        inside = grid.to_cells(points[seen]) - cells[seen][:, ::-1]
        assert ((inside > -1e-9) & (inside < 1 + 1e-9)).all()


def test_tables_take_nine_bits_for_eight_cells_beside_those_of_rays():
    assert draw("....#", "....#").table_bytes == 4 * 4 * 7 * 2 + 2 * 4 + 4


def test_no_poses_give_no_points():
    finder = RangeFinder.from_bearings([0.0, 1.0], 5.0, opening_angle=0.3)
    points, cells = draw("..#").expected_points(np.empty((0, 3)), finder)
    assert points.shape == cells.shape == (0, 2, 2)


def test_bad_input_is_an_error():
    caster = draw("..#")
    with pytest.raises(InvalidInputError, match="origins: expected finite numbers"):
        caster.cast([0.0, np.nan, 0.0], 0.1, 5.0)
    with pytest.raises(InvalidInputError, match=r"opening_angle: expected \[0, pi\) radians, got -0.1"):
        caster.cast([0.0, 0.0, 0.0], -0.1, 5.0)
    with pytest.raises(InvalidInputError, match="range limits"):
        caster.cast([0.0, 0.0, 0.0], 0.1, np.inf)


def test_the_opening_angle_chooses_the_caster():
    grid = draw("..#").grid
    assert isinstance(make_caster(grid, RangeFinder([[0, 0, 0]], 5.0)), RayCaster)
    chosen = make_caster(grid, RangeFinder([[0, 0, 0]], 5.0, opening_angle=0.2), unknown="occupied")
    assert isinstance(chosen, ConeCaster)
    assert chosen.unknown == "occupied"


def test_a_point_is_seen_in_the_frame_of_a_turned_map():
    caster = draw("....#", "....#", resolution=0.5, origin=(1.0, 2.0, 0.7))
    pose = compose([1.0, 2.0, 0.7], [0.25, 0.4, 0.1])
    points, cells = caster.expected_points(pose, RangeFinder([[0, 0, 0]], 5.0, opening_angle=0.4))
    np.testing.assert_allclose(points, [transform_points([1.0, 2.0, 0.7], [2.0, 0.4])], atol=1e-12)
    assert cells.tolist() == [[0, 4]]
