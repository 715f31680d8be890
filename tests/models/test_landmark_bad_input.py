"""What users feed to the landmark model by mistake is refused by name and value, or handled as documented.

Logs hold negative ranges and bearings beyond pi.
"""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.detections import SPURIOUS, UNKNOWN, Detections
from beamfield.errors import InvalidInputError
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.landmark_poses import sample_poses

LANDMARKS = LandmarkMap([[2.0, 0.0], [0.0, 3.0]], ids=[4, 9])
NOISE = LandmarkParameters(0.3, 0.2, spurious_rate=0.05, max_range=8.0)
CORRESPONDENCES = ("known", "nearest", "sum", "assignment")
POSE = np.array([1.9, 0.1, 0.2])


def model(correspondence: str = "known") -> LandmarkModel:
    return LandmarkModel(LANDMARKS, NOISE, correspondence=correspondence)


def test_a_mount_in_degrees_is_refused():
    with pytest.raises(InvalidInputError, match="heading of mount: expected radians, at most a full turn, got 90"):
        LandmarkModel(LANDMARKS, NOISE, correspondence="sum", mount=(0.2, 0.0, 90.0))


@pytest.mark.parametrize("correspondence", CORRESPONDENCES)
def test_a_negative_range_near_a_landmark_has_the_density_of_the_noise(correspondence):
    value = model(correspondence).log_likelihood(Detections([-0.2], [0.5], ids=[4]), POSE)
    dx, dy = 2.0 - POSE[0], -POSE[1]
    r, phi = np.hypot(dx, dy), np.arctan2(dy, dx) - POSE[2]
    off = (0.5 - phi + np.pi) % (2.0 * np.pi) - np.pi
    expected = -0.5 * ((-0.2 - r) / 0.3) ** 2 - 0.5 * (off / 0.2) ** 2 - np.log(2.0 * np.pi * 0.3 * 0.2)
    assert float(value) == pytest.approx(expected, abs=1e-6)


def test_a_negative_range_still_yields_poses_around_the_landmark(rng):
    poses = sample_poses(model(), Detections([-0.2], [0.5], ids=[4]), 500, rng).poses
    away = np.hypot(poses[:, 0] - 2.0, poses[:, 1])
    assert np.isfinite(poses).all()
    # The posterior of a distance under N(-0.2; r', 0.3) lies within a few sigma of 0.
    assert 0.0 < away.max() < 1.5


@pytest.mark.parametrize("turns", [-3, -1, 1, 1000])
@pytest.mark.parametrize("correspondence", CORRESPONDENCES)
def test_a_bearing_beyond_pi_is_the_direction_it_is(correspondence, turns):
    ids = None if correspondence != "known" else [9]
    near = model(correspondence).log_likelihood(Detections([3.0], [2.8], ids=ids), POSE)
    far = model(correspondence).log_likelihood(Detections([3.0], [2.8 + 2.0 * np.pi * turns], ids=ids), POSE)
    assert float(far) == pytest.approx(float(near), abs=1e-9)


def test_an_unknown_id_is_refused_with_the_ids_there_are():
    with pytest.raises(InvalidInputError, match=r"ids?: .*\b5\b"):
        model().log_likelihood(Detections([1.0], [0.0], ids=[5]), POSE)
    with pytest.raises(InvalidInputError, match=r"\b5\b"):
        sample_poses(model(), Detections([1.0], [0.0], ids=[5]), 3, np.random.default_rng(0))


def test_a_duplicate_id_in_an_observation_is_two_features_of_one_landmark():
    """Detectors see a tag in two images; each feature counts."""
    one = model().log_likelihood(Detections([1.0], [0.1], ids=[4]), POSE)
    two = model().log_likelihood(Detections([1.0, 1.0], [0.1, 0.1], ids=[4, 4]), POSE)
    assert float(two) == pytest.approx(2.0 * float(one), rel=1e-9)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        (([np.inf], [0.0]), "ranges: expected finite numbers or NaN, got inf"),
        (([1.0], [-np.inf]), "bearings: expected finite numbers or NaN, got -inf"),
        (([1.0, 2.0], [0.0]), r"bearings: expected shape \(2,\), got \(1,\)"),
        (([1.0], [0.0], [[1.0, np.nan]]), r"all numbers or all NaN, got \[1.0, nan\] at index 0"),
        (([1.0], [0.0], None, [-3]), "ids: expected at least -2, got -3"),
        (([1.0], [0.0], None, [1.5]), "ids: expected whole numbers, got float64"),
    ],
)
def test_columns_that_are_no_detections_are_refused(columns, message):
    with pytest.raises(InvalidInputError, match=message):
        Detections(*columns)


COLOURED = LandmarkMap(LANDMARKS.positions, signatures=[1.0, 2.0])
TYPED = LandmarkMap(LANDMARKS.positions, signatures=[0, 1], kind="type")


@pytest.mark.parametrize(
    ("landmarks", "noise", "columns", "message"),
    [
        (LANDMARKS, {}, ([1.0, 2.0], [0.0, 0.0], None, [4, UNKNOWN]), "'known' .* id of every .* none for feature 1"),
        (LANDMARKS, {}, ([1.0], [0.0], [3.0], [4]), "signatures: the map's landmarks have none"),
        (LANDMARKS, {}, ([1.0], [0.0], None, [SPURIOUS]), "max_range: a spurious feature needs max_range"),
        (COLOURED, {"sigma_signature": 0.5}, ([1.0], [0.0], [[3.0, 1.0]], [1]), r"expected shape \(1,\), got \(1, 2\)"),
        (TYPED, {"confusion": np.eye(2)}, ([1.0], [0.0], [2], [1]), r"signatures: expected types 0 to 1, got 2\.0"),
    ],
    ids=["no id", "no signatures", "spurious", "shape", "type"],
)
def test_detections_that_the_model_cannot_weigh_are_refused(landmarks, noise, columns, message):
    known = LandmarkModel(landmarks, LandmarkParameters(0.3, 0.2, **noise), correspondence="known")
    with pytest.raises(InvalidInputError, match=message):
        known.log_likelihood(Detections(*columns), POSE)


def test_the_correspondence_must_be_chosen():
    with pytest.raises(TypeError, match="correspondence"):
        LandmarkModel(LANDMARKS, NOISE)
    with pytest.raises(InvalidInputError, match=r"correspondence: expected 'known', .* got 'best'"):
        model("best")


@pytest.mark.parametrize(
    ("signatures", "kind", "noise", "message"),
    [
        ([1.0, 2.0, 4.0], None, {}, "sigma_signature: expected a value, as .* 'number', got None"),
        (np.eye(3), None, {"signature_covariance": np.eye(2)}, r"signature_covariance: .* \(3, 3\), got \(2, 2\)"),
        ([0, 1, 2], "type", {"confusion": np.eye(2)}, "confusion: expected a row for type 2, got 2 rows"),
    ],
    ids=["number", "vector", "type"],
)
def test_noise_that_does_not_fit_the_map_is_refused(signatures, kind, noise, message):
    landmarks = LandmarkMap(np.zeros((3, 2)), None, signatures, kind)
    with pytest.raises(InvalidInputError, match=message):
        LandmarkModel(landmarks, LandmarkParameters(0.3, 0.2, **noise), correspondence="known")


@pytest.mark.parametrize("wrong", [0.0, -0.1, np.nan, np.inf])
@pytest.mark.parametrize("name", ["sigma_range", "sigma_bearing", "sigma_signature"])
def test_a_deviation_that_is_not_positive_is_refused(name, wrong):
    with pytest.raises(InvalidInputError, match=f"{name}: expected a positive number .*, got {wrong}"):
        LandmarkParameters(**{"sigma_range": 0.1, "sigma_bearing": 0.1, name: wrong})


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("max_range", np.inf, "max_range: .* got inf"),
        ("range_scale", 0.0, r"range_scale: expected a positive number .*, got 0.0"),
        ("range_bias", np.nan, r"range_bias: expected at most 1e\+09, got nan"),
        ("spurious_rate", 1.0, r"spurious_rate: expected a probability in \[0, 1\), got 1.0"),
        ("spurious_rate", 0.1, "max_range: expected a limit where spurious_rate > 0, got None"),
        ("signature_covariance", [1.0], "signature_covariance: expected a square matrix"),
        ("signature_covariance", np.diag([0.1, 0.0]), "signature_covariance: expected positive variances, got .*0.1"),
        ("signature_covariance", np.diag([-0.1, 0.2]), "signature_covariance: expected positive variances, got .*-0.1"),
        ("signature_covariance", [[1.0] * 2] * 2, "expected a positive definite matrix, got .*1.0, 1.0.*eigenvalue"),
        # Singular in other units.
        ("signature_covariance", [[1e-6, 1e-3], [1e-3, 1.0]], "expected a positive definite matrix"),
        ("signature_covariance", [[1.0, 2.0], [2.0, 1.0]], "a positive definite matrix, got .*eigenvalue -1"),
        ("signature_covariance", [[1.0, 0.5], [0.2, 1.0]], "signature_covariance: expected a symmetric matrix, .*0.5"),
        ("signature_covariance", [[1.0, np.inf], [np.inf, 1.0]], "signature_covariance: .* finite numbers, got inf"),
        ("confusion", [[0.9, 0.1], [0.3, 0.6]], "confusion: expected rows that sum to 1, got 0.9 in row 1"),
        ("confusion", [[1.1, -0.1], [0.5, 0.5]], r"confusion: expected probabilities in \[0, 1\], got 1.1"),
        ("confusion", [[np.nan, 1.0], [0.5, 0.5]], "confusion: expected finite numbers, got nan"),
        ("confusion", [[0.5, 0.5]], r"confusion: expected a square matrix, got shape \(1, 2\)"),
    ],
)
def test_parameters_that_are_no_noise_are_refused(name, value, message):
    with pytest.raises(InvalidInputError, match=message):
        LandmarkParameters(**{"sigma_range": 0.3, "sigma_bearing": 0.2, name: value})
