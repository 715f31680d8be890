"""The normal cut to a window, beside SciPy's and beside numerical integration."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest
from scipy import integrate, stats

from beamfield.landmark_noise.truncated_normal import WIDEST, fit_window_normal, log_window_mass


@pytest.mark.parametrize("mean", [0.0, 0.3, -1.0, 4.0, -60.0])
@pytest.mark.parametrize("sigma", [0.05, 1.0, 30.0])
def test_the_mass_of_the_window_is_right_far_into_the_tails(mean, sigma):
    # Scaled by its largest value, so that nothing underflows.
    nearest = np.clip(mean, -1.0, 1.0)
    top = stats.norm.logpdf(nearest, mean, sigma)
    edges = np.unique(np.clip([-1.0, nearest - 40 * sigma**2, nearest - 8 * sigma, nearest - 0.02 * sigma**2,
                               nearest, nearest + 0.02 * sigma**2, nearest + 8 * sigma, 1.0], -1.0, 1.0))  # fmt: skip
    mass = sum(
        integrate.quad(lambda y: np.exp(stats.norm.logpdf(y, mean, sigma) - top), a, b, epsabs=0.0)[0]
        for a, b in pairwise(edges)
    )
    assert log_window_mass(mean, sigma, 1.0) == pytest.approx(top + np.log(mass), abs=1e-7)


def test_the_fit_is_the_maximum_of_the_cut_likelihood(rng):
    y = rng.normal(0.2, 0.4, 5000)
    y = y[np.abs(y) < 0.5]
    row = (np.array([y.mean()]), np.array([np.square(y).mean()]), np.ones((1, 1)), np.ones(1))
    beta, sigma = fit_window_normal(*row, 0.5, (np.array([0.0]), 0.1))

    def log_likelihood(mean: float, sigma: float) -> float:
        return float(stats.truncnorm.logpdf(y, (-0.5 - mean) / sigma, (0.5 - mean) / sigma, mean, sigma).sum())

    best = log_likelihood(float(beta[0]), sigma)
    for d_mean, d_sigma in [(1e-3, 0.0), (-1e-3, 0.0), (0.0, 1e-3), (0.0, -1e-3), (1e-3, 1e-3)]:
        assert log_likelihood(float(beta[0]) + d_mean, sigma + d_sigma) < best
    assert beta[0] == pytest.approx(0.2, abs=0.08)
    assert sigma == pytest.approx(0.4, abs=0.08)


def test_a_regression_within_a_window_is_recovered(rng):
    x = rng.uniform(0.0, 8.0, 20_000)
    y = 0.05 - 0.02 * x + rng.normal(0.0, 0.2, x.size)
    kept = np.abs(y) < 0.3
    x, y = x[kept], y[kept]
    design = np.column_stack([np.ones_like(x), x - x.mean()])
    beta, sigma = fit_window_normal(y, y * y, design, np.ones_like(y), 0.3, (np.zeros(2), 0.1))
    assert beta[1] == pytest.approx(-0.02, abs=0.003)
    assert beta[0] - beta[1] * x.mean() == pytest.approx(0.05, abs=0.015)
    assert sigma == pytest.approx(0.2, abs=0.01)


def test_a_window_filled_evenly_stops_at_the_widest_sigma():
    row = (np.zeros(1), np.full(1, 0.4), np.ones((1, 1)), np.ones(1))  # more spread than a uniform's 1/3
    beta, sigma = fit_window_normal(*row, 1.0, (np.zeros(1), 0.5))
    assert sigma == pytest.approx(WIDEST)
    assert beta[0] == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("start", [(5.0, 0.01), (-30.0, 3.0), (0.0, 15.0)])
def test_any_start_leads_to_the_same_end(start):
    row = (np.full(1, 0.1), np.full(1, 0.05), np.ones((1, 1)), np.ones(1))
    beta, sigma = fit_window_normal(*row, 1.0, (np.array([start[0]]), start[1]))
    expected = fit_window_normal(*row, 1.0, (np.array([0.1]), 0.2))
    assert beta[0] == pytest.approx(expected[0][0], abs=1e-6)
    assert sigma == pytest.approx(expected[1], abs=1e-6)
