"""Drawing by weight: unbiased, with little variance, and as many as Fox's bound asks for."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.stats import chi2, norm

from beamfield.errors import InvalidInputError
from beamfield.kernels import particles as kernels
from beamfield.localization.resampling import (
    KldSampling,
    bin_numbers,
    draw_enough,
    systematic_indices,
)

WEIGHTS = np.array([0.0, 0.31, 0.002, 0.0, 0.2, 0.488, 0.0])
OFFSETS = (np.arange(5000) + 0.5) / 5000


def counts_over_offsets(draw, n: int) -> np.ndarray:
    """Return how often each index comes, (offsets, m)."""
    counts = []
    for offset in OFFSETS:
        out = np.empty(n, np.int64)
        draw(offset, out)
        counts.append(np.bincount(out, minlength=len(WEIGHTS)))
    return np.array(counts)


@pytest.mark.parametrize("n", [1, 7, 60])
def test_systematic_draws_are_unbiased_and_off_by_less_than_one(n):
    counts = counts_over_offsets(lambda offset, out: kernels.draw_systematically(WEIGHTS, offset, out), n)
    # The mean over the offset is an integral by the midpoint rule over a step function.
    np.testing.assert_allclose(counts.mean(axis=0), n * WEIGHTS, atol=3 * n / len(OFFSETS))
    assert np.abs(counts - n * WEIGHTS).max() < 1.0


@pytest.mark.parametrize("n", [1, 13, 60])
def test_draws_one_by_one_are_unbiased_too_and_nearly_as_even(n):
    never = np.full(2, n + 1)
    bins = np.zeros(len(WEIGHTS), np.int64)
    counts = counts_over_offsets(
        lambda offset, out: kernels.draw_until_enough(WEIGHTS, bins, 1, never, offset, out), n
    )  # fmt: skip
    np.testing.assert_allclose(counts.mean(axis=0), n * WEIGHTS, atol=3 * n / len(OFFSETS))
    # An independent draw has the variance n w (1 - w): this one's is a small share of it.
    if n == 60:
        assert (counts.var(axis=0) <= 0.1 * n * WEIGHTS * (1 - WEIGHTS) + 0.12).all()


def test_rounding_of_the_sum_draws_no_particle_without_weight():
    weights = np.append(np.full(10, 0.1 - 1e-17), 0.0)
    weights[:10] *= 1 - 1e-13
    out = np.empty(1, np.int64)
    kernels.draw_systematically(weights, 1.0 - 1e-16, out)
    assert out[0] == 9
    kernels.draw_until_enough(weights, np.zeros(11, np.int64), 1, np.array([1, 1]), 1.0 - 1e-16, out)
    assert out[0] == 9


@pytest.mark.parametrize(("error", "probability"), [(0.05, 0.99), (0.01, 0.9), (0.5, 0.999)])
def test_the_number_needed_is_foxs_bound(error, probability):
    kld = KldSampling(least=1, error=error, probability=probability)
    for k in (2, 3, 10, 500, 20000):
        a = 2.0 / (9.0 * (k - 1))
        bound = (k - 1) / (2 * error) * (1 - a + math.sqrt(a) * norm.ppf(probability)) ** 3
        assert kld.particles_needed(k) == math.ceil(bound)
        # The approximated quantity is a chi-square quantile.
        assert bound == pytest.approx(chi2.ppf(probability, k - 1) / (2 * error), rel=0.04)
    assert kld.particles_needed([0, 1]).tolist() == [1, 1]


def test_drawing_stops_as_soon_as_there_are_enough_for_the_bins_hit(rng):
    poses = rng.normal(0, [1.5, 1.5, 0.6], (3000, 3))
    weights = rng.random(3000)
    weights /= weights.sum()
    kld = KldSampling(least=20, error=0.2)
    bins, n_bins = bin_numbers(poses)[:2]
    indices = draw_enough(weights, bins, n_bins, 100_000, kld, rng)
    keys = np.column_stack([np.floor(poses[:, :2] / 0.5), np.floor((poses[:, 2] % (2 * np.pi)) / (2 * np.pi) * 36)])
    for n in (len(indices), len(indices) - 1):
        k = len(np.unique(keys[indices[:n]], axis=0))
        assert (n >= kld.particles_needed(k)) == (n == len(indices))
    assert len(draw_enough(weights, bins, n_bins, 50, kld, rng)) == 50


def test_bins_are_numbered_as_a_dictionary_would(rng):
    poses = rng.normal(0, [3, 3, 4], (2000, 3)) - [40.0, 0.0, 0.0]
    numbers, n_bins, keys, _ = bin_numbers(poses)
    known = {}
    sectors = np.floor((poses[:, 2] / (2 * np.pi) % 1.0) * 36)
    for number, x, y, sector in zip(numbers, *np.floor(poses[:, :2] / 0.5).T, sectors, strict=True):
        assert known.setdefault((x, y, sector), number) == number
    assert len(known) == n_bins == len(set(keys.tolist()))


def test_poses_beyond_all_bins_share_the_last():
    poses = np.array([[0, 0, 0], [1e30, 0, 0], [-1e30, 0, 0], [1e29, 0, 0], [0, 0, 1e9]])
    assert bin_numbers(poses)[0].tolist() == [0, 1, 2, 1, 3]


def test_bad_numbers_are_refused(rng):
    for weights in ([0.5, 0.6], [1.5, -0.5], [], [[1.0]], [np.nan, 1.0]):
        with pytest.raises(InvalidInputError, match="weights"):
            systematic_indices(weights, 3, rng)
    with pytest.raises(InvalidInputError, match="n: expected at least 1"):
        systematic_indices([1.0], 0, rng)
    for options in ({"least": 0}, {"error": 0.0}, {"probability": 1.0}):
        with pytest.raises(InvalidInputError, match=next(iter(options))):
            KldSampling(**options)
