"""Learning from sensors that measure nothing below min_range, near walls: what was drawn comes back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.calibration.beam_table import BeamTable, build_beam_table
from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.calibration.evaluation import likely_causes, pit_deviation, randomized_pit, score_models, timeline
from beamfield.calibration.intrinsic.block_intervals import block_intervals
from beamfield.calibration.intrinsic.climb import climb
from beamfield.calibration.intrinsic.curvature import naive_covariance
from beamfield.calibration.intrinsic.em import learn_intrinsic_parameters
from beamfield.calibration.intrinsic.known_causes import learn_from_known_causes
from beamfield.calibration.intrinsic.learning_problem import learning_problem
from beamfield.calibration.intrinsic.likelihood import IntrinsicLikelihood, theta_of
from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_density import beam_log_density
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams
from beamfield.models.sonar import SonarModel
from beamfield.scan_fit.surprise import beam_surprise
from beamfield.sensors import RangeFinder, SensorLog

TRUTH = BeamParameters(0.62, 0.2, 0.08, 0.1, 0.08, 1.5)
SLOPED = BeamParameters(0.62, 0.2, 0.08, 0.1, 0.04, 1.5, 0.05, 0.06)
LEARNED = ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short")
LASER = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 30, endpoint=False), 5.0, name="laser")
RING = replace(LASER.subset(np.arange(0, 30, 2)), opening_angle=np.radians(25.0), name="ring")
MIN_RANGES = (0.0, 0.1, 0.3)


def corridor() -> OccupancyGrid:
    """Return a corridor of 6 m x 1.2 m: most walls are less than a metre away, many in the blind zone."""
    return OccupancyGrid.from_ros(np.pad(np.zeros((24, 120), int), 1, constant_values=100), 0.05)


def drawn_log(finder: RangeFinder, truth: BeamParameters, n_scans: int, seed: int = 3) -> SensorLog:
    rng = np.random.default_rng(seed)
    poses = rng.uniform([0.1, 0.15, -3.0], [6.0, 1.15, 3.0], (n_scans, 3))
    kind = SonarModel if finder.opening_angle > 0.0 else BeamModel
    scans = kind(corridor(), truth, finder=finder).sample(poses, rng=rng)
    ranges = np.array([scan.ranges for scan in scans])
    return SensorLog(finder, 5.0 * np.arange(n_scans), ranges, poses, np.full((n_scans, 3), np.nan))


def drawn_table(finder: RangeFinder, truth: BeamParameters, n_scans: int) -> BeamTable:
    return build_beam_table(drawn_log(finder, truth, n_scans, 3), corridor(), np.arange(n_scans))


def assert_never_falls(trace: tuple[float, ...]) -> None:
    assert np.all(np.diff(trace) >= -1e-9 * np.abs(trace[:-1]))


@pytest.mark.parametrize("low", MIN_RANGES)
@pytest.mark.parametrize("truth", [TRUTH, SLOPED], ids=["chapter", "offset and slope"])
@pytest.mark.parametrize("finder", [LASER, RING], ids=["laser", "sonars"])
def test_what_was_drawn_comes_back_within_its_standard_errors(finder, truth, low):
    table = drawn_table(replace(finder, min_range=low), truth, 800 if finder is LASER else 1300)
    assert table.min_range == low
    assert table.n_no_measurement == 0  # nothing is drawn in the blind zone
    assert table.ranges.min() >= low
    assert (table.expected_ranges < 0.3).mean() > 0.05
    options = {"min_range": low, "fit_offset": truth is SLOPED, "fit_sigma_slope": truth is SLOPED}
    result = learn_intrinsic_parameters(table.ranges, table.expected_ranges, table.max_range, **options)
    assert result.converged
    assert_never_falls(result.trace)
    problem = learning_problem(table.max_range, **options)
    used = ~table.hits_nothing
    likelihood = IntrinsicLikelihood(table.ranges[used], table.expected_ranges[used], table.max_range, min_range=low)
    got, want = theta_of(result.parameters), theta_of(truth)
    errors = np.sqrt(np.diag(naive_covariance(likelihood, problem, want)))
    assert np.all(np.abs(got - want) <= 4.0 * errors + 1e-12)
    at = {p: beam_log_density(table.ranges[used], table.expected_ranges[used], 5.0, p, min_range=low).mean()
          for p in (result.parameters, truth)}  # fmt: skip
    assert result.log_likelihood == pytest.approx(at[result.parameters], rel=1e-12)
    assert result.log_likelihood >= at[truth]


@pytest.mark.parametrize("finder", [LASER, RING], ids=["laser", "sonars"])
def test_the_intervals_of_a_calibration_hold_the_truth(finder):
    missed = 0
    for low in MIN_RANGES:
        log = drawn_log(replace(finder, min_range=low), TRUTH, 700)
        result = calibrate(log, corridor(), CalibrationOptions(refine=False))
        assert result.table.min_range == low
        assert result.candidates[0].chosen  # the truth has neither offset nor slope
        assert result.pit_deviation < 0.025
        missed += sum(
            not bounds[0] <= getattr(TRUTH, name) <= bounds[1] for name, bounds in result.intervals.intervals.items()
        )
    # One of 18 is expected.
    assert missed <= 3


def test_without_min_range_shorts_would_be_learned_too_few_and_too_far():
    table = drawn_table(replace(LASER, min_range=0.3), TRUTH, 1500)
    beams = table.ranges, table.expected_ranges, table.max_range
    with_limit = learn_intrinsic_parameters(*beams, min_range=0.3).parameters
    without = learn_intrinsic_parameters(*beams).parameters
    assert without.z_short < TRUTH.z_short - 0.03
    assert without.lambda_short < TRUTH.lambda_short - 0.3
    assert with_limit.z_short == pytest.approx(TRUTH.z_short, abs=0.02)
    assert with_limit.lambda_short == pytest.approx(TRUTH.lambda_short, abs=0.3)


@pytest.mark.parametrize("truth", [TRUTH, SLOPED], ids=["chapter", "offset and slope"])
def test_every_step_climbs_and_plain_em_ends_in_the_same_place(truth):
    table = drawn_table(replace(LASER, min_range=0.3), truth, 120)
    used = ~table.hits_nothing
    likelihood = IntrinsicLikelihood(table.ranges[used], table.expected_ranges[used], 5.0, min_range=0.3)
    problem = learning_problem(5.0, min_range=0.3, fit_offset=truth is SLOPED, fit_sigma_slope=truth is SLOPED)
    ends = []
    for start in ([0.3, 0.5, 0.1, 0.1, 0.2, 0.01, 0.1, 5.0], [0.7, 0.1, 0.1, 0.1, 1e-4, 0.0, -0.02, 0.3]):
        for accelerate, most in ((True, 300), (False, 3000)):
            end = climb(
                likelihood, problem, np.array(start), tolerance=1e-10, max_iterations=most, accelerate=accelerate
            )
            assert_never_falls(end.trace)
            ends.append(end.objective)
    assert np.ptp(ends) < 1e-7


def test_the_derivatives_are_those_of_the_density():
    table = drawn_table(replace(LASER, min_range=0.3), SLOPED, 40)
    used = ~table.hits_nothing
    z, expected = table.ranges[used], table.expected_ranges[used]
    likelihood = IntrinsicLikelihood(z, expected, 5.0, min_range=0.3)
    theta = theta_of(SLOPED)
    value, gradient, hessian = likelihood.derivatives(theta)
    assert value == pytest.approx(beam_log_density(z, expected, 5.0, SLOPED, min_range=0.3).sum(), rel=1e-12)
    assert value == pytest.approx(likelihood.expected_statistics(theta).log_likelihood, rel=1e-12)
    for i in range(8):
        step = np.zeros(8)
        step[i] = 1e-5 * theta[i]
        above, below = likelihood.derivatives(theta + step), likelihood.derivatives(theta - step)
        assert gradient[i] == pytest.approx((above[0] - below[0]) / (2 * step[i]), rel=1e-5, abs=1e-3)
        assert hessian[i] == pytest.approx((above[1] - below[1]) / (2 * step[i]), rel=1e-4, abs=0.05)


def test_known_causes_are_learned_in_ranges_from_min_range_on():
    rng, low = np.random.default_rng(1), 0.3
    expected = rng.uniform(0.0, 4.9, 60_000)
    cause = rng.choice(4, expected.size, p=TRUTH.weights)
    z = np.empty(expected.size)
    for number, weights in enumerate(np.eye(4)):
        alone = BeamParameters(*weights, TRUTH.sigma_hit, TRUTH.lambda_short)
        z[cause == number] = sample_beams(expected[cause == number], 5.0, alone, rng, min_range=low)
    got = learn_from_known_causes(z, expected, cause, 5.0, min_range=low)
    assert got.sigma_hit == pytest.approx(TRUTH.sigma_hit, rel=0.02)
    assert got.lambda_short == pytest.approx(TRUTH.lambda_short, rel=0.06)


def test_intervals_surround_what_was_learned():
    table = drawn_table(replace(RING, min_range=0.3), SLOPED, 600)
    beams = table.ranges, table.expected_ranges
    options = {"min_range": 0.3, "fit_offset": True, "fit_sigma_slope": True}
    fit = learn_intrinsic_parameters(*beams, 5.0, **options).parameters
    result = block_intervals(*beams, table.stamps, 5.0, fit, **options)
    assert len(result.intervals) == 8
    for name, (low, high) in result.intervals.items():
        assert low < getattr(fit, name) < high


def test_scores_transform_causes_and_timeline_take_the_tables_min_range():
    table = drawn_table(replace(LASER, min_range=0.3), TRUTH, 400)
    used = table.select(~table.hits_nothing)
    assert used.min_range == 0.3
    want = beam_log_density(used.ranges, used.expected_ranges, 5.0, TRUTH, min_range=0.3)
    blocks = np.arange(len(table)) % 7
    score = score_models({"truth": TRUTH}, table, blocks)[0]
    assert score.log_likelihood == pytest.approx(want.mean(), rel=1e-12)
    shown = timeline(table, TRUTH, np.zeros(len(table), bool))
    assert shown.log_likelihood @ np.bincount(used.scan) == pytest.approx(want.sum(), rel=1e-12)
    assert pit_deviation(randomized_pit(table, TRUTH, np.random.default_rng(0))) < 0.015
    wrong = pit_deviation(randomized_pit(replace(table, min_range=0.0), TRUTH, np.random.default_rng(0)))
    assert wrong > 0.05
    assert np.bincount(likely_causes(used, TRUTH), minlength=4)[2] == (used.ranges == 5.0).sum()


def test_the_surprise_of_the_models_own_readings_is_0_on_average():
    table = drawn_table(replace(LASER, min_range=0.3), SLOPED, 1500)
    got = beam_surprise(table.ranges, table.expected_ranges, 5.0, SLOPED, min_range=0.3)
    near = table.expected_ranges < 0.5
    for rows in (near, ~near & ~table.hits_nothing):
        for values in (got.excess, got.through, got.short):
            part = values[rows]
            assert abs(part.mean()) <= 4.0 * part.std() / np.sqrt(part.size)


def test_a_reading_below_min_range_is_refused_by_its_index():
    expected = np.full(30, 1.0)
    z = np.where(np.arange(30) == 4, 0.2, 1.0)
    with pytest.raises(InvalidInputError, match=r"ranges\[4\].*0\.3"):
        learn_intrinsic_parameters(z, expected, 5.0, min_range=0.3)
    with pytest.raises(InvalidInputError, match=r"ranges\[4\].*0\.3"):
        block_intervals(z, expected, np.arange(30.0), 5.0, TRUTH, min_range=0.3)
    with pytest.raises(InvalidInputError, match="min_range"):
        learn_intrinsic_parameters(expected, expected, 5.0, min_range=5.0)
    with pytest.raises(InvalidInputError, match="beam 4"):
        learn_from_known_causes(z, expected, ["hit"] * 30, 5.0, min_range=0.3)
