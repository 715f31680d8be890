"""Sensors that measure nothing below min_range: each cause of the mixture is conditioned on a reading from there on."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_density import beam_cdf, beam_components, beam_log_density, beam_pit, beam_responsibilities
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import beams_from_uniforms, sample_beams
from beamfield.sensors import RangeFinder, Scan

MAX_RANGE = 5.0
EVERYTHING = BeamParameters(0.5, 0.2, 0.1, 0.2, 0.15, 0.8, -0.07, 0.1)
CHAPTER = BeamParameters(0.6, 0.15, 0.1, 0.15, 0.1, 1.3)
UNIFORM_SHORTS = BeamParameters(0.3, 0.5, 0.1, 0.1, 0.3, 0.0, 0.2)
EXPECTED = np.array([0.31, 0.5, 1.0, 3.0, 4.9, MAX_RANGE])


def reference(z: np.ndarray, z_star: np.ndarray, p: BeamParameters, low: float) -> np.ndarray:
    """Return the mixture's density for z in [low, max_range) and z* > low, from SciPy's distributions cut to there."""
    sigma, mean = np.hypot(p.sigma_hit, p.sigma_slope * z_star), z_star + p.range_offset
    hit = stats.truncnorm.pdf(z, (low - mean) / sigma, (MAX_RANGE - mean) / sigma, loc=mean, scale=sigma)
    if p.lambda_short == 0.0:
        short = stats.uniform.pdf(z, low, z_star - low)
    else:
        law = stats.expon(scale=1.0 / p.lambda_short)
        short = np.where(z <= z_star, law.pdf(z) / (law.cdf(z_star) - law.cdf(low)), 0.0)
    return p.z_hit * hit + p.z_short * short + p.z_rand / (MAX_RANGE - low)


@pytest.mark.parametrize("parameters", [EVERYTHING, CHAPTER, UNIFORM_SHORTS], ids=["all", "chapter", "uniform shorts"])
@pytest.mark.parametrize("low", [0.0, 0.1, 0.3])
def test_the_density_is_that_of_the_causes_cut_to_what_is_measured(parameters, low):
    z, z_star = np.meshgrid(np.linspace(low, MAX_RANGE, 400, endpoint=False)[1:], EXPECTED)
    got = beam_log_density(z, z_star, MAX_RANGE, parameters, min_range=low)
    assert np.exp(got) == pytest.approx(reference(z, z_star, parameters, low), rel=1e-10)


@pytest.mark.parametrize(("low", "limit"), [(0.24, 4.0), (0.48, 5.6), (0.56, 8.0)])
def test_a_range_just_below_max_range_is_a_return(low, limit):
    below = np.nextafter(limit, 0.0)
    assert below - low == limit - low  # what must not make it one
    parameters = BeamParameters(0.0, 0.0, 0.4, 0.6, 0.1, 1.0)
    density = np.log(0.6 / (limit - low))
    assert beam_log_density([below, limit], 3.0, limit, parameters, min_range=low) == pytest.approx(
        [density, np.log(0.4)]
    )
    grid = OccupancyGrid.from_ros(np.array([[0, 100]]), resolution=1.0)
    scan = Scan([below, limit], RangeFinder.from_bearings([0.0, 0.0], min_range=low, max_range=limit))
    each = BeamModel(grid, parameters).beam_log_likelihood(scan, [0.5, 0.5, 0.0])
    assert each == pytest.approx([density, np.log(0.4)])


def test_each_cause_is_that_of_the_whole_range_over_its_mass_above_min_range():
    low, z = 0.3, np.linspace(0.3, 4.99, 50)
    slope = BeamParameters(0.4, 0.2, 0.2, 0.2, 0.1, 0.7, 0.05, 0.2)
    for z_star in EXPECTED:
        whole = beam_components(z, z_star, MAX_RANGE, slope)
        cut = beam_components(z, z_star, MAX_RANGE, slope, min_range=low)
        for cause, weights in ((0, (1.0, 0.0, 0.0, 0.0)), (1, (0.0, 1.0, 0.0, 0.0)), (3, (0.0, 0.0, 0.0, 1.0))):
            alone = BeamParameters(*weights, 0.1, 0.7, 0.05, 0.2)
            above = 1.0 - beam_cdf(low, z_star, MAX_RANGE, alone)
            assert cut[:, cause] == pytest.approx(whole[:, cause] / above, rel=1e-9)


@pytest.mark.parametrize("z_star", [0.0, 0.1, 0.3, 0.300001, 0.35, 2.0, MAX_RANGE])
def test_density_and_mass_integrate_to_one_and_to_the_distribution_function(z_star):
    low, n = 0.3, 400_000
    total = EVERYTHING.z_max
    for start, stop in ((low, low + 2e-6), (low + 2e-6, MAX_RANGE)):
        z = start + (np.arange(n) + 0.5) * (stop - start) / n
        total += np.exp(beam_log_density(z, z_star, MAX_RANGE, EVERYTHING, min_range=low)).mean() * (stop - start)
        if stop < MAX_RANGE:
            assert beam_cdf(stop, z_star, MAX_RANGE, EVERYTHING, min_range=low) == pytest.approx(
                total - EVERYTHING.z_max, abs=1e-5
            )
    assert total == pytest.approx(1.0, abs=1e-5)
    assert beam_cdf([low, MAX_RANGE], z_star, MAX_RANGE, EVERYTHING, min_range=low).tolist() == [0.0, 1.0]


def test_nearer_readings_are_no_measurements():
    near = [0.0, 0.1, np.nextafter(0.3, 0.0), np.nan]
    assert beam_log_density(near, 1.0, MAX_RANGE, CHAPTER, min_range=0.3).tolist() == [0.0] * 4
    assert not beam_responsibilities(near, 1.0, MAX_RANGE, CHAPTER, min_range=0.3).any()
    assert np.isnan(beam_cdf(near, 1.0, MAX_RANGE, CHAPTER, min_range=0.3)).all()
    assert np.isfinite(beam_log_density(0.3, 1.0, MAX_RANGE, CHAPTER, min_range=0.3))


def test_an_obstacle_in_the_blind_zone_counts_as_one_at_its_end():
    z = np.linspace(0.3, MAX_RANGE, 100)
    at_end = beam_log_density(z, 0.3, MAX_RANGE, EVERYTHING, min_range=0.3)
    for nearer in (0.0, 0.1, 0.29):
        assert (beam_log_density(z, nearer, MAX_RANGE, EVERYTHING, min_range=0.3) == at_end).all()


def test_the_weights_are_the_shares_of_the_readings_that_are_drawn(rng):
    z_star = np.full(200_000, 0.8)
    z = sample_beams(z_star, MAX_RANGE, CHAPTER, rng, min_range=0.3)
    share = beam_responsibilities(z, z_star, MAX_RANGE, CHAPTER, min_range=0.3).mean(axis=0)
    assert share == pytest.approx(CHAPTER.weights, abs=0.005)


@pytest.mark.parametrize("low", [0.0, 0.1, 0.3, 4.9])
def test_readings_that_are_drawn_are_measured_and_follow_the_distribution_function(low, rng):
    z_star = rng.uniform(0.0, 1.1 * MAX_RANGE, 50_000)
    z = sample_beams(z_star, MAX_RANGE, EVERYTHING, rng, min_range=low)
    assert z.min() >= low
    assert z.max() == MAX_RANGE
    assert (z == MAX_RANGE).mean() == pytest.approx(EVERYTHING.z_max, abs=0.006)
    pit = beam_pit(z, z_star, MAX_RANGE, EVERYTHING, rng, min_range=low)
    assert stats.kstest(pit, "uniform").pvalue > 1e-4
    u, v = rng.random((2, 50_000))
    dependent = beams_from_uniforms(u, v, z_star, MAX_RANGE, EVERYTHING, min_range=low)
    assert dependent.min() >= low
    assert stats.ks_2samp(z, dependent).pvalue > 1e-4


def test_a_draw_at_the_end_of_the_range_is_no_missing_return():
    only_random = BeamParameters(0.0, 0.0, 0.0, 1.0, 0.1, 0.0)
    last = np.nextafter(1.0, 0.0)
    for low in (0.1, 0.15, 0.3, 1.0 / 3.0):
        z = beams_from_uniforms([last], [last], [1.0], MAX_RANGE, only_random, min_range=low)
        assert low <= z[0] < MAX_RANGE
        assert np.isfinite(beam_log_density(z, 1.0, MAX_RANGE, only_random, min_range=low)).all()


def test_scans_are_scored_and_drawn_by_their_sensors_min_range(rng):
    room = np.pad(np.zeros((20, 30), int), 1, constant_values=100)
    finder = RangeFinder.from_bearings(np.linspace(-3.0, 3.0, 24), MAX_RANGE, min_range=0.3)
    model = BeamModel(OccupancyGrid.from_ros(room, 0.1), EVERYTHING, finder=finder)
    poses = rng.uniform([0.1, 0.1, -3.0], [3.1, 2.1, 3.0], (200, 3))  # some in walls, many near them
    scans = model.sample(poses, rng=rng)
    assert min(scan.ranges.min() for scan in scans) >= 0.3
    scan = Scan(np.where(np.arange(24) == 5, 0.2, scans[0].ranges), finder)
    expected = model.expected(poses)
    assert (expected < 0.3).any()  # what is expected stays the distance to the wall
    want = beam_log_density(
        np.where(scan.ranges < 0.3, np.nan, scan.ranges), expected, MAX_RANGE, EVERYTHING, min_range=0.3
    )
    assert (model.beam_log_likelihood(scan, poses) == want).all()
    assert model.log_likelihood(scan, poses) == pytest.approx(want.sum(axis=1), rel=1e-12)
    assert model.responsibilities(scan, poses[0]).sum(axis=1) == pytest.approx(np.where(np.arange(24) == 5, 0.0, 1.0))


@pytest.mark.parametrize("low", [-0.1, MAX_RANGE, np.nan, np.inf])
def test_an_impossible_min_range_is_refused(low):
    with pytest.raises(InvalidInputError, match="min_range"):
        beam_log_density(1.0, 1.0, MAX_RANGE, CHAPTER, min_range=low)
    with pytest.raises(InvalidInputError, match="min_range"):
        sample_beams([1.0], MAX_RANGE, CHAPTER, np.random.default_rng(0), min_range=low)
