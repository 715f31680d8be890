"""What users feed to the landmark model by mistake is refused by name and value, or handled as documented.

One test for each kind of bad input. Logs hold negative ranges and bearings beyond pi.
"""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.detections import Detections
from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.landmarks.landmark_files import read_landmarks
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


def test_a_duplicate_id_in_a_map_is_refused(tmp_path):
    with pytest.raises(InvalidInputError, match=r"ids: .*\b7\b"):
        LandmarkMap(np.zeros((3, 2)), ids=[7, 8, 7])
    path = tmp_path / "map.csv"
    path.write_text("id,x,y\n7,0,0\n8,1,1\n7,2,2\n")
    with pytest.raises(FormatError, match=r"map\.csv:4: expected each id once, got 7 again after line 2"):
        read_landmarks(path)


def test_a_duplicate_id_in_an_observation_is_two_features_of_one_landmark():
    """Detectors see a tag in two images; each feature counts."""
    one = model().log_likelihood(Detections([1.0], [0.1], ids=[4]), POSE)
    two = model().log_likelihood(Detections([1.0, 1.0], [0.1, 0.1], ids=[4, 4]), POSE)
    assert float(two) == pytest.approx(2.0 * float(one), rel=1e-9)


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf])
def test_a_position_that_is_no_number_is_refused(wrong, tmp_path):
    with pytest.raises(InvalidInputError, match=rf"positions: expected finite numbers, got {wrong} at index \(1, 0\)"):
        LandmarkMap([[0.0, 1.0], [wrong, 2.0]])
    with pytest.raises(InvalidInputError, match=f"poses: expected finite numbers, got {wrong}"):
        model().log_likelihood(Detections([1.0], [0.0], ids=[4]), [wrong, 0.0, 0.0])
    path = tmp_path / "map.csv"
    path.write_text(f"id,x,y\n7,{wrong},0\n")
    with pytest.raises(FormatError, match=f"map.csv:2: .*{wrong}"):
        read_landmarks(path)


@pytest.mark.parametrize("wrong", [0.0, -0.1, np.nan, np.inf])
@pytest.mark.parametrize("name", ["sigma_range", "sigma_bearing", "sigma_signature"])
def test_a_deviation_that_is_not_positive_is_refused(name, wrong):
    with pytest.raises(InvalidInputError, match=f"{name}: expected a positive number .*, got {wrong}"):
        LandmarkParameters(**{"sigma_range": 0.1, "sigma_bearing": 0.1, name: wrong})


@pytest.mark.parametrize("variances", [(0.1, 0.0), (-0.1, 0.2)], ids=["zero", "negative"])
def test_a_covariance_without_positive_variances_is_refused(variances):
    with pytest.raises(
        InvalidInputError, match=f"signature_covariance: expected positive variances, got .*{variances[0]}"
    ):
        LandmarkParameters(0.1, 0.1, signature_covariance=np.diag(variances))


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([[0.9, 0.1], [0.3, 0.6]], "confusion: expected rows that sum to 1, got 0.9 in row 1"),
        ([[1.1, -0.1], [0.5, 0.5]], r"confusion: expected probabilities in \[0, 1\], got 1.1"),
        ([[np.nan, 1.0], [0.5, 0.5]], "confusion: expected finite numbers, got nan"),
        ([[0.5, 0.5]], r"confusion: expected a square matrix, got shape \(1, 2\)"),
    ],
    ids=["sum", "range", "nan", "shape"],
)
def test_a_confusion_matrix_that_is_none_is_refused(rows, message):
    with pytest.raises(InvalidInputError, match=message):
        LandmarkParameters(0.1, 0.1, confusion=rows)


@pytest.mark.parametrize(
    ("covariance", "message"),
    [
        ([[1.0, 1.0], [1.0, 1.0]], "expected a positive definite matrix, got .*1.0, 1.0.*eigenvalue"),
        ([[1e-6, 1e-3], [1e-3, 1.0]], "expected a positive definite matrix"),
        ([[1.0, 2.0], [2.0, 1.0]], "expected a positive definite matrix, got .*eigenvalue -1"),
        ([[1.0, 0.5], [0.2, 1.0]], "expected a symmetric matrix, got .*0.5"),
        ([[1.0, np.inf], [np.inf, 1.0]], "expected finite numbers, got inf"),
    ],
    ids=["singular", "singular in other units", "indefinite", "asymmetric", "infinite"],
)
def test_a_singular_covariance_is_refused(covariance, message):
    with pytest.raises(InvalidInputError, match=f"signature_covariance: {message}"):
        LandmarkParameters(0.1, 0.1, signature_covariance=covariance)
