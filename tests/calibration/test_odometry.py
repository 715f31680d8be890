"""Odometry calibrated against poses: known noise and known errors come back, faults are found, bad input is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import approx_fprime
from scipy.stats import multivariate_normal

from beamfield.calibration.odometry.findings import odometry_findings
from beamfield.calibration.odometry.learning import calibrate_odometry, learn_systematic_errors
from beamfield.calibration.odometry.noise_family import DIFFERENTIAL, GAUSSIAN, OMNI
from beamfield.calibration.odometry.noise_fit import fit_levels
from beamfield.calibration.odometry.result import Estimate, OdometryCalibration, OdometryOptions
from beamfield.calibration.odometry.windows import cut_odometry_windows, update_scans
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.finding import Finding
from beamfield.geometry import FloatArray, between, compose
from beamfield.kernels.window_noise import negative_log_likelihood
from beamfield.models.differential_motion import DifferentialMotion
from beamfield.models.gaussian_motion import USUAL_MOTION
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.odometry import OdometryNoise, noisy_odometry
from beamfield.stacks.registry import STACKS

EVERY_SCAN = OdometryOptions(update_min_d=0.0, update_min_a=0.0, reference_error=0.02)
LASER = RangeFinder.from_bearings([0.0], max_range=8.0)


def drive(rng: np.random.Generator, n: int) -> FloatArray:
    turns = rng.choice([0.0, 0.0, 1.0], n) * rng.normal(0.0, 0.4, n)
    return np.column_stack([rng.uniform(0.24, 0.3, n), np.zeros(n), turns])


def chained(steps: FloatArray) -> FloatArray:
    poses = [np.zeros(3)]
    for step in steps:
        poses.append(compose(poses[-1], step))
    return np.array(poses)


def log_of(poses: FloatArray, odometry: FloatArray, rng: np.random.Generator | None = None) -> SensorLog:
    if rng is not None:
        poses = poses + np.array([0.02, 0.02, 0.005]) * rng.standard_normal(poses.shape)
    return SensorLog(LASER, np.arange(len(poses), dtype=float), np.ones((len(poses), 1)), poses, odometry)


def amcl_log(alphas: tuple[float, ...], seed: int, n: int = 250) -> SensorLog:
    rng = np.random.default_rng(seed)
    odometry, poses, model = chained(drive(rng, n)), [np.zeros(3)], DifferentialMotion(*alphas)
    for i in range(n):
        poses.append(model.sample(poses[-1][None], odometry[i : i + 2], rng)[0])
    return log_of(np.array(poses), odometry, rng)


@pytest.fixture(scope="module")
def common() -> OdometryCalibration:
    return calibrate_odometry(amcl_log((0.03,) * 4, 1), EVERY_SCAN)


def test_one_known_alpha_comes_back_and_one_is_enough(common):
    alpha = common.candidates[1].levels[0]
    assert alpha.low < 0.03 < alpha.high < 2.0 * alpha.low
    assert common.chosen.name == "one alpha"
    assert common.alphas == DifferentialMotion(alpha.value, alpha.value, alpha.value, alpha.value)
    assert common.chosen.gain > 3.0 * common.chosen.gain_se  # over nav2's 0.2
    assert 0.9 < common.coverage < 0.99
    assert len(common.fault_stamps) == 0
    assert [finding.name for finding in common.findings if finding.severity == "warning"] == []
    assert common.by_length[-2][1] == pytest.approx(alpha.value, rel=0.01)


def test_four_different_alphas_come_back_within_their_intervals():
    result = calibrate_odometry(amcl_log((0.2, 0.01, 0.03, 0.03), 2), EVERY_SCAN)
    assert result.chosen.name == "four alphas"
    for level, truth in zip(result.chosen.levels[:3], (0.2, 0.01, 0.03), strict=True):
        assert level.low < truth < level.high < 30.0 * level.low
    assert result.alphas.alpha2 == 0.02  # the floor
    assert result.alphas.alpha1 > 0.1
    assert "odometry-floor" in {finding.name for finding in result.findings}


def test_scales_of_simulated_wheels_come_back():
    rng = np.random.default_rng(3)
    poses = chained(drive(rng, 160))
    log = log_of(poses, noisy_odometry(poses, rng, OdometryNoise(distance_scale=0.02, turn_scale=-0.04)), rng)
    result = calibrate_odometry(log, EVERY_SCAN)
    for name, truth in (("distance_scale", 1 / 1.02 - 1), ("turn_scale", 1 / 0.96 - 1), ("drift", 0.0), ("yaw", 0.0)):
        error = result.systematic[name]
        assert error.low < truth < error.high < error.low + 0.05
    names = {finding.name for finding in result.findings}
    assert {"odometry-distance-scale", "odometry-turn-scale"} <= names
    assert result.corrected_alpha < result.candidates[1].levels[0].value
    assert "odometry-drift" not in names


@pytest.mark.parametrize(
    ("name", "error"),
    [("distance_scale", [0.01, 0, 0]), ("turn_scale", [0, 0.01, 0]), ("drift", [0, 0, 0.01]), ("yaw", None)],
)
def test_each_systematic_error_has_the_sign_and_size_of_its_definition(name, error):
    steps = drive(np.random.default_rng(4), 70)
    steps[::7, 0] *= -1.0  # backwards, too
    true = steps.copy()
    if error is None:
        cos, sin = np.cos(0.01), np.sin(0.01)
        true[:, 0], true[:, 1] = cos * steps[:, 0] - sin * steps[:, 1], sin * steps[:, 0] + cos * steps[:, 1]
    else:
        scale, turn_scale, drift = error
        true[:, :2] *= 1.0 + scale
        true[:, 2] += turn_scale * steps[:, 2] + drift * steps[:, 0]
    result = calibrate_odometry(log_of(chained(true), chained(steps)), EVERY_SCAN)
    for key, estimate in result.systematic.items():
        assert estimate.value == pytest.approx(0.01 if key == name else 0.0, abs=1e-3), key


def test_noise_of_the_heading_which_shortens_paths_is_no_scale_of_distances():
    logs = [amcl_log((0.05,) * 4, seed, n=400) for seed in range(12)]
    scales = [learn_systematic_errors(log, covariances=None).errors["distance_scale"].value for log in logs]
    assert np.mean(scales) == pytest.approx(0.0, abs=0.013)


def test_what_a_drive_does_not_show_is_left_out():
    straight = np.tile([0.3, 0.0, 0.0], (80, 1))
    result = calibrate_odometry(log_of(chained(straight), chained(straight)), EVERY_SCAN)
    assert set(result.systematic) == {"distance_scale", "drift", "yaw"}
    assert "odometry-is-reference" in {finding.name for finding in result.findings}
    assert "not shown by this drive" in result.summary()
    # Rotation from rotation, and the other three, which the reference's error hides.
    assert [(level.value, level.high) for level in result.candidates[3].levels] == [(0.0, np.inf)] * 4


def test_noise_of_the_heading_on_a_straight_drive_is_no_scale_of_turns():
    rng = np.random.default_rng(6)
    straight = chained(np.tile([0.3, 0.0, 0.0], (160, 1)))
    odometry = noisy_odometry(straight, rng, OdometryNoise(distance_scale=0.0, turn_scale=0.0))
    result = calibrate_odometry(log_of(straight, odometry), EVERY_SCAN)
    assert "turn_scale" not in result.systematic
    assert "odometry-turn-scale" not in {finding.name for finding in result.findings}
    assert {"distance_scale", "drift"} <= set(result.systematic)


def test_a_missed_turn_is_a_fault_and_not_noise(common):
    log = amcl_log((0.03,) * 4, 1)
    steps = between(log.poses[:-1], log.poses[1:])
    steps[120, 2] += 1.4
    result = calibrate_odometry(replace(log, poses=chained(steps)), EVERY_SCAN)
    faults = [finding for finding in result.findings if finding.name == "odometry-faults"]
    assert faults[0].values["n_turns"] >= 7
    assert 113 <= result.fault_stamps[0] <= 120
    assert result.candidates[1].levels[0].value == pytest.approx(common.candidates[1].levels[0].value, rel=0.15)


def test_odometry_that_loses_its_sign_backwards_is_named():
    steps = drive(np.random.default_rng(5), 100)
    steps[60:80, 0] *= -1.0
    wrong = steps.copy()
    wrong[60:80, 0] *= -1.0
    result = calibrate_odometry(log_of(chained(steps), chained(wrong)), EVERY_SCAN)
    sign = next(finding for finding in result.findings if finding.name == "odometry-sign")
    assert (sign.values["n_lost"], sign.values["n_backwards"], sign.values["first_s"]) == (20.0, 20.0, 60.0)


def sign_log(shown: FloatArray, driven: FloatArray) -> SensorLog:
    """Return a log whose reference and odometry move by so many metres, (n,), in steps of a second."""
    poses, odometry = (
        np.cumsum(np.pad(np.array(steps)[:, None], ((1, 0), (0, 2))), axis=0) for steps in (shown, driven)
    )
    log = log_of(poses, odometry)
    return replace(log, stamps=log.stamps + 500.0)


@pytest.mark.parametrize(
    ("n_lost", "n_right", "step", "found"),
    [(5, 20, 0.05, True), (5, 20, 0.035, False), (4, 0, 0.05, False), (5, 21, 0.05, False)],
)
def test_a_sign_is_lost_in_five_steps_back_and_a_fifth_of_them_at_least(common, n_lost, n_right, step, found):
    shown = np.r_[np.full(10, step), np.full(n_right + n_lost, -step)]
    driven = np.r_[shown[: 10 + n_right], np.full(n_lost, step)]
    signs = [one for one in odometry_findings(common, sign_log(shown, driven)) if one.name == "odometry-sign"]
    values = {"n_lost": n_lost, "n_backwards": n_lost + n_right, "first_s": 10.0 + n_right}
    assert [dict(one.values) for one in signs] == [values] * found


def found_in(result: OdometryCalibration, **changes: object) -> list[Finding]:
    still = sign_log(np.zeros(3), np.zeros(3))
    return list(odometry_findings(replace(result, **changes), still))


@pytest.mark.parametrize(
    ("name", "value"), [("distance_scale", 0.01), ("turn_scale", 0.01), ("drift", 0.005), ("yaw", 0.01)]
)
def test_systematic_errors_are_named_that_are_sure_and_worth_correcting(common, name, value):
    def found(value: float, low: float, high: float) -> list[str]:
        return [one.name for one in found_in(common, systematic={name: Estimate(value, low, high)})]

    assert found(1.1 * value, 0.1 * value, 3.0 * value) == [f"odometry-{name.replace('_', '-')}"]
    assert found(-1.1 * value, -3.0 * value, -0.1 * value) == [f"odometry-{name.replace('_', '-')}"]
    assert found(0.9 * value, 0.1 * value, 3.0 * value) == []
    assert found(1.1 * value, -0.1 * value, 3.0 * value) == []


def test_noise_is_white_up_to_a_power_of_the_length(common):
    def found(power: float) -> list[Finding]:
        return found_in(common, systematic={}, by_length=((2, 0.05), (4, 0.3), (8, 0.05 * 4.0**power)))

    assert found(0.64) == found(-0.64) == []
    (lasting,), (cancelling,) = found(0.66), found(-0.66)
    assert lasting.name == cancelling.name == "odometry-not-white"
    assert "alpha grows from 0.05 over 2 to 0.12 over 8 update steps" in lasting.text
    assert lasting.why.startswith("Errors that last")
    assert lasting.do.startswith("Put the systematic errors right")
    assert "alpha shrinks from 0.05 over 2 to 0.02 over 8 update steps" in cancelling.text
    assert cancelling.why.startswith("Errors that cancel")
    assert cancelling.do == "Check the stamps, and the error of the reference."
    low = found_in(common, systematic={}, by_length=((2, 0.019), (8, 0.001)))
    assert low == []  # what is advised is the floor then


def test_faults_are_turns_or_slips_or_neither(common):
    residuals = [[9.0, 0.0, 0.31], [0.0, 0.62, 0.29], [0.58, 0.0, 0.0], [0.1, 0.0, 0.0], [0.08, 0.0, -0.3]]
    driven = np.column_stack([[0.0, 2.0, 4.0, 6.0, 6.0, 6.0], np.zeros((6, 2))])
    windows = replace(common.windows, odometry=driven, first=np.arange(5), length=1, residuals=np.array(residuals))
    of = {"windows": windows, "is_noise": np.zeros(5, np.bool_), "fault_stamps": np.array([7.0])}
    (faults,) = found_in(common, systematic={}, **of)
    assert "(1 with a turn missed or made up, 2 with a slip or a lost sign), first from stamp 7.0 on" in faults.text
    assert dict(faults.values) == {"n_windows": 5.0, "first_stamp": 7.0, "n_turns": 1.0, "n_slips": 2.0}


def test_few_blocks_and_a_reference_made_of_the_odometry_are_named(common):
    assert [one.name for one in found_in(common, systematic={}, n_blocks=3)] == ["odometry-few-blocks"]
    assert found_in(common, systematic={}, n_blocks=4) == []
    for largest, names in ((0.9e-3, ["odometry-is-reference"]), (1.1e-3, [])):
        same = replace(common.windows, residuals=np.full_like(common.windows.residuals, -largest))
        assert [one.name for one in found_in(common, systematic={}, windows=same)] == names


def test_a_drift_that_adds_up_is_not_white():
    rng = np.random.default_rng(6)
    steps = drive(rng, 100)
    true = steps.copy()
    true[:, 2] += 0.05
    result = calibrate_odometry(log_of(chained(true), chained(steps), rng), EVERY_SCAN)
    assert "odometry-not-white" in {finding.name for finding in result.findings}
    # A filter that knows of no drift needs noise as large: 0.05 rad over 0.27 m.
    assert result.filter_motion.drift > 2.0 * USUAL_MOTION.drift
    assert result.filter_motion.turn == USUAL_MOTION.turn
    # Below the floor, which is advised then, no shape of the noise is of any consequence.
    true[:, 2] -= 0.05 - 0.004
    result = calibrate_odometry(log_of(chained(true), chained(steps)), EVERY_SCAN)
    assert max(alpha for _, alpha in result.by_length) < result.options.floor
    assert "odometry-not-white" not in {finding.name for finding in result.findings}


def test_covariances_of_poses_take_the_place_of_one_error_for_all():
    log = amcl_log((0.03,) * 4, 1)[:60]
    same = np.tile(np.diag([0.02**2, 0.02**2, 0.005**2]), (len(log), 1, 1))
    given = calibrate_odometry(log, replace(EVERY_SCAN, reference_error=1.0), covariances=same)
    constant = calibrate_odometry(log, EVERY_SCAN)
    assert given.candidates[1].levels[0].value == pytest.approx(constant.candidates[1].levels[0].value, rel=1e-4)


@pytest.mark.parametrize("model", [DifferentialMotion(0.01, 0.01, 0.02, 0.02)])
def test_mean_and_covariance_of_a_window_are_those_of_its_draws(model):
    odometry = chained(drive(np.random.default_rng(7), 20))
    windows = cut_odometry_windows(odometry, odometry, np.zeros((21, 3, 3)), np.arange(21), 8)
    drawn = np.tile(odometry[0], (200_000, 1))
    rng = np.random.default_rng(8)
    for i in range(8):
        drawn = model.sample(drawn, odometry[i : i + 2], rng)
    seen, less = np.cov(between(odometry[0], drawn).T), (between(odometry[0], drawn) - windows.motion[0]).mean(axis=0)
    assert np.hypot(*less[:2]) > 0.006
    np.testing.assert_allclose(windows.shortening(model)[0, :2], less[:2], atol=0.0006)
    computed = windows.covariance(model)[0]
    scale = np.sqrt(np.outer(np.diag(seen), np.diag(seen)))
    np.testing.assert_allclose(computed / scale, seen / scale, atol=0.06)


def test_a_robot_that_turns_on_the_spot_gets_no_less_far():
    # Wheels that slip a little move it by less than a hair, in directions that say nothing.
    rng = np.random.default_rng(9)
    steps = np.column_stack([1e-9 * rng.standard_normal((20, 2)), np.full(20, 0.3)])
    odometry = chained(steps)
    windows = cut_odometry_windows(odometry, odometry, np.zeros((21, 3, 3)), np.arange(21), 8)
    assert np.abs(windows.shortening(DifferentialMotion(1.0, 1.0, 1.0, 1.0))).max() < 1e-6


def test_the_reference_at_both_ends_of_a_window_counts():
    rng = np.random.default_rng(9)
    poses = chained(drive(rng, 20))
    covariance = np.diag([0.03, 0.05, 0.02]) ** 2
    windows = cut_odometry_windows(poses, poses, np.tile(covariance, (21, 1, 1)), np.arange(21), 8)
    noise = rng.multivariate_normal(np.zeros(3), covariance, (20_000, 2))
    drawn = between(poses[0] + noise[:, 0], poses[8] + noise[:, 1])
    np.testing.assert_allclose(np.cov(drawn.T), windows.reference[0], atol=0.05 * windows.reference[0].max())


def test_the_likelihood_and_its_derivatives_are_those_of_normals():
    rng = np.random.default_rng(10)
    residuals, levels = rng.normal(size=(30, 3)), np.array([0.4, 1.3])
    roots = rng.normal(size=(3, 30, 3, 3))
    reference, *units = roots @ np.swapaxes(roots, 2, 3)
    by_window = np.ascontiguousarray(np.swapaxes(np.array(units), 0, 1))
    gradient, information = np.empty(2), np.empty((2, 2))

    def loss(at: FloatArray) -> float:
        return negative_log_likelihood(residuals, reference, by_window, at, np.empty(2), np.empty((2, 2)))

    value = negative_log_likelihood(residuals, reference, by_window, levels, gradient, information)
    covariances = reference + levels[0] * units[0] + levels[1] * units[1]
    exact = sum(multivariate_normal(cov=c).logpdf(r) for r, c in zip(residuals, covariances, strict=True))
    assert -value == pytest.approx(exact + 45.0 * np.log(2.0 * np.pi))
    np.testing.assert_allclose(gradient, approx_fprime(levels, loss, 1e-6), rtol=1e-4, atol=1e-4)
    inverse = np.linalg.inv(covariances)
    expected = [[0.5 * np.trace(inverse @ a @ inverse @ b, axis1=1, axis2=2).sum() for a in units] for b in units]
    np.testing.assert_allclose(information, expected, rtol=1e-9)
    best = fit_levels(residuals, reference, np.array(units))
    inside = best > 1e-6  # a level on its bound has a slope
    slope = np.array([loss(best * (1.0 + 1e-4 * unit)) - loss(best) for unit in np.eye(2)])
    assert (slope[inside] >= -1e-6).all()


def test_noise_shows_in_few_windows_though_others_have_none():
    # The median window is explained by the reference's error alone, as in logs of every scan.
    rng = np.random.default_rng(8)
    reference = np.broadcast_to(1e-4 * np.eye(3), (200, 3, 3))
    residuals = 0.005 * rng.standard_normal((200, 3))
    residuals[::8, 2] = 0.15 * rng.standard_normal(25)
    units = np.zeros((2, 200, 3, 3))
    units[0, :, :2, :2], units[1, :, 2, 2] = np.eye(2), 1.0

    def mean_log_density(levels: FloatArray) -> float:
        windows = zip(residuals, reference + np.tensordot(levels, units, 1), strict=True)
        return float(np.mean([multivariate_normal(np.zeros(3), covariance).logpdf(off) for off, covariance in windows]))

    best = fit_levels(residuals, reference, units)
    others = [np.array([1e-7, 10.0**power]) for power in np.arange(-5.0, 0.0, 0.25)]
    assert mean_log_density(best) >= max(map(mean_log_density, others)) - 1e-6


@pytest.mark.parametrize("seed", [135, 174, 339, 535])
def test_a_level_that_stays_at_its_bound_stops_no_other(seed):
    # Each window shows both kinds of noise to another degree; 3 of 60 windows are wide.
    rng = np.random.default_rng(seed)
    reference, units = np.broadcast_to(np.eye(3), (60, 3, 3)), np.zeros((2, 60, 3, 3))
    variances = 10.0 ** rng.uniform(-4.0, 1.0, (2, 60, 3)) * (rng.random((2, 1, 3)) < 0.6)
    units[:, :, [0, 1, 2], [0, 1, 2]] = variances
    residuals = rng.standard_normal((60, 3)) * rng.choice([0.5, 1.0, 1.0], (60, 1))
    residuals[:3] *= 3.0

    def cost(levels: FloatArray) -> float:
        covariance = 1.0 + np.tensordot(levels, variances, 1)
        return 0.5 * float(np.sum(np.log(covariance) + residuals**2 / covariance))

    power = np.arange(-7.0, 1.5, 0.1)
    around = min(cost(10.0 ** np.array([a, b])) for a in power for b in power)
    assert cost(fit_levels(residuals, reference, units)) < around + 1e-6


def test_updates_are_those_of_amcl():
    odometry = np.zeros((7, 3))
    odometry[:, 0] = [0.0, 0.1, 0.26, 0.3, 0.3, 0.3, 0.5]
    odometry[:, 1] = [0.0, 0.0, 0.0, 0.24, 0.24, np.nan, 0.24]
    odometry[:, 2] = [3.1, 3.1, 3.1, 3.1, -2.9, 0.0, -2.9]
    assert update_scans(odometry, 0.25, 0.2).tolist() == [0, 2, 4]


@pytest.mark.parametrize("family", [*DIFFERENTIAL, GAUSSIAN, OMNI], ids=lambda family: family.name)
def test_units_of_a_family_add_up_to_its_model(family):
    levels = np.arange(1.0, len(family.units) + 1.0) * 0.01
    odometry = np.array([[1.0, 2.0, 0.5], [1.3, 2.1, 0.9]])
    total = sum(a * unit.step(odometry).covariance() for a, unit in zip(levels, family.units, strict=True))
    np.testing.assert_allclose(family.build(levels).step(odometry).covariance(), total, atol=1e-15)


def test_every_program_gets_noise_as_wide_in_its_own_parameters(common):
    alpha = common.alphas.alpha1
    values = {name: {kind: of(common) for kind, of in stack.motions.items()} for name, stack in STACKS.items()}
    assert values["nav2"]["nav2_amcl::DifferentialMotionModel"]["alpha3"] == pytest.approx(alpha, rel=0.01)
    assert values["beluga"]["differential_drive"] == values["nav2"]["nav2_amcl::DifferentialMotionModel"]
    assert values["ros1"]["diff-corrected"]["odom_alpha1"] == pytest.approx(alpha, rel=0.01)
    # "diff" takes the variance for the deviation: alpha' s^2 = sqrt(alpha) s at a step of s = 0.27 m.
    assert values["ros1"]["diff"]["odom_alpha2"] == pytest.approx(np.sqrt(alpha) / 0.27, rel=0.3)
    assert len(values["ros1"]["omni"]) == len(values["nav2"]["nav2_amcl::OmniMotionModel"]) == 5
    factors = {values["mrpt"]["mmGaussian"][name] / default for name, default in (("a1", 0.01), ("a4", 0.05))}
    assert max(factors) == pytest.approx(min(factors), rel=0.01)
    assert min(factors) > 1.0


def test_the_floor_holds_for_every_program():
    log = amcl_log((1e-4,) * 4, 11, n=60)
    low, high = (calibrate_odometry(log, replace(EVERY_SCAN, floor=floor)) for floor in (0.0, 0.05))
    assert high.alphas == DifferentialMotion(0.05, 0.05, 0.05, 0.05)
    for stack in (STACKS["ros1"], STACKS["mrpt"]):
        for of in stack.motions.values():
            assert min(b / a for a, b in zip(of(low).values(), of(high).values(), strict=True) if a > 0) > 3.0


def test_a_result_says_all_in_its_summary(common):
    text = common.summary()
    for words in (
        "nav2's default, 0.2",
        "one alpha (chosen)",
        "distance_scale",
        "Advised at updates every 0 m",
    ):
        assert words in text


@pytest.mark.parametrize(
    ("change", "error", "words"),
    [
        ({"poses": np.full((251, 3), np.nan)}, TooLittleDataError, "no reference poses"),
        ({"odometry": np.full((251, 3), np.nan)}, TooLittleDataError, "no odometry"),
        ({"odometry": np.zeros((251, 3))}, TooLittleDataError, "12 windows of 8 update steps .* record a longer drive"),
    ],
)
def test_logs_that_show_nothing_are_refused(change, error, words):
    log = replace(amcl_log((0.03,) * 4, 1), **change)
    with pytest.raises(error, match=words):
        calibrate_odometry(log)
    if "no " not in words:
        with pytest.raises(error, match="never moves"):
            calibrate_odometry(log, EVERY_SCAN)


def test_exact_poses_and_exact_odometry_give_numbers():
    poses = chained(drive(np.random.default_rng(12), 60))
    result = calibrate_odometry(log_of(poses, poses), EVERY_SCAN, covariances=np.zeros((61, 3, 3)))
    assert result.alphas == DifferentialMotion(0.02, 0.02, 0.02, 0.02)
    assert result.filter_motion == USUAL_MOTION
    assert np.isfinite([error.value for error in result.systematic.values()]).all()


def test_a_short_log_has_no_intervals_but_values():
    result = calibrate_odometry(amcl_log((0.03,) * 4, 1)[:40], EVERY_SCAN)
    assert result.n_blocks < 4
    assert result.candidates[1].levels[0].high == np.inf
    assert "odometry-few-blocks" in {finding.name for finding in result.findings}
    assert np.isfinite(result.alphas.alpha1)


@pytest.mark.parametrize(
    "covariances",
    [np.zeros((3, 3)), np.full((251, 3, 3), np.nan), np.tile(-np.eye(3), (251, 1, 1))],
)
def test_bad_covariances_are_refused(covariances):
    with pytest.raises(InvalidInputError, match="covariances"):
        calibrate_odometry(amcl_log((0.03,) * 4, 1), covariances=covariances)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"floor": -0.1}, "floor: expected a finite number >= 0, got -0.1"),
        ({"reference_error": 0.0}, "reference_error: expected a positive number from .*, got 0.0"),
        ({"update_min_d": float("nan")}, "update_min_d: expected a finite number >= 0, got nan"),
    ],
)
def test_bad_options_are_refused(options, message):
    with pytest.raises(InvalidInputError, match=message):
        OdometryOptions(**options)
