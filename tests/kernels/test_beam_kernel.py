"""The beam model's scalar formulas against SciPy; passes with the JIT off as well (NUMBA_DISABLE_JIT=1)."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from scipy import integrate, special, stats

from beamfield.kernels import beam, many_beams
from beamfield.models.beam_density import read_only
from tests.kernels.entry import Entries, entry
from tests.reference.beam_tables import integral, p_hit, p_short

MAX_RANGE = 8.0
formulas, quick_normal_below = Entries(beam), entry(many_beams._quick_normal_below)
THETA = beam.BeamView(0.6, 0.15, 0.05, 0.2, 0.1, 0.7, 0.0, 0.0, MAX_RANGE)
NO_RAND = THETA._replace(z_hit=0.8, z_rand=0.0)

Z_STARS = [0.0, 1e-12, 1e-7, 1e-6, 1e-3, 0.05, 0.3, 3.0, 7.9, MAX_RANGE]
VARIANTS = {
    "plain": THETA,
    "uniform short": THETA._replace(lambda_short=0.0),
    "steep short": THETA._replace(lambda_short=300.0),
    "nearly uniform short": THETA._replace(lambda_short=1e-9),
    "wide hit": THETA._replace(sigma_hit=20.0),
    "sharp hit": THETA._replace(sigma_hit=1e-4),
    "offset": THETA._replace(range_offset=0.17),
    "negative offset": THETA._replace(range_offset=-0.17),
    "slope": THETA._replace(sigma_slope=0.05),
    "offset far beyond the tails": THETA._replace(range_offset=9.0, sigma_hit=0.02),
    "offset far below 0": THETA._replace(range_offset=-9.0, sigma_hit=0.02),
}


def breaks(z_star, view):
    """Where the density bends sharply: around the mean, the end of short, and the ends of the interval."""
    sigma = math.hypot(view.sigma_hit, view.sigma_slope * z_star)
    mean = z_star + view.range_offset
    around_mean = mean + sigma * np.arange(-40.0, 40.5, 2.0)
    support = max(z_star, 1e-6)
    steep = support * np.concatenate([[0.0], np.geomspace(1e-9, 1.0, 40)])
    # Where the mean lies outside, the density falls off from the nearer end over a tiny length.
    outside = max(0.0, -mean, mean - view.max_range)
    decay = sigma * sigma / max(outside, sigma)
    ends = decay * np.geomspace(1e-3, 1e3, 40)
    return np.concatenate([around_mean, steep, ends, view.max_range - ends])


@pytest.mark.parametrize("variant", VARIANTS)
@pytest.mark.parametrize("z_star", Z_STARS)
def test_distribution_function_is_the_integral_of_the_density_which_is_1_with_the_point_mass(variant, z_star):
    view = VARIANTS[variant]
    edges = breaks(z_star, view)

    def density(z):
        return np.array([formulas.mixture(x, z_star, view) for x in z])

    for z in (0.0, 1e-4, 0.1, z_star, 0.999 * MAX_RANGE):
        if z < MAX_RANGE:
            expected = integral(density, 0.0, z, edges, order=12) if z > 0.0 else 0.0
            assert formulas.mixture_cdf(z, z_star, view) == pytest.approx(expected, abs=1e-9)
    assert integral(density, 0.0, MAX_RANGE, edges, order=12) == pytest.approx(1.0 - view.z_max, abs=1e-9)
    assert formulas.mixture(MAX_RANGE, z_star, view) == view.z_max
    assert formulas.mixture_cdf(MAX_RANGE, z_star, view) == 1.0
    just_below = formulas.mixture_cdf(math.nextafter(MAX_RANGE, 0.0), z_star, view)
    assert just_below == pytest.approx(1.0 - view.z_max, abs=1e-9)


def test_hit_density_is_a_truncated_normal():
    for z, z_star, sigma in itertools.product([0.0, 0.02, 2.9, 3.0, 3.4, 7.99], [0.0, 0.1, 3.0, 7.9, 8.0], [0.1, 3.0]):
        view = THETA._replace(sigma_hit=sigma)
        assert formulas.hit_density(z, z_star, view) == pytest.approx(p_hit(z, z_star, sigma, MAX_RANGE), rel=1e-10)


def test_short_density_is_a_truncated_exponential():
    for z, z_star, rate in itertools.product([0.0, 0.02, 2.9, 3.1], [1e-3, 0.1, 3.0, 8.0], [0.0, 0.1, 2.0, 400.0]):
        view = THETA._replace(lambda_short=rate)
        assert formulas.short_density(z, z_star, view) == pytest.approx(p_short(z, z_star, rate), rel=1e-10)


def test_rand_density_and_max_mass_do_not_overlap():
    below = math.nextafter(MAX_RANGE, 0.0)
    assert formulas.rand_density(below, MAX_RANGE) == 1.0 / MAX_RANGE
    assert formulas.max_mass(below, MAX_RANGE) == 0.0
    assert formulas.rand_density(MAX_RANGE, MAX_RANGE) == 0.0
    assert formulas.max_mass(MAX_RANGE, MAX_RANGE) == 1.0


def test_at_max_range_only_the_point_mass_counts():
    """Table 6.1 read literally would add p_hit there, a density: 0.6 * 7.98 for a ray that hits nothing."""
    assert formulas.mixture(MAX_RANGE, MAX_RANGE, THETA) == THETA.z_max
    assert formulas.mixture(math.inf, 3.0, THETA) == THETA.z_max


def test_mixture_at_one_hand_computed_point():
    # z = 2.9, z* = 3: hit N(-1 sigma) = 0.241970724519143 / 0.1; short 0.7 e^-2.03 / (1 - e^-2.1); rand 1 / 8.
    hit = 2.41970724519143
    short = 0.7 * math.exp(-2.03) / (1.0 - math.exp(-2.1))
    assert formulas.mixture(2.9, 3.0, THETA) == pytest.approx(0.6 * hit + 0.15 * short + 0.2 / 8.0, rel=1e-13)


def test_no_unity_shortcut_where_it_would_show():
    """The normaliser is taken as 1 beyond 8.3 sigma from both limits; both sides of that border agree."""
    sigma = 0.1
    for mean in (8.29 * sigma, 8.31 * sigma, MAX_RANGE - 8.29 * sigma, MAX_RANGE - 8.31 * sigma):
        factor, edge = formulas.hit_normaliser(mean, sigma, MAX_RANGE)
        assert edge == 0.0
        assert factor == pytest.approx(1.0 / (sigma * math.sqrt(2.0 * math.pi)), rel=3e-16)


@pytest.mark.parametrize("near", [0.5, 3.0, 24.0, 26.0, 60.0, 1e3, 1e8])
def test_normal_integral_far_in_a_tail(near):
    """Against scaled complementary error functions: integral over [a, inf) of exp(-(t^2 - a^2) / 2)."""
    value, edge = formulas.normal_interval(near, math.inf)
    mirrored = formulas.normal_interval(-math.inf, -near)
    scaled = value * math.exp(0.5 * (near * near - edge * edge)) if near < 25.0 else value
    assert scaled == pytest.approx(math.sqrt(math.pi / 2.0) * special.erfcx(near / math.sqrt(2.0)), rel=1e-12)
    assert mirrored == (value, edge)


@pytest.mark.parametrize(("low", "width"), [(0.1, 1e-9), (3.0, 1e-3), (12.0, 0.5), (40.0, 0.01), (1e5, 1e-7)])
def test_normal_integral_over_a_narrow_slice(low, width):
    value, edge = formulas.normal_interval(low, low + width)
    width = (low + width) - low
    reference, _ = integrate.quad(lambda t: math.exp(-t * (low + 0.5 * t)), 0.0, width, epsabs=0.0, epsrel=1e-13)
    assert edge == low
    assert value == pytest.approx(reference, rel=1e-12)


def test_normal_integral_of_nothing_is_zero():
    assert formulas.normal_interval(2.0, 2.0) == (0.0, 0.0)


def test_hit_density_with_its_mean_far_outside_the_limits():
    """40 sigma above max_range the plain normaliser (6.6) underflows; the density there is nearly exponential."""
    sigma, distance = 0.1, 4.0
    view = THETA._replace(range_offset=distance, sigma_hit=sigma)
    reference = stats.truncnorm.logpdf(7.999, -120.0, -40.0, loc=MAX_RANGE + distance, scale=sigma)
    assert math.log(formulas.hit_density(7.999, MAX_RANGE, view)) == pytest.approx(reference, rel=1e-8)


def test_no_expected_range_gives_a_density_that_is_not_finite():
    for z_star in Z_STARS:
        for view in VARIANTS.values():
            for z in (0.0, 5e-324, 1e-7, 1.0, z_star):
                assert math.isfinite(formulas.mixture(z, z_star, view))


def test_nearly_uniform_short_keeps_its_digits():
    """lambda z* = 9e-9 is on the series' side of the border; expm1 is exact on both."""
    for rate in (1e-12, 3e-9, 4e-9):
        view = THETA._replace(lambda_short=rate)
        assert formulas.short_cdf(1.5, 3.0, view) == pytest.approx(
            math.expm1(-rate * 1.5) / math.expm1(-rate * 3), rel=1e-15
        )
        assert formulas.short_factor(3.0, rate) == pytest.approx(rate / -math.expm1(-rate * 3.0), rel=1e-15)


def test_inside_a_wall_short_readings_are_explained_by_the_first_micrometre_only():
    assert formulas.short_density(0.0, 0.0, THETA) == pytest.approx(1e6, rel=1e-6)
    assert formulas.short_density(2e-6, 0.0, THETA) == 0.0


def test_log_does_not_underflow_for_possible_readings():
    """60 sigma off without a random component: log density -1800 + constants, not -inf."""
    expected = math.log(0.8) + stats.norm.logpdf(7.5, loc=1.5, scale=0.1)
    assert formulas.log_mixture(7.5, 1.5, NO_RAND) == pytest.approx(expected, rel=1e-13)


def test_log_does_not_underflow_for_shorts_far_out_in_their_tail():
    """An exponential of rate 400 at 2.5 m, where the hit is 5 m off: log(0.15) + log(400) - 1000."""
    view = NO_RAND._replace(z_hit=0.8, lambda_short=400.0, sigma_hit=0.01)
    assert formulas.log_mixture(2.5, 7.5, view) == pytest.approx(math.log(0.15) + math.log(400.0) - 1000.0, rel=1e-14)


def test_log_is_minus_infinity_only_for_impossible_readings():
    only_short = beam.BeamView(0.0, 1.0, 0.0, 0.0, 0.1, 0.7, 0.0, 0.0, MAX_RANGE)
    assert formulas.log_mixture(4.0, 3.0, only_short) == -math.inf
    assert formulas.log_mixture(MAX_RANGE, 3.0, only_short) == -math.inf
    assert formulas.log_mixture(2.0, 3.0, only_short) > -math.inf


@pytest.mark.parametrize("z", [math.nan, -0.1, -math.inf])
def test_no_measurement_contributes_nothing(z):
    assert formulas.log_mixture(z, 3.0, THETA) == 0.0
    assert formulas.responsibilities(z, 3.0, THETA) == (0.0, 0.0, 0.0, 0.0)
    assert math.isnan(formulas.mixture_cdf(z, 3.0, THETA))


def test_unknown_expected_range_contributes_nothing():
    assert formulas.log_mixture(1.0, math.nan, THETA) == 0.0


def test_responsibilities_are_the_weighted_shares():
    z, z_star = 2.8, 3.0
    parts = [0.6 * p_hit(z, z_star, 0.1, MAX_RANGE), 0.15 * p_short(z, z_star, 0.7), 0.0, 0.2 / MAX_RANGE]
    assert formulas.responsibilities(z, z_star, THETA) == pytest.approx(np.array(parts) / sum(parts), rel=1e-12)
    assert formulas.responsibilities(MAX_RANGE, z_star, THETA) == (0.0, 0.0, 1.0, 0.0)


def test_responsibilities_survive_underflow():
    assert formulas.responsibilities(7.5, 1.5, NO_RAND) == (1.0, 0.0, 0.0, 0.0)
    # 40 sigma from the wall, where shorts as far from the sensor are as rare as hits.
    z, z_star, view = 3.0, 7.0, NO_RAND._replace(lambda_short=267.0)
    logs = np.array([math.log(0.8) + stats.norm.logpdf(z, z_star, 0.1), math.log(0.15 * 267.0) - 267.0 * z])
    hit, short, *others = formulas.responsibilities(z, z_star, view)
    assert (hit, short) == pytest.approx(special.softmax(logs), rel=1e-9)
    assert min(hit, short) > 0.01
    assert others == [0.0, 0.0]


def test_vectorised_normal_distribution_function_is_exact_to_rounding():
    t = np.linspace(0.0, 9.0, 5000)
    np.testing.assert_allclose([quick_normal_below(v) for v in t], special.ndtr(t), rtol=0, atol=5e-16)


def adversarial_beams(rng, n_poses):
    """Return ranges (k,) and expected ranges (n_poses, k): all special values against each other, and random ones."""
    special_values = [0.0, 5e-324, 1e-7, 1e-6, 2e-6, 0.3, 0.83, 7.17, 7.9999, math.nextafter(MAX_RANGE, 0.0), MAX_RANGE]
    ranges = np.concatenate([special_values, rng.uniform(0.0, MAX_RANGE, 29)])
    expected = rng.uniform(0.0, 9.0, (n_poses, ranges.size))
    for i, value in enumerate([*special_values, np.nan, 9.0, np.inf]):
        expected[i] = value
    expected[14:20] = np.clip(ranges + rng.normal(0.0, 0.1, (6, ranges.size)), 0.0, None)
    return read_only(ranges), read_only(expected)


@pytest.mark.parametrize("variant", VARIANTS)
def test_vectorised_loops_equal_the_scalar_formulas(variant):
    view = VARIANTS[variant]
    ranges, expected = adversarial_beams(np.random.default_rng(8), 40)
    flat_ranges, flat_expected = read_only(np.tile(ranges, len(expected))), expected.ravel()
    out = np.empty(flat_ranges.size)
    many_beams.fill_log_density(flat_ranges, flat_expected, view, out)
    capped = np.where(np.isnan(flat_expected), np.nan, np.minimum(flat_expected, MAX_RANGE))
    one_by_one = [formulas.log_mixture(z, z_star, view) for z, z_star in zip(flat_ranges, capped, strict=True)]
    np.testing.assert_allclose(out, one_by_one, rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("density", [1e-30, 1e-15, 1e-8, 1e12])
@pytest.mark.parametrize("k", [1, 7, 8, 37, 200])
def test_products_do_not_leave_the_numbers_that_there_are(density, k):
    """A plain product of many such densities would be 0 or infinite."""
    sharp = beam.BeamView(1.0, 0.0, 0.0, 0.0, 0.4 / density, 0.5, 0.0, 0.0, MAX_RANGE)
    rare = beam.BeamView(1.0 - density * MAX_RANGE, 0.0, 0.0, density * MAX_RANGE, 0.01, 0.5, 0.0, 0.0, MAX_RANGE)
    view, at = (sharp, 3.0) if density > 1.0 else (rare, 5.0)
    out = np.empty(2)
    with np.errstate(over="ignore"):
        many_beams.fill_scan_log_likelihood(read_only(np.full(k, at)), read_only(np.full((2, k), 3.0)), view, out)
    assert out.tolist() == pytest.approx([k * formulas.log_mixture(at, 3.0, view)] * 2, rel=1e-13)


@pytest.mark.parametrize("k", [15, 16])
def test_rare_readings_after_less_rare_ones_do_not_underflow_their_product(k):
    """Eight densities of 1e-14 leave room for no seven of 1e-29."""
    view = THETA._replace(z_rand=0.0, z_short=0.0)
    ranges = np.where(np.arange(k) < 8, 3.8, 4.17)
    each = [formulas.log_mixture(z, 3.0, view) for z in ranges]
    assert sum(each) < math.log(1e-308)
    out = np.empty(1)
    many_beams.fill_scan_log_likelihood(read_only(ranges), read_only(np.full((1, k), 3.0)), view, out)
    assert out[0] == pytest.approx(sum(each), rel=1e-13)


def test_product_of_many_beams_is_the_sum_of_their_logs():
    ranges, expected = adversarial_beams(np.random.default_rng(5), 37)
    for view in (THETA, NO_RAND, THETA._replace(sigma_hit=1e-5), THETA._replace(sigma_hit=1e-150)):
        out = np.empty(37)
        # Products of eight may overflow, and are then taken apart; with the JIT off, NumPy says so.
        with np.errstate(over="ignore"):
            many_beams.fill_scan_log_likelihood(ranges, expected, view, out)
        each = np.empty(expected.size)
        many_beams.fill_log_density(read_only(np.tile(ranges, 37)), expected.ravel(), view, each)
        np.testing.assert_allclose(out, each.reshape(37, -1).sum(axis=1), rtol=1e-13)
