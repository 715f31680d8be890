"""The covariance from the curvature where statistics has closed forms for it."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.calibration.intrinsic.curvature import naive_covariance
from beamfield.calibration.intrinsic.learning_problem import learning_problem
from beamfield.calibration.intrinsic.likelihood import (
    N_PARAMETERS,
    OFFSET,
    VARIANCE,
    W_HIT,
    W_MAX,
    IntrinsicLikelihood,
    theta_of,
)
from beamfield.models.beam_parameters import BeamParameters

MAX_RANGE = 8.0


@pytest.mark.parametrize("held", [{"z_short": 0.0, "z_rand": 0.0, "lambda_short": 0.0}, {"lambda_short": 0.0}])
def test_hits_and_no_returns_vary_like_a_count_and_the_noise_like_a_sample_variance(held):
    """n hits, all far from both limits, and m beams without return; nothing else, as said or as learned."""
    n, m = 900, 100
    off = np.random.default_rng(8).normal(0.0, 0.05, n)
    off -= off.mean()
    expected = np.linspace(2.0, 6.0, n + m)
    z = np.concatenate([expected[:n] + off, np.full(m, MAX_RANGE)])
    sigma = float(np.sqrt((off**2).mean()))
    problem = learning_problem(MAX_RANGE, hold=held, fit_offset=True)
    theta = theta_of(BeamParameters(n / (n + m), 0.0, m / (n + m), 0.0, sigma, 0.0))
    got = naive_covariance(IntrinsicLikelihood(z, expected, MAX_RANGE), problem, theta)
    want = np.zeros((N_PARAMETERS, N_PARAMETERS))
    binomial = n * m / (n + m) ** 3
    want[W_HIT, W_HIT] = want[W_MAX, W_MAX] = binomial
    want[W_HIT, W_MAX] = want[W_MAX, W_HIT] = -binomial
    want[VARIANCE, VARIANCE] = 2.0 * sigma**4 / n
    want[OFFSET, OFFSET] = sigma**2 / n
    np.testing.assert_allclose(got, want, rtol=1e-6, atol=1e-14)


def test_nothing_to_learn_has_no_covariance():
    hold = {"z_hit": 0.9, "z_short": 0.0, "z_max": 0.1, "z_rand": 0.0, "sigma_hit": 0.05, "lambda_short": 0.0}
    problem = learning_problem(MAX_RANGE, hold=hold)
    theta = theta_of(BeamParameters(0.9, 0.0, 0.1, 0.0, 0.05, 0.0))
    likelihood = IntrinsicLikelihood(np.array([3.0, 3.1, MAX_RANGE]), np.full(3, 3.0), MAX_RANGE)
    np.testing.assert_array_equal(naive_covariance(likelihood, problem, theta), np.zeros((N_PARAMETERS, N_PARAMETERS)))
