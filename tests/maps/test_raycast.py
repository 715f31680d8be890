"""The conventions of ray casting on maps small enough to check by eye."""

from __future__ import annotations

import gc
import weakref

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.maps import raycast
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder
from tests.threads import forced_threads

EAST, NORTH, WEST, SOUTH = 0.0, np.pi / 2, np.pi, -np.pi / 2
NORTH_EAST, SOUTH_WEST = np.pi / 4, -3 * np.pi / 4


def draw(*lines, resolution=1.0, origin=(0.0, 0.0, 0.0), caster=RayCaster, **options):
    """Build a caster from a drawing, the top line last row: # occupied, . free, ? unknown."""
    values = {"#": 1.0, ".": 0.0, "?": np.nan}
    cells = np.array([[values[c] for c in line] for line in reversed(lines)])
    return caster(OccupancyGrid(cells, resolution, origin), **options)


def test_the_range_ends_where_the_ray_enters_the_first_occupied_cell():
    caster = draw("....#.#")
    assert caster.cast([0.5, 0.5, EAST], 10.0) == 3.5
    assert caster.cast_hits([0.5, 0.5, EAST], 10.0).tolist() == [0, 4]
    assert caster.cast([5.25, 0.5, WEST], 10.0) == 0.25


def test_the_range_is_in_metres():
    assert draw("....#", resolution=0.05).cast([0.025, 0.025, EAST], 10.0) == pytest.approx(0.175, abs=1e-15)


def test_a_ray_that_hits_nothing_has_max_range():
    caster = draw("....#")
    assert caster.cast([0.5, 0.5, WEST], 10.0) == 10.0
    assert caster.cast_hits([0.5, 0.5, WEST], 10.0).tolist() == [-1, -1]


def test_an_obstacle_at_max_range_is_not_seen():
    caster = draw("....#")
    assert caster.cast([0.5, 0.5, EAST], 3.5) == 3.5
    assert caster.cast_hits([0.5, 0.5, EAST], 3.5).tolist() == [-1, -1]
    assert caster.cast_hits([0.5, 0.5, EAST], 3.5000001).tolist() == [0, 4]


def test_a_start_in_an_occupied_cell_has_range_0():
    caster = draw(".#.")
    for heading in np.linspace(-4, 4, 33):
        assert caster.cast([1.3, 0.7, heading], 10.0) == 0.0
    assert caster.cast_hits([1.3, 0.7, 1.0], 10.0).tolist() == [0, 1]


def test_a_start_on_a_border_is_in_the_upper_right_cell():
    caster = draw(".#.")
    assert caster.cast([1.0, 0.5, WEST], 10.0) == 0.0
    assert caster.cast([2.0, 0.5, EAST], 10.0) == 10.0
    assert caster.cast([2.0, 0.5, WEST], 10.0) == 0.0


def test_a_ray_along_a_border_is_in_the_upper_right_cells():
    caster = draw(
        "...#",
        "..#.",
    )
    assert caster.cast([0.0, 1.0, EAST], 10.0) == 3.0
    assert caster.cast([3.5, 1.0, WEST], 10.0) == 0.0
    assert caster.cast([2.0, 5.0, SOUTH], 10.0) == 4.0
    assert caster.cast([3.0, -2.0, NORTH], 10.0) == 3.0


@pytest.mark.parametrize("turns", [0, 1, -1, 5, 1000])
def test_rounding_of_the_heading_does_not_push_a_ray_off_its_border(turns):
    # cos(pi / 2) is 6e-17 and cos(3 pi / 2) is -2e-16 in float64.
    caster = draw("#..", "...", "...")
    assert caster.cast([1.0, 0.5, NORTH + 2 * np.pi * turns], 10.0) == 10.0
    assert caster.cast([0.0, 0.5, NORTH + 2 * np.pi * turns], 10.0) == 1.5


def test_rays_enter_the_map_from_outside():
    caster = draw("..#")
    assert caster.cast([-7.0, 0.5, EAST], 20.0) == 9.0
    assert caster.cast([10.0, 0.5, WEST], 20.0) == 7.0
    assert caster.cast([2.5, -3.0, NORTH], 20.0) == 3.0
    assert caster.cast([0.5, -1.5, NORTH_EAST], 20.0) == pytest.approx(1.5 * np.sqrt(2), rel=1e-15)
    assert caster.cast([-7.0, 0.5, WEST], 20.0) == 20.0
    assert caster.cast([-7.0, 0.5, EAST], 9.0) == 9.0
    assert caster.cast([-7.0, 1.5, EAST], 20.0) == 20.0


def test_a_corner_of_one_occupied_cell_does_not_block_a_ray_through_it():
    caster = draw(
        "#..",
        "...",
        "..#",
    )
    assert caster.cast([0.0, 1.0, NORTH_EAST], 10.0) == 10.0
    assert caster.cast([1.0, 0.0, NORTH_EAST], 10.0) == 10.0
    assert caster.cast([3.0, 2.0, SOUTH_WEST], 10.0) == 10.0


def test_two_cells_that_touch_at_a_corner_block_a_ray_through_it_in_both_directions():
    caster = draw(
        "...",
        "#..",
        ".#.",
    )
    diagonal = 0.5 * np.sqrt(2)
    assert caster.cast([0.5, 0.5, NORTH_EAST], 10.0) == pytest.approx(diagonal, rel=1e-15)
    assert caster.cast([1.5, 1.5, SOUTH_WEST], 10.0) == pytest.approx(diagonal, rel=1e-15)
    assert caster.cast_hits([0.5, 0.5, NORTH_EAST], 10.0).tolist() in ([0, 1], [1, 0])


def test_the_cell_behind_a_corner_blocks_there():
    caster = draw(".#", "..")
    assert caster.cast([0.5, 0.5, NORTH_EAST], 10.0) == pytest.approx(0.5 * np.sqrt(2), rel=1e-15)
    assert caster.cast_hits([0.5, 0.5, NORTH_EAST], 10.0).tolist() == [1, 1]


def test_corners_treat_all_directions_alike():
    around = np.array([[1.0, 0, 1], [0, 0, 0], [1, 0, 1]])
    caster = RayCaster(OccupancyGrid(around, 0.1, (1.7, -3.3, 0.6)))
    poses = [[*caster.grid.to_map([1.5, 1.5]), 0.6 + np.pi / 4 * k] for k in range(8)]
    np.testing.assert_allclose(caster.cast(poses, 10.0), [10.0, 0.05 * np.sqrt(2)] * 4, rtol=1e-12)


def test_unknown_cells_are_free_or_occupied_as_asked():
    assert draw("..?.#").cast([0.5, 0.5, EAST], 10.0) == 3.5
    assert draw("..?.#", unknown="occupied").cast([0.5, 0.5, EAST], 10.0) == 1.5
    assert draw("?", unknown="occupied").cast([0.5, 0.5, EAST], 10.0) == 0.0
    assert draw("?").cast([0.5, 0.5, EAST], 10.0) == 10.0


def test_the_yaw_of_the_grid_turns_the_map():
    caster = draw("....#", origin=(10.0, 20.0, np.pi / 2))
    assert caster.cast([9.5, 20.5, NORTH], 10.0) == pytest.approx(3.5, abs=1e-12)


def test_expected_ranges_have_one_entry_per_pose_and_beam():
    caster = draw("....#", "....#")
    finder = RangeFinder.from_bearings([EAST, NORTH, WEST], 10.0, mount=(0.25, 0.0, 0.0))
    ranges = caster.expected_ranges(np.tile([0.5, 0.5, 0.0], (2, 4, 1)), finder)
    assert ranges.shape == (2, 4, 3)
    np.testing.assert_array_equal(ranges[1, 2], [3.25, 10.0, 10.0])
    hits = caster.expected_hits([0.5, 0.5, 0.0], finder)
    assert hits.tolist() == [[0, 4], [-1, -1], [-1, -1]]


def test_no_poses_and_no_beams_give_empty_results():
    caster = draw("....#")
    assert caster.cast(np.zeros((0, 3)), 1.0).shape == (0,)
    assert caster.cast_hits(np.zeros((0, 3)), 1.0).shape == (0, 2)
    assert caster.expected_ranges(np.zeros((0, 3)), RangeFinder.from_bearings([0.0], 1.0)).shape == (0, 1)
    empty = RangeFinder(np.zeros((0, 3)), 1.0)
    assert caster.expected_ranges(np.zeros((5, 3)), empty).shape == (5, 0)
    assert caster.expected_hits(np.zeros((5, 3)), empty).shape == (5, 0, 2)


def test_hits_say_where_the_range_ends(rng):
    grid = OccupancyGrid((rng.random((60, 70)) < 0.05).astype(float), 0.1, (-2.0, 1.0, 0.3))
    caster = RayCaster(grid)
    finder = RangeFinder.from_bearings(np.linspace(-2, 2, 31), 3.0)
    poses = np.column_stack([rng.uniform(-4, 8, (500, 2)), rng.uniform(-4, 4, 500)])
    ranges, hits = caster.expected_ranges(poses, finder), caster.expected_hits(poses, finder)
    seen = ranges < 3.0
    np.testing.assert_array_equal(hits[..., 0] >= 0, seen)
    headings = poses[:, None, 2] + finder.bearings
    # A tenth of a millimetre behind the end of the range.
    ends = poses[:, None, :2] + (ranges + 1e-4)[..., None] * np.stack([np.cos(headings), np.sin(headings)], -1)
    cells = np.floor(grid.to_cells(ends))[..., ::-1]
    inside = np.all(cells == hits, axis=-1)[seen & (ranges > 0)]
    assert grid.occupied[tuple(hits[seen].T)].all()
    assert inside.mean() > 0.995  # the rest cut corners shorter than that


@pytest.mark.parametrize("threads", [2, 3, 7])
def test_the_number_of_threads_changes_no_bit(rng, threads):
    caster = RayCaster(OccupancyGrid((rng.random((200, 200)) < 0.01).astype(float), 0.05))
    poses = np.column_stack([rng.uniform(-1, 11, (1111, 2)), rng.uniform(-4, 4, 1111)])
    finder = RangeFinder.from_bearings(np.linspace(-2, 2, 61), 8.0)

    def results(n):
        with forced_threads(n):
            yield from (caster.expected_ranges(poses, finder), caster.expected_hits(poses, finder))
            yield from (caster.cast(poses, 8.0), caster.cast_hits(poses, 8.0))

    assert all(many.tobytes() == one.tobytes() for many, one in zip(results(threads), results(1), strict=True))


def test_casters_of_a_map_share_its_tables_while_it_is_there(monkeypatch):
    grid = draw("..?#").grid
    passes, stops = RayCaster(grid), RayCaster(grid, unknown="occupied")
    assert RayCaster(grid).stops.base is passes.stops.base
    assert RayCaster(grid, unknown="occupied").stops.base is stops.stops.base
    assert [one.cast([0.5, 0.5, EAST], 10.0) for one in (passes, stops)] == [2.5, 1.5]
    there = weakref.ref(grid)
    del grid, passes, stops
    gc.collect()
    assert there() is None
    monkeypatch.setattr(raycast, "KEPT_BYTES", 0)
    grid = draw("...#").grid
    assert RayCaster(grid).stops.base is not RayCaster(grid).stops.base


def test_a_caster_does_not_change_and_does_not_touch_its_input():
    caster = draw("..#")
    with pytest.raises(AttributeError):
        caster.unknown = "occupied"
    poses = np.array([[0.5, 0.5, 0.0]])
    poses.flags.writeable = False
    caster.cast(poses, 5.0)
    assert poses.tolist() == [[0.5, 0.5, 0.0]]


def test_poses_in_any_memory_order_give_the_same_ranges(rng):
    caster = draw("..#.", "#...", "....")
    poses = np.column_stack([rng.uniform(0, 3, (40, 2)), rng.uniform(-4, 4, 40)])
    np.testing.assert_array_equal(caster.cast(np.asfortranarray(poses), 5.0), caster.cast(poses, 5.0))
    np.testing.assert_array_equal(caster.cast(poses[::-2], 5.0), caster.cast(poses, 5.0)[::-2])


WEIRD = [0.0, -0.0, 1e-320, -1e-300, 1e-17, 0.5, 1.0, 3.0, -1e-9, 1e15, -4e18, 1e200, -1.7e308, 1.7e308]


def test_casting_ends_for_weird_numbers():
    """Positions up to the largest float, headings of many turns, ranges far longer than the map."""
    caster = draw("..#", "...", "#..")
    turned = draw("..#", "...", "#..", resolution=1e-3, origin=(1e6, -1e6, 2.0))
    far_yaw = draw("..#", "...", "#..", origin=(0.0, 0.0, 1e9))
    headings = [0.0, -1.7e308, 1e-320, 6e-17, 1e-12, -1e-12, np.pi, 0.7, 1e5, 1e6, -1e9, 1e22, 1.7e308]
    poses = np.array(np.meshgrid(WEIRD, WEIRD, headings)).reshape(3, -1).T
    for each in (caster, turned, far_yaw):
        for max_range in (1e-300, 1e-9, 5.0, 1e18, 1.7e308):
            ranges = each.cast(poses, max_range)
            assert ((ranges >= 0) & (ranges <= max_range)).all()
            each.cast_hits(poses, max_range)


def test_what_lies_in_freed_memory_does_not_reach_a_few_rays():
    # A handful of rays leaves most of the block that walks in lockstep unused. Scratch memory taken from these arrays
    # would hold starts inside the map with infinite directions.
    caster = draw("....#", ".....")
    for size in range(1056, 1080):
        junk = [np.repeat([0.5, np.inf], size // 2) for _ in range(50)]
        del junk
        assert caster.cast([0.5, 1.5, EAST], 10.0) == 3.5
        assert caster.expected_ranges([0.5, 1.5, EAST], RangeFinder.from_bearings([0.0], 9.0)).tolist() == [3.5]


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_poses_must_be_finite(bad):
    caster = draw("..#")
    with pytest.raises(InvalidInputError, match="origins: expected finite numbers"):
        caster.cast([0.0, bad, 0.0], 5.0)
    with pytest.raises(InvalidInputError, match="poses: expected finite numbers"):
        caster.expected_ranges([[0.0, 0.0, bad]], RangeFinder.from_bearings([0.0], 5.0))


def test_poses_must_have_three_numbers():
    with pytest.raises(InvalidInputError, match=r"expected shape \(\.\.\., 3\), got \(2,\)"):
        draw("..#").cast([0.0, 1.0], 5.0)


@pytest.mark.parametrize("bad", [0.0, -1.0, np.inf, np.nan])
def test_max_range_must_be_positive_and_finite(bad):
    with pytest.raises(InvalidInputError, match="max_range: expected a positive finite number"):
        draw("..#").cast([0.0, 0.0, 0.0], bad)


def test_unknown_must_be_one_of_its_two_values():
    with pytest.raises(InvalidInputError, match="unknown: expected 'free' or 'occupied', got 'maybe'"):
        draw("..#", unknown="maybe")


def test_tables_take_eight_bytes_per_cell():
    caster = RayCaster(OccupancyGrid(np.zeros((100, 200)), 0.05))
    assert caster.table_bytes == 8 * 102 * 202
