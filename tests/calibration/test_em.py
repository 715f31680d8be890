"""Learning: the maximum is reached, the likelihood never falls, known parameters come back."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize

from beamfield.calibration.intrinsic.climb import climb
from beamfield.calibration.intrinsic.curvature import naive_covariance
from beamfield.calibration.intrinsic.em import FEWEST_BEAMS, learn_intrinsic_parameters
from beamfield.calibration.intrinsic.learning_problem import SIGMA_FLOOR_SHARE, learning_problem
from beamfield.calibration.intrinsic.likelihood import IntrinsicLikelihood, theta_of
from beamfield.calibration.intrinsic.m_steps import m_step
from beamfield.calibration.intrinsic.priors import IntrinsicPriors
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.kernels.m_step import hit_objective, short_slopes
from beamfield.models.beam_density import beam_log_density
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams
from tests.reference import table_6_2
from tests.threads import forced_threads

# What makes learning hard: hits cut at 0, hits cut at the maximum range, shorts far from 0, shorts near it.
CASES = {
    "indoor": (BeamParameters(0.8, 0.1, 0.05, 0.05, 0.1, 0.5), 30.0, (0.3, 12.0)),
    "near walls": (BeamParameters(0.7, 0.1, 0.05, 0.15, 0.2, 2.0), 5.0, (0.1, 0.6)),
    "cut at the top": (BeamParameters(0.7, 0.15, 0.1, 0.05, 0.3, 0.5), 5.0, (3.5, 4.99)),
    "uniform shorts": (BeamParameters(0.75, 0.2, 0.02, 0.03, 0.05, 0.0), 10.0, (0.5, 9.0)),
    "offset": (BeamParameters(0.8, 0.1, 0.05, 0.05, 0.05, 0.4, 0.04), 10.0, (0.5, 9.0)),
    "offset and slope": (BeamParameters(0.8, 0.1, 0.05, 0.05, 0.03, 0.4, -0.03, 0.02), 10.0, (0.5, 9.0)),
}


def draw(name: str, n: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray, float, BeamParameters, dict[str, bool]]:
    truth, max_range, (low, high) = CASES[name]
    rng = np.random.default_rng(seed)
    expected = rng.uniform(low, high, n)
    options = {"fit_offset": truth.range_offset != 0.0, "fit_sigma_slope": truth.sigma_slope != 0.0}
    return sample_beams(expected, max_range, truth, rng), expected, max_range, truth, options


def assert_never_falls(trace: tuple[float, ...]) -> None:
    steps = np.diff(trace)
    assert np.all(steps >= -1e-9 * np.abs(trace[:-1]))


@pytest.mark.parametrize("name", CASES)
def test_known_parameters_come_back_within_their_standard_errors(name):
    z, expected, max_range, truth, options = draw(name, 40_000)
    result = learn_intrinsic_parameters(z, expected, max_range, **options)
    assert result.converged
    assert_never_falls(result.trace)
    got, want = theta_of(result.parameters), theta_of(truth)
    problem = learning_problem(max_range, **options)
    # The curvature at the truth, where no parameter is on a bound by chance; lambda = 0 gets the inside's.
    inside = np.where(problem.free & (want == 0.0), 1e-9, want)
    errors = np.sqrt(np.diag(naive_covariance(IntrinsicLikelihood(z, expected, max_range), problem, inside)))
    assert np.all(np.abs(got - want) <= 4.0 * errors + 1e-12)
    assert result.log_likelihood >= beam_log_density(z, expected, max_range, truth).mean()
    assert result.log_likelihood == pytest.approx(
        beam_log_density(z, expected, max_range, result.parameters).mean(), rel=1e-12
    )


@pytest.mark.parametrize("name", ["near walls", "cut at the top", "offset and slope"])
def test_no_optimiser_finds_more(name):
    z, expected, max_range, _, options = draw(name, 2000)
    result = learn_intrinsic_parameters(z, expected, max_range, **options)
    free = [4, 5] + [6] * options["fit_offset"] + [7] * options["fit_sigma_slope"]

    def parameters(x):
        weights = np.exp(x[:4] - np.max(x[:4]))
        shapes = [0.0, 0.0, 0.0, 0.0]
        for position, value in zip(free, x[4:], strict=True):
            shapes[position - 4] = value if position == 6 else abs(value)
        return BeamParameters(*(weights / weights.sum()), max(shapes[0], 1e-3), *shapes[1:])

    def loss(x):
        return -beam_log_density(z, expected, max_range, parameters(x)).mean()

    p = result.parameters
    shapes = np.array([p.sigma_hit, p.lambda_short, p.range_offset, p.sigma_slope])[np.array(free) - 4]
    for factor in (1.0, 1.3):
        start = np.concatenate([np.log(np.maximum(p.weights, 1e-6)), shapes * factor])
        best = optimize.minimize(loss, start, method="Nelder-Mead", options={"maxiter": 1500, "fatol": 1e-12})
        assert -best.fun <= result.log_likelihood + 1e-9


@pytest.mark.parametrize("name", CASES)
def test_the_m_step_ends_where_nothing_rises_whatever_the_start(name):
    z, expected, max_range, truth, options = draw(name, 2000)
    problem, likelihood = learning_problem(max_range, **options), IntrinsicLikelihood(z, expected, max_range)
    for start in (theta_of(truth), [0.25, 0.25, 0.25, 0.25, 0.5, 0.01, -0.1, 1.0]):
        theta = problem.apply(np.array(start))
        given, out = likelihood.expected_statistics(theta, slope_is_free=bool(problem.free[5])), np.empty(10)
        new = m_step(given, theta, problem)
        hit_objective(given.node_ranges, given.node_hit, max_range, 0.0, *new[4:7], out)
        # Nats per hit in log v, log q and offsets of a sigma; a slope may end at 0.
        slopes = out[1:4] * [new[4], new[5], np.sqrt(new[4])] / given.counts[0]
        assert np.all(np.abs(slopes[problem.free[4:7]]) <= 1e-8)
        rise, bend = short_slopes(given.node_ranges, given.node_short, given.sum_short_range, new[7])
        assert abs(rise) <= 1e-10 * abs(bend) * new[7] or (new[7] == 0.0 and rise <= 0.0)


def test_plain_em_agrees_and_never_falls():
    z, expected, max_range, _, _ = draw("near walls", 3000)
    fast = learn_intrinsic_parameters(z, expected, max_range)
    plain = learn_intrinsic_parameters(z, expected, max_range, accelerate=False, max_iterations=3000)
    assert plain.newton_steps == 0
    assert fast.iterations < plain.iterations / 5
    assert_never_falls(plain.trace)
    assert plain.log_likelihood == pytest.approx(fast.log_likelihood, abs=1e-8)
    assert plain.parameters.weights == pytest.approx(fast.parameters.weights, abs=1e-3)


@pytest.mark.parametrize("name", CASES)
def test_every_step_from_a_bad_start_climbs(name):
    z, expected, max_range, _, options = draw(name, 3000)
    likelihood = IntrinsicLikelihood(z, expected, max_range)
    problem = learning_problem(max_range, **options)
    for start in ([0.01, 0.97, 0.01, 0.01, 4.0, 0.01, 0.3, 5.0], [0.97, 0.01, 0.01, 0.01, 1e-6, 0.0, -0.1, 0.0]):
        for accelerate in (True, False):
            end = climb(likelihood, problem, np.array(start), tolerance=1e-10, max_iterations=60, accelerate=accelerate)
            assert_never_falls(end.trace)
            assert np.isfinite(end.objective)
            assert end.theta[:4].sum() == pytest.approx(1.0, abs=1e-12)


def test_z_max_is_exactly_the_share_of_max_readings():
    z, expected, max_range, _, _ = draw("cut at the top", 5000)
    z[:7] = np.inf
    result = learn_intrinsic_parameters(z, expected, max_range)
    assert result.parameters.z_max == pytest.approx(np.mean(z >= max_range), rel=1e-12)


def test_literal_table_6_2_lowers_the_likelihood_and_finds_lambda_several_times_too_large():
    z, expected, max_range, truth, _ = draw("near walls", 100_000)
    thetas = table_6_2.learn_intrinsic_parameters(z, expected, max_range, 0.2, 0.5, 60)
    trace = [table_6_2.log_likelihood(z, expected, max_range, theta) for theta in thetas]
    assert min(np.diff(trace)) < -1e-3
    assert thetas[-1][5] > 3.0 * truth.lambda_short
    result = learn_intrinsic_parameters(z, expected, max_range)
    assert result.log_likelihood > trace[-1] + 0.02
    assert result.log_likelihood == pytest.approx(
        table_6_2.log_likelihood(z, expected, max_range, theta_of_table(result.parameters)), rel=1e-12
    )
    assert result.parameters.lambda_short == pytest.approx(truth.lambda_short, rel=0.35)


def theta_of_table(p: BeamParameters) -> list[float]:
    return [*p.weights, p.sigma_hit, p.lambda_short]


def test_held_parameters_stay_and_the_others_share_the_rest():
    z, expected, max_range, _, _ = draw("indoor", 4000)
    hold = {"z_rand": 0.2, "z_max": 0.01, "sigma_hit": 0.07, "lambda_short": 0.0, "range_offset": 0.01}
    result = learn_intrinsic_parameters(z, expected, max_range, hold=hold)
    for name, value in hold.items():
        assert getattr(result.parameters, name) == pytest.approx(value, abs=1e-12)
    assert result.parameters.z_hit + result.parameters.z_short == pytest.approx(0.79, abs=1e-12)
    assert_never_falls(result.trace)
    # One free weight is left: no better place for it.
    grid = [
        BeamParameters(0.79 - s, s, 0.01, 0.2, 0.07, 0.0, 0.01)
        for s in result.parameters.z_short + np.array([-1e-3, 1e-3])
    ]
    assert all(beam_log_density(z, expected, max_range, p).mean() < result.log_likelihood for p in grid)


def test_weights_count_beams():
    z, expected, max_range, _, _ = draw("indoor", 2000)
    counts = np.random.default_rng(0).integers(0, 3, z.size)
    weighted = learn_intrinsic_parameters(z, expected, max_range, weights=counts)
    repeated = learn_intrinsic_parameters(np.repeat(z, counts), np.repeat(expected, counts), max_range)
    assert weighted.log_likelihood == pytest.approx(repeated.log_likelihood, rel=1e-9)
    assert weighted.parameters.weights == pytest.approx(repeated.parameters.weights, abs=1e-5)


def test_any_order_of_beams_and_number_of_threads_gives_the_same():
    z, expected, max_range, _, _ = draw("indoor", 70_000)
    with forced_threads(1):
        one = learn_intrinsic_parameters(z, expected, max_range)
    with forced_threads(3):
        assert learn_intrinsic_parameters(z, expected, max_range) == one
    turned = learn_intrinsic_parameters(z[::-1].copy(), expected[::-1].copy(), max_range)
    assert turned.log_likelihood == pytest.approx(one.log_likelihood, rel=1e-11)


def test_hits_far_from_both_limits_give_the_mean_and_deviation_of_their_errors():
    """(6.30) with an offset: nothing is cut, so the closed forms hold, and no slope comes from them."""
    off = np.random.default_rng(12).normal(0.2, 0.05, 2000)
    expected = np.linspace(2.0, 6.0, off.size)
    hold = {"z_hit": 1.0, "z_short": 0.0, "z_max": 0.0, "z_rand": 0.0, "lambda_short": 0.0}
    result = learn_intrinsic_parameters(expected + off, expected, 9.0, hold=hold, fit_offset=True)
    assert result.parameters.sigma_slope == 0.0
    assert result.parameters.range_offset == pytest.approx(off.mean(), abs=1e-6)
    assert result.parameters.sigma_hit == pytest.approx(off.std(), rel=1e-5)


# No bin of these touches an edge, where the M-step has a closed form.
@pytest.mark.parametrize("offset", [1.2, -1.2])
def test_an_offset_at_its_limit_is_the_maximum_there(rng, offset):
    expected = rng.uniform(2.0, 8.0, 1000)
    z = np.where(rng.random(1000) < 0.8, rng.normal(expected + offset, 0.05), rng.uniform(0.0, 10.0, 1000))
    found = learn_intrinsic_parameters(z, expected, 10.0, fit_offset=True)
    parameters = found.parameters
    assert abs(parameters.range_offset) == 1.0
    assert found.log_likelihood == pytest.approx(beam_log_density(z, expected, 10.0, parameters).mean(), rel=1e-9)
    held = learn_intrinsic_parameters(z, expected, 10.0, hold={"range_offset": parameters.range_offset})
    assert found.log_likelihood == pytest.approx(held.log_likelihood, rel=1e-9)


def test_priors_pull_towards_what_was_imagined_and_the_objective_never_falls():
    z, expected, max_range, _, _ = draw("indoor", 500)
    free = learn_intrinsic_parameters(z, expected, max_range)
    priors = IntrinsicPriors(
        {"z_short": 1e6, "z_hit": 1e6}, sigma_hit=0.3, sigma_beams=1e7, mean_short=0.5, short_beams=1e8
    )
    result = learn_intrinsic_parameters(z, expected, max_range, priors=priors)
    assert_never_falls(result.trace)
    assert result.parameters.sigma_hit == pytest.approx(0.3, rel=1e-3)
    assert result.parameters.lambda_short == pytest.approx(2.0, rel=1e-2)
    assert result.parameters.z_short == pytest.approx(0.5, abs=1e-3)
    assert result.log_likelihood < free.log_likelihood
    assert learn_intrinsic_parameters(z, expected, max_range, priors=IntrinsicPriors()).parameters == free.parameters


def test_rays_that_hit_nothing_are_left_out_and_counted():
    z, expected, max_range, _, _ = draw("indoor", 3000)
    nothing = np.array([max_range, np.inf, max_range + 1.0])
    result = learn_intrinsic_parameters(
        np.concatenate([z, [30.0, 30.0, 2.0]]), np.concatenate([expected, nothing]), max_range
    )
    assert (result.n_excluded, result.n_beams) == (3, 3000)
    assert result.parameters == learn_intrinsic_parameters(z, expected, max_range).parameters


def test_readings_without_measurement_contribute_nothing_and_are_counted():
    z, expected, max_range, _, _ = draw("indoor", 3000)
    holes, weights = [0, 1700, 1701, 2999], np.linspace(0.5, 1.5, 3000)
    with_holes = z.copy()
    with_holes[holes] = np.nan
    beyond = np.where(np.arange(3000) == 1700, max_range, expected)  # its ray hits nothing: still no measurement
    result = learn_intrinsic_parameters(with_holes, beyond, max_range, weights=weights)
    assert (result.n_no_measurement, result.n_excluded, result.n_beams) == (4, 0, 2996)
    without = [np.delete(column, holes) for column in (z, expected, weights)]
    same = learn_intrinsic_parameters(*without[:2], max_range, weights=without[2])
    assert (result.parameters, same.n_no_measurement) == (same.parameters, 0)
    with pytest.raises(TooLittleDataError, match=r"of 40 beams 30 carry no measurement.* and 4 have weight 0"):
        learn_intrinsic_parameters([np.nan, np.nan, np.nan, 1.0] * 10, [1.0] * 40, 8.0, weights=[0.0] * 16 + [1.0] * 24)


def test_all_readings_at_maximum_range():
    result = learn_intrinsic_parameters(np.full(50, 8.0), np.full(50, 3.0), 8.0)
    assert result.parameters.weights == (0.0, 0.0, 1.0, 0.0)
    assert [f.name for f in result.findings] == ["no-returns"]
    assert result.log_likelihood == 0.0


def test_exact_readings_stop_sigma_at_its_floor():
    expected = np.linspace(1.0, 7.0, 300)
    result = learn_intrinsic_parameters(expected, expected, 8.0)
    assert result.parameters.sigma_hit == pytest.approx(SIGMA_FLOOR_SHARE * 8.0)
    assert result.parameters.z_hit == pytest.approx(1.0, abs=1e-4)
    assert "sigma-at-floor" in {f.name for f in result.findings}


def test_noise_that_is_all_slope_is_no_noiseless_simulation():
    rng = np.random.default_rng(2)
    expected = rng.uniform(0.5, 7.0, 4000)
    z = np.clip(expected * (1.0 + rng.normal(0.0, 0.05, 4000)), 0.0, 7.99)
    # Near walls are exact: the constant part of the noise has nothing to explain.
    z[expected < 1.0] = expected[expected < 1.0] * (1.0 + rng.normal(0.0, 0.001, int((expected < 1.0).sum())))
    result = learn_intrinsic_parameters(z, expected, 8.0, fit_sigma_slope=True)
    names = {f.name for f in result.findings}
    assert result.parameters.sigma_hit == pytest.approx(SIGMA_FLOOR_SHARE * 8.0)
    assert "noise-all-slope" in names
    assert "sigma-at-floor" not in names


def test_readings_at_zero_stop_lambda_at_its_ceiling():
    z, expected, max_range, _, _ = draw("indoor", 2000)
    z[:300] = 0.0
    result = learn_intrinsic_parameters(z, expected, max_range, hold={"z_rand": 0.05})
    assert np.isfinite(result.log_likelihood)
    assert result.parameters.lambda_short > 10.0
    assert_never_falls(result.trace)


def test_poses_in_a_wall_do_no_harm():
    z, expected, max_range, _, _ = draw("indoor", 2000)
    expected[:40] = 0.0
    result = learn_intrinsic_parameters(z, expected, max_range)
    assert np.isfinite(result.log_likelihood)
    assert result.parameters.sigma_hit == pytest.approx(0.1, rel=0.1)


def test_initial_parameters_are_one_more_start():
    z, expected, max_range, truth, _ = draw("indoor", 2000)
    result = learn_intrinsic_parameters(z, expected, max_range, initial=truth, n_starts=1)
    assert result.log_likelihood == pytest.approx(
        learn_intrinsic_parameters(z, expected, max_range).log_likelihood, abs=1e-9
    )


def test_progress_is_reported_and_input_left_alone():
    z, expected, max_range, _, _ = draw("indoor", 500)
    before = z.copy(), expected.copy()
    seen: list[tuple[str, int]] = []
    learn_intrinsic_parameters(z, expected, max_range, progress=lambda stage, count: seen.append((stage, count)))
    assert {stage for stage, _ in seen} == {"screening", "climbing"}
    assert np.array_equal(z, before[0])
    assert np.array_equal(expected, before[1])


@pytest.mark.parametrize("n", [2_000, 60_000], ids=["starts tried on all beams", "starts tried on a sample"])
def test_the_trace_holds_every_iteration_on_all_beams(n):
    z, expected, max_range, _, _ = draw("indoor", n)
    seen: list[tuple[str, int]] = []
    result = learn_intrinsic_parameters(
        z, expected, max_range, n_starts=1, progress=lambda stage, count: seen.append((stage, count))
    )
    assert len(result.trace) == 1 + result.iterations == 1 + result.em_steps + result.newton_steps
    assert_never_falls(result.trace)
    assert result.trace[-1] == pytest.approx(result.log_likelihood, rel=1e-12)
    if n < 40_000:
        assert result.em_steps >= 5
        start = result.trace[0]
        assert start < result.log_likelihood - 1e-3


def test_iterations_spent_on_finding_a_start_count():
    z, expected, max_range, _, _ = draw("cut at the top", 3_000)
    result = learn_intrinsic_parameters(z, expected, max_range, accelerate=False, max_iterations=30)
    assert result.iterations == 30
    assert not result.converged


def test_stopping_early_is_a_finding():
    z, expected, max_range, _, _ = draw("cut at the top", 30_000)
    result = learn_intrinsic_parameters(z, expected, max_range, accelerate=False, max_iterations=1)
    assert not result.converged
    assert result.findings[0].name == "not-converged"


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"expected_ranges": [1.0, np.nan] * 20}, r"expected_ranges\[1\]: expected a number >= 0, got nan"),
        ({"ranges": [np.nan, -0.5] * 20}, r"ranges\[1\].*got -0.5"),
        ({"expected_ranges": [1.0, -np.inf] * 20}, r"expected_ranges\[1\].*-inf"),
        ({"expected_ranges": [1.0] * 39}, "expected_ranges: expected the shape"),
        ({"ranges": [[1.0] * 40]}, r"one dimension, got shape \(1, 40\); \.ravel\(\) makes one"),
        ({"weights": [1.0] * 39 + [-1.0]}, r"weights\[39\]"),
        ({"weights": [1.0] * 39 + [np.inf]}, "weights: expected finite"),
        ({"max_range": 0.0}, "max_range"),
        ({"max_range": np.inf}, "max_range"),
        ({"hold": {"z_hat": 0.1}}, "'z_hat'"),
        ({"hold": {"z_hit": 1.1}}, "hold"),
        ({"hold": {"z_hit": -0.1}}, "hold z_hit"),
        ({"hold": {"z_hit": 0.6, "z_short": 0.6}}, "sum to 1.2"),
        ({"hold": {"sigma_hit": 0.0}}, "hold sigma_hit"),
        ({"hold": {"lambda_short": np.nan}}, "hold lambda_short"),
        ({"hold": {"z_max": 0.0}, "ranges": [1.0, 8.0] * 20}, "hold z_max"),
        ({"hold": {"z_hit": 1.0}, "ranges": [1.0, 8.0] * 20}, r"z_hit = 1 some reading has no cause; .*\(20 are\)"),
        ({"hold": {"z_short": 1.0}, "ranges": [0.5, 2.0] * 20}, "z_short = 1 some reading has no cause; .* z_rand"),
        ({"n_starts": 0}, "n_starts"),
        ({"tolerance": 0.0}, "tolerance"),
        ({"max_iterations": 0}, "max_iterations"),
    ],
)
def test_impossible_input_is_named(change, text):
    arguments = {"ranges": [1.0] * 40, "expected_ranges": [1.0] * 40, "max_range": 8.0} | change
    beams = [arguments.pop(name) for name in ("ranges", "expected_ranges", "max_range")]
    with pytest.raises(InvalidInputError, match=text):
        learn_intrinsic_parameters(*beams, **arguments)


def test_held_weights_may_sum_to_1_but_for_rounding():
    z, expected, max_range, _, _ = draw("cut at the top", 1000)
    below = z < max_range
    hold = {"z_hit": 0.8, "z_short": 0.1, "z_rand": 0.1 + 1e-10}
    result = learn_intrinsic_parameters(z[below], expected[below], max_range, hold=hold)
    assert result.parameters.z_max == 0.0
    assert result.parameters.z_hit == pytest.approx(0.8)


@pytest.mark.parametrize(
    "arguments", [{"weight_counts": {"z_hot": 1.0}}, {"sigma_beams": -1.0}, {"sigma_hit": 0.0}, {"mean_short": np.nan}]
)
def test_impossible_priors_are_named(arguments):
    with pytest.raises(InvalidInputError):
        IntrinsicPriors(**arguments)


def test_too_few_beams():
    n = FEWEST_BEAMS
    with pytest.raises(TooLittleDataError, match=f"{n - 1} beams.*{n + 1} beams 0 carry.* the rays of 2 hit"):
        learn_intrinsic_parameters([1.0] * (n + 1), [1.0] * (n - 1) + [8.0] * 2, 8.0)
    with pytest.raises(TooLittleDataError, match="0 beams"):
        learn_intrinsic_parameters([], [], 8.0)
