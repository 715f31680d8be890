"""The beam model on arrays of ranges: against other programs' numbers and its own conventions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from beamfield.errors import InvalidInputError
from beamfield.models.beam_density import beam_cdf, beam_components, beam_log_density, beam_pit, beam_responsibilities
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams
from tests.threads import forced_threads

MAX_RANGE = 8.0
PARAMETERS = BeamParameters(z_hit=0.6, z_short=0.15, z_max=0.05, z_rand=0.2, sigma_hit=0.1, lambda_short=0.7)


def beams(rng, n):
    expected = rng.uniform(0.01, MAX_RANGE, n)
    return sample_beams(expected, MAX_RANGE, PARAMETERS, rng), expected


@pytest.mark.oracle
def test_given_the_oracles_ranges_densities_agree(oracle_case):
    ranges, book = oracle_case.ranges, oracle_case.answers("book")
    expected = np.reshape(book["ranges_PxK"], (-1, len(ranges)))
    log_beam = beam_log_density(ranges, expected, oracle_case.max_range, oracle_case.beam_parameters)
    np.testing.assert_allclose(log_beam.ravel(), np.ravel(book["log_beam_PxK"]), atol=1e-9, rtol=0)
    np.testing.assert_allclose(log_beam.sum(axis=-1), book["log_beam"], atol=1e-9, rtol=0)


def test_components_times_weights_are_the_mixture(rng):
    ranges, expected = beams(rng, 500)
    mixture = beam_components(ranges, expected, MAX_RANGE, PARAMETERS) @ PARAMETERS.weights
    np.testing.assert_allclose(np.log(mixture), beam_log_density(ranges, expected, MAX_RANGE, PARAMETERS), rtol=1e-12)


def test_responsibilities_are_shares_of_the_mixture(rng):
    ranges, expected = beams(rng, 500)
    parts = beam_components(ranges, expected, MAX_RANGE, PARAMETERS) * PARAMETERS.weights
    shares = beam_responsibilities(ranges, expected, MAX_RANGE, PARAMETERS)
    np.testing.assert_allclose(shares, parts / parts.sum(axis=-1, keepdims=True), atol=1e-14)


def test_expected_ranges_beyond_the_sensor_count_as_its_limit():
    beyond = beam_log_density([7.9, 8.0], [30.0, np.inf], MAX_RANGE, PARAMETERS)
    at_limit = beam_log_density([7.9, 8.0], [8.0, 8.0], MAX_RANGE, PARAMETERS)
    assert beyond.tolist() == at_limit.tolist()


def test_broadcasts_one_scan_against_many_expected_scans(rng):
    ranges, _ = beams(rng, 12)
    expected = rng.uniform(0.0, MAX_RANGE, (3, 5, 12))
    batch = beam_log_density(ranges, expected, MAX_RANGE, PARAMETERS)
    assert batch.shape == (3, 5, 12)
    assert batch[1, 2, 3] == beam_log_density(ranges[3], expected[1, 2, 3], MAX_RANGE, PARAMETERS)
    assert beam_responsibilities(ranges, expected, MAX_RANGE, PARAMETERS).shape == (3, 5, 12, 4)


def test_never_nan_but_where_there_is_no_distribution():
    odd = np.array([0.0, -0.0, 5e-324, 1e-300, 1e-9, 1.0, 7.999, 8.0, 1e300, np.inf, -np.inf, np.nan, -1.0])
    ranges, expected = np.meshgrid(odd, [0.0, 5e-324, 1e-9, 1.0, 7.999, 8.0, 1e300, np.inf, np.nan])
    for sigma, rate, offset, slope in [(0.1, 0.7, 0, 0), (1e-9, 0, 0.3, 0), (1e9, 1e9, -1e3, 2.0), (1e-12, 1, 50, 0)]:
        parameters = BeamParameters(0.9, 0.1, 0.0, 0.0, sigma, rate, offset, slope)
        for function in (beam_log_density, beam_responsibilities, beam_components):
            assert not np.isnan(function(ranges, expected, MAX_RANGE, parameters)).any()
        cdf = beam_cdf(ranges, expected, MAX_RANGE, parameters)
        measured = (ranges >= 0) & (expected >= 0)
        assert np.isnan(cdf[~measured]).all()
        assert ((cdf[measured] >= 0.0) & (cdf[measured] <= 1.0)).all()


def test_cdf_of_every_variant_is_the_frequency_of_its_samples(rng):
    """Kolmogorov-Smirnov on the randomised PIT, at a fixed seed: 20,000 draws per case."""
    cases = [
        PARAMETERS,
        BeamParameters(0.6, 0.2, 0.1, 0.1, 0.3, 0.0, range_offset=0.1, sigma_slope=0.05),
        BeamParameters(0.7, 0.2, 0.1, 0.0, 0.05, 4.0, range_offset=3.0),
        BeamParameters(0.5, 0.3, 0.1, 0.1, 30.0, 1e-9, range_offset=-0.3),
    ]
    for parameters in cases:
        for z_star in (0.0, 0.02, 3.0, 7.95, 8.0):
            expected = np.full(20_000, z_star)
            ranges = sample_beams(expected, MAX_RANGE, parameters, rng)
            pit = beam_pit(ranges, expected, MAX_RANGE, parameters, rng)
            assert stats.kstest(pit, "uniform").pvalue > 1e-4


def test_pit_is_not_uniform_under_a_wrong_model(rng):
    ranges, expected = beams(rng, 20_000)
    wrong = BeamParameters(0.6, 0.15, 0.05, 0.2, sigma_hit=0.12, lambda_short=0.7)
    assert stats.kstest(beam_pit(ranges, expected, MAX_RANGE, wrong, rng), "uniform").pvalue < 1e-4


def test_pit_of_a_single_beam():
    rng = np.random.default_rng(1)
    value = beam_pit(MAX_RANGE, 3.0, MAX_RANGE, PARAMETERS, rng)
    assert value.shape == ()
    assert 0.95 <= float(value) <= 1.0


def test_samples_are_ranges_or_no_return_and_repeat_with_the_seed():
    expected = np.array([0.0, 1e-9, 3.0, 8.0, 20.0] * 20_000).reshape(1000, 100)
    z = sample_beams(expected, MAX_RANGE, PARAMETERS, np.random.default_rng(3))
    assert z.shape == expected.shape
    assert ((z >= 0.0) & (z <= MAX_RANGE)).all()
    assert (z == sample_beams(expected, MAX_RANGE, PARAMETERS, np.random.default_rng(3))).all()


def test_where_no_reading_is_expected_none_is_drawn(rng):
    assert np.isnan(sample_beams([np.nan, 1.0], MAX_RANGE, PARAMETERS, rng)).tolist() == [True, False]


def test_any_number_of_threads_gives_the_same_bits(rng):
    ranges, expected = beams(rng, 50_001)
    for function in (beam_log_density, beam_responsibilities, beam_components, beam_cdf):
        with forced_threads(1):
            one = function(ranges, expected, MAX_RANGE, PARAMETERS)
        for threads in (2, 3, 7):
            with forced_threads(threads):
                assert (function(ranges, expected, MAX_RANGE, PARAMETERS) == one).all()


@pytest.mark.parametrize("max_range", [0.0, -1.0, np.inf, np.nan])
def test_rejects_a_limit_that_is_none(max_range):
    with pytest.raises(InvalidInputError, match="max_range: expected a positive number"):
        beam_log_density([1.0], [1.0], max_range, PARAMETERS)


def test_rejects_negative_expected_ranges():
    with pytest.raises(InvalidInputError, match=r"expected_ranges: .* got -1.0 at index \(1,\)"):
        beam_log_density([1.0, 1.0], [1.0, -1.0], MAX_RANGE, PARAMETERS)


def test_rejects_shapes_that_do_not_broadcast():
    with pytest.raises(InvalidInputError, match=r"got \(3,\) and \(2,\)"):
        beam_log_density(np.ones(3), np.ones(2), MAX_RANGE, PARAMETERS)


def test_no_beams_give_an_empty_result():
    assert beam_log_density([], [], MAX_RANGE, PARAMETERS).shape == (0,)
