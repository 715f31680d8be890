"""The landmark model beside Table 6.4 and beside every assignment tried one by one; passes with the JIT off as well."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import integrate, stats

from beamfield.detections import SPURIOUS, UNKNOWN, Detections
from beamfield.errors import InvalidInputError
from beamfield.geometry import compose
from beamfield.kernels import landmark as kernels
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from tests.reference.landmark_tables import (
    best_exclusive,
    landmark_model_known_correspondence,
    spurious_density,
    sum_over_correspondences,
    table_6_4_to_the_letter,
)

POSITIONS = [(2.0, 1.0), (-1.0, 3.0), (0.5, -2.5)]
SIGMAS = (0.3, 0.2, 0.5)
COLOURS = [1.0, 2.0, 4.0]
PARAMETERS = LandmarkParameters(*SIGMAS[:2], spurious_rate=0.1, max_range=6.0)
MAP = LandmarkMap(POSITIONS, ids=[7, 3, 12])
POSES = np.array([[0.0, 0.0, 0.0], [0.4, -0.3, 2.5], [1.0, 1.5, -3.1], [-2.0, 0.7, 40.0], [2.5, 1.0, 3.0]])
FEATURES = [(2.1, 0.5, None), (3.0, -2.9, None), (None, 1.0, None), (2.2, None, None), (1.0, 3.3, None)]


def detections(features=FEATURES, ids=None) -> Detections:
    columns = [[math.nan if value is None else value for value in column] for column in zip(*features, strict=True)]
    signatures = None if np.isnan(columns[2]).all() else columns[2]
    return Detections(columns[0], columns[1], signatures, ids)


def model(correspondence="known", parameters=PARAMETERS, landmarks=MAP, **options) -> LandmarkModel:
    return LandmarkModel(landmarks, parameters, correspondence=correspondence, **options)


def test_known_correspondence_is_table_6_4_with_the_heading_of_6_40():
    which = [0, 1, 2, 0, 1]
    got = model().detection_log_likelihood(detections(ids=[7, 3, 12, 7, 3]), POSES)
    for i, pose in enumerate(POSES):
        for k, feature in enumerate(FEATURES):
            q = landmark_model_known_correspondence(feature, which[k], pose, POSITIONS, SIGMAS)
            assert got[i, k] == pytest.approx(math.log(q), rel=1e-9, abs=1e-9)


def test_line_4_as_printed_is_right_only_for_robots_that_look_along_x():
    feature = (2.1, 0.5, None)
    z = detections([feature], ids=[7])
    for pose, same in ((POSES[0], True), (POSES[1], False)):
        printed = table_6_4_to_the_letter(feature, 0, pose, POSITIONS, SIGMAS)
        assert (math.exp(model().log_likelihood(z, pose)) == pytest.approx(printed, rel=1e-9)) is same


def test_no_features_with_signatures_are_no_features():
    coloured = LandmarkMap(POSITIONS, signatures=COLOURS)
    m = model("sum", LandmarkParameters(*SIGMAS, spurious_rate=0.1, max_range=6.0), coloured)
    assert m.log_likelihood(Detections([], [], []), POSES).tolist() == [0.0] * len(POSES)


@pytest.mark.parametrize("kind", ["number", "vector", "type"])
def test_features_of_which_none_shows_a_signature_are_features_without_signatures(kind):
    signatures = np.array([[0.0, 1.0], [1.0, 0.0]]) if kind == "vector" else np.array([0.0, 1.0])
    landmarks = LandmarkMap([[2.0, 0.0], [0.0, 3.0]], signatures=signatures, kind=kind)
    noise = LandmarkParameters(
        0.1,
        0.05,
        sigma_signature=0.2 if kind == "number" else None,
        signature_covariance=np.eye(2) if kind == "vector" else None,
        confusion=np.eye(2) if kind == "type" else None,
    )
    model = LandmarkModel(landmarks, noise, correspondence="sum")
    poses = [[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]
    unseen = Detections([2.0, 3.0], [0.0, 1.5], np.full_like(signatures, np.nan))
    plain = Detections([2.0, 3.0], [0.0, 1.5])
    assert np.array_equal(model.log_likelihood(unseen, poses), model.log_likelihood(plain, poses))


def test_a_bearing_just_across_pi_is_close_by():
    landmarks = LandmarkMap([[-2.0, 0.0]])
    z = Detections([2.0, 2.0], [np.pi - 0.01, -np.pi + 0.01], ids=[1, 1])
    close, same = model(landmarks=landmarks).detection_log_likelihood(z, [0.0, 0.0, 0.0])
    assert close == pytest.approx(same)
    assert close == pytest.approx(stats.norm.logpdf(0.0, 0.0, 0.3) + stats.norm.logpdf(0.01, 0.0, 0.2))


def test_the_polynomial_arc_tangent_is_exact_all_around(rng):
    """With a large weight on the bearing, an error of 1e-15 rad would show."""
    directions = np.concatenate([rng.uniform(-np.pi, np.pi, 2000), np.arange(-8, 9) * np.pi / 8])
    landmarks = LandmarkMap(np.column_stack([np.cos(directions), np.sin(directions)]))
    m = model(parameters=LandmarkParameters(1.0, 0.5), landmarks=landmarks)
    z = Detections(np.ones(len(directions)), np.zeros(len(directions)), ids=landmarks.ids)
    expected = stats.norm.logpdf(directions, 0.0, 0.5) + stats.norm.logpdf(0.0)
    expected -= math.log(math.erf(math.pi / (0.5 * math.sqrt(2.0))))
    np.testing.assert_allclose(m.detection_log_likelihood(z, np.zeros(3)), expected, rtol=0, atol=1e-13)


def test_the_sum_runs_over_all_landmarks_and_none():
    got = model("sum").detection_log_likelihood(detections(), POSES)
    for i, pose in enumerate(POSES):
        for k, feature in enumerate(FEATURES):
            q = sum_over_correspondences(feature, pose, POSITIONS, SIGMAS, 0.1, 6.0)
            assert got[i, k] == pytest.approx(math.log(q), rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("sigmas", [(0.3, 0.2), (1e-6, 1e-7), (5.0, 3.0), (0.01, 0.5), (2.0, 0.01)])
def test_nearest_finds_the_first_of_the_best_of_all_candidates_to_the_last_bit(sigmas):
    """Bounds leave out only what cannot win: two landmarks of one position, poses on landmarks, missing values."""
    rng = np.random.default_rng(5)
    positions = np.repeat(rng.uniform(0.0, 4.0, (15, 2)), 2, axis=0)
    features = np.column_stack([rng.uniform(-1.0, 5.0, 9), np.cos(angles := rng.uniform(-3.1, 3.1, 9)), np.sin(angles)])
    weights = np.tile(1.0 / np.array(sigmas), (9, 1))
    weights[3, 0] = weights[4, 1] = 0.0
    poses = np.column_stack([rng.uniform(0.0, 4.0, (60, 2)), rng.uniform(-9.0, 9.0, 60)])
    poses[:15, :2], poses[15, :2] = positions[::2], 1e200
    features[:5, 1:] = np.cos(0.3), np.sin(0.3)
    base = rng.choice([0.0, 1.0, -np.inf], (9, 30), p=[0.5, 0.3, 0.2])
    base[8] = -np.inf
    given = poses, np.zeros(3), np.column_stack([features, weights]), np.ascontiguousarray(positions.T), base
    none = np.full(9, -np.inf)
    none[::2] = -3.0
    each = np.empty((60, 9, 30))
    values, chosen = np.empty((60, 9)), np.empty((60, 9), dtype=np.int64)
    with np.errstate(all="ignore"):  # without the JIT they warn
        kernels.fill_candidates(*given, each)
        kernels.fill_nearest(*given, -0.5, none, values, chosen)
    best = each.max(axis=2) - 0.5
    which = np.where(none > best, 30, each.argmax(axis=2))
    which[np.maximum(best, none) == -np.inf] = 31
    np.testing.assert_array_equal(values, np.maximum(best, none))
    np.testing.assert_array_equal(chosen, which)
    assert {30, 31} < set(chosen.ravel().tolist())


@pytest.mark.parametrize("how", ["known", "nearest"])
def test_poses_of_the_next_block_are_scored_as_if_alone(how, rng):
    poses = np.column_stack([rng.uniform(0.0, 4.0, (kernels.BLOCK + 5, 2)), rng.uniform(-3.0, 3.0, kernels.BLOCK + 5)])
    m, z = model(how), detections(ids=[7, 3, 12, 7, 3]) if how == "known" else detections()
    got = m.detection_log_likelihood(z, poses)
    np.testing.assert_array_equal(got[-9:], [m.detection_log_likelihood(z, pose) for pose in poses[-9:]])


def test_nearest_is_the_least_mahalanobis_distance():
    z = detections()
    m = model("nearest", LandmarkParameters(*SIGMAS[:2]))
    squares = np.zeros((len(POSES), len(z), 3))
    for j in range(3):
        expected = m.expected(POSES)[:, None, j]
        a = (z.ranges - expected[..., 0]) / SIGMAS[0]
        b = np.angle(np.exp(1j * (z.bearings - expected[..., 1]))) / SIGMAS[1]
        squares[..., j] = np.nan_to_num(a) ** 2 + np.nan_to_num(b) ** 2
    assert (m.correspondences(z, POSES) == MAP.ids[squares.argmin(axis=-1)]).all()


def test_a_feature_far_from_every_landmark_is_of_none():
    z = Detections([2.0, 5.9], [0.0, 2.0])
    landmarks = LandmarkMap([[2.0, 0.0]])
    for how in ("nearest", "assignment", "sum"):
        assert model(how, landmarks=landmarks).correspondences(z, np.zeros(3)).tolist() == [1, SPURIOUS]


@pytest.mark.parametrize("rate", [0.1, 0.001])
def test_assignment_is_the_best_of_all_exclusive_correspondences(rate):
    features = FEATURES[:4]
    z = detections(features)
    m = model("assignment", LandmarkParameters(*SIGMAS[:2], spurious_rate=rate, max_range=6.0))
    for pose in POSES:
        best, choice = best_exclusive(features, pose, POSITIONS, SIGMAS, rate, 6.0)
        assert math.exp(m.log_likelihood(z, pose)) == pytest.approx(best, rel=1e-8)
        expected = [SPURIOUS if j is None else MAP.ids[j] for j in choice]
        assert m.correspondences(z, pose).tolist() == expected


def test_in_a_large_map_a_feature_far_from_its_nearest_landmark_is_of_none_by_every_correspondence():
    """Every landmark has the prior 0.7 / 1000: over two sigmas off, the nearest has 1.6% of the posterior."""
    grid = np.stack(np.meshgrid(np.arange(1, 41) * 50.0, np.arange(25) * 50.0), axis=-1).reshape(-1, 2)
    landmarks, parameters = LandmarkMap(grid), LandmarkParameters(0.5, 0.1, spurious_rate=0.3, max_range=60.0)
    feature = (49.0, 0.25, None)
    none = 0.3 * spurious_density(feature, 60.0)
    whole = sum_over_correspondences(feature, (0.0, 0.0, 0.0), grid, (0.5, 0.1), 0.3, 60.0)
    assert none / whole > 0.98
    for how in ("sum", "nearest", "assignment"):
        m = LandmarkModel(landmarks, parameters, correspondence=how)
        assert m.correspondences(detections([feature]), np.zeros(3)).tolist() == [SPURIOUS]
        expected = whole if how == "sum" else none
        assert m.log_likelihood(detections([feature]), np.zeros(3)) == pytest.approx(math.log(expected), abs=1e-9)


def test_two_features_of_one_landmark_exclude_each_other_only_under_assignment():
    landmarks = LandmarkMap([[2.0, 0.0], [2.0, 0.5]])
    z = Detections([2.0, 2.01], [0.0, 0.01])
    assert model("nearest", landmarks=landmarks).correspondences(z, np.zeros(3)).tolist() == [1, 1]
    assert sorted(model("assignment", landmarks=landmarks).correspondences(z, np.zeros(3)).tolist()) == [1, 2]
    # A landmark that a known id names is taken.
    named = Detections([2.0, 2.01], [0.0, 0.01], ids=[1, UNKNOWN])
    assert model("assignment", landmarks=landmarks).correspondences(named, np.zeros(3)).tolist() == [1, 2]


def test_more_features_than_landmarks_are_impossible_without_spurious_ones():
    m = model("assignment", LandmarkParameters(0.3, 0.2), LandmarkMap([[2.0, 0.0]]))
    z = Detections([2.0, 2.0], [0.0, 0.0])
    assert m.log_likelihood(z, POSES).tolist() == [-np.inf] * len(POSES)
    assert m.correspondences(z, POSES[0]).tolist() == [UNKNOWN, UNKNOWN]


def test_a_known_spurious_feature_has_the_stated_density():
    z = Detections([2.0, 7.0, -0.1, np.nan], [0.3, 0.3, 0.3, 0.3], ids=[SPURIOUS] * 4)
    values = np.exp(model().detection_log_likelihood(z, POSES[0]))
    np.testing.assert_allclose(values, np.array([1.0 / 6.0, 0.0, 0.0, 1.0]) / (2.0 * np.pi))


def test_a_number_as_signature_is_gaussian_and_its_lack_says_nothing():
    landmarks = LandmarkMap(POSITIONS, [7, 3, 12], COLOURS)
    parameters = LandmarkParameters(*SIGMAS[:2], SIGMAS[2], spurious_rate=0.1, max_range=6.0)
    features = [(2.1, 0.5, 1.3), (3.0, -2.9, 3.0), (2.2, 1.0, None)]
    got = model("known", parameters, landmarks).detection_log_likelihood(detections(features, [7, 3, 12]), POSES)
    for i, pose in enumerate(POSES):
        for k, feature in enumerate(features):
            q = landmark_model_known_correspondence(feature, k, pose, POSITIONS, SIGMAS, COLOURS)
            assert got[i, k] == pytest.approx(math.log(q), rel=1e-9, abs=1e-9)


def test_a_vector_as_signature_is_gaussian_with_its_covariance():
    covariance = np.array([[0.5, 0.2], [0.2, 0.3]])
    looks = np.array([[1.0, 2.0], [0.0, 0.0], [3.0, -1.0]])
    landmarks = LandmarkMap(POSITIONS, signatures=looks)
    parameters = LandmarkParameters(0.3, 0.2, signature_covariance=covariance)
    z = Detections([np.nan] * 3, [np.nan] * 3, [[1.2, 1.5], [np.nan, np.nan], [2.0, 0.0]], [1, 2, 3])
    got = model("known", parameters, landmarks).detection_log_likelihood(z, POSES[0])
    normal = stats.multivariate_normal(cov=covariance)
    np.testing.assert_allclose(got, [normal.logpdf([0.2, -0.5]), 0.0, normal.logpdf([-1.0, 1.0])], atol=1e-12)


def test_a_type_as_signature_uses_the_confusion_matrix():
    landmarks = LandmarkMap(POSITIONS, signatures=[0, 1, 1], kind="type")
    parameters = LandmarkParameters(0.3, 0.2, confusion=[[0.9, 0.1, 0.0], [0.2, 0.7, 0.1], [0.0, 0.0, 1.0]])
    z = Detections([np.nan] * 4, [np.nan] * 4, [1, 1, 2, np.nan], [1, 2, 1, SPURIOUS])
    got = np.exp(model("known", parameters, landmarks).detection_log_likelihood(z, POSES[0]))
    np.testing.assert_allclose(got, [0.1, 0.7, 0.0, 1.0])
    spurious = Detections([np.nan], [np.nan], [2], [SPURIOUS])
    assert np.exp(model("known", parameters, landmarks).log_likelihood(spurious, POSES[0])) == pytest.approx(1 / 3)


def test_signatures_decide_between_landmarks_that_geometry_cannot_tell_apart():
    landmarks = LandmarkMap([[2.0, 0.1], [2.0, -0.1]], signatures=[0, 1], kind="type")
    parameters = LandmarkParameters(0.3, 0.2, confusion=[[0.9, 0.1], [0.1, 0.9]])
    m = model("nearest", parameters, landmarks)
    assert m.correspondences(Detections([2.0, 2.0], [0.0, 0.0], [0, 1]), np.zeros(3)).tolist() == [1, 2]


def test_a_feature_that_nothing_explains_is_of_unknown_landmark():
    landmarks = LandmarkMap([[2.0, 0.0]], signatures=[0], kind="type")
    z = Detections([2.0], [0.0], [1])
    for how in ("nearest", "sum", "assignment"):
        m = model(how, LandmarkParameters(0.3, 0.2, confusion=np.eye(2)), landmarks)
        assert m.log_likelihood(z, np.zeros(3)) == -np.inf
        assert m.correspondences(z, np.zeros(3)).tolist() == [UNKNOWN]


@pytest.mark.parametrize("sigma", [0.2, 3.0])
def test_bearings_have_a_density_on_the_circle_whatever_the_noise(sigma):
    m = model(parameters=LandmarkParameters(0.3, sigma))
    bearings = np.linspace(-np.pi, np.pi, 4001)[1:]
    z = Detections(np.full(4000, np.nan), bearings, ids=[7] * 4000)
    assert np.exp(m.detection_log_likelihood(z, POSES[1])).mean() * 2.0 * np.pi == pytest.approx(1.0, abs=1e-4)


def test_the_spurious_signature_density_integrates_to_one():
    landmarks = LandmarkMap(POSITIONS, signatures=COLOURS)
    m = model("known", LandmarkParameters(0.3, 0.2, 0.5), landmarks)

    def density(s: float) -> float:
        return math.exp(m.log_likelihood(Detections([np.nan], [np.nan], [s], [SPURIOUS]), POSES[0]))

    assert integrate.quad(density, -20.0, 25.0)[0] == pytest.approx(1.0, abs=1e-8)


def test_expected_measurements_under_mount_and_bias_have_the_highest_density():
    mount = (0.3, -0.2, 0.9)
    parameters = LandmarkParameters(0.3, 0.2, range_bias=0.4, bearing_bias=-0.3)
    m = model(parameters=parameters, mount=mount)
    best = stats.norm.logpdf(0.0, 0.0, 0.3) + stats.norm.logpdf(0.0, 0.0, 0.2)
    for pose in POSES:
        ranges, bearings = m.expected(pose).T
        z = Detections(ranges, bearings, ids=MAP.ids)
        np.testing.assert_allclose(m.detection_log_likelihood(z, pose), best, rtol=1e-12)
        sensor = compose(pose, mount)
        assert ranges[0] - 0.4 == pytest.approx(math.dist(POSITIONS[0], sensor[:2]))


def test_ranges_with_a_scale_are_normal_around_the_scaled_distance():
    m = model(parameters=LandmarkParameters(0.3, 0.2, range_bias=0.4, range_scale=1.07))
    for pose in POSES:
        true = np.hypot(*(np.array(POSITIONS) - pose[:2]).T)
        np.testing.assert_allclose(m.expected(pose)[:, 0], 1.07 * true + 0.4, rtol=1e-14)
        z = Detections([2.0, 5.0, 0.3], [np.nan] * 3, ids=MAP.ids)
        expected = stats.norm.logpdf(z.ranges, 1.07 * true + 0.4, 0.3)
        np.testing.assert_allclose(m.detection_log_likelihood(z, pose), expected, rtol=1e-12)


def test_a_sensor_without_ranges_or_bearings_has_no_sigma_for_them(rng):
    only_bearings = model("sum", LandmarkParameters(None, 0.2, spurious_rate=0.1, max_range=6.0))
    z = only_bearings.sample(POSES[0], rng)[0]
    assert np.isnan(z.ranges).all()
    both = model("sum").log_likelihood(z.without_ids(), POSES)
    np.testing.assert_array_equal(only_bearings.log_likelihood(z.without_ids(), POSES), both)
    only_ranges = model(parameters=LandmarkParameters(0.3, None))
    assert np.isnan(only_ranges.sample(POSES[0], rng)[0].bearings).all()
    with pytest.raises(InvalidInputError, match="sigma_bearing: feature 1 has a measured value, but the sigma is None"):
        only_ranges.log_likelihood(Detections([1.0, 2.0], [np.nan, 0.1], ids=[7, 3]), POSES)
    with pytest.raises(InvalidInputError, match="sigma_range: feature 0 has a measured value"):
        only_bearings.log_likelihood(Detections([1.0], [0.2]), POSES)


def test_a_landmark_at_the_sensor_counts_as_straight_ahead():
    z = Detections([0.0], [0.1], ids=[7])
    expected = stats.norm.logpdf(0.0, 0.0, 0.3) + stats.norm.logpdf(0.1, 0.0, 0.2)
    for heading in (0.0, 2.0, -3.0):
        assert model().log_likelihood(z, [2.0, 1.0, heading]) == pytest.approx(expected)


def test_poses_beyond_any_map_are_impossible_and_not_nan():
    z = detections(ids=[7, 3, 12, 7, 3])
    with np.errstate(over="ignore", invalid="ignore"):  # NumPy's scalars warn with the JIT off
        values = model().log_likelihood(z, [[1e200, 0.0, 0.0], [-1e307, 1e307, 0.0]])
    assert values.tolist() == [-np.inf, -np.inf]


def test_only_sums_and_known_correspondences_are_densities():
    normalised = {how: model(how).is_normalized for how in ("known", "nearest", "sum", "assignment")}
    assert normalised == {"known": True, "nearest": False, "sum": True, "assignment": False}


def test_samples_see_the_landmarks_that_were_asked_for(rng):
    first, second = model().sample(POSES[:2], rng, ids=[12, 12, 7])
    assert first.ids.tolist() == second.ids.tolist() == [12, 12, 7]
    assert len(model().sample(POSES, rng)[4]) == 3


def test_sampled_signatures_follow_the_noise(rng):
    confusion = [[0.6, 0.4, 0.0], [0.1, 0.2, 0.7], [0.0, 0.0, 1.0]]
    kinds = LandmarkMap(POSITIONS, signatures=[0, 1, 2], kind="type")
    m = model("known", LandmarkParameters(0.3, 0.2, confusion=confusion), kinds)
    seen = np.array([z.signatures for z in m.sample(np.zeros((2000, 3)), rng)])
    shares = np.array([[(seen[:, j] == t).mean() for t in range(3)] for j in range(3)])
    np.testing.assert_allclose(shares, confusion, atol=4 * 0.5 / np.sqrt(2000))
    covariance = np.array([[0.5, 0.2], [0.2, 0.3]])
    vectors = LandmarkMap([[1.0, 0.0]], signatures=[[1.0, 2.0]])
    m = model("known", LandmarkParameters(0.3, 0.2, signature_covariance=covariance), vectors)
    seen = np.array([z.signatures[0] for z in m.sample(np.zeros((8000, 3)), rng)])
    np.testing.assert_allclose(np.cov(seen.T), covariance, atol=0.03)


def test_wide_bearing_noise_stays_on_the_circle(rng):
    m = model(parameters=LandmarkParameters(0.3, 2.5), landmarks=LandmarkMap([[1.0, 0.0]]))
    bearings = np.array([z.bearings[0] for z in m.sample(np.zeros((5000, 3)), rng)])
    assert stats.kstest(bearings, stats.truncnorm(-np.pi / 2.5, np.pi / 2.5, scale=2.5).cdf).pvalue > 1e-3


def test_twenty_thousand_poses_and_twenty_detections_in_one_call(rng):
    landmarks = LandmarkMap(rng.uniform(0.0, 20.0, (20, 2)))
    m = model(landmarks=landmarks)
    z = m.sample([9.0, 8.0, 0.7], rng)[0]
    poses = np.array([9.0, 8.0, 0.7]) + rng.normal(0.0, 0.3, (20_000, 3))
    values = m.log_likelihood(z, poses)
    assert values.shape == (20_000,)
    for i in (0, 511, 512, 19_999):
        q = [
            landmark_model_known_correspondence((r, phi, None), j, poses[i], landmarks.positions, SIGMAS)
            for j, (r, phi) in enumerate(zip(z.ranges, z.bearings, strict=True))
        ]
        assert values[i] == pytest.approx(np.log(q).sum(), rel=1e-9)
