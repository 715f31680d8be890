"""The landmark model on UTIAS MRCLAM: poses from motion capture, features with true ids."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.io import loadmat

from beamfield.detections import Detections
from beamfield.geometry import wrap_angle
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters

pytestmark = pytest.mark.real

# A few hundred moments are enough, and keep the test short.
EVERY = 20


@pytest.fixture(scope="module")
def moments(data: Path) -> tuple[LandmarkMap, list[tuple[np.ndarray, Detections]]]:
    content = loadmat(data / "mrclam_instant" / "mrclam1.mat")
    landmarks = LandmarkMap(content["landmark"][:, 1:], content["landmark"][:, 0].astype(np.int64))
    poses = {int(row[0]): row[1:] for row in content["groundtruth"]}
    result = []
    for moment in sorted(poses)[::EVERY]:
        rows = content["measurement"][content["measurement"][:, 0] == moment]
        result.append((poses[moment], Detections(rows[:, 2], rows[:, 3], ids=rows[:, 1].astype(np.int64))))
    return landmarks, result


def test_real_residuals_have_the_known_bias_and_spread(moments):
    landmarks, seen = moments
    model = LandmarkModel(landmarks, LandmarkParameters(0.2, 0.05), correspondence="known")
    residuals = []
    for pose, z in seen:
        expected = model.expected(pose)[landmarks.indices_of(z.ids)]
        residuals.append(np.column_stack([z.ranges - expected[:, 0], wrap_angle(z.bearings - expected[:, 1])]))
    mean, spread = np.concatenate(residuals).mean(axis=0), np.concatenate(residuals).std(axis=0)
    np.testing.assert_allclose(spread, [0.164, 0.0127], rtol=0.1)
    assert mean[0] == pytest.approx(-0.038, abs=0.02)


def test_features_without_ids_find_their_landmarks_at_the_true_pose(moments):
    landmarks, seen = moments
    parameters = LandmarkParameters(0.17, 0.013, spurious_rate=0.01, max_range=12.0)
    right = {}
    for how in ("nearest", "assignment"):
        model = LandmarkModel(landmarks, parameters, correspondence=how)
        hits = [model.correspondences(z.without_ids(), pose) == z.ids for pose, z in seen]
        right[how] = np.concatenate(hits).mean()
    assert right["nearest"] > 0.95
    assert right["assignment"] >= right["nearest"]


def test_the_true_pose_beats_its_neighbours_even_without_ids(moments, rng):
    landmarks, seen = moments
    parameters = LandmarkParameters(0.17, 0.013, spurious_rate=0.01, max_range=12.0)
    model = LandmarkModel(landmarks, parameters, correspondence="sum")
    scores = np.zeros(201)
    for pose, z in seen:
        away = rng.normal(0.0, [0.5, 0.5, 0.2], (200, 3))
        scores += model.log_likelihood(z.without_ids(), np.vstack([pose, pose + away]))
    assert scores.argmax() == 0
