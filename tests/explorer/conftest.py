"""A short drive through a room, explored."""

import numpy as np
import pytest

from beamfield.explorer.parameter_set import typical_sets
from beamfield.explorer.session import Session
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog

N_SCANS = 12


@pytest.fixture(scope="package")
def grid() -> OccupancyGrid:
    """A room of 10 m x 6 m with a box, in cells of 0.1 m."""
    cells = np.zeros((60, 100))
    cells[[0, -1]] = cells[:, [0, -1]] = 1.0
    cells[35:45, 60:75] = 1.0
    return OccupancyGrid(cells, resolution=0.1, origin=(-1.0, -2.0, 0.0))


@pytest.fixture(scope="package")
def log(grid) -> SensorLog:
    """Twelve scans along the room; the last has no reference pose."""
    finder = RangeFinder.from_bearings(np.linspace(-2.0, 2.0, 41), max_range=8.0)
    poses = np.column_stack([np.linspace(0.0, 5.0, N_SCANS), np.full(N_SCANS, 0.3), np.linspace(0.0, 0.4, N_SCANS)])
    truth = BeamModel(grid, BeamParameters(0.85, 0.05, 0.05, 0.05, 0.05, 0.5), finder=finder)
    ranges = np.array([scan.ranges for scan in truth.sample(poses, rng=1)])
    known = poses.copy()
    known[-1] = np.nan
    return SensorLog(finder, np.arange(N_SCANS) * 0.5, ranges, poses=known, odometry=poses)


@pytest.fixture(scope="package")
def session(log, grid) -> Session:
    numbers = {"p-value": np.r_[np.linspace(1.0, 0.01, N_SCANS - 1), np.nan]}
    return Session(log, grid, typical_sets(grid, log.finder), numbers=numbers)
