"""Noise learned from real landmark sensors: cameras, ranging radios, infrared beacons."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from benchmarks.landmark_sets import read_mrclam, read_plaza, read_roh

from beamfield.landmark_noise.learning import LandmarkLearningResult, learn_landmark_parameters

pytestmark = pytest.mark.real


def names_of(result: LandmarkLearningResult) -> set[str]:
    return {finding.name for finding in result.findings}


def holds(result: LandmarkLearningResult, name: str, value: float) -> bool:
    low, high = result.intervals[name]
    return low <= value <= high


def test_mrclam_has_the_known_moments(data: Path):
    landmarks, log = read_mrclam(data / "mrclam_instant" / "mrclam1.mat")
    plain = learn_landmark_parameters(landmarks, log, fit_spurious=False, fit_scale=False, n_replicates=20)
    assert plain.n_sightings == 32970
    p = plain.parameters
    assert p.range_bias == pytest.approx(-0.038, abs=5e-4)
    assert p.sigma_range == pytest.approx(0.164, abs=5e-4)
    assert p.sigma_bearing == pytest.approx(0.0127, abs=1e-4)
    assert {"range-sigma-by-distance", "bearing-heavy-tails"} <= names_of(plain)
    mixed = learn_landmark_parameters(landmarks, log, fit_scale=False, n_replicates=20)
    assert mixed.log_likelihood > plain.log_likelihood


@pytest.mark.parametrize(("number", "bias", "sigma"), [(1, 2.79, 1.15), (2, 2.93, 1.56)])
def test_ranging_radios_measure_seven_per_cent_too_far(number, bias, sigma, data: Path):
    landmarks, log = read_plaza(data / "plaza_range_only" / f"Plaza{number}_.mat")
    biased = learn_landmark_parameters(landmarks, log, fit_scale=False)
    assert biased.parameters.range_bias == pytest.approx(bias, abs=0.01)
    assert biased.parameters.sigma_range == pytest.approx(sigma, abs=0.01)
    assert biased.parameters.sigma_bearing is None
    assert "range-bias" in names_of(biased)
    # Left to itself, the learner finds that the bias is a scale: the same in both sets.
    scaled = learn_landmark_parameters(landmarks, log)
    assert holds(scaled, "range_scale", 1.0695)
    assert holds(scaled, "range_bias", 0.0)
    assert scaled.parameters.sigma_range < 0.58
    assert scaled.log_likelihood > biased.log_likelihood + 0.5
    assert "range-scale" in names_of(scaled)


def test_infrared_beacons_have_degrees_of_noise_from_place_to_place(data: Path):
    landmarks, log = read_roh(data / "roh_bearing")
    result = learn_landmark_parameters(landmarks, log)
    assert (result.n_sightings, result.n_blocks) == (7200, 9)
    assert result.parameters.sigma_range is None
    # Within one place and beacon the deviation is 0.4 to 4 degrees; over all places offsets of each come on top.
    assert 1.5 < np.rad2deg(result.parameters.sigma_bearing) < 3.5
    each = [
        np.std(result.table.bearing_residuals[(result.table.blocks == b) & (result.table.landmarks == j)])
        for b in range(9)
        for j in range(4)
    ]
    assert np.rad2deg(np.min(each)) == pytest.approx(0.37, abs=0.05)
    assert np.rad2deg(np.max(each)) == pytest.approx(4.2, abs=0.1)
    assert "bearing-heavy-tails" in names_of(result)
