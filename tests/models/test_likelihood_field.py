"""LikelihoodFieldModel: hand-derived numbers, Table 6.3, other programs' numbers, options, precision."""

from __future__ import annotations

import math
import pickle
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import compose, transform_points
from beamfield.maps.distance import DistanceField
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, Scan
from tests.reference.field_tables import likelihood_field_range_finder_model
from tests.threads import forced_threads

PARAMETERS = LikelihoodFieldParameters(z_hit=0.7, z_rand=0.2, sigma_hit=0.5)
MAX_RANGE = 8.0
# One row of cells of 1 m: an obstacle in the last, unknown before it.
ROW = OccupancyGrid.from_ros([[0, 0, 0, 0, -1, 100]], 1.0)


def finder(*bearings_deg, **limits):
    return RangeFinder.from_bearings(np.deg2rad(bearings_deg), MAX_RANGE, **limits)


def model_of(grid, parameters=PARAMETERS, **options):
    return LikelihoodFieldModel(grid, parameters, **options)


def value(dist):
    sigma = PARAMETERS.sigma_hit
    hit = math.exp(-0.5 * (dist / sigma) ** 2) / (sigma * math.sqrt(2 * math.pi))
    return math.log(PARAMETERS.z_hit * hit + PARAMETERS.z_rand / MAX_RANGE)


def poses_in(room, rng, n=200):
    inside = np.column_stack([rng.uniform(0.2, 5.8, n), rng.uniform(0.2, 3.8, n)])
    return np.column_stack([transform_points(room.origin, inside), rng.uniform(-4, 4, n)])


def random_scan(rng, k=31, **limits):
    mounts = np.column_stack([rng.uniform(-0.3, 0.3, (k, 2)), rng.uniform(-3, 3, k)])
    return Scan(rng.uniform(0.1, 4.0, k), RangeFinder(mounts, MAX_RANGE, **limits))


def test_one_scan_by_hand():
    """From (0.5, 0.5) facing the obstacle 5 m ahead: its cell, the cell before it, and the robot's own."""
    scan = Scan([5.2, 3.6, 0.3], finder(0, 0, 0))
    expected = [value(0.0), value(1.0), value(5.0)]
    model = model_of(ROW)
    np.testing.assert_allclose(model.beam_log_likelihood(scan, [0.5, 0.5, 0.0]), expected, atol=1e-7)
    assert float(model.log_likelihood(scan, [0.5, 0.5, 0.0])) == pytest.approx(sum(expected), abs=1e-7)
    assert model.distances_to_obstacles(scan, [0.5, 0.5, 0.0]).tolist() == [0.0, 1.0, 5.0]


def test_interpolated_by_hand():
    """End points at 5.7, 4.1 and 0.8 along the row of centres at 0.5, 1.5 ... with distances 5, 4, 3, 2, 1, 0."""
    scan = Scan([5.2, 3.6, 0.3], finder(0, 0, 0))
    model = model_of(ROW, off_map="far", interpolation="bilinear")
    np.testing.assert_allclose(model.distances_to_obstacles(scan, [0.5, 0.5, 0.0]), [0.0, 1.4, 4.7], atol=1e-12)
    expected = [value(0.0), value(1.4), value(4.7)]
    np.testing.assert_allclose(model.beam_log_likelihood(scan, [0.5, 0.5, 0.0]), expected, atol=1e-9)


def test_agrees_with_table_6_3_written_out(rng):
    occupied = rng.random((14, 17)) < 0.1
    grid = OccupancyGrid.from_ros(np.where(occupied, 100, 0), 0.25)
    model = model_of(grid)
    for _ in range(5):
        scan = random_scan(rng, 9)
        ranges = np.where(rng.random(9) < 0.2, MAX_RANGE, scan.ranges)
        pose = rng.uniform([0.0, 0.0, -3.0], [4.0, 3.5, 3.0])
        q = likelihood_field_range_finder_model(
            ranges, scan.finder.mounts, pose, occupied, 0.25, (0.7, 0.2, 0.5), MAX_RANGE
        )
        assert float(model.log_likelihood(Scan(ranges, scan.finder), pose)) == pytest.approx(math.log(q), abs=1e-5)


def double_precision(model, scan, poses):
    """Line 8 in NumPy from the model's own distances, nearest cell, everything in double precision."""
    dist = model.distances_to_obstacles(scan, poses)
    p = model.parameters
    hit = np.exp(-0.5 * (dist / p.sigma_hit) ** 2) / (p.sigma_hit * math.sqrt(2 * math.pi))
    return np.log(p.z_hit * hit + p.z_rand / scan.finder.max_range)


def test_each_beam_is_within_the_stated_error_of_double_precision(room, rng):
    """Where it is not, the end point lies within 5e-7 of the field's extent of a cell's border."""
    model, scan, poses = model_of(room), random_scan(rng, 60), poses_in(room, rng, 3000)
    expected, got = double_precision(model, scan, poses), model.beam_log_likelihood(scan, poses)
    wrong = np.abs(got - expected) > 2e-8
    assert wrong.mean() < 1e-4
    ends = compose(compose(poses[:, None], scan.finder.mounts), np.pad(scan.ranges[:, None], ((0, 0), (0, 2))))
    cells = room.to_cells(ends[..., :2])
    to_border = np.abs(cells - np.round(cells)).min(axis=-1)
    extent = max(model.distances.distance.shape)
    assert (to_border[wrong] < 5e-7 * extent).all()
    sums = model.log_likelihood(scan, poses)[~wrong.any(axis=1)]
    np.testing.assert_allclose(sums, expected.sum(axis=1)[~wrong.any(axis=1)], rtol=0, atol=60 * 2e-8)


def test_readings_without_end_point_change_nothing():
    pose = [0.5, 0.5, 0.1]
    scan = Scan([np.nan, 5.0, MAX_RANGE, np.inf, -np.inf, 0.05, 2.0, 99.0, -1.0], finder(*range(9), min_range=0.1))
    measured = Scan([5.0, 2.0], finder(1, 6, min_range=0.1))
    for interpolation in ("nearest", "bilinear"):
        model = model_of(ROW, interpolation=interpolation)
        assert model.log_likelihood(scan, pose) == model.log_likelihood(measured, pose)
        assert np.flatnonzero(model.beam_log_likelihood(scan, pose)).tolist() == [1, 6]
        assert np.flatnonzero(~np.isnan(model.distances_to_obstacles(scan, pose))).tolist() == [1, 6]


def test_a_scan_without_any_end_point_says_nothing():
    scan = Scan([np.nan, np.inf, MAX_RANGE], finder(0, 1, 2))
    for interpolation in ("nearest", "bilinear"):
        model = model_of(ROW, interpolation=interpolation)
        assert model.log_likelihood(scan, np.zeros((2, 2, 3))).tolist() == [[0.0, 0.0], [0.0, 0.0]]
        assert (model.beam_log_likelihood(scan, np.zeros((4, 3))) == 0.0).all()
    assert (model.log_likelihood_gradient(scan, np.zeros((4, 3))) == 0.0).all()


def test_thinning_counts_beams_with_an_end_point_only():
    """Fifteen of twenty-five beams are NaN, too close or without return; five of the other ten are used, evenly."""
    ranges = np.full(25, 1.5)
    ranges[[0, 2, 4, 6, 8, 10, 12, 14, 16, 18, 20, 21, 22, 23, 24]] = [np.nan, 0.1, MAX_RANGE] * 5
    scan = Scan(ranges, finder(*np.linspace(-80, 80, 25), min_range=0.2))
    each = model_of(ROW, n_beams=5).beam_log_likelihood(scan, [0.5, 0.5, 0.0])
    assert np.flatnonzero(each).tolist() == [1, 5, 9, 15, 19]


@pytest.mark.parametrize("interpolation", ["nearest", "bilinear"])
@pytest.mark.parametrize("data", [np.zeros((5, 5)), np.full((5, 5), -1)])
def test_a_map_without_obstacles_leaves_rand_only(data, interpolation):
    grid, scan = OccupancyGrid.from_ros(data, 0.5), Scan([0.6, 1.0, 7.0], finder(0, 90, 180))
    poses = [[1.2, 1.2, 0.3], [50.0, 0.0, 1.0]]
    model = model_of(grid, interpolation=interpolation)
    np.testing.assert_allclose(model.log_likelihood(scan, poses), 3 * math.log(0.2 / MAX_RANGE), rtol=1e-9)
    cut = model_of(grid, interpolation=interpolation, max_distance=0.5)
    np.testing.assert_allclose(cut.log_likelihood(scan, poses), 3 * value(0.5), rtol=1e-7)
    if interpolation == "bilinear":
        assert (model.log_likelihood_gradient(scan, poses) == 0.0).all()


@pytest.mark.parametrize("interpolation", ["nearest", "bilinear"])
def test_without_rand_an_end_point_far_from_everything_is_impossible(interpolation):
    parameters = LikelihoodFieldParameters(z_hit=1.0, z_rand=0.0, sigma_hit=0.05)
    model = model_of(ROW, parameters, interpolation=interpolation)
    scan = Scan([5.0, 4.0, 3.0], finder(0, 0, 0))
    each = model.beam_log_likelihood(scan, [0.5, 0.5, 0.0])
    peak = -math.log(0.05 * math.sqrt(2 * math.pi))
    assert each == pytest.approx([peak, peak - 200.0, -math.inf], abs=1e-5)
    assert model.log_likelihood(scan, [0.5, 0.5, 0.0]) == -math.inf
    assert model.log_likelihood(Scan([5.0, 4.0], finder(0, 0)), [0.5, 0.5, 0.0]) == pytest.approx(
        2 * peak - 200.0, abs=1e-5
    )
    assert model.log_likelihood(Scan([5.0], finder(0)), [500.0, 0.5, 0.0]) == -math.inf


def test_off_the_map_distances_go_on_unless_cut_off():
    """The obstacle ends at x = 6; the next cell's centre is 1 m from its own."""
    scan, pose = Scan([6.0, 7.1], finder(0, 0)), [0.5, 0.5, 0.0]
    np.testing.assert_allclose(model_of(ROW).beam_log_likelihood(scan, pose), [value(1.0), value(2.0)], atol=1e-7)
    far = model_of(ROW, off_map="far").beam_log_likelihood(scan, pose)
    np.testing.assert_allclose(far, math.log(0.2 / MAX_RANGE), atol=1e-7)
    clipped = model_of(ROW, off_map="far", max_distance=1.5).beam_log_likelihood(scan, pose)
    np.testing.assert_allclose(clipped, value(1.5), atol=1e-7)


def test_where_a_field_ends_makes_no_difference(room, rng):
    """Past 8 sigma a hit is lost in z_rand: the continued field may stop there."""
    scan = random_scan(rng)
    poses = np.column_stack([rng.uniform(-12, 12, (500, 2)), rng.uniform(-3, 3, 500)])
    wide = LikelihoodFieldModel(room, PARAMETERS, distances=DistanceField.from_grid(room, margin=15.0))
    np.testing.assert_allclose(model_of(room).log_likelihood(scan, poses), wide.log_likelihood(scan, poses), rtol=1e-7)


def test_in_uniform_unknown_space_every_reading_is_equally_likely():
    scan, pose = Scan([5.0, 4.0, 3.0, 7.0], finder(0, 0, 0, 0)), [0.5, 0.5, 0.0]
    expected = [value(0.0), math.log(1 / MAX_RANGE), value(2.0), math.log(1 / MAX_RANGE)]
    for interpolation in ("nearest", "bilinear"):
        for off_map in ("continued", "far"):
            model = model_of(ROW, unknown="uniform", interpolation=interpolation, off_map=off_map)
            np.testing.assert_allclose(model.beam_log_likelihood(scan, pose), expected, atol=1e-7)


@pytest.mark.parametrize("unknown", ["free", "uniform"])
def test_the_gradient_is_that_of_finite_differences(room, rng, unknown):
    """Two steps are compared to leave out bends of the interpolation, where a difference is no derivative."""
    model = model_of(room, unknown=unknown, interpolation="bilinear", exponent=0.7)
    scan, poses = random_scan(rng, 5), poses_in(room, rng, 300)
    gradient = model.log_likelihood_gradient(scan, poses)
    assert gradient.shape == (300, 3)
    n_compared = 0
    for axis in range(3):

        def difference(step, axis=axis):
            shift = np.eye(3)[axis] * step
            return (model.log_likelihood(scan, poses + shift) - model.log_likelihood(scan, poses - shift)) / (2 * step)

        coarse, fine = difference(1e-5), difference(5e-6)
        smooth = np.abs(coarse - fine) < 1e-5
        n_compared += smooth.sum()
        np.testing.assert_allclose(gradient[smooth, axis], fine[smooth], rtol=1e-4, atol=1e-4)
    assert n_compared > 850
    assert np.abs(gradient).max() > 1.0


def test_following_the_gradient_finds_the_pose():
    """A square room is seen from a pose 15 cm and 4 degrees off; plain ascent comes back to within half a cell."""
    data = np.zeros((62, 50))
    data[[0, -1]] = data[:, [0, -1]] = 100
    model = model_of(
        OccupancyGrid.from_ros(data, 0.1),
        LikelihoodFieldParameters(z_hit=0.9, z_rand=0.1, sigma_hit=0.3),
        interpolation="bilinear",
    )
    truth = np.array([2.2, 2.9, 0.4])
    bearings = np.linspace(-np.pi, np.pi, 72, endpoint=False)
    direction = np.stack([np.cos(truth[2] + bearings), np.sin(truth[2] + bearings)])
    walls = np.array([[0.05, 4.95], [0.05, 6.15]])
    with np.errstate(divide="ignore"):
        ranges = np.max((walls[:, None, :] - truth[:2, None, None]) / direction[:, :, None], axis=2).min(axis=0)
    scan = Scan(ranges, RangeFinder.from_bearings(bearings, 10.0))
    pose = truth + np.array([0.12, -0.09, 0.07])
    for _ in range(200):
        pose = pose + 2e-4 * model.log_likelihood_gradient(scan, pose)
    assert np.abs(pose - truth).max() < 0.03


def test_no_gradient_from_nearest_cells():
    with pytest.raises(InvalidInputError, match="interpolation: a gradient needs 'bilinear', got 'nearest'"):
        model_of(ROW).log_likelihood_gradient(Scan([1.0], finder(0)), np.zeros(3))


def test_interpolation_is_continuous_and_nearest_is_not(room):
    scan = Scan([1.0], finder(0))
    poses = np.column_stack([np.linspace(-1.0, 1.5, 5001), np.full(5001, 4.0), np.zeros(5001)])
    steps = [
        np.abs(np.diff(model_of(room, interpolation=kind).log_likelihood(scan, poses))).max()
        for kind in ("bilinear", "nearest")
    ]
    assert steps[0] < 0.01
    assert steps[1] > 0.05


def test_many_ranges_of_no_return_do_not_pile_up_tables(room, rng):
    model, ranges = model_of(room), rng.uniform(0.1, 4.0, 5)
    poses = poses_in(room, rng, 10)
    for _ in range(2):
        for max_range in range(5, 15):
            sensor = RangeFinder.from_bearings(np.arange(5.0), float(max_range))
            got = model.log_likelihood(Scan(ranges, sensor), poses)
            fresh = model_of(room).log_likelihood(Scan(ranges, sensor), poses)
            assert (got == fresh).all()
    assert len(model._look_ups.tables._tables) <= 4


@pytest.mark.parametrize("n_beams", [7, None])
def test_poses_with_gaps_in_memory_score_alike_with_several_threads(room, rng, n_beams):
    scan, poses = random_scan(rng), poses_in(room, rng, 12_000)
    model = model_of(room, n_beams=n_beams)
    with forced_threads(1):
        expected = model.log_likelihood(scan, poses)
    with forced_threads(2):
        assert (model.log_likelihood(scan, poses[::3]) == expected[::3]).all()
        assert (model.log_likelihood(scan, np.asfortranarray(poses)) == expected).all()
        assert (model.log_likelihood(scan, np.ascontiguousarray(poses[::-1])[::-1]) == expected).all()


@pytest.mark.parametrize("threads", [1, 2, 3])
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("column", [0, 1, 2])
def test_a_pose_that_is_not_finite_is_named_whoever_meets_it(room, rng, threads, bad, column):
    scan, poses = random_scan(rng), poses_in(room, rng, 1500)
    model = model_of(room)
    for row in (0, 700, 1499):
        broken = poses.copy()
        broken[row, column] = bad
        expected = rf"poses: expected finite numbers, got {bad} at index \({row}, "
        with forced_threads(threads), pytest.raises(InvalidInputError, match=expected):
            model.log_likelihood(scan, broken)
    assert np.isfinite(model.log_likelihood(scan, poses)).all()


@pytest.mark.parametrize("threads", [1, 2])
def test_finite_poses_beyond_all_maps_are_no_error(room, rng, threads):
    scan, poses = random_scan(rng), np.zeros((1500, 3))
    poses[::3], poses[1::3, 2] = 1e300, 1e9
    poses[2::3, 0] = -1e15
    with forced_threads(threads):
        got = model_of(room).log_likelihood(scan, poses)
    assert np.isfinite(got).all()
    assert got[0] == pytest.approx(scan.finder.n_beams * math.log(PARAMETERS.z_rand / MAX_RANGE), abs=1e-3)


def test_threads_that_need_a_table_at_once_share_it(room, rng):
    scan, poses = random_scan(rng), poses_in(room, rng)
    expected = model_of(room).log_likelihood(scan, poses)
    model = model_of(room)
    with ThreadPoolExecutor(8) as pool:
        for result in pool.map(lambda _: model.log_likelihood(scan, poses), range(32)):
            assert (result == expected).all()
    assert len(model._look_ups.tables._tables) == 1


def test_memory_of_a_table_is_as_stated(room, rng):
    model, scan = model_of(room), random_scan(rng)
    before = len(pickle.dumps(model))
    model.log_likelihood(scan, np.zeros(3))
    assert model._look_ups.tables.table(MAX_RANGE).codes.nbytes == model.table_bytes
    assert len(pickle.dumps(model)) == before


def test_parameters_of_a_beam_model_carry_over():
    beam = BeamParameters(z_hit=0.6, z_short=0.15, z_max=0.05, z_rand=0.2, sigma_hit=0.1, lambda_short=1.0)
    assert LikelihoodFieldParameters.from_beam_parameters(beam) == LikelihoodFieldParameters(0.6, 0.2, 0.1)


@pytest.mark.parametrize("name", ["range_offset", "sigma_slope"])
def test_what_a_field_cannot_have_is_dropped_only_if_told(name):
    beam = BeamParameters(0.6, 0.15, 0.05, 0.2, sigma_hit=0.1, lambda_short=1.0, **{name: 0.02})
    with pytest.raises(InvalidInputError, match=f"{name}: a likelihood field has no .*, expected 0, got 0.02"):
        LikelihoodFieldParameters.from_beam_parameters(beam)
    other = {"range_offset": "sigma_slope", "sigma_slope": "range_offset"}[name]
    with pytest.raises(InvalidInputError, match=name):
        LikelihoodFieldParameters.from_beam_parameters(beam, drop=[other])
    dropped = LikelihoodFieldParameters.from_beam_parameters(beam, drop=["range_offset", "sigma_slope"])
    assert dropped == LikelihoodFieldParameters(0.6, 0.2, 0.1)
    with pytest.raises(InvalidInputError, match="drop: expected names among range_offset, sigma_slope, got 'z_max'"):
        LikelihoodFieldParameters.from_beam_parameters(beam, drop=["z_max"])


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((1.1, 0.0, 0.1), r"z_hit: expected a weight in \[0, 1\], got 1.1"),
        ((0.5, -0.1, 0.1), r"z_rand: expected a weight in \[0, 1\], got -0.1"),
        ((0.7, 0.5, 0.1), r"z_hit \+ z_rand: expected more than 0 and at most 1, got 1.2"),
        ((0.0, 0.0, 0.1), r"z_hit \+ z_rand: expected more than 0 and at most 1, got 0"),
        ((0.5, 0.5, 0.0), "sigma_hit: expected a positive number from 1e-12 to 1e\\+09, got 0.0"),
        ((0.5, math.inf, 0.1), "z_rand: expected a finite number, got inf"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(values, message):
    with pytest.raises(InvalidInputError, match=message):
        LikelihoodFieldParameters(*values)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"exponent": 0.0}, "exponent: expected a positive, finite number, got 0.0"),
        ({"n_beams": 0}, "n_beams: expected at least 1 or None, got 0"),
        ({"unknown": "occupied"}, "unknown: expected 'free' or 'uniform', got 'occupied'"),
        ({"interpolation": "cubic"}, "interpolation: expected 'nearest' or 'bilinear', got 'cubic'"),
        ({"off_map": "near"}, "off_map: expected 'continued' or 'far', got 'near'"),
        ({"max_distance": -2.0}, "max_distance: expected a positive, finite number of metres or None, got -2.0"),
        ({"max_distance": 0.04}, "max_distance: expected at least one cell, .* m, or None, got 0.04"),
    ],
)
def test_options_that_make_no_sense_are_refused(options, message):
    with pytest.raises(InvalidInputError, match=message):
        model_of(ROW, **options)


@pytest.mark.oracle
@pytest.mark.parametrize("unknown", ["free", "uniform"])
def test_other_programs_agree(oracle_case, unknown):
    theta = oracle_case.values
    parameters = LikelihoodFieldParameters(theta["z_hit"], theta["z_rand"], theta["sigma_hit"])
    model = model_of(oracle_case.grid, parameters, max_distance=theta["max_occ_dist"], off_map="far", unknown=unknown)
    scan = Scan(oracle_case.ranges, oracle_case.finder)
    book = oracle_case.answers("book")[
        "log_likelihood_field" + ("_unknown_1_over_zmax" if unknown == "uniform" else "")
    ]
    np.testing.assert_allclose(model.log_likelihood(scan, oracle_case.poses), book, atol=1e-6, rtol=0)
