"""SonarModel over grids and landmarks: where it is the beam model, where it is not, and what it recovers."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_density import beam_log_density
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.sonar import SonarModel
from beamfield.sensors import RangeFinder, Scan
from tests.reference.cone_oracles import clip_cells

PARAMETERS = BeamParameters(z_hit=0.6, z_short=0.2, z_max=0.1, z_rand=0.1, sigma_hit=0.1, lambda_short=0.5)
RING = np.linspace(-np.pi, np.pi, 8, endpoint=False)


@pytest.fixture
def grid(rng):
    return OccupancyGrid((rng.random((20, 25)) < 0.04).astype(np.float32), 0.2)


def poses_in(grid, rng, n):
    rows, cols = grid.shape
    return np.column_stack([rng.uniform(0, np.array([cols, rows]) * grid.resolution, (n, 2)), rng.uniform(-4, 4, n)])


def test_without_opening_angle_it_is_the_beam_model(grid, rng):
    finder = RangeFinder.from_bearings(RING, 4.0)
    poses = poses_in(grid, rng, 50)
    scan = Scan([1.0, 2.0, np.inf, np.nan, 0.3, 3.0, 1.5, 1.1], finder)
    options = {"exponent": 0.5, "n_beams": 5, "unknown": "occupied"}
    sonar, beam = SonarModel(grid, PARAMETERS, **options), BeamModel(grid, PARAMETERS, **options)
    np.testing.assert_array_equal(sonar.log_likelihood(scan, poses), beam.log_likelihood(scan, poses))
    np.testing.assert_array_equal(sonar.beam_log_likelihood(scan, poses), beam.beam_log_likelihood(scan, poses))


def test_the_expected_range_is_that_of_the_cone(grid, rng):
    finder = RangeFinder.from_bearings(RING, 4.0, opening_angle=0.5)
    poses = poses_in(grid, rng, 20)
    expected = SonarModel(grid, PARAMETERS, finder=finder).expected(poses)
    for pose, ranges in zip(poses, expected, strict=True):
        for bearing, found in zip(RING, ranges, strict=True):
            wanted = clip_cells(*(pose[:2] / 0.2), pose[2] + bearing, 0.25, grid.occupied, 20.0) * 0.2
            assert found == pytest.approx(wanted, abs=1e-12)


def test_a_scan_is_the_product_of_the_densities_of_its_sensors(grid, rng):
    finder = RangeFinder.from_bearings(RING, 4.0, opening_angle=0.5)
    model = SonarModel(grid, PARAMETERS, finder=finder)
    poses = poses_in(grid, rng, 30)
    ranges = np.array([1.0, 2.0, 4.0, 0.4, 0.3, 3.0, 1.5, 1.1])
    density = beam_log_density(np.tile(ranges, (30, 1)), model.expected(poses), 4.0, PARAMETERS)
    np.testing.assert_allclose(model.log_likelihood(Scan(ranges, finder), poses), density.sum(axis=1), rtol=1e-12)


def test_among_landmarks_the_nearest_in_the_cone_is_expected():
    finder = RangeFinder.from_bearings([0.0, np.pi / 2], 6.0, opening_angle=0.5)
    landmarks = LandmarkMap([[2.0, 0.3], [3.0, 0.0], [0.0, -2.0]])
    points = SonarModel(landmarks, PARAMETERS, finder=finder)
    assert points.expected([0.0, 0.0, 0.0]).tolist() == [np.hypot(2.0, 0.3), 6.0]
    posts = SonarModel(landmarks, PARAMETERS, finder=finder, landmark_radius=0.1)
    assert posts.expected([0.0, 0.0, 0.0]) == pytest.approx([np.hypot(2.0, 0.3) - 0.1, 6.0])
    assert points.log_likelihood(Scan([2.02, np.inf], finder), [[0, 0, 0], [0.5, 0, 0]]).argmax() == 0


def test_bad_options_are_errors(grid):
    with pytest.raises(InvalidInputError, match="exponent: expected a positive, finite number, got 0"):
        SonarModel(grid, PARAMETERS, exponent=0)
    with pytest.raises(InvalidInputError, match="n_beams: expected at least 1 or None, got 0"):
        SonarModel(grid, PARAMETERS, n_beams=0)
    with pytest.raises(InvalidInputError, match="landmark_radius: expected 0 with a grid"):
        SonarModel(grid, PARAMETERS, landmark_radius=0.2)
    with pytest.raises(InvalidInputError, match="radius: expected finite metres >= 0, got -1"):
        SonarModel(LandmarkMap([[0.0, 0.0]]), PARAMETERS, landmark_radius=-1.0)
    with pytest.raises(InvalidInputError, match="finder: expected a RangeFinder"):
        SonarModel(grid, PARAMETERS).expected([0.0, 0.0, 0.0])


def test_with_parameters_keeps_the_tables(grid):
    finder = RangeFinder.from_bearings(RING, 4.0, opening_angle=0.5)
    model = SonarModel(grid, PARAMETERS, finder=finder, exponent=0.5)
    other = model.with_parameters(BeamParameters(1.0, 0.0, 0.0, 0.0, 0.2, 0.0))
    assert isinstance(other, SonarModel)
    assert other.exponent == 0.5
    assert other.parameters.sigma_hit == 0.2
    assert other._source is model._source
