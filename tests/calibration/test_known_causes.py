"""Known causes against brute-force maximisation of the same likelihood."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import optimize, stats

from beamfield.calibration.intrinsic.known_causes import learn_from_known_causes
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.models.beam_density import CAUSES

MAX_RANGE = 5.0


def labelled_beams(n: int = 4000):
    rng = np.random.default_rng(3)
    expected = np.where(rng.random(n) < 0.5, rng.uniform(0.1, 0.6, n), rng.uniform(4.0, 4.95, n))
    causes = rng.choice(4, n, p=[0.6, 0.2, 0.1, 0.1])
    hit = stats.truncnorm.rvs(-expected / 0.3, (MAX_RANGE - expected) / 0.3, expected, 0.3, random_state=rng)
    short = stats.truncexpon.rvs(1.5 * expected, scale=1 / 1.5, random_state=rng)
    z = np.choose(causes, [hit, short, np.full(n, MAX_RANGE), rng.uniform(0.0, MAX_RANGE, n)])
    return np.where(causes == 2, MAX_RANGE, np.minimum(z, np.nextafter(MAX_RANGE, 0))), expected, causes


def test_shapes_maximise_the_likelihood_of_the_cut_densities():
    z, expected, causes = labelled_beams()
    got = learn_from_known_causes(z, expected, causes, MAX_RANGE)
    hit, short = causes == 0, causes == 1

    def hit_loss(sigma):
        a, b = -expected[hit] / sigma, (MAX_RANGE - expected[hit]) / sigma
        return -stats.truncnorm.logpdf(z[hit], a, b, expected[hit], sigma).sum()

    def short_loss(rate):
        return -stats.truncexpon.logpdf(z[short], rate * expected[short], scale=1 / rate).sum()

    sigma = optimize.minimize_scalar(hit_loss, bounds=(0.05, 2.0), method="bounded", options={"xatol": 1e-9}).x
    rate = optimize.minimize_scalar(short_loss, bounds=(0.01, 20.0), method="bounded", options={"xatol": 1e-9}).x
    assert got.sigma_hit == pytest.approx(sigma, rel=1e-6)
    assert got.lambda_short == pytest.approx(rate, rel=1e-5)
    assert got.weights == pytest.approx(np.bincount(causes) / z.size, abs=1e-15)


def test_closed_form_is_the_chapters():
    z, expected, causes = labelled_beams()
    got = learn_from_known_causes(z, expected, causes, MAX_RANGE, closed_form=True)
    hit, short = causes == 0, causes == 1
    assert got.sigma_hit == pytest.approx(np.sqrt(np.mean((z[hit] - expected[hit]) ** 2)), rel=1e-12)
    assert got.lambda_short == pytest.approx(short.sum() / z[short].sum(), rel=1e-12)
    exact = learn_from_known_causes(z, expected, causes, MAX_RANGE)
    assert got.lambda_short > 1.5 * exact.lambda_short


def test_names_and_numbers_of_causes_mean_the_same():
    z, expected, causes = labelled_beams(200)
    names = [CAUSES[c] for c in causes]
    by_name = learn_from_known_causes(z, expected, names, MAX_RANGE)
    assert by_name == learn_from_known_causes(z, expected, causes, MAX_RANGE)


def test_no_shorts_give_rate_zero():
    got = learn_from_known_causes([1.0, 1.2, 5.0], [1.1, 1.1, 2.0], ["hit", "hit", "max"], MAX_RANGE)
    assert (got.lambda_short, got.z_short, got.z_max) == (0.0, 0.0, pytest.approx(1 / 3))


@pytest.mark.parametrize(
    ("z", "expected", "causes", "text"),
    [
        ([1.0, 5.0], [1.0, 1.0], ["hit", "hit"], "beam 1: range 5.0"),
        ([1.0, 2.0], [1.0, 1.0], ["hit", "short"], "beam 1"),
        ([1.0, 2.0], [1.0, 1.0], ["hit", "max"], "beam 1"),
        ([1.0, np.nan], [1.0, 1.0], ["hit", "rand"], "beam 1: range nan"),
        ([1.0, 1.0], [1.0, 1.0], ["hit", "wall"], "'wall'"),
        ([1.0, 1.0], [1.0, 1.0], [0, 4], "positions 0 to 3"),
        ([1.0, 1.0], [1.0], [0, 0], "expected_ranges"),
    ],
)
def test_impossible_input_is_named(z, expected, causes, text):
    with pytest.raises(InvalidInputError, match=text):
        learn_from_known_causes(z, expected, causes, MAX_RANGE)


def test_without_hits_there_is_no_sigma():
    with pytest.raises(TooLittleDataError, match="0 hits"):
        learn_from_known_causes([5.0], [1.0], ["max"], MAX_RANGE)
    with pytest.raises(InvalidInputError, match="max_range"):
        learn_from_known_causes([5.0], [1.0], ["max"], 0.0)
    with pytest.raises(TooLittleDataError, match="0 hits among 0 beams"):
        learn_from_known_causes([], [], [], MAX_RANGE)
