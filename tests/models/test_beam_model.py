"""BeamModel over a map: hand-derived numbers, other programs' numbers, options, bounded memory."""

from __future__ import annotations

import math
import pickle
import tracemalloc

import numpy as np
import pytest
from scipy import stats

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.range_table import RangeTable
from beamfield.maps.raycast import RayCaster
from beamfield.models import range_mixture
from beamfield.models.beam import BeamModel
from beamfield.models.beam_density import beam_log_density
from beamfield.models.beam_parameters import BeamParameters, SavedBeamModel
from beamfield.sensors import RangeFinder, Scan
from tests.reference.beam_tables import beam_range_finder_model, expected_range_by_small_steps

PARAMETERS = BeamParameters(z_hit=0.6, z_short=0.2, z_max=0.1, z_rand=0.1, sigma_hit=0.1, lambda_short=0.5)
MAX_RANGE = 8.0
# A corridor along x, one cell of 1 m wide walls at y in [0, 1) and [4, 5); open at both ends.
CORRIDOR = np.zeros((5, 10))
CORRIDOR[[0, 4]] = 100


@pytest.fixture(scope="module")
def grid():
    return OccupancyGrid.from_ros(CORRIDOR, 1.0)


def finder(*bearings_deg, **limits):
    return RangeFinder.from_bearings(np.deg2rad(bearings_deg), MAX_RANGE, **limits)


def test_one_scan_by_hand(grid):
    """At (5, 2.5) facing +x: left wall 1.5 m, right wall 1.5 m, ahead nothing (z* = 8)."""
    model = BeamModel(grid, PARAMETERS)
    scan = Scan([1.6, 1.0, np.inf], finder(90, -90, 0))
    np.testing.assert_allclose(model.expected([5.0, 2.5, 0.0], scan.finder), [1.5, 1.5, 8.0], atol=1e-9)
    # 1.6: one sigma beyond the wall, too long for short. 1.0: five sigma before it, so short explains it. inf: z_max.
    first = 0.6 * math.exp(-0.5) / (0.1 * math.sqrt(2 * math.pi)) + 0.1 / 8
    second = (
        0.6 * math.exp(-12.5) / (0.1 * math.sqrt(2 * math.pi))
        + 0.2 * 0.5 * math.exp(-0.5) / (1 - math.exp(-0.75))
        + 0.1 / 8
    )
    expected = [math.log(first), math.log(second), math.log(0.1)]
    np.testing.assert_allclose(model.beam_log_likelihood(scan, [5.0, 2.5, 0.0]), expected, atol=1e-8)
    assert float(model.log_likelihood(scan, [5.0, 2.5, 0.0])) == pytest.approx(sum(expected), abs=1e-8)
    causes = model.responsibilities(scan, [5.0, 2.5, 0.0])
    assert causes.argmax(axis=-1).tolist() == [0, 1, 2]
    assert causes.sum(axis=-1) == pytest.approx(1.0)


def test_agrees_with_table_6_1_written_out(rng):
    occupied = rng.random((20, 20)) < 0.1
    grid = OccupancyGrid.from_ros(np.where(occupied, 100, 0), 0.25)
    sensor = finder(*range(-170, 180, 120))
    pose = np.array([2.51, 2.33, 0.4])
    z_star = [expected_range_by_small_steps(occupied, 0.25, pose, b, MAX_RANGE, 1e-5) for b in sensor.bearings]
    ranges = np.minimum(np.array(z_star) + rng.normal(0.0, 0.1, len(z_star)), 7.9).clip(0.0)
    theta = (*PARAMETERS.weights, PARAMETERS.sigma_hit, PARAMETERS.lambda_short)
    q = beam_range_finder_model(ranges, z_star, theta, MAX_RANGE)
    # Steps of 1e-5 m change each beam by up to 1e-5 / sigma times its residual in sigma.
    value = BeamModel(grid, PARAMETERS).log_likelihood(Scan(ranges, sensor), pose)
    assert float(value) == pytest.approx(math.log(q), abs=3e-3)


@pytest.mark.oracle
def test_end_to_end_other_programs_agree(oracle_case):
    """The caster promises ranges to 1e-9 cells; a range's error times the slope of the log density bounds a beam's."""
    sensor, poses, ranges = oracle_case.finder, oracle_case.poses, oracle_case.ranges
    book, model = (
        oracle_case.answers("book"),
        BeamModel(oracle_case.grid, oracle_case.beam_parameters, unknown="occupied"),
    )
    expected = model.expected(poses, sensor)
    np.testing.assert_allclose(expected.ravel(), book["ranges_PxK"], atol=1e-8, rtol=0)
    per_beam = model.beam_log_likelihood(Scan(ranges, sensor), poses)
    np.testing.assert_allclose(per_beam.ravel(), book["log_beam_PxK"], atol=1e-6, rtol=0)
    np.testing.assert_allclose(model.log_likelihood(Scan(ranges, sensor), poses), book["log_beam"], atol=1e-6, rtol=0)


def test_a_saved_model_brings_its_exponent_and_beams(grid):
    saved = SavedBeamModel(
        *PARAMETERS.weights, PARAMETERS.sigma_hit, PARAMETERS.lambda_short, PARAMETERS.range_offset,
        PARAMETERS.sigma_slope, exponent=0.05, single_scan_exponent=0.2, n_beams=3, max_range=8.0,
    )  # fmt: skip
    model = BeamModel(grid, saved)
    assert (model.exponent, model.n_beams, model.parameters) == (0.05, 3, PARAMETERS)
    assert not model.is_normalized
    single = BeamModel(grid, saved, exponent=saved.single_scan_exponent, n_beams=2)
    assert (single.exponent, single.n_beams) == (0.2, 2)


def test_thinning_counts_beams_with_a_measurement_only(grid):
    """Ten of twenty beams are NaN or too close; five of the other ten are used, evenly, first and last among them."""
    sensor = finder(*np.linspace(-80, 80, 20), min_range=0.2)
    ranges = np.full(20, 1.5)
    ranges[::2] = [np.nan, 0.1] * 5
    each = BeamModel(grid, PARAMETERS, n_beams=5).beam_log_likelihood(Scan(ranges, sensor), [5.0, 2.5, 0.0])
    assert np.flatnonzero(each).tolist() == [1, 5, 9, 15, 19]


def test_thinning_to_more_beams_than_there_are_uses_all(grid):
    scan, pose = Scan([1.4, np.nan, 1.0], finder(90, 0, -90)), [5.0, 2.5, 0.1]
    all_beams = BeamModel(grid, PARAMETERS).log_likelihood(scan, pose)
    assert BeamModel(grid, PARAMETERS, n_beams=2).log_likelihood(scan, pose) == all_beams
    assert BeamModel(grid, PARAMETERS, n_beams=1).log_likelihood(scan, pose) != all_beams


def test_readings_that_are_no_measurement_change_nothing(grid):
    pose, model = [5.0, 2.5, 0.1], BeamModel(grid, PARAMETERS)
    with_gaps = Scan([np.nan, 1.4, 0.05, 1.0, -np.inf], finder(10, 90, 30, -90, 40, min_range=0.1))
    without = Scan([1.4, 1.0], finder(90, -90, min_range=0.1))
    assert model.log_likelihood(with_gaps, pose) == model.log_likelihood(without, pose)
    assert (model.responsibilities(with_gaps, pose)[[0, 2, 4]] == 0.0).all()


def test_every_reading_from_max_range_on_is_the_same_measurement(grid):
    model, sensor = BeamModel(grid, PARAMETERS), finder(90)
    values = [float(model.log_likelihood(Scan([z], sensor), [5.0, 2.5, 0.0])) for z in (8.0, 8.1, 1e9, np.inf)]
    assert values == [math.log(0.1)] * 4


def test_defined_inside_walls_and_off_the_map(grid):
    model, sensor = BeamModel(grid, PARAMETERS), finder(90, 0)
    in_wall, far_off = [5.0, 0.5, 0.0], [500.0, 500.0, 0.0]
    assert model.expected([in_wall, far_off], sensor).tolist() == [[0.0, 0.0], [MAX_RANGE, MAX_RANGE]]
    values = model.log_likelihood(Scan([1.0, 2.0], sensor), [in_wall, far_off])
    # In the wall, both readings are too long for hit and short; off the map, short or random.
    assert values[0] == pytest.approx(2 * math.log(0.1 / 8), rel=1e-12)
    short = [0.2 * 0.5 * math.exp(-0.5 * z) / (1 - math.exp(-4.0)) + 0.1 / 8 for z in (1.0, 2.0)]
    assert values[1] == pytest.approx(math.log(short[0]) + math.log(short[1]), rel=1e-9)


def test_each_beam_starts_at_its_own_mount(grid):
    """Two beams to the left, one mounted 0.4 m to the left of the robot's centre."""
    sensor = RangeFinder(np.array([[0.0, 0.0, np.pi / 2], [0.0, 0.4, np.pi / 2]]), MAX_RANGE)
    model = BeamModel(grid, PARAMETERS)
    np.testing.assert_allclose(model.expected([5.0, 2.5, 0.0], sensor), [1.5, 1.1], atol=1e-9)
    scan = Scan([1.45, 1.15], sensor)
    given = beam_log_density(scan.ranges, [1.5, 1.1], MAX_RANGE, PARAMETERS).sum()
    assert float(model.log_likelihood(scan, [5.0, 2.5, 0.0])) == pytest.approx(given, abs=1e-7)


def test_unknown_cells_stop_rays_only_if_asked():
    values = CORRIDOR.copy()
    values[:, 7] = -1
    unknown = OccupancyGrid.from_ros(values, 1.0)
    sensor, pose = finder(0, 90), [5.5, 2.5, 0.0]
    np.testing.assert_allclose(BeamModel(unknown, PARAMETERS).expected(pose, sensor), [8.0, 1.5])
    np.testing.assert_allclose(BeamModel(unknown, PARAMETERS, unknown="occupied").expected(pose, sensor), [1.5, 1.5])


def test_chunks_change_no_bit(grid, rng, monkeypatch):
    sensor = finder(*range(-90, 91, 10))
    model = BeamModel(grid, PARAMETERS)
    scan = model.sample([5.0, 2.5, 0.1], sensor, rng)[0]
    poses = rng.uniform([0, 1, -3], [10, 4, 3], (1000, 3))
    whole = model.log_likelihood(scan, poses)
    monkeypatch.setattr(range_mixture, "RAYS_PER_CHUNK", 300)
    assert (model.log_likelihood(scan, poses) == whole).all()


def test_many_poses_take_little_memory(grid, rng):
    """20,000 poses x 180 beams would be 29 MB of expected ranges alone."""
    sensor = finder(*np.linspace(-90, 90, 180))
    model = BeamModel(grid, PARAMETERS)
    scan = model.sample([5.0, 2.5, 0.1], sensor, rng)[0]
    poses = rng.uniform([0, 1, -3], [10, 4, 3], (20_000, 3))
    model.log_likelihood(scan, poses)  # compiled before memory is traced
    tracemalloc.start()
    values = model.log_likelihood(scan, poses)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert values.shape == (20_000,)
    assert np.isfinite(values).all()
    assert peak < 20e6


def test_samples_are_scans_of_the_sensor_around_the_expected_ranges(grid, rng):
    sensor = finder(90, -90)
    model = BeamModel(grid, BeamParameters(1.0, 0.0, 0.0, 0.0, 0.1, 0.5), finder=sensor)
    scans = model.sample(np.tile([5.0, 2.5, 0.0], (2000, 1)), rng=rng)
    assert all(scan.finder is sensor for scan in scans)
    ranges = np.array([scan.ranges for scan in scans]).ravel()
    assert stats.kstest(ranges, stats.norm(1.5, 0.1).cdf).pvalue > 1e-3


def test_sampling_without_a_sensor_is_an_error(grid, rng):
    with pytest.raises(InvalidInputError, match="finder: expected a RangeFinder"):
        BeamModel(grid, PARAMETERS).sample([[5.0, 2.5, 0.0]], rng=rng)


def test_other_parameters_on_the_same_tables(grid):
    first = BeamModel(grid, PARAMETERS, exponent=0.5)
    other = BeamParameters(0.7, 0.1, 0.1, 0.1, 0.2, 0.0)
    second = first.with_parameters(other)
    scan, pose = Scan([1.4, 1.0], finder(90, -90)), [5.0, 2.5, 0.1]
    assert second.log_likelihood(scan, pose) == BeamModel(grid, other, exponent=0.5).log_likelihood(scan, pose)
    assert first.parameters is PARAMETERS


def test_a_pickle_holds_the_map_but_not_the_tables():
    """Tables take four bytes per cell on top of the map's four; they are rebuilt."""
    large = OccupancyGrid.from_ros(np.zeros((500, 500)), 0.1)
    assert len(pickle.dumps(BeamModel(large, PARAMETERS))) < 500 * 500 * 4 + 5000


@pytest.mark.parametrize(
    ("options", "message"),
    [
        *(({"exponent": x}, "exponent: expected a positive, finite number") for x in (0.0, -1.0, np.inf, np.nan)),
        ({"n_beams": 0}, "n_beams: expected at least 1 or None, got 0"),
        ({"unknown": "maybe"}, "unknown: expected 'free' or 'occupied', got 'maybe'"),
    ],
)
def test_options_that_make_no_sense_are_refused(grid, options, message):
    with pytest.raises(InvalidInputError, match=message):
        BeamModel(grid, PARAMETERS, **options)


def test_expected_ranges_come_from_the_caster_that_is_given(rng):
    """A table's are a little off, which shows in the likelihood; a caster of another map is refused."""
    cells = np.where(rng.random((20, 20)) < 0.1, 100, 0)
    grid = OccupancyGrid.from_ros(cells, 0.25)
    sensor = finder(*range(-170, 180, 31))
    scan = Scan(np.linspace(0.3, 3.0, sensor.n_beams), sensor)
    poses = np.column_stack([rng.uniform(0.0, 5.0, (50, 2)), rng.uniform(-3.0, 3.0, 50)])
    table, usual = RangeTable.build(grid, headings=45), BeamModel(grid, PARAMETERS)
    model = BeamModel(OccupancyGrid.from_ros(cells, 0.25), PARAMETERS, caster=table)
    z_star = table.expected_ranges(poses, sensor)
    assert (z_star != usual.expected(poses, sensor)).mean() > 0.3
    expected = beam_log_density(scan.ranges, z_star, MAX_RANGE, PARAMETERS).sum(axis=-1)
    np.testing.assert_allclose(model.log_likelihood(scan, poses), expected, rtol=1e-6)
    again = pickle.loads(pickle.dumps(model)).with_parameters(PARAMETERS)
    np.testing.assert_array_equal(again.log_likelihood(scan, poses), model.log_likelihood(scan, poses))
    shared = BeamModel(grid, PARAMETERS, caster=RayCaster(grid))
    np.testing.assert_array_equal(shared.log_likelihood(scan, poses), usual.log_likelihood(scan, poses))
    for other in (
        OccupancyGrid.from_ros(cells.T, 0.25),
        OccupancyGrid.from_ros(cells, 0.25, (0.1, 0.0, 0.0)),
        OccupancyGrid.from_ros(np.where(cells == 100, 100, -1), 0.25),
    ):
        with pytest.raises(InvalidInputError, match="caster: expected one of the model's grid, got one of another map"):
            BeamModel(other, PARAMETERS, caster=table)
    with pytest.raises(InvalidInputError, match="caster: expected unknown='occupied', got 'free'"):
        BeamModel(grid, PARAMETERS, unknown="occupied", caster=table)
    with pytest.raises(InvalidInputError, match="caster"):
        BeamModel(grid, PARAMETERS, caster=grid)
