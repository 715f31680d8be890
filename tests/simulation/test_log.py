from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import beams_from_uniforms, sample_beams
from beamfield.sensors import RangeFinder, ScanLog, SensorLog
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.log import simulate_log
from tests.simulation.plans import plan
from tests.threads import forced_threads

MAX_RANGE = 8.0
TRUTH = BeamParameters(z_hit=0.7, z_short=0.15, z_max=0.05, z_rand=0.1, sigma_hit=0.05, lambda_short=0.6)
FINDER = RangeFinder.from_bearings(np.deg2rad(np.linspace(-90, 90, 61)), MAX_RANGE, mount=(0.1, 0.0, 0.0))
DEPENDENCE = Dependence(angle=np.deg2rad(9.0), time=0.5)


def simulate(**options: object) -> ScanLog:
    arguments: dict[str, object] = {"duration": 120.0, "scan_rate": 5.0, "seed": 3} | options
    return simulate_log(plan(1), FINDER, TRUTH, **arguments)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def independent() -> SensorLog:
    return simulate().only_sensor()


@pytest.fixture(scope="module")
def dependent() -> SensorLog:
    return simulate(dependence=DEPENDENCE).only_sensor()


def mixture_cdf(z: np.ndarray, z_star: np.ndarray, p: BeamParameters) -> np.ndarray:
    """P(range <= z) of (6.12) below max_range, written with scipy's distributions alone."""
    sigma = np.hypot(p.sigma_hit, p.sigma_slope * z_star)
    mean = z_star + p.range_offset
    hit = stats.truncnorm(-mean / sigma, (MAX_RANGE - mean) / sigma, loc=mean, scale=sigma)
    short = stats.truncexpon(b=p.lambda_short * z_star, scale=1.0 / p.lambda_short)
    return p.z_hit * hit.cdf(z) + p.z_short * short.cdf(z) + p.z_rand * z / MAX_RANGE


def uniforms(log: SensorLog, p: BeamParameters, rng: np.random.Generator) -> np.ndarray:
    """Randomised probability integral transform of each reading whose ray meets something; (t, k), NaN elsewhere."""
    expected = RayCaster(plan(1)).expected_ranges(log.poses, log.finder)
    returned = mixture_cdf(np.where(np.isinf(log.ranges), 0.0, log.ranges), expected, p)
    missing = 1.0 - p.z_max * rng.random(log.ranges.shape)
    u = np.where(np.isinf(log.ranges), missing, returned)
    u[expected >= MAX_RANGE] = np.nan
    return u


def test_independent_readings_follow_the_mixture(independent: SensorLog, rng: np.random.Generator) -> None:
    u = uniforms(independent, TRUTH, rng)
    assert np.isfinite(u).sum() > 20_000
    assert stats.kstest(u[np.isfinite(u)], "uniform").pvalue > 0.01


def test_the_test_above_notices_wrong_parameters(independent: SensorLog, rng: np.random.Generator) -> None:
    for wrong in ({"sigma_hit": 0.055}, {"lambda_short": 0.2}, {"z_hit": 0.72, "z_rand": 0.08}):
        u = uniforms(independent, replace(TRUTH, **wrong), rng)
        assert stats.kstest(u[np.isfinite(u)], "uniform").pvalue < 0.01


def test_dependent_readings_follow_the_mixture_beam_by_beam(rng: np.random.Generator) -> None:
    log = simulate(duration=900.0, scan_rate=1.0, dependence=Dependence(angle=np.deg2rad(9.0), time=0.05)).only_sensor()
    # At 1 scan per second and a reach of 0.05 s scans are independent; every 20th beam (60 degrees) is, too.
    u = uniforms(log, TRUTH, rng)[:, ::20]
    assert stats.kstest(u[np.isfinite(u)], "uniform").pvalue > 0.01


def test_dependent_readings_keep_the_shares_of_causes(dependent: SensorLog) -> None:
    expected = RayCaster(plan(1)).expected_ranges(dependent.poses, FINDER)
    seen = expected < MAX_RANGE
    assert np.isinf(dependent.ranges)[seen].mean() == pytest.approx(TRUTH.z_max, abs=0.01)
    near = np.abs(dependent.ranges - expected) < 3 * TRUTH.sigma_hit
    # Random and short readings fall near the expected range, too: 0.3 m of 8 m, and some of the exponential.
    assert near[seen].mean() == pytest.approx(TRUTH.z_hit + 0.01, abs=0.03)


def test_wrong_readings_come_in_bursts_only_if_asked(independent: SensorLog, dependent: SensorLog) -> None:
    def resemblance(log: SensorLog) -> float:
        expected = RayCaster(plan(1)).expected_ranges(log.poses, FINDER)
        seen = expected < MAX_RANGE
        wrong = (np.abs(log.ranges - expected) > 0.3) & seen
        return float((wrong[:, :-1] & wrong[:, 1:]).sum() / (wrong[:, :-1] & seen[:, 1:]).sum())

    # Given that a beam is wrong, how often its neighbour is.
    assert resemblance(independent) == pytest.approx(0.27, abs=0.03)
    assert resemblance(dependent) > 0.5


def test_a_beam_that_meets_nothing_does_not_hit(independent: SensorLog, dependent: SensorLog) -> None:
    for log in (independent, dependent):
        nothing = RayCaster(plan(1)).expected_ranges(log.poses, FINDER) >= MAX_RANGE
        assert nothing.sum() > 300
        share = np.isinf(log.ranges[nothing]).mean()
        assert share == pytest.approx(TRUTH.z_hit + TRUTH.z_max, abs=0.08)


def test_range_offset_and_slope_are_simulated(rng: np.random.Generator) -> None:
    shifted = replace(TRUTH, range_offset=0.05, sigma_slope=0.02)
    log = simulate_log(plan(1), FINDER, shifted, duration=60.0, scan_rate=5.0, seed=3).only_sensor()
    u = uniforms(log, shifted, rng)
    assert stats.kstest(u[np.isfinite(u)], "uniform").pvalue > 0.01
    wrong = uniforms(log, TRUTH, rng)
    assert stats.kstest(wrong[np.isfinite(wrong)], "uniform").pvalue < 1e-6


def test_readings_follow_the_conventions_of_a_scan_log(independent: SensorLog) -> None:
    assert len(independent) == 600
    assert not np.isnan(independent.ranges).any()
    assert independent.ranges.min() >= 0.0
    assert independent.ranges[np.isfinite(independent.ranges)].max() < MAX_RANGE
    np.testing.assert_allclose(np.diff(independent.stamps), 0.2)
    assert independent.has_poses
    assert independent.has_odometry


def test_poses_are_the_truth_and_odometry_drifts_away_from_it(independent: SensorLog) -> None:
    travelled = np.hypot(*np.diff(independent.poses[:, :2], axis=0).T).sum()
    assert 60.0 < travelled < 120.0
    np.testing.assert_array_equal(independent.odometry[0], 0.0)
    reported = np.hypot(*np.diff(independent.odometry[:, :2], axis=0).T).sum()
    assert reported == pytest.approx(travelled, rel=0.05)
    # Steps of the odometry resemble the true ones far more than a jump of the reference would.
    true_step = np.hypot(*np.diff(independent.poses[:, :2], axis=0).T)
    odometry_step = np.hypot(*np.diff(independent.odometry[:, :2], axis=0).T)
    assert np.abs(true_step - odometry_step).max() < 0.05


def test_the_same_seed_gives_the_same_log_and_another_seed_another(dependent: SensorLog) -> None:
    with forced_threads(2):
        again = simulate(dependence=DEPENDENCE).only_sensor()
    np.testing.assert_array_equal(again.ranges, dependent.ranges)
    np.testing.assert_array_equal(again.odometry, dependent.odometry)
    other = simulate(seed=4, duration=20.0).only_sensor()
    assert np.abs(other.poses - dependent.poses[:100]).max() > 0.5


def test_the_log_names_its_sensor_and_reports_progress() -> None:
    seen: list[tuple[int, int]] = []
    finder = replace(FINDER, name="/scan")
    log = simulate_log(
        plan(1), finder, TRUTH, duration=60.0, seed=1, progress=lambda done, total: seen.append((done, total))
    )
    assert list(log.sensors) == ["/scan"]
    assert seen[-1] == (600, 600)
    assert log.odometry is not None
    assert len(log.odometry) == 600


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"duration": 0.0}, "duration: expected a positive"),
        ({"scan_rate": np.nan}, "scan_rate: expected a positive"),
        ({"duration": 0.01}, "expected 1 to 1000000 scans, got 0.05"),
        ({"duration": 1e9}, "expected 1 to 1000000 scans"),
        ({"start": np.inf}, "start: expected a finite"),
    ],
)
def test_impossible_durations_are_refused(options: dict[str, float], message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        simulate(**options)


def test_a_map_without_obstacles_is_refused() -> None:
    empty = OccupancyGrid(np.zeros((100, 100)), 0.1)
    with pytest.raises(InvalidInputError, match="no occupied cell"):
        simulate_log(empty, FINDER, TRUTH, duration=5.0)


def test_beams_from_uniforms_inverts_each_cause_at_the_given_numbers() -> None:
    p = BeamParameters(z_hit=0.5, z_short=0.2, z_max=0.1, z_rand=0.2, sigma_hit=0.1, lambda_short=0.0)
    causes = [0.25, 0.6, 0.75, 0.9]
    ranges = beams_from_uniforms(causes, [0.5, 0.25, 0.5, 0.75], [4.0, 4.0, 4.0, 4.0], 8.0, p)
    assert ranges == pytest.approx([4.0, 1.0, 8.0, 6.0])


def test_beams_from_uniforms_refuses_other_shapes() -> None:
    with pytest.raises(InvalidInputError, match="uniforms: expected shape"):
        beams_from_uniforms([0.5], [0.5, 0.5], [1.0, 1.0], 8.0, TRUTH)


def test_sampling_and_inverting_uniforms_are_the_same_thing() -> None:
    expected = np.linspace(0.1, 7.9, 500)
    rng = np.random.default_rng(3)
    causes, places = rng.random(500), rng.random(500)
    sampled = sample_beams(expected, MAX_RANGE, TRUTH, np.random.default_rng(3))
    np.testing.assert_array_equal(sampled, beams_from_uniforms(causes, places, expected, MAX_RANGE, TRUTH))
