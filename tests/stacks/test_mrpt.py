"""MRPT's models: values on a small room, readings, points, rays and the map."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, Scan
from beamfield.stacks.mrpt.field import MrptField
from beamfield.stacks.mrpt.parameters import MrptFieldParameters, MrptRayParameters
from beamfield.stacks.mrpt.rays import MrptRays
from beamfield.stacks.mrpt.scan import mrpt_grid, scan_points
from tests.stacks.small_room import MAX_RANGE, POSES, small_room, small_scan

FIELD = MrptFieldParameters(
    LF_stdHit=0.08, LF_zHit=0.6, LF_zRandom=0.2, LF_maxRange=MAX_RANGE, LF_decimation=1, LF_maxCorrsDistance=0.5
)
RAYS = MrptRayParameters(rayTracing_stdHit=0.08, rayTracing_decimation=1)
# What MRPT's compiled code returned: logarithms.
ANSWERS = {
    "field": (MrptField, {}, [-18.941517265065322, -32.2263946818818, -29.100762361962254, -36.368107388567466]),
    "field, fourth powers": (
        MrptField, {"LF_useSquareDist": True},
        [-10.772986020586924, -20.513874442572412, -23.603961953757857, -31.451539133582887],
    ),
    "field, means": (
        MrptField, {"LF_alternateAverageMethod": True},
        [-0.9359159501566735, -1.714377595880338, -1.453638418392491, -2.2698427989851484],
    ),
    "rays": (MrptRays, {}, [-13.169439444491047, -46.04739221954723, -36.73513763941855, -45.39586920972498]),
}  # fmt: skip
# Of the first pose's 16 rays; -1 where nothing is met.
FIRST_RAYS = [0.4, 0.48, 0.64, 0.56, 0.48, 0.56, 0.8, -1, 0.56, -1, 1.44, 0.8, 0.8, 0.8, 0.56, 0.48]


@pytest.mark.parametrize("name", ANSWERS)
def test_weights_are_those_of_the_program(name):
    kind, changes, expected = ANSWERS[name]
    parameters = replace(FIELD if kind is MrptField else RAYS, **changes)
    got = kind(small_room(), parameters).log_likelihood(small_scan(), POSES)
    assert np.exp(got - expected) == pytest.approx(1.0, abs=1e-6)


def test_single_precision_rounds_as_the_program():
    got = MrptField(small_room(), FIELD, precision="single").log_likelihood(small_scan(), POSES)
    assert got == pytest.approx(ANSWERS["field"][2], abs=1e-12)


def test_fourth_powers_in_single_precision_are_those_of_the_program():
    parameters = replace(FIELD, LF_useSquareDist=True)
    got = MrptField(small_room(), parameters, precision="single").log_likelihood(small_scan(), POSES)
    assert got == pytest.approx(ANSWERS["field, fourth powers"][2], abs=1e-12)


def test_field_by_hand():
    """A slow reference: every occupied cell for every end point."""
    rng = np.random.default_rng(5)
    grid = OccupancyGrid.from_ros(np.where(rng.random((12, 15)) < 0.1, 100, 0), 0.2, [1.0, -2.0, 0.0])
    scan = Scan(rng.uniform(0.3, 2.5, 9), RangeFinder.from_bearings(np.linspace(-2, 2, 9), 4.0, mount=(0.2, 0.1, 0.4)))
    poses = rng.uniform([0.5, -2.5, -3.0], [4.5, 1.0, 3.0], (40, 3))
    model = MrptField(grid, MrptFieldParameters(LF_decimation=2))
    rows, cols = np.nonzero(grid.occupied)
    got = model.log_likelihood(scan, poses)
    off = 0
    for i, (x, y, theta) in enumerate(poses):
        total = 0.0
        sensor = (x + 0.2 * math.cos(theta) - 0.1 * math.sin(theta), y + 0.2 * math.sin(theta) + 0.1 * math.cos(theta))
        for k in range(9):
            along = theta + 0.4 + np.linspace(-2, 2, 9)[k]
            col = int((sensor[0] + scan.ranges[k] * math.cos(along) - 1.0) / 0.2)
            row = int((sensor[1] + scan.ranges[k] * math.sin(along) + 2.0) / 0.2)
            distance = 0.3
            if 0 <= col < 14 and 0 <= row < 11:
                distance = min(0.3, 0.2 * np.hypot(rows - row, cols - col).min())
            else:
                off += 1
            total += math.log(0.95 * math.exp(-0.5 * (distance / 0.35) ** 2) + 0.05 / 81.0)
        assert got[i] == pytest.approx(total, abs=1e-6)
    assert off > 10


def test_last_row_and_column_are_off_the_map_and_a_cell_before_the_first_is_on_it():
    grid = OccupancyGrid.from_ros(np.full((3, 3), 100), 1.0)
    finder = RangeFinder.from_bearings([0.0], 8.0)
    model = MrptField(grid, FIELD)
    places = {-1.1: 2, -0.9: 0, 0.5: 0, 1.9: 0, 2.1: 2, 3.1: 2}
    for x, place in places.items():
        for pose in ([x, 0.5, 0.0], [0.5, x, 0.0]):
            evidence = model.evidence(Scan([0.0], finder), [pose])
            assert evidence.places.tolist() == [[place]]
            assert evidence.distances[0, 0] == (np.inf if place else 0.0)


def test_a_map_of_one_cell_has_no_cell_on_it():
    model = MrptField(OccupancyGrid.from_ros([[100]], 1.0), FIELD)
    assert model.evidence(small_scan(), POSES).places.min() == 2


def test_off_the_map_is_worth_what_the_largest_distance_is():
    model = MrptField(OccupancyGrid.from_ros([[100, 0]] * 2, 1.0), MrptFieldParameters())
    scan = Scan([1.0], RangeFinder.from_bearings([0.0], 5.0))
    far = 0.95 * math.exp(-0.5 * (0.3 / 0.35) ** 2) + 0.05 / 81.0
    assert np.exp(model.log_likelihood(scan, [50.0, 50.0, 0.0])) == pytest.approx(far)
    fourth = model.with_parameters(replace(model.parameters, LF_useSquareDist=True))
    assert np.exp(fourth.log_likelihood(scan, [50.0, 50.0, 0.0])) == pytest.approx(far)


def test_a_reading_after_an_invalid_one_makes_no_point():
    ranges = [1.0, np.nan, 1.0, 1.0, np.inf, 1.0, 1.0, 5.0, 1.0, 1.0, 0.05, 1.0, 1.0]
    scan = Scan(ranges, RangeFinder.from_bearings(0.5 * np.arange(13.0), 5.0, min_range=0.1))
    assert scan_points(scan, 0.0).tolist() == [0, 3, 6, 9, 12]


def test_points_are_thinned_out_not_beams_and_only_from_ten_on():
    for n_points, expected in ((9, list(range(1, 10))), (10, [1, 4, 7, 10]), (12, [1, 4, 7, 10])):
        ranges = np.full(13, 1.0)
        ranges[n_points + 1 :] = np.nan
        # The first point is lost with the reading before it.
        scan = Scan(ranges, RangeFinder.from_bearings(0.5 * np.arange(13.0), 5.0, min_range=0.1))
        scan = Scan(np.concatenate([[np.nan], ranges]), RangeFinder.from_bearings(0.4 * np.arange(14.0), 5.0))
        beams = MrptField(small_room(), replace(FIELD, LF_decimation=3)).evidence(scan, POSES).beams
        assert (beams - 1).tolist() == expected


def test_points_close_to_the_last_one_are_left_out():
    scan = Scan(np.full(101, 1.0), RangeFinder.from_bearings(np.arange(101) * 0.009, 5.0))
    assert scan_points(scan, 0.02).tolist() == list(range(0, 101, 3))
    assert scan_points(scan, 0.0).tolist() == list(range(101))
    assert scan_points(Scan(np.full(101, np.nan), scan.finder), 0.02).tolist() == []
    beams = {spacing: len(MrptField(small_room(), FIELD, least_spacing=spacing).evidence(scan, POSES).beams)
             for spacing in (0.0, 0.02, 0.1)}  # fmt: skip
    assert beams == {0.0: 101, 0.02: 34, 0.1: 9}
    default = MrptField(small_room(), FIELD).evidence(scan, POSES).beams
    assert default.tolist() == scan_points(scan, 0.05).tolist()


@pytest.mark.parametrize(("decimation", "beams"), [(1, [0, 2, 3, 4]), (2, [0, 2, 4]), (3, [0, 3]), (9, [0])])
def test_rays_are_thinned_out_before_invalid_readings_are_dropped(decimation, beams):
    scan = Scan([1.0, np.nan, 1.0, 1.0, 1.0], RangeFinder.from_bearings(np.zeros(5), 5.0))
    model = MrptRays(small_room(), replace(RAYS, rayTracing_decimation=decimation))
    assert model.evidence(scan, POSES).beams.tolist() == beams


def test_rays_take_the_limits_of_the_sensor():
    scan = Scan([0.05, 0.1, 4.9, 5.0, 7.0, np.inf, -np.inf], RangeFinder.from_bearings(np.zeros(7), 5.0, min_range=0.1))
    assert MrptRays(small_room(), RAYS).evidence(scan, POSES).beams.tolist() == [1, 2]


def test_a_scan_without_readings_says_nothing():
    scan = Scan(np.full(16, np.nan), small_scan().finder)
    assert MrptRays(small_room(), RAYS).log_likelihood(scan, POSES).tolist() == [1.0] * 4
    for average in (False, True):
        model = MrptField(small_room(), replace(FIELD, LF_alternateAverageMethod=average))
        assert model.log_likelihood(scan, POSES).tolist() == [0.0] * 4


def test_rays_are_those_of_the_program():
    ranges = MrptRays(small_room(), RAYS).evidence(small_scan(), POSES).expected_ranges[0]
    hits = np.array(FIRST_RAYS) > 0.0
    assert ranges[hits] == pytest.approx(np.array(FIRST_RAYS)[hits], abs=1e-6)
    # Through the unknown cells; and to the end of the ray.
    assert ranges[~hits] == pytest.approx([2.0, 1.6])


@pytest.mark.parametrize("rays", ["marching", "exact"])
def test_where_rays_end(rays):
    grid = OccupancyGrid.from_ros([[-1] + [0] * 8 + [100]], 1.0)
    model = MrptRays(grid, RAYS, rays=rays)
    scan = Scan([1.0, 1.0, 1.0], RangeFinder.from_bearings([0.0, np.pi, np.pi / 2], 10.0))
    wall, unknown, outside = model.evidence(scan, [[3.5, 0.5, 0.0], [20.0, 0.5, 0.0]]).expected_ranges.T
    # Five and a half cells are seven steps of 0.8 of them.
    assert wall.tolist() == pytest.approx([5.6 if rays == "marching" else 5.5, 10.0])
    assert unknown.tolist() == [10.0, 10.0]
    assert outside.tolist() == [10.0, 10.0]
    short = Scan([1.0], RangeFinder.from_bearings([0.0], 5.0))
    assert model.evidence(short, [[3.5, 0.5, 0.0]]).expected_ranges == pytest.approx(4.0)


def test_differences_beyond_two_metres_count_no_more_with_the_filter():
    grid = OccupancyGrid.from_ros([[0] * 9 + [100]], 1.0)
    finder = RangeFinder.from_bearings([0.0], 30.0)
    model = MrptRays(grid, MrptRayParameters())
    pose = [0.5, 0.5, 0.0]
    two, four = (model.log_likelihood(Scan([8.8 + z], finder), pose) for z in (2.0, 4.0))
    assert two == pytest.approx(four)
    without = model.with_parameters(MrptRayParameters(rayTracing_useDistanceFilter=False))
    assert without.log_likelihood(Scan([12.8], finder), pose) < four - 1.0


def test_map_values_on_either_side_of_one_half_are_obstacles_or_free():
    grid = OccupancyGrid.from_ros([[0, 30, 50, 51, 100, -1]], 1.0)
    raw = mrpt_grid(grid, "raw")
    assert raw.occupied.tolist() == [[False, False, False, True, True, False]]
    assert raw.free.tolist() == [[True, True, False, False, False, False]]
    trinary = mrpt_grid(grid, "trinary")
    assert trinary.occupied.tolist() == [[False] * 4 + [True, False]]
    scale = mrpt_grid(OccupancyGrid([[0.1, 0.3, 0.6, 0.9]], 1.0, free_thresh=0.2, occupied_thresh=0.7), "scale")
    assert scale.occupied.tolist() == [[False, False, True, True]]


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        (MrptFieldParameters, "likelihoodMethod", 1), (MrptFieldParameters, "likelihoodMethod", "4"),
        (MrptFieldParameters, "LF_stdHit", 0.0), (MrptFieldParameters, "LF_zHit", -0.1),
        (MrptFieldParameters, "LF_zRandom", np.nan), (MrptFieldParameters, "LF_maxRange", np.inf),
        (MrptFieldParameters, "LF_decimation", 0), (MrptFieldParameters, "LF_maxCorrsDistance", -1.0),
        (MrptFieldParameters, "LF_useSquareDist", 1), (MrptRayParameters, "likelihoodMethod", 4),
        (MrptRayParameters, "rayTracing_stdHit", -1.0), (MrptRayParameters, "rayTracing_decimation", 2.5),
        (MrptRayParameters, "rayTracing_useDistanceFilter", "no"),
    ],
)  # fmt: skip
def test_parameters_without_meaning_are_refused(kind, name, value):
    with pytest.raises(InvalidInputError, match=f"{name}: expected"):
        kind(**{name: value})


@pytest.mark.parametrize(
    ("kind", "option", "value"),
    [
        (MrptField, "precision", "half"), (MrptField, "least_spacing", -0.1), (MrptField, "least_spacing", np.nan),
        (MrptField, "map_mode", "grey"), (MrptRays, "rays", "bresenham"), (MrptRays, "map_mode", "grey"),
    ],
)  # fmt: skip
def test_options_that_do_not_exist_are_refused(kind, option, value):
    with pytest.raises(InvalidInputError, match=f"{option}: expected"):
        kind(small_room(), FIELD if kind is MrptField else RAYS, **{option: value})
