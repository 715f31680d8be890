"""Conformal p-values and the lost filter, on numbers with known answers."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.scan_fit.conformal import conformal_p_values, cross_conformal_p_values
from beamfield.scan_fit.likelihood_ratio import (
    LostEvidence,
    correlation_time,
    effective_number,
    evidence_weights,
    learn_evidence,
)
from beamfield.scan_fit.lost import (
    LostRates,
    kidnapped_series,
    lost_probability,
    reliability_table,
)

SIMPLE = LostEvidence([0.0, 1.0], [-2.0, 2.0], 0.0)


class TestConformal:
    @pytest.mark.parametrize("n", [3, 19, 200])
    def test_it_is_valid_however_few_good_scans_there_are(self, n, rng):
        draws = rng.gamma(0.7, size=(20_000, n + 1))
        p = np.array([conformal_p_values(row[:1], row[1:])[0] for row in draws])
        for level in (0.05, 0.2, 0.5):
            assert (p <= level).mean() <= level + 4 * np.sqrt(level / len(p))
        assert p.min() >= 1.0 / (n + 1)

    def test_ties_count_as_at_least_as_strange(self):
        assert conformal_p_values([1.0], [1.0, 1.0, 0.0]).tolist() == [0.75]

    def test_cross_conformal_equals_leaving_neighbours_out_by_hand(self, rng):
        values, stamps = rng.normal(size=40), np.sort(rng.uniform(0, 20, 40))
        found = cross_conformal_p_values(values, stamps, values, stamps, 2.0)
        for i in range(40):
            far = np.abs(stamps - stamps[i]) > 2.0
            assert found[i] == pytest.approx((1 + (values[far] >= values[i]).sum()) / (far.sum() + 1))

    def test_nothing_far_enough_gives_no_number(self):
        assert np.isnan(cross_conformal_p_values([1.0], [0.0], [1.0, 2.0], [0.0, 1.0], 5.0)).all()

    def test_nan_gives_nan(self):
        assert np.isnan(conformal_p_values([np.nan], [1.0]))[0]
        with pytest.raises(InvalidInputError, match="gap_s"):
            cross_conformal_p_values([1.0], [0.0], [1.0], [0.0], -1.0)


class TestEvidence:
    def test_it_finds_the_ratio_of_two_normal_distributions(self, rng):
        good, lost = rng.normal(0.0, 1.0, 20_000), rng.normal(2.0, 1.0, 20_000)
        evidence = learn_evidence(good, lost, n_good=20_000, n_lost=20_000, correlation_s=0.0)
        x = np.linspace(-0.5, 2.5, 20)
        np.testing.assert_allclose(evidence(x), 2.0 * x - 2.0, atol=0.25)

    def test_it_never_falls_and_is_bounded_by_the_data(self, rng):
        good, lost = rng.normal(0, 1, 60), np.concatenate([rng.normal(4, 1, 50), rng.normal(-3, 0.1, 10)])
        evidence = learn_evidence(good, lost, n_good=60, n_lost=60, correlation_s=0.0)
        values = evidence(np.linspace(-10, 20, 500))
        assert (np.diff(values) >= 0).all()
        assert np.abs(values).max() <= np.log(2 * 60 + 2)
        assert evidence(np.array([np.nan]))[0] == 0.0

    def test_equal_distributions_are_no_evidence(self):
        same = np.ones(50)
        assert learn_evidence(same, same, n_good=50, n_lost=50, correlation_s=1.0)(np.array([1.0, 5.0])).tolist() == [
            0,
            0,
        ]

    def test_without_values_on_one_side_there_is_no_evidence(self):
        nothing, some = np.full(5, np.nan), np.arange(5.0)
        for good, lost in [(nothing, some), (some, nothing), (nothing, nothing)]:
            assert learn_evidence(good, lost, n_good=5, n_lost=5, correlation_s=1.0)([1.0, 9.0]).tolist() == [0, 0]

    def test_the_correlation_time_of_an_autoregression_is_found(self, rng):
        x = np.zeros(20_000)
        for i in range(1, len(x)):
            x[i] = np.exp(-0.1 / 2.0) * x[i - 1] + rng.normal()
        stamps = 0.1 * np.arange(len(x))
        assert correlation_time(stamps, x) == pytest.approx(2.0, rel=0.3)
        assert correlation_time(stamps, rng.normal(size=len(x))) == pytest.approx(0.0, abs=0.05)
        assert effective_number(stamps, 2.0) == pytest.approx(500, rel=0.02)

    def test_weights_lie_between_nothing_new_and_all_new(self):
        weights = evidence_weights([0.0, 0.0, 0.1, 100.0], 2.0)
        assert weights[0] == 1.0
        assert weights[1] == 0.0
        assert 0.0 < weights[2] < 0.05
        assert weights[3] == pytest.approx(1.0)

    @pytest.mark.parametrize(
        ("knots", "ratio"), [([0.0, 0.0], [0.0, 1.0]), ([0.0, 1.0], [1.0, 0.0]), ([0.0], [np.inf])],
        ids=["knots", "falling", "infinite"],
    )  # fmt: skip
    def test_evidence_that_would_behave_oddly_is_refused(self, knots, ratio):
        with pytest.raises(InvalidInputError, match="evidence"):
            LostEvidence(knots, ratio, 1.0)


class TestFilter:
    def test_it_is_bayes_rule_by_hand(self):
        rates = LostRates(0.1, 0.3)
        found = lost_probability([1.0, 0.0], [0.0, 2.0], SIMPLE, rates)
        odds = 0.25 / 0.75 * np.exp(2.0)
        first = odds / (1 + odds)
        between = 0.25 + (first - 0.25) * np.exp(-0.8)
        odds = between / (1 - between) * np.exp(-2.0)
        np.testing.assert_allclose(found, [first, odds / (1 + odds)], rtol=1e-12)

    def test_without_evidence_it_returns_to_the_prior(self):
        found = lost_probability([1.0, *[np.nan] * 50], np.arange(51.0) * 20.0, SIMPLE)
        assert found[0] > 0.3
        assert found[-1] == pytest.approx(LostRates().prior, rel=1e-6)

    def test_more_surprise_never_lowers_it(self):
        stamps = np.arange(30.0) * 0.2
        low, high = (lost_probability(np.full(30, s), stamps, SIMPLE) for s in (0.4, 0.6))
        assert (high > low).all()

    def test_it_never_reaches_certainty(self):
        found = lost_probability(np.full(5000, 9.0), np.arange(5000.0), SIMPLE)
        assert 0.99 < found[-1] < 1.0
        assert lost_probability([], [], SIMPLE).shape == (0,)

    def test_it_is_reliable_on_held_out_kidnappings(self, rng):
        """Values that depend on each other over 2 s: the table must show what was promised."""
        evidence = LostEvidence(np.linspace(-4, 6, 60), 2.0 * np.linspace(-4, 6, 60) - 2.0, 2.0)
        stamps, p, truth = np.arange(2000) * 0.2, [], []
        for _ in range(10):
            noise = np.zeros(len(stamps))
            draws = rng.normal(size=len(stamps))
            noise[0] = draws[0]
            for i in range(1, len(noise)):
                noise[i] = np.exp(-0.1) * noise[i - 1] + np.sqrt(1 - np.exp(-0.2)) * draws[i]
            values, lost = kidnapped_series(noise, noise + 2.0, stamps, rng)
            p.append(lost_probability(values, stamps, evidence, LostRates(0.05, 0.05)))
            truth.append(lost)
        for row in reliability_table(np.concatenate(p), np.concatenate(truth)):
            assert row.observed == pytest.approx(row.predicted, abs=0.15), row

    @pytest.mark.parametrize(
        ("stamps", "message"), [([0.0, -1.0], "decrease"), ([0.0, np.nan], "finite"), ([0.0], "one shape")],
        ids=["backwards", "nan", "shape"],
    )  # fmt: skip
    def test_bad_stamps_are_refused(self, stamps, message):
        with pytest.raises(InvalidInputError, match=message):
            lost_probability([0.0, 1.0], stamps, SIMPLE)

    def test_bad_rates_are_refused(self):
        with pytest.raises(InvalidInputError, match="lose"):
            LostRates(0.0, 1.0)
