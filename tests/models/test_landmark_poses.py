"""Sampled poses beside the posterior on a fine grid of poses."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate, stats

from beamfield.detections import SPURIOUS, UNKNOWN, Detections
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.landmark_poses import PoseSamples, log_distance_mass, sample_distances, sample_poses

REACH, FINE, COARSE = 3.5, 112, 7
PARAMETERS = LandmarkParameters(0.4, 0.5, max_range=3.0)
ONE = Detections([1.0], [0.6], ids=[1])


def model(landmarks=((0.2, -0.1),), parameters=PARAMETERS, **options) -> LandmarkModel:
    landmarks = landmarks if isinstance(landmarks, LandmarkMap) else LandmarkMap(landmarks)
    return LandmarkModel(landmarks, parameters, correspondence="sum", **options)


def posterior_in_bins(of: LandmarkModel, z: Detections, keep=None) -> np.ndarray:
    """Return the share of each of 7 x 7 x 7 bins of x, y, theta, from 112^3 poses."""
    line = (np.arange(FINE) + 0.5) / FINE * 2.0 - 1.0
    poses = np.stack(np.meshgrid(REACH * line, REACH * line, np.pi * line, indexing="ij"), axis=-1)
    density = np.exp(of.log_likelihood(z, poses))
    if keep is not None:
        density *= keep(poses)
    step = FINE // COARSE
    share = density.reshape(COARSE, step, COARSE, step, COARSE, step).sum(axis=(1, 3, 5))
    return share / share.sum()


def weights_in_bins(poses: np.ndarray, weights: np.ndarray) -> np.ndarray:
    edges = [np.linspace(-end, end, COARSE + 1) for end in (REACH, REACH, np.pi)]
    return np.histogramdd(poses, edges, weights=weights)[0]


def chi_square_p(poses: np.ndarray, shares: np.ndarray) -> float:
    seen, expected = weights_in_bins(poses, np.ones(len(poses))).ravel(), shares.ravel() * len(poses)
    many = expected > 8.0
    seen = np.append(seen[many], len(poses) - seen[many].sum())
    expected = np.append(expected[many], expected[~many].sum())
    return float(stats.chisquare(seen, expected).pvalue)


def in_disc(poses: np.ndarray) -> np.ndarray:
    return np.hypot(poses[..., 0] - 0.2, poses[..., 1] + 0.1) <= 3.0


@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (0.3, -0.2, 0.8)], ids=["centre", "mounted"])
def test_exact_poses_follow_the_posterior_under_a_uniform_prior(mount, rng):
    of = model(mount=mount)
    samples = sample_poses(of, ONE, 20_000, rng)
    assert chi_square_p(samples.poses, posterior_in_bins(of, ONE)) > 1e-3
    assert np.exp(samples.log_weights).sum() == pytest.approx(1.0)
    assert samples.effective_size == pytest.approx(20_000)


def test_the_table_s_poses_are_too_dense_on_the_inside(rng):
    of = model()
    shares = posterior_in_bins(of, ONE)
    samples = sample_poses(of, ONE, 20_000, rng, method="table")
    assert chi_square_p(samples.poses, shares) < 1e-6
    # What its distances do follow: the normal itself.
    distances = np.hypot(samples.poses[:, 0] - 0.2, samples.poses[:, 1] + 0.1)
    assert stats.kstest(distances, stats.foldnorm(1.0 / 0.4, scale=0.4).cdf).pvalue > 1e-3


def test_range_only_leaves_the_heading_free_and_bearing_only_the_distance_up_to_the_limit(rng):
    for z in (Detections([1.0], [np.nan], ids=[1]), Detections([np.nan], [0.6], ids=[1])):
        limited = bool(np.isnan(z.ranges[0]))
        # A bin on the rim of the disc is known only to the fine grid's step: 8000 poses do not see the difference.
        samples = sample_poses(model(), z, 8_000, rng)
        assert chi_square_p(samples.poses, posterior_in_bins(model(), z, in_disc if limited else None)) > 1e-3


def test_poses_stay_in_free_space(rng):
    room = np.zeros((14, 14))
    room[:, 8:] = 100
    room[3:6, 2:5] = -1
    grid = OccupancyGrid.from_ros(room, 0.5, (-3.5, -3.5, 0.0))
    of = model()
    samples = sample_poses(of, ONE, 15_000, rng, grid=grid)
    shares = posterior_in_bins(of, ONE, lambda poses: grid.look_up(grid.free, poses[..., :2]))
    assert chi_square_p(samples.poses, shares) > 1e-3


@pytest.mark.parametrize(
    "z",
    [
        Detections([1.0, 1.5], [0.6, -0.8], ids=[1, 2]),
        Detections([1.0, np.nan, np.nan], [np.nan, 0.3, 2.0], ids=[1, 2, 1]),
        Detections([1.0, 1.5], [0.6, -0.8]),
    ],
    ids=["range and bearing", "mixed", "unknown ids"],
)
def test_weighted_poses_follow_the_posterior_given_all_features(z, rng):
    landmarks = [(0.2, -0.1), (-0.6, 0.8)]
    of = model(landmarks)

    def within(poses):
        """Within max_range of the landmark of every feature without a range."""
        keep = np.ones(poses.shape[:-1], dtype=bool)
        for k in np.flatnonzero(np.isnan(z.ranges)):
            x, y = landmarks[z.ids[k] - 1]
            keep &= np.hypot(poses[..., 0] - x, poses[..., 1] - y) <= 3.0
        return keep

    samples = sample_poses(of, z, 40_000, rng)
    weights = np.exp(samples.log_weights)
    got = weights_in_bins(samples.poses, weights)
    error = np.sqrt(weights_in_bins(samples.poses, weights**2)) + 1e-4
    assert np.abs((got - posterior_in_bins(of, z, within)) / error).max() < 4.5
    assert samples.effective_size > 1000


def test_a_signature_chooses_the_landmark(rng):
    landmarks = LandmarkMap([[-50.0, 0.0], [50.0, 0.0]], signatures=[0, 1], kind="type")
    of = model(landmarks, LandmarkParameters(0.4, 0.5, confusion=[[0.9, 0.1], [0.3, 0.7]]))
    poses = sample_poses(of, Detections([1.0], [0.0], [0]), 4000, rng).poses
    # 0.9 against 0.3
    assert (poses[:, 0] < 0.0).mean() == pytest.approx(0.75, abs=0.03)


def test_biases_are_taken_off(rng):
    of = model(parameters=LandmarkParameters(0.01, 0.01, range_bias=0.5, bearing_bias=0.2))
    poses = sample_poses(of, ONE, 500, rng).poses
    assert np.hypot(poses[:, 0] - 0.2, poses[:, 1] + 0.1).mean() == pytest.approx(0.5, abs=0.01)


def test_bias_and_scale_are_taken_out_of_poses_and_of_their_weights():
    two = LandmarkMap([[0.2, -0.1], [1.0, 0.8]])
    measured = Detections([1.5, np.nan, 2.0], [0.6, 0.1, np.nan], ids=[1, 2, UNKNOWN])
    corrected = Detections((measured.ranges - 0.5) / 1.25, measured.bearings, ids=measured.ids)
    scaled = model(two, LandmarkParameters(0.5, 0.5, max_range=3.0, range_bias=0.5, range_scale=1.25))
    plain = model(two, LandmarkParameters(0.4, 0.5, max_range=3.0))
    got, expected = (
        sample_poses(of, z, 2000, np.random.default_rng(5)) for of, z in ((scaled, measured), (plain, corrected))
    )
    np.testing.assert_allclose(got.poses, expected.poses, atol=1e-12)
    np.testing.assert_allclose(got.log_weights, expected.log_weights, atol=1e-10)


@pytest.mark.parametrize("mean", [3.0, 0.5, 0.0, -0.2, -2.0])
def test_distances_follow_their_density_for_any_mean(mean, rng):
    def density(r):
        return r * stats.norm.pdf(r, mean, 0.5)

    mass = integrate.quad(density, 0.0, 8.0, epsabs=0.0)[0]
    assert log_distance_mass(mean, 0.5) == pytest.approx(math.log(mass), abs=1e-9)
    r = np.linspace(0.0, 8.0, 4001)
    cdf = integrate.cumulative_simpson(density(r), x=r, initial=0.0) / mass
    distances = sample_distances(mean, 0.5, 5000, rng)
    assert stats.kstest(distances, lambda at: np.interp(at, r, cdf)).pvalue > 1e-3


def test_the_seed_repeats_the_poses():
    first, second = (sample_poses(model(), ONE, 50, np.random.default_rng(3)).poses for _ in range(2))
    assert (first == second).all()


@pytest.mark.parametrize(
    ("z", "options", "message"),
    [
        (ONE, {"method": "book"}, "method: expected 'exact' or 'table', got 'book'"),
        (ONE, {"n": 0}, "n: expected 1 to 100000000, got 0"),
        (Detections([], []), {}, "expected at least one feature, got none"),
        (Detections([1.0], [0.0], ids=[SPURIOUS]), {}, "got SPURIOUS"),
        (Detections([np.nan], [np.nan], ids=[1]), {}, "feature 0 has neither range nor bearing"),
        (Detections([1.0, 1.0], [0.0, 0.0], ids=[1, 1]), {"method": "table"}, "got 2 features"),
        (Detections([1.0], [0.0], ids=[5]), {}, "ids: expected ids of the map, got 5"),
    ],
    ids=["method", "number", "none", "spurious", "nothing measured", "table of two", "unknown id"],
)
def test_bad_input_is_refused(z, options, message, rng):
    with pytest.raises(InvalidInputError, match=message):
        sample_poses(model(), z, rng=rng, **{"n": 10, **options})


def test_a_bearing_alone_needs_a_limit(rng):
    of = model(parameters=LandmarkParameters(0.4, 0.5))
    with pytest.raises(InvalidInputError, match="max_range: feature 0 has no range, but max_range is None"):
        sample_poses(of, Detections([np.nan], [0.1], ids=[1]), 10, rng)


@pytest.mark.parametrize(
    ("sigmas", "z", "message"),
    [
        ((None, 0.5), ONE, "sigma_range: feature 0 has a range, but the sigma is None"),
        ((0.4, None), ONE, "sigma_bearing: feature 0 has a bearing, but the sigma is None"),
    ],
    ids=["range", "bearing"],
)
def test_what_has_no_sigma_is_refused(sigmas, z, message, rng):
    with pytest.raises(InvalidInputError, match=message):
        sample_poses(model(parameters=LandmarkParameters(*sigmas, max_range=3.0)), z, 10, rng)


def test_a_map_without_free_space_near_the_landmark_is_reported(rng):
    grid = OccupancyGrid.from_ros(np.full((14, 14), 100), 0.5, (-3.5, -3.5, 0.0))
    with pytest.raises(TooLittleDataError, match=r"only 0 of .* lie in free space"):
        sample_poses(model(), ONE, 10, rng, grid=grid)


def test_an_impossible_type_is_reported(rng):
    landmarks = LandmarkMap([[0.0, 0.0]], signatures=[0], kind="type")
    of = model(landmarks, LandmarkParameters(0.4, 0.5, confusion=np.eye(2)))
    with pytest.raises(TooLittleDataError, match="no landmark can show the signature of feature 0"):
        sample_poses(of, Detections([1.0], [0.0], [1]), 10, rng)


def test_many_poses_print_as_their_number():
    samples = PoseSamples(np.zeros((1000, 3)), np.full(1000, -7.0))
    assert repr(samples) == "PoseSamples(poses=<1000 x 3 numbers, 0 to 0>, log_weights=<1000 numbers, -7 to -7>)"
