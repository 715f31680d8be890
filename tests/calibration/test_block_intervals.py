"""Intervals from blocks of time hold the truth where beams depend on each other and naive intervals do not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize, stats

from beamfield.calibration.intrinsic.block_intervals import block_intervals
from beamfield.calibration.intrinsic.curvature import naive_covariance
from beamfield.calibration.intrinsic.em import learn_intrinsic_parameters
from beamfield.calibration.intrinsic.learning_problem import learning_problem
from beamfield.calibration.intrinsic.likelihood import IntrinsicLikelihood, theta_of
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams
from tests.threads import forced_threads

MAX_RANGE = 8.0
BLOCK_S = 20.0


def dependent_beams(rng: np.random.Generator, n_blocks: int = 30, per_block: int = 150):
    """Blocks whose shares of causes vary: in some, people walk by. The mean shares over all blocks are known."""
    mean = np.array([0.7, 0.15, 0.05, 0.1])
    shares = rng.dirichlet(25.0 * mean, n_blocks)
    z, expected = [], []
    for weights in shares:
        z_star = rng.uniform(1.0, 7.0, per_block)
        theta = BeamParameters(*(weights / weights.sum()), 0.05, 0.5)
        z.append(sample_beams(z_star, MAX_RANGE, theta, rng))
        expected.append(z_star)
    stamps = np.repeat(np.arange(n_blocks) * BLOCK_S, per_block) + np.tile(np.linspace(0.0, 19.0, per_block), n_blocks)
    return np.concatenate(z), np.concatenate(expected), stamps, mean


def test_intervals_hold_the_truth_where_naive_ones_do_not():
    rng = np.random.default_rng(8)
    hits, naive_hits, n = 0, 0, 0
    for _ in range(40):
        z, expected, stamps, mean = dependent_beams(rng)
        result = learn_intrinsic_parameters(z, expected, MAX_RANGE, n_starts=1)
        got = block_intervals(z, expected, stamps, MAX_RANGE, result.parameters, block_s=BLOCK_S)
        theta = theta_of(result.parameters)
        likelihood = IntrinsicLikelihood(z, expected, MAX_RANGE)
        naive = np.sqrt(np.diag(naive_covariance(likelihood, learning_problem(MAX_RANGE), theta)))
        assert got.n_blocks == 30
        for i, name in enumerate(("z_hit", "z_short", "z_max", "z_rand")):
            low, high = got.intervals[name]
            hits += low <= mean[i] <= high
            naive_hits += abs(theta[i] - mean[i]) <= 1.96 * naive[i]
            n += 1
    assert hits / n >= 0.9
    assert naive_hits / n <= 0.75


def test_standard_errors_agree_with_the_cluster_robust_sandwich():
    z, expected, stamps, _ = dependent_beams(np.random.default_rng(2), n_blocks=60, per_block=200)
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    got = block_intervals(z, expected, stamps, MAX_RANGE, parameters, block_s=BLOCK_S)
    theta, groups = theta_of(parameters), stamps // BLOCK_S
    naive = naive_covariance(IntrinsicLikelihood(z, expected, MAX_RANGE), learning_problem(MAX_RANGE), theta)
    # Liang and Zeger, "Longitudinal data analysis using generalized linear models", Biometrika 73, 1986.
    scores = [
        IntrinsicLikelihood(z[groups == g], expected[groups == g], MAX_RANGE).derivatives(theta)[1]
        for g in np.unique(groups)
    ]
    sandwich = np.sqrt(np.diag(naive @ np.transpose(scores) @ scores @ naive * len(scores) / (len(scores) - 1)))
    sandwich[4] /= 2.0 * parameters.sigma_hit  # of sigma, not of its square
    positions = {"z_hit": 0, "z_short": 1, "z_max": 2, "z_rand": 3, "sigma_hit": 4, "lambda_short": 7}
    for name, i in positions.items():
        assert got.standard_errors[name] == pytest.approx(sandwich[i], rel=0.08), name


def test_standard_errors_are_those_of_learning_again_without_each_block():
    z, expected, stamps, _ = dependent_beams(np.random.default_rng(3), n_blocks=12, per_block=400)
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    got = block_intervals(z, expected, stamps, MAX_RANGE, parameters, block_s=BLOCK_S)
    groups = stamps // BLOCK_S
    without = [learn_intrinsic_parameters(z[groups != g], expected[groups != g], MAX_RANGE) for g in np.unique(groups)]
    for name, error in got.standard_errors.items():
        values = np.array([getattr(result.parameters, name) for result in without])
        want = np.sqrt((len(values) - 1) * values.var())
        assert error == pytest.approx(want, rel=0.1), name


def reaches_of_skewed_blocks(shares: np.ndarray) -> tuple[float, float]:
    """Standard errors down and up, where Hall's transform of the studentised mean is as far out as Student's t."""
    n, mean, t = len(shares), shares.mean(), stats.t.ppf(0.975, len(shares) - 1)
    beams = mean * (1.0 - mean) / (shares.var(ddof=1) / n)
    a = stats.skew(shares) / np.sqrt(n) - stats.binom.stats(1, mean, moments="s") / np.sqrt(beams)

    def transformed(x):  # Hall 1992, equation of the cubic transform
        return x + a * x**2 / 3.0 + a**2 * x**3 / 27.0 + a / 6.0

    down, up = (optimize.brentq(lambda x, end=end: transformed(x) - end, -99.0, 99.0) for end in (t, -t))
    return max(down, t), max(-up, t)


@pytest.mark.parametrize("odd_block", [1.0, 4.0])
def test_the_weight_of_no_return_is_a_share_whose_interval_is_that_of_korn_and_graubard(odd_block):
    """With Hall's correction where one block has many times as many such readings as the others."""
    rng = np.random.default_rng(3)
    z, expected, stamps, _ = dependent_beams(rng, n_blocks=9)
    z[:150][rng.random(150) < 0.1 * (odd_block - 1.0)] = MAX_RANGE
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    got = block_intervals(z, expected, stamps, MAX_RANGE, parameters, block_s=BLOCK_S)
    per_block = (z >= MAX_RANGE).reshape(9, -1).mean(axis=1)  # blocks of equal size: their mean is the estimate
    share, down_and_up = per_block.mean(), reaches_of_skewed_blocks(per_block)
    assert (down_and_up[1] > 1.3 * stats.t.ppf(0.975, 8)) == (odd_block > 1.0)
    below, above = (
        share * (1.0 - share) / (per_block.var(ddof=1) / 9) * (stats.norm.ppf(0.975) / reach) ** 2
        for reach in down_and_up
    )
    low = stats.beta.ppf(0.025, share * below, below - share * below + 1.0)
    high = stats.beta.ppf(0.975, share * above + 1.0, above - share * above)
    assert got.intervals["z_max"] == pytest.approx((low, high), rel=0.1)
    assert got.standard_errors["z_max"] == pytest.approx(per_block.std(ddof=1) / 3.0, rel=0.1)


def independent_beams(truth: BeamParameters, n: int, rng: np.random.Generator):
    expected = rng.uniform(1.0, 7.0, n)
    return sample_beams(expected, MAX_RANGE, truth, rng), expected, np.linspace(0.0, 400.0, n)


@pytest.mark.parametrize("name", ["z_short", "z_max", "z_rand"])
def test_a_cause_that_was_not_seen_has_an_upper_bound_by_the_rule_of_three(name):
    """Independent beams: 3 / n where no reading resembles the cause, more where some could be it."""
    others = {"z_short": 0.1, "z_max": 0.1, "z_rand": 0.1} | {name: 0.0}
    truth = BeamParameters(z_hit=0.8, **others, sigma_hit=0.02, lambda_short=0.0)
    z, expected, stamps = independent_beams(truth, 6000, np.random.default_rng(5))
    hold = {"lambda_short": 0.0}
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE, hold=hold).parameters
    got = block_intervals(z, expected, stamps, MAX_RANGE, parameters, hold=hold)
    low, high = got.intervals[name]
    if name != "z_max":  # of shorts or random readings a few may be taken for the other
        assert low <= getattr(parameters, name) <= high
        assert 3.0 / z.size < high < 0.03
        return
    assert parameters.z_max == low == 0.0
    assert np.isnan(got.standard_errors["z_max"])
    wider = (stats.t.ppf(0.975, got.n_blocks - 1) / stats.norm.ppf(0.975)) ** 2
    assert 0.99 * wider * 3.0 / z.size < high < 6.0 * wider * 3.0 / z.size


def test_a_weight_that_other_causes_move_is_not_a_share_of_less_than_one_reading():
    """Random readings before the wall in one block, behind it in the others: as if a few of all were shorts."""
    rng = np.random.default_rng(0)
    expected, place = rng.uniform(1.0, 7.0, (8, 400)), rng.random((8, 400))
    anywhere, before, behind = MAX_RANGE * place, expected * place, expected + (MAX_RANGE - expected) * place
    moved = np.where(np.arange(8)[:, None] == 7, before, np.where(rng.random((8, 400)) < 0.12, behind, anywhere))
    z = np.where(rng.random((8, 400)) < 0.3, moved, rng.normal(expected, 0.05)).ravel()
    beams, hold = (z, expected.ravel()), {"lambda_short": 0.0}
    stamps = (np.repeat(np.arange(8), 400) + np.tile(np.linspace(0.0, 0.95, 400), 8)) * BLOCK_S
    parameters = learn_intrinsic_parameters(*beams, MAX_RANGE, hold=hold).parameters
    got = block_intervals(*beams, stamps, MAX_RANGE, parameters, hold=hold, block_s=BLOCK_S)
    share, error = parameters.z_short, got.standard_errors["z_short"]
    assert 0.0 < share < error
    of_one_reading = stats.beta.ppf(0.975, 2.0, (1.0 - share) / share)
    most = max(of_one_reading, share + stats.t.ppf(0.975, 7) * error)
    assert got.intervals["z_short"][1] == pytest.approx(most, rel=0.01)


@pytest.mark.parametrize("tiny", [1e-12, 1e-200, 5e-324])
def test_a_vanishing_weight_has_a_finite_interval(tiny):
    truth = BeamParameters(0.9, 0.0, 0.05, 0.05, 0.05, 0.0)
    z, expected, stamps = independent_beams(truth, 2000, np.random.default_rng(6))
    given = BeamParameters(0.9, tiny, 0.05, 0.05, 0.05, 0.0)
    low, high = block_intervals(z, expected, stamps, MAX_RANGE, given).intervals["z_short"]
    assert 0.0 <= low <= tiny < high < 0.1


def test_only_hits_leave_no_parameter_without_width():
    truth = BeamParameters(1.0, 0.0, 0.0, 0.0, 0.02, 0.0)
    z, expected, stamps = independent_beams(truth, 4000, np.random.default_rng(2))
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    got = block_intervals(z, expected, stamps, MAX_RANGE, parameters)
    for name in ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit"):
        low, high = got.intervals[name]
        assert low <= getattr(parameters, name) <= high
        assert 0.0 < high - low < 0.02
    assert got.intervals["lambda_short"] == (0.0, np.inf)


def test_bounds_of_unseen_causes_hold_the_truth():
    """Every third of these logs has no reading without return though one in 2000 is expected to be such."""
    truth = BeamParameters(0.8995, 0.05, 0.0005, 0.05, 0.05, 0.5)
    rng = np.random.default_rng(4)
    held, unseen, n_logs = 0, 0, 80
    for _ in range(n_logs):
        z, expected, stamps = independent_beams(truth, 2000, rng)
        parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE, n_starts=1).parameters
        low, high = block_intervals(z, expected, stamps, MAX_RANGE, parameters).intervals["z_max"]
        held += low <= truth.z_max <= high
        unseen += parameters.z_max == 0.0
    assert unseen > 0.25 * n_logs
    assert held >= 0.93 * n_logs


def test_uniform_shorts_have_a_rate_that_may_be_above_zero():
    truth = BeamParameters(0.8, 0.15, 0.0, 0.05, 0.05, 0.0)
    rng = np.random.default_rng(5)
    z, expected, stamps = independent_beams(truth, 6000, rng)
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    assert parameters.lambda_short == 0.0
    low, high = block_intervals(z, expected, stamps, MAX_RANGE, parameters).intervals["lambda_short"]
    assert low == 0.0
    assert 0.02 < high < 0.3


def test_noise_at_its_floor_may_be_anything_below():
    z, expected, stamps = independent_beams(BeamParameters(0.8, 0.1, 0.05, 0.05, 0.02, 0.5), 3000,
                                            np.random.default_rng(5))  # fmt: skip
    exact = np.abs(z - expected) < 0.1
    z[exact] = expected[exact]
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    low, high = block_intervals(z, expected, stamps, MAX_RANGE, parameters).intervals["sigma_hit"]
    assert parameters.sigma_hit == pytest.approx(1e-5 * MAX_RANGE)
    assert low == 0.0
    assert parameters.sigma_hit < high < 2.0 * parameters.sigma_hit


@pytest.mark.parametrize("n_near", [0, 2], ids=["no shorts", "two readings next to the sensor"])
def test_a_rate_that_nothing_determines_has_an_open_interval_not_the_bound_of_the_search(n_near):
    rng = np.random.default_rng(5)
    expected = rng.uniform(1.0, 7.0, 3000)
    z = sample_beams(expected, MAX_RANGE, BeamParameters(0.9, 0.0, 0.1, 0.0, 0.05, 0.0), rng)
    z[:n_near] = 0.003
    stamps = np.linspace(0.0, 400.0, z.size)
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    got = block_intervals(z, expected, stamps, MAX_RANGE, parameters)
    assert got.intervals["lambda_short"] == (0.0, np.inf)
    assert got.standard_errors["lambda_short"] == np.inf
    assert all(np.isfinite(got.intervals[name]).all() for name in got.intervals if name != "lambda_short")


def test_a_rate_whose_interval_reaches_the_ceiling_of_the_search_is_undetermined():
    """Enough readings cut short to call it a cause, but all next to the sensor: any large rate will do."""
    rng = np.random.default_rng(5)
    expected = rng.uniform(1.0, 7.0, 3000)
    z = sample_beams(expected, MAX_RANGE, BeamParameters(0.9, 0.0, 0.1, 0.0, 0.05, 0.0), rng)
    z[::300] = 1e-5
    stamps = np.linspace(0.0, 400.0, z.size)
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    assert parameters.z_short * z.size > 5.0
    got = block_intervals(z, expected, stamps, MAX_RANGE, parameters)
    assert got.intervals["lambda_short"] == (0.0, np.inf)


def test_an_offset_at_its_limit_is_undetermined():
    rng = np.random.default_rng(5)
    expected = rng.uniform(1.0, 5.0, 3000)
    z, stamps = rng.normal(expected + 2.0, 0.02), np.linspace(0.0, 400.0, expected.size)
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE, fit_offset=True).parameters
    assert parameters.range_offset == pytest.approx(0.1 * MAX_RANGE)
    got = block_intervals(z, expected, stamps, MAX_RANGE, parameters, fit_offset=True)
    assert got.intervals["range_offset"] == (-np.inf, np.inf)


def test_without_hits_their_shape_is_undetermined():
    rng = np.random.default_rng(6)
    expected, z = rng.uniform(1.0, 5.0, 3000), rng.uniform(0.0, MAX_RANGE, 3000)
    stamps, hold = np.linspace(0.0, 400.0, 3000), {"z_hit": 0.0, "z_short": 0.0}
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE, hold=hold, fit_offset=True).parameters
    got = block_intervals(z, expected, stamps, MAX_RANGE, parameters, hold=hold, fit_offset=True)
    assert got.intervals["sigma_hit"] == (0.0, np.inf)
    assert got.intervals["range_offset"] == (-np.inf, np.inf)
    assert got.standard_errors["sigma_hit"] == np.inf


@pytest.mark.parametrize("left", [0.5, 0.0])
def test_a_weight_that_the_held_ones_leave_is_exact(left):
    rng = np.random.default_rng(7)
    expected, z = rng.uniform(1.0, 5.0, 3000), rng.uniform(0.0, MAX_RANGE, 3000)
    stamps, hold = np.linspace(0.0, 400.0, 3000), {"z_hit": 0.5, "z_short": 0.5 - left, "z_max": 0.0}
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE, hold=hold).parameters
    got = block_intervals(z, expected, stamps, MAX_RANGE, parameters, hold=hold)
    assert got.intervals["z_rand"] == pytest.approx((left, left), abs=1e-12)


def test_held_parameters_get_no_interval_and_learned_extras_do():
    z, expected, stamps, _ = dependent_beams(np.random.default_rng(3))
    hold = {"lambda_short": 0.5}
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE, hold=hold, fit_offset=True).parameters
    got = block_intervals(z, expected, stamps, MAX_RANGE, parameters, hold=hold, fit_offset=True)
    assert set(got.intervals) == {"z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "range_offset"}
    assert got.intervals["range_offset"][0] < 0.0 < got.intervals["range_offset"][1]


def test_same_bits_with_any_number_of_threads():
    z, expected, stamps, _ = dependent_beams(np.random.default_rng(3))
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    with forced_threads(1):
        one = block_intervals(z, expected, stamps, MAX_RANGE, parameters)
    with forced_threads(3):
        three = block_intervals(z, expected, stamps, MAX_RANGE, parameters)
    assert one.intervals == three.intervals
    assert one.standard_errors == three.standard_errors


def test_more_blocks_or_more_time_settle_the_warning_of_few_blocks():
    z, expected, stamps, _ = dependent_beams(np.random.default_rng(3), n_blocks=12)
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters

    def names(times, block_s=None):
        got = block_intervals(z, expected, times, MAX_RANGE, parameters, block_s=block_s)
        return got.n_blocks, [finding.name for finding in got.findings]

    assert names(stamps) == (12, [])
    assert names(stamps / 2.0) == (12, ["few-blocks"])  # 120 s: blocks of 10 s, chosen automatically
    assert names(stamps, 60.0) == (4, ["few-blocks"])
    assert names(stamps, 40.0) == (6, [])


def test_one_block_gives_no_intervals():
    z, expected, stamps, _ = dependent_beams(np.random.default_rng(3), n_blocks=4)
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    got = block_intervals(z, expected, stamps, MAX_RANGE, parameters, block_s=1e4)
    assert (got.intervals, got.n_blocks) == ({}, 1)
    assert [finding.name for finding in got.findings] == ["no-intervals"]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"stamps": [0.0, np.nan]}, r"stamps\[1\]"),
        ({"stamps": [0.0]}, "stamps"),
        ({"ranges": [1.0, -1.0]}, r"ranges\[1\]"),
        ({"block_s": 0.0}, "block_s"),
    ],
)
def test_impossible_input_is_named(change, text):
    arguments = {"ranges": [1.0, 1.0], "expected_ranges": [1.0, 1.0], "stamps": [0.0, 1.0]} | change
    beams = [arguments.pop(name) for name in ("ranges", "expected_ranges", "stamps")]
    with pytest.raises(InvalidInputError, match=text):
        block_intervals(*beams, MAX_RANGE, BeamParameters(0.7, 0.1, 0.1, 0.1, 0.1, 0.1), **arguments)


def test_beams_without_a_measurement_are_left_out():
    z, expected, stamps, _ = dependent_beams(np.random.default_rng(3))
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    want = block_intervals(z, expected, stamps, MAX_RANGE, parameters)
    padded = [np.insert(column, 7, value) for column, value in ((z, np.nan), (expected, 3.0), (stamps, stamps[7]))]
    assert block_intervals(*padded, MAX_RANGE, parameters).intervals == want.intervals


def test_no_beams():
    with pytest.raises(TooLittleDataError, match="0 of 1 beams"):
        block_intervals([1.0], [8.0], [0.0], MAX_RANGE, BeamParameters(0.7, 0.1, 0.1, 0.1, 0.1, 0.1))


@pytest.mark.oracle
def test_naive_errors_are_several_times_too_small_on_a_real_log(oracle):
    with np.load(oracle / "calibration" / "set_intel_train.npz", allow_pickle=False) as file:
        z, expected, stamps, max_range = file["z"], file["zs"], file["t"], float(file["zmax"])
    parameters = learn_intrinsic_parameters(z, expected, max_range).parameters
    got = block_intervals(z, expected, stamps, max_range, parameters)
    likelihood = IntrinsicLikelihood(z, expected, max_range)
    naive = np.sqrt(np.diag(naive_covariance(likelihood, learning_problem(max_range), theta_of(parameters))))
    for name, i in {"z_hit": 0, "z_short": 1, "z_max": 2}.items():
        assert 4.0 < got.standard_errors[name] / naive[i] < 24.0
