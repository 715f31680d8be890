"""Block bootstrap: intervals hold the truth where beams depend on each other and naive intervals do not."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.calibration import bootstrap
from beamfield.calibration.bootstrap import bootstrap_intervals
from beamfield.calibration.curvature import naive_covariance
from beamfield.calibration.em import learn_intrinsic_parameters
from beamfield.calibration.intrinsic_likelihood import IntrinsicLikelihood, theta_of
from beamfield.calibration.learning_problem import learning_problem
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams

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
    for trial in range(40):
        z, expected, stamps, mean = dependent_beams(rng)
        result = learn_intrinsic_parameters(z, expected, MAX_RANGE, n_starts=1)
        got = bootstrap_intervals(
            z, expected, stamps, MAX_RANGE, result.parameters, block_s=BLOCK_S, n_replicates=60, seed=trial
        )
        theta = theta_of(result.parameters)
        likelihood = IntrinsicLikelihood(z, expected, MAX_RANGE)
        naive = np.sqrt(np.diag(naive_covariance(likelihood, learning_problem(MAX_RANGE), theta)))
        assert got.n_blocks == 30
        for i, name in enumerate(("z_hit", "z_short", "z_max", "z_rand")):
            low, high = got.intervals[name]
            hits += low <= mean[i] <= high
            naive_hits += abs(theta[i] - mean[i]) <= 1.96 * naive[i]
            n += 1
    assert hits / n >= 0.87
    assert naive_hits / n <= 0.75


def test_standard_errors_agree_with_the_cluster_robust_sandwich():
    z, expected, stamps, _ = dependent_beams(np.random.default_rng(2), n_blocks=60, per_block=200)
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    got = bootstrap_intervals(z, expected, stamps, MAX_RANGE, parameters, block_s=BLOCK_S, n_replicates=400)
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
        assert got.standard_errors[name] == pytest.approx(sandwich[i], rel=0.25), name


def test_a_parameter_on_its_bound_gets_an_interval_that_starts_there():
    rng = np.random.default_rng(5)
    expected = rng.uniform(1.0, 7.0, 6000)
    z = sample_beams(expected, MAX_RANGE, BeamParameters(0.8, 0.15, 0.0, 0.05, 0.05, 0.0), rng)
    stamps = np.linspace(0.0, 400.0, z.size)
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    got = bootstrap_intervals(z, expected, stamps, MAX_RANGE, parameters, n_replicates=100)
    assert got.intervals["lambda_short"][0] == 0.0
    assert 0.0 < got.intervals["lambda_short"][1] < 0.3
    assert got.intervals["z_max"] == (0.0, 0.0)
    assert np.all(got.replicates[:, :4] >= 0.0)


@pytest.mark.parametrize("n_near", [0, 2], ids=["no shorts", "two readings next to the sensor"])
def test_a_rate_that_nothing_determines_has_an_open_interval_not_the_bound_of_the_search(n_near):
    rng = np.random.default_rng(5)
    expected = rng.uniform(1.0, 7.0, 3000)
    z = sample_beams(expected, MAX_RANGE, BeamParameters(0.9, 0.0, 0.1, 0.0, 0.05, 0.0), rng)
    z[:n_near] = 0.003
    stamps = np.linspace(0.0, 400.0, z.size)
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    got = bootstrap_intervals(z, expected, stamps, MAX_RANGE, parameters, n_replicates=50)
    assert got.intervals["lambda_short"] == (0.0, np.inf)
    assert got.standard_errors["lambda_short"] == np.inf
    assert all(np.isfinite(got.intervals[name]).all() for name in got.intervals if name != "lambda_short")


def test_replicates_that_reach_the_ceiling_of_the_search_are_no_bound():
    """Enough readings cut short to call it a cause, but all next to the sensor: any large rate will do."""
    rng = np.random.default_rng(5)
    expected = rng.uniform(1.0, 7.0, 3000)
    z = sample_beams(expected, MAX_RANGE, BeamParameters(0.9, 0.0, 0.1, 0.0, 0.05, 0.0), rng)
    z[::300] = 1e-5
    stamps = np.linspace(0.0, 400.0, z.size)
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    assert parameters.z_short * z.size > 5.0
    got = bootstrap_intervals(z, expected, stamps, MAX_RANGE, parameters, n_replicates=50)
    assert got.intervals["lambda_short"] == (0.0, np.inf)


def test_replicates_are_maxima_of_their_own_sample():
    z, expected, stamps, _ = dependent_beams(np.random.default_rng(3), n_blocks=10)
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    got = bootstrap_intervals(z, expected, stamps, MAX_RANGE, parameters, block_s=BLOCK_S, n_replicates=5, seed=9)
    blocks = (stamps // BLOCK_S).astype(int)
    draws = np.random.default_rng(9).multinomial(10, np.full(10, 0.1), size=5)
    for draw, replicate in zip(draws, got.replicates, strict=True):
        again = learn_intrinsic_parameters(z, expected, MAX_RANGE, weights=draw[blocks])
        assert replicate[:4] == pytest.approx(again.parameters.weights, abs=2e-3)
        assert replicate[4] == pytest.approx(again.parameters.sigma_hit, rel=0.01)


def test_held_parameters_get_no_interval_and_learned_extras_do():
    z, expected, stamps, _ = dependent_beams(np.random.default_rng(3))
    hold = {"lambda_short": 0.5}
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE, hold=hold, fit_offset=True).parameters
    got = bootstrap_intervals(z, expected, stamps, MAX_RANGE, parameters, hold=hold, fit_offset=True, n_replicates=20)
    assert set(got.intervals) == {"z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "range_offset"}
    assert got.intervals["range_offset"][0] < 0.0 < got.intervals["range_offset"][1]


def test_same_seed_same_intervals_with_any_number_of_threads():
    z, expected, stamps, _ = dependent_beams(np.random.default_rng(3))
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    seen: list[tuple[int, int]] = []
    one = bootstrap_intervals(
        z, expected, stamps, MAX_RANGE, parameters, n_replicates=20, threads=1, progress=lambda *step: seen.append(step)
    )
    three = bootstrap_intervals(z, expected, stamps, MAX_RANGE, parameters, n_replicates=20, threads=3)
    assert np.array_equal(one.replicates, three.replicates)
    assert seen == [(i + 1, 20) for i in range(20)]


def test_many_beams_are_thinned_around_the_estimate_of_all(monkeypatch):
    z, expected, stamps, _ = dependent_beams(np.random.default_rng(3))
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    whole = bootstrap_intervals(z, expected, stamps, MAX_RANGE, parameters, n_replicates=100)
    monkeypatch.setattr(bootstrap, "MOST_BEAMS", 2000)
    thin = bootstrap_intervals(z, expected, stamps, MAX_RANGE, parameters, n_replicates=100)
    assert thin.replicates[:, 0].mean() == pytest.approx(parameters.z_hit, abs=0.01)
    assert thin.standard_errors["z_hit"] == pytest.approx(whole.standard_errors["z_hit"], rel=0.5)


def test_few_blocks_are_a_warning_and_one_block_gives_no_intervals():
    z, expected, stamps, _ = dependent_beams(np.random.default_rng(3), n_blocks=4)
    parameters = learn_intrinsic_parameters(z, expected, MAX_RANGE).parameters
    got = bootstrap_intervals(z, expected, stamps, MAX_RANGE, parameters, block_s=BLOCK_S, n_replicates=20)
    assert [finding.name for finding in got.findings] == ["few-blocks"]
    assert got.n_blocks == 4
    got = bootstrap_intervals(z, expected, stamps, MAX_RANGE, parameters, block_s=1e4, n_replicates=20)
    assert got.intervals == {}
    assert got.n_blocks == 1
    assert [finding.name for finding in got.findings] == ["no-intervals"]


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"stamps": [0.0, np.nan]}, r"stamps\[1\]"),
        ({"stamps": [0.0]}, "stamps"),
        ({"ranges": [1.0, -1.0]}, r"ranges\[1\]"),
        ({"n_replicates": 1}, "n_replicates"),
        ({"level": 1.0}, "level"),
        ({"block_s": 0.0}, "block_s"),
    ],
)
def test_impossible_input_is_named(change, text):
    arguments = {"ranges": [1.0, 1.0], "expected_ranges": [1.0, 1.0], "stamps": [0.0, 1.0]} | change
    beams = [arguments.pop(name) for name in ("ranges", "expected_ranges", "stamps")]
    with pytest.raises(InvalidInputError, match=text):
        bootstrap_intervals(*beams, MAX_RANGE, BeamParameters(0.7, 0.1, 0.1, 0.1, 0.1, 0.1), **arguments)


def test_no_beams():
    with pytest.raises(TooLittleDataError, match="0 of 1 beams"):
        bootstrap_intervals([1.0], [8.0], [0.0], MAX_RANGE, BeamParameters(0.7, 0.1, 0.1, 0.1, 0.1, 0.1))


@pytest.mark.oracle
def test_naive_errors_are_several_times_too_small_on_a_real_log(oracle):
    with np.load(oracle / "calibration" / "set_intel_train.npz", allow_pickle=False) as file:
        z, expected, stamps, max_range = file["z"], file["zs"], file["t"], float(file["zmax"])
    parameters = learn_intrinsic_parameters(z, expected, max_range).parameters
    got = bootstrap_intervals(z, expected, stamps, max_range, parameters, n_replicates=60)
    likelihood = IntrinsicLikelihood(z, expected, max_range)
    naive = np.sqrt(np.diag(naive_covariance(likelihood, learning_problem(max_range), theta_of(parameters))))
    for name, i in {"z_hit": 0, "z_short": 1, "z_max": 2}.items():
        assert 4.0 < got.standard_errors[name] / naive[i] < 24.0
