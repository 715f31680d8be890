"""Robots that drive beyond what their map shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.localization.mapped_area import MappedArea, MappedAreaModel
from beamfield.localization.replay import PoseBelief
from beamfield.localization.scan_localizer import ScanLocalizer
from beamfield.localization.trajectory import fit_trajectory
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.gaussian_motion import USUAL_MOTION
from beamfield.models.likelihood_field import LikelihoodFieldModel

# Known to the left of x = 2, and 4 m long.
AREA = MappedArea(OccupancyGrid(np.where(np.arange(40) < 20, 0.0, np.nan) * np.ones((10, 1)), 0.1))


class Position:
    is_normalized = True

    def log_likelihood(self, z, poses):
        return z * np.asarray(poses)[..., 0]


def test_beyond_the_map_are_its_unknown_cells_and_all_off_its_edges():
    poses = np.array([[0.5, 0.5, 0.0], [1.99, 0.5, 2.0], [2.01, 0.5, 0.0], [0.5, 1.5, 0.0], [-0.1, 0.5, 0.0]])
    assert AREA.is_beyond(poses).tolist() == [False, False, True, True, True]


def test_poses_beyond_the_map_are_worth_as_much_as_the_median_within():
    model = MappedAreaModel(Position(), AREA)
    x = np.array([0.1, 3.0, 0.5, 1.1, 9.0])
    poses = np.column_stack([x, np.full(5, 0.5), np.zeros(5)])
    assert model.log_likelihood(2.0, poses) == pytest.approx([0.2, 1.0, 1.0, 2.2, 1.0])
    assert model.log_likelihood(2.0, poses[[0, 2]]) == pytest.approx([0.2, 1.0])
    # Where most are beyond, only odometry tells.
    assert model.log_likelihood(2.0, poses[[0, 1, 4]]).tolist() == [0.0, 0.0, 0.0]
    assert not model.is_normalized


def test_a_robot_that_drives_beyond_its_map_and_back_is_followed(office, drive):
    log = drive[45:340]
    columns = office.origin[0] + office.resolution * np.arange(office.shape[1])
    cells = np.where(columns > np.quantile(drive.poses[:, 0], 0.8), np.nan, office.probability)
    grid = replace(office, probability=cells)
    field = LikelihoodFieldModel(grid, LikelihoodFieldParameters(0.8, 0.1, 0.1), n_beams=60, exponent=0.03)
    localizer = ScanLocalizer(grid, field, USUAL_MOTION)
    found = localizer.run(log, PoseBelief.around(log.poses[0]), np.random.default_rng(0))
    # By its scans it would be up to 2.7 m off.
    assert np.hypot(*(found.poses - log.poses)[:, :2].T).max() < 0.5
    (finding,) = found.findings
    assert finding.text.endswith("of 295 scans the robot is where the map is unknown, or beyond its edges.")
    assert finding.values["count"] == pytest.approx(69, abs=5)
    fit = fit_trajectory(log, grid, start=log.poses[0])
    (stretch,) = (one for one in fit.findings if one.name == "beyond-map-stretch")
    assert stretch.values["share"] == pytest.approx(69 / 295, abs=0.1)
    assert "the robot is where the map is unknown" in stretch.text
