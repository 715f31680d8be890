from __future__ import annotations

import numpy as np
import pytest

from beamfield.calibration.beam_table import BeamTable
from beamfield.calibration.evaluation import (
    DEFAULTS,
    block_standard_error,
    is_worth_it,
    likely_causes,
    pit_deviation,
    randomized_pit,
    score_models,
    timeline,
    uniform_parameters,
)
from beamfield.models.beam_density import beam_log_density
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams

TRUTH = BeamParameters(0.75, 0.1, 0.05, 0.1, 0.05, 0.4)


def simulated(rng: np.random.Generator, n: int = 20_000) -> BeamTable:
    expected = rng.uniform(0.5, 9.5, n)
    expected[:50] = 10.0
    ranges = sample_beams(expected, 10.0, TRUTH, rng)
    scan = np.arange(n) // 100
    return BeamTable(
        np.minimum(ranges, 10.0),
        expected,
        scan.astype(np.int32),
        (np.arange(n) % 100).astype(np.int32),
        scan * 0.1,
        10.0,
    )


def test_the_stacks_defaults_are_their_documented_values_over_their_sum():
    nav2, ros1 = DEFAULTS["nav2 defaults"], DEFAULTS["ROS 1 defaults"]
    np.testing.assert_allclose(nav2.weights, np.array([0.5, 0.05, 0.05, 0.5]) / 1.1)
    np.testing.assert_allclose(ros1.weights, np.array([0.95, 0.1, 0.05, 0.05]) / 1.15)
    assert (nav2.sigma_hit, nav2.lambda_short) == (ros1.sigma_hit, ros1.lambda_short) == (0.2, 0.1)


def test_the_truth_scores_best_and_the_differences_add_up(rng):
    table = simulated(rng)
    scores = score_models({"truth": TRUTH, **DEFAULTS, "uniform": uniform_parameters(0.05)}, table, table.scan // 20)
    assert [s.name for s in scores] == ["truth", "nav2 defaults", "ROS 1 defaults", "uniform"]
    rows = ~table.hits_nothing
    by_hand = beam_log_density(table.ranges[rows], table.expected_ranges[rows], 10.0, TRUTH).mean()
    assert scores[0].log_likelihood == pytest.approx(by_hand, abs=1e-12)
    for score in scores[1:]:
        assert score.behind_fit > 5 * score.behind_fit_se > 0
        assert score.log_likelihood + score.behind_fit == pytest.approx(scores[0].log_likelihood, abs=1e-12)


def test_a_uniform_has_a_density_and_a_point_mass():
    uniform = uniform_parameters(0.25)
    values = beam_log_density(np.array([0.1, 5.0, 10.0]), np.full(3, 4.0), 10.0, uniform)
    np.testing.assert_allclose(np.exp(values), [0.075, 0.075, 0.25])


def test_a_uniform_fitted_without_any_no_return_still_allows_one():
    assert np.isfinite(beam_log_density(np.array([10.0]), np.array([4.0]), 10.0, uniform_parameters(0.0))).all()


def test_errors_of_blocks_count_as_blocks(rng):
    """With one random value per block, the standard error is that of as many values as there are blocks."""
    values = rng.normal(size=200)
    repeated, blocks = np.repeat(values, 50), np.repeat(np.arange(200), 50)
    expected = values.std(ddof=1) / np.sqrt(200)
    assert block_standard_error(repeated, blocks) == pytest.approx(expected, rel=1e-9)
    assert np.isnan(block_standard_error(values, np.zeros(200, np.int64)))


def test_the_pit_is_uniform_for_the_true_model_and_not_for_another(rng):
    table = simulated(rng)
    good = randomized_pit(table, TRUTH, rng)
    assert len(good) == (~table.hits_nothing).sum()
    assert pit_deviation(good) < 1.63 / np.sqrt(len(good))  # 1% point of Kolmogorov's distribution
    wide = BeamParameters(0.75, 0.1, 0.05, 0.1, 0.2, 0.4)
    assert pit_deviation(randomized_pit(table, wide, rng)) > 0.05


def test_deviation_of_evenly_spread_values_is_half_a_step():
    assert pit_deviation((np.arange(10) + 0.5) / 10) == pytest.approx(0.05)
    assert np.isnan(pit_deviation(np.array([])))
    # Above the diagonal at one end, below it at the other.
    assert pit_deviation(np.array([0.0, 0.1, 0.2])) == pytest.approx(0.8)
    assert pit_deviation(np.array([0.8, 0.9, 1.0])) == pytest.approx(0.8)


def test_each_kind_of_reading_is_given_its_cause():
    z = np.array([4.0, 1.0, 10.0, 8.0])
    table = BeamTable(z, np.full(4, 4.0), np.zeros(4, np.int32), np.arange(4, dtype=np.int32), np.zeros(4), 10.0)
    np.testing.assert_array_equal(likely_causes(table, TRUTH), [0, 1, 2, 3])


def test_the_timeline_is_the_mean_of_each_scan(rng):
    table = simulated(rng, 1000)
    held_out = table.scan % 3 == 1
    line = timeline(table, TRUTH, held_out)
    np.testing.assert_array_equal(line.scan, np.arange(10))
    rows = (table.scan == 7) & ~table.hits_nothing
    by_hand = beam_log_density(table.ranges[rows], table.expected_ranges[rows], 10.0, TRUTH).mean()
    assert line.log_likelihood[7] == pytest.approx(by_hand)
    assert line.held_out[7]
    assert not line.held_out[8]


@pytest.mark.parametrize(
    ("gain", "spread", "is_worth"),
    [(0.0051, 0.0, True), (0.0049, 0.0, False), (0.021, 0.01, True), (0.019, 0.01, False)],
)
def test_a_parameter_more_is_worth_a_gain_that_is_large_and_sure(gain, spread, is_worth):
    # Blocks of +- spread sqrt(99) around the gain have the standard error spread.
    gains = gain + spread * np.sqrt(99.0) * np.tile([-1.0, 1.0], 50)
    assert block_standard_error(gains, np.arange(100)) == pytest.approx(spread, abs=1e-12)
    assert is_worth_it(gains, np.arange(100)) is is_worth
