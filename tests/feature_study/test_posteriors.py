"""Posteriors given a scan, its walls and its corners agree on where the scan was taken; their noise can be learned."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.feature_study.noise import TYPICAL_CORNERS
from benchmarks.feature_study.posteriors import learn_feature_noise, posteriors_of_scan
from benchmarks.rooms import drawn_room

from beamfield.errors import InvalidInputError
from beamfield.features.map_features import MapFeatures
from beamfield.localization.pose_posterior import PoseLattice
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog

NICHES = [(0, 0), (6, 0), (6, 4), (4, 4), (4, 5), (3, 5), (3, 4), (0, 4)]
PARAMETERS = BeamParameters(0.97, 0.0, 0.01, 0.02, 0.02, 1.0)


@pytest.fixture(scope="module")
def drive():
    grid, walls, corners = drawn_room(NICHES)
    rng = np.random.default_rng(6)
    poses = np.column_stack([rng.uniform(0.8, 5.2, 12), rng.uniform(0.8, 3.2, 12), rng.uniform(-3.1, 3.1, 12)])
    finder = RangeFinder.from_bearings(np.radians(np.arange(-180.0, 180.0, 2.0)), 8.0)
    scans = BeamModel(grid, PARAMETERS).sample(poses, finder, rng)
    log = SensorLog(finder, np.arange(12.0), np.array([scan.ranges for scan in scans]), poses, poses)
    lattice = PoseLattice.over_map(grid, resolution=0.25, headings=36)
    return grid, MapFeatures(walls, corners), log, lattice


def test_noise_learned_from_other_scans_finds_the_pose(drive):
    grid, features, log, lattice = drive
    noise = learn_feature_noise(log, np.arange(1, 12), grid, PARAMETERS, features, lattice)
    # The map is exact and the walls are straight: what is learned is small, and clutter far below what is typical.
    assert noise.lines.parameters.sigma_rho < 0.03
    assert noise.lines.parameters.spurious_rate < 0.2
    assert noise.lines.parameters.max_range < 6.0
    assert noise.corners.sigma_place < 0.03
    assert noise.corners.clutter < TYPICAL_CORNERS.clutter / 3.0
    result = posteriors_of_scan(
        log.scan(0), grid, PARAMETERS, features, lattice, exponent=12 / log.finder.n_beams, noise=noise
    )
    assert result.n_lines >= 4
    assert result.n_corners >= 1
    for posterior in (result.scan, result.lines):
        assert np.hypot(*(posterior.best_pose() - log.poses[0])[:2]) < 0.4
    assert 0.0 < result.corners.information < result.lines.information


def test_bad_input_is_refused(drive):
    grid, features, log, lattice = drive
    with pytest.raises(InvalidInputError, match=r"exponent: expected a number in \(0, 1\], got 2"):
        posteriors_of_scan(log.scan(0), grid, PARAMETERS, features, lattice, exponent=2.0)
