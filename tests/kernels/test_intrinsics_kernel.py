"""Passes of learning against the beam model's density and numerical derivatives; passes with the JIT off as well."""

from __future__ import annotations

import math

import numba
import numpy as np
import pytest
from scipy import integrate, stats

from beamfield.calibration.intrinsic.likelihood import IntrinsicLikelihood, parameters_of
from beamfield.kernels import cuts
from beamfield.kernels.m_step import hit_objective
from beamfield.models.beam_density import beam_log_density, beam_responsibilities
from tests.kernels.entry import entry
from tests.threads import forced_threads

log_mass, relative_rate, mean_share = entry(cuts.log_mass), entry(cuts.relative_rate), entry(cuts.mean_share)
MAX_RANGE = 8.0
# w_hit, w_short, w_max, w_rand, sigma^2, sigma_slope^2, offset, lambda
THETAS = {
    "plain": [0.6, 0.15, 0.05, 0.2, 0.1**2, 0.0, 0.0, 0.7],
    "uniform short": [0.6, 0.15, 0.05, 0.2, 0.1**2, 0.0, 0.0, 0.0],
    "steep short": [0.6, 0.15, 0.05, 0.2, 0.1**2, 0.0, 0.0, 60.0],
    "wide hit": [0.6, 0.15, 0.05, 0.2, 3.0**2, 0.0, 0.0, 0.7],
    "sharp hit": [0.6, 0.15, 0.05, 0.2, 0.002**2, 0.0, 0.0, 0.7],
    "offset and slope": [0.6, 0.15, 0.05, 0.2, 0.1**2, 0.05**2, 0.17, 0.7],
    "negative offset": [0.6, 0.15, 0.05, 0.2, 0.05**2, 0.01**2, -0.3, 2.0],
    "no random": [0.8, 0.15, 0.05, 0.0, 0.1**2, 0.0, 0.0, 0.7],
    "no short": [0.7, 0.0, 0.05, 0.25, 0.1**2, 0.0, 0.0, 0.7],
}


def beams(n: int = 300) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(4)
    expected = np.concatenate([rng.uniform(0.0, MAX_RANGE, n), [0.0, 1e-7, 1e-4, 0.01, 7.9999]])
    z = np.where(
        rng.random(expected.size) < 0.6, rng.normal(expected, 0.15), rng.uniform(0.0, MAX_RANGE, expected.size)
    )
    z[:10] = MAX_RANGE
    return np.clip(z, 0.0, MAX_RANGE), expected


@pytest.fixture(params=list(THETAS))
def theta(request: pytest.FixtureRequest) -> np.ndarray:
    return np.array(THETAS[request.param])


def test_log_likelihood_is_the_beam_models(theta):
    z, expected = beams()
    with np.errstate(all="ignore"):  # with the JIT off its kernels raise NumPy's warnings
        want = beam_log_density(z, expected, MAX_RANGE, parameters_of(theta))
    for i in (slice(None), slice(10, None), slice(300, 305), slice(20, 21)):
        likelihood = IntrinsicLikelihood(z[i], expected[i], MAX_RANGE)
        got = likelihood.expected_statistics(theta).log_likelihood
        assert got == pytest.approx(want[i].sum(), rel=1e-12, abs=1e-12)
        assert likelihood.derivatives(theta)[0] == pytest.approx(want[i].sum(), rel=1e-12, abs=1e-12)


def test_statistics_are_the_responsibilities(theta):
    z, expected = beams()
    with np.errstate(all="ignore"):
        e = beam_responsibilities(z, expected, MAX_RANGE, parameters_of(theta))
    r = z - expected
    got = IntrinsicLikelihood(z, expected, MAX_RANGE).expected_statistics(theta, slope_is_free=True)
    assert got.counts == pytest.approx(e.sum(axis=0), rel=1e-11, abs=1e-11)
    assert got.sum_short_range == pytest.approx(e[:, 1] @ z, rel=1e-11, abs=1e-11)
    # Nodes stand for the beams in every sum of a smooth function of the expected range.
    for function in (np.ones_like, np.square, lambda x: np.exp(-0.7 * x)):
        at_beams, at_nodes = function(expected), function(got.node_ranges)
        want = [(e[:, 0] * at_beams).sum(), (e[:, 0] * r * at_beams).sum(), (e[:, 0] * r**2 * at_beams).sum()]
        assert got.node_hit @ at_nodes == pytest.approx(want, rel=1e-10, abs=1e-10)
        assert got.node_short @ at_nodes == pytest.approx((e[:, 1] * at_beams).sum(), rel=1e-10, abs=1e-10)


def test_counts_are_repeated_beams(theta):
    z, expected = beams(60)
    counts = np.random.default_rng(0).integers(0, 4, z.size)
    weighted = IntrinsicLikelihood(z, expected, MAX_RANGE, weights=counts.astype(float))
    repeated = IntrinsicLikelihood(np.repeat(z, counts), np.repeat(expected, counts), MAX_RANGE)
    assert weighted.n_beams == repeated.n_beams
    got, want = weighted.expected_statistics(theta), repeated.expected_statistics(theta)
    assert got.log_likelihood == pytest.approx(want.log_likelihood, rel=1e-12)
    assert got.counts == pytest.approx(want.counts, rel=1e-11, abs=1e-12)
    assert weighted.derivatives(theta)[1] == pytest.approx(repeated.derivatives(theta)[1], rel=1e-9, abs=1e-9)


def test_derivatives_are_those_of_the_log_likelihood(theta):
    z, expected = beams(100)
    z = np.where(np.abs(z - expected) > 0.5, np.minimum(z, expected), z)  # no outliers that only underflow explains
    likelihood = IntrinsicLikelihood(z, expected, MAX_RANGE)
    _, gradient, hessian = likelihood.derivatives(theta)
    for i in range(8):
        step = 1e-5 * (theta[i] if theta[i] > 0.0 else 1e-3)
        if theta[i] == 0.0 and i != 6:
            continue  # on a bound: differences would leave it
        up, down = theta.copy(), theta.copy()
        up[i] += step
        down[i] -= step
        slope = (likelihood.derivatives(up)[0] - likelihood.derivatives(down)[0]) / (2.0 * step)
        curvature = (likelihood.derivatives(up)[1] - likelihood.derivatives(down)[1]) / (2.0 * step)
        scale = np.sqrt(np.abs(np.diag(hessian)) + 1.0)
        assert abs(slope - gradient[i]) <= 1e-5 * scale[i] * (1.0 + np.sqrt(z.size))
        assert np.all(np.abs(curvature - hessian[i]) <= 1e-4 * scale[i] * scale)


@pytest.mark.parametrize("x", [(0.09, 0.0, 0.0), (0.04, 0.01, 0.1), (1.5, 0.0, -0.4)], ids=["plain", "slope", "wide"])
def test_the_objective_of_hits_is_the_log_density_of_readings_at_the_nodes(x):
    """Three readings at each of some expected ranges, near the limits of [0, 8) too; slopes by differences."""
    nodes, origin = np.array([0.1, 0.8, 3.0, 7.5, 7.95]), 0.25
    off = np.array([-0.1, 0.02, 0.4])
    weights = np.array([np.full(5, 3.0), np.full(5, off.sum()), np.full(5, (off**2).sum())])

    def objective(v: float, q: float, b: float) -> np.ndarray:
        out = np.empty(10)
        hit_objective(nodes, weights, MAX_RANGE, origin, v, q, b, out)
        return out

    want = 0.0
    for node in nodes:
        s, mean = math.sqrt(x[0] + x[1] * (origin + node) ** 2), node + x[2]
        mass = stats.norm.cdf(MAX_RANGE, mean, s) - stats.norm.cdf(0.0, mean, s)
        want += stats.norm.logpdf(node + off, mean, s).sum() - 3.0 * math.log(mass)
    got = objective(*x)
    assert got[0] == pytest.approx(want, rel=1e-10)
    steps = np.diag([1e-6, 1e-7, 1e-6])
    slopes = np.array([(objective(*(x + d)) - objective(*(x - d))) / (2.0 * d.sum()) for d in steps])
    np.testing.assert_allclose(got[1:4], slopes[:, 0], rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(got[4:], slopes[:, 1:4][np.tril_indices(3)], rtol=1e-6, atol=1e-6)


def test_beams_that_only_an_underflowing_hit_explains_keep_a_finite_likelihood():
    theta = np.array([0.95, 0.0, 0.05, 0.0, 0.01**2, 0.0, 0.0, 0.0])
    z, expected = np.full(30, 6.0), np.full(30, 3.0)
    got = IntrinsicLikelihood(z, expected, MAX_RANGE).expected_statistics(theta)
    want = 30 * (np.log(0.95) + stats.norm.logpdf(300.0) - np.log(0.01))
    assert got.log_likelihood == pytest.approx(want, rel=1e-12)
    assert got.counts == pytest.approx([30.0, 0.0, 0.0, 0.0])


def test_an_impossible_beam_has_likelihood_zero_not_nan():
    theta = np.array([0.0, 0.95, 0.05, 0.0, 0.1**2, 0.0, 0.0, 0.0])
    got = IntrinsicLikelihood(np.array([4.0, 1.0]), np.array([3.0, 3.0]), MAX_RANGE).expected_statistics(theta)
    assert got.log_likelihood == -math.inf
    assert np.isfinite(got.counts).all()


@pytest.mark.parametrize(
    ("low", "high"), [(-1.0, 2.0), (-40.0, 50.0), (3.0, 4.0), (-4.0, -3.0), (24.9, 60.0), (25.1, 60.0), (100.0, 130.0)]
)
def test_log_mass_of_the_normal_distribution(low, high):
    near = max(low, -high, 0.0)
    if near > 0.0:
        far = high if low > 0.0 else -low
        integral = integrate.quad(lambda t: math.exp(-near * t - 0.5 * t * t), 0.0, far - near, epsabs=0, epsrel=1e-13)
        want = math.log(integral[0]) - 0.5 * near * near - 0.5 * math.log(2.0 * math.pi)
    else:
        want = math.log(stats.norm.cdf(high) - stats.norm.cdf(low))
    assert log_mass(low, high) == pytest.approx(want, rel=1e-11, abs=1e-12)


@pytest.mark.parametrize("x", [0.0, 1e-6, 9.9e-3, 1.01e-2, 0.099, 0.101, 1.0, 30.0, 699.0, 701.0])
def test_shapes_of_a_short_are_continuous_and_right(x):
    if x == 0.0:
        assert (relative_rate(x), *mean_share(x)) == (1.0, 0.5, -1 / 12)
        return
    # Mean and variance of an exponential distribution with rate x cut to [0, 1].
    density = integrate.quad(lambda u: math.exp(-x * u), 0.0, min(1.0, 50 / x), epsrel=1e-13, epsabs=0)[0]
    mean = integrate.quad(lambda u: u * math.exp(-x * u), 0.0, min(1.0, 50 / x), epsrel=1e-13, epsabs=0)[0] / density
    square = integrate.quad(lambda u: (u - mean) ** 2 * math.exp(-x * u), 0.0, min(1.0, 50 / x), epsrel=1e-13, epsabs=0)
    assert relative_rate(x) == pytest.approx(1.0 / density, rel=1e-12)
    share, slope = mean_share(x)
    assert share == pytest.approx(mean, rel=1e-11)
    assert slope == pytest.approx(-square[0] / density, rel=1e-9)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="several tasks need more beams than interpreted loops can take")
def test_any_number_of_threads_gives_the_same_bits():
    rng = np.random.default_rng(1)
    expected = rng.uniform(0.1, 7.9, 120_000)
    z = np.clip(rng.normal(expected, 0.1), 0.0, MAX_RANGE)
    theta = np.array(THETAS["offset and slope"])
    likelihood = IntrinsicLikelihood(z, expected, MAX_RANGE)
    with forced_threads(1):
        one, derivatives = likelihood.expected_statistics(theta), likelihood.derivatives(theta)
    with forced_threads(5):
        assert likelihood.expected_statistics(theta).log_likelihood == one.log_likelihood
        for values, same in zip(derivatives[1:], likelihood.derivatives(theta)[1:], strict=True):
            assert np.array_equal(values, same)
