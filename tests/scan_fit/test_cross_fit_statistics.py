"""How well scans fit a map that the log drew itself: by the map of the other half."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.calibration.cross_fit import CrossFitMaps
from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.scan_fit.cross_fit_statistics import cross_fit_statistics
from beamfield.scan_fit.statistics import fit_statistics
from beamfield.sensors import RangeFinder, SensorLog

PARAMETERS = BeamParameters(0.9, 0.05, 0.02, 0.03, 0.05, 0.3)


def room(width: int) -> OccupancyGrid:
    """An empty room, 4 m high, so many cells of 0.1 m wide."""
    cells = np.zeros((40, width))
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    return OccupancyGrid.from_ros(cells, 0.1)


def on(grid: OccupancyGrid) -> BeamModel:
    return BeamModel(grid, PARAMETERS)


@pytest.fixture
def log() -> SensorLog:
    finder = RangeFinder.from_bearings(np.radians(np.arange(-180.0, 180.0, 10.0)), 8.0)
    poses = np.column_stack([np.linspace(1.0, 2.0, 12), np.full(12, 2.0), np.linspace(0.0, 1.0, 12)])
    scans = on(room(60)).sample(poses, finder, np.random.default_rng(3))
    ranges = np.stack([scan.ranges for scan in scans])
    return SensorLog(finder, np.arange(12.0), ranges, poses=poses, odometry=np.full((12, 3), np.nan))


def test_each_scan_is_judged_by_the_map_it_did_not_draw(log):
    # The half's own map is another room: whoever were judged by it would not fit.
    half = np.array([0, 0, 1, 1, 0, 0, 1, 1, 1, 0, 0, 1], dtype=np.int8)
    for other in (0, 1):
        rooms = (room(60), room(40)) if other == 0 else (room(40), room(60))
        found = cross_fit_statistics(on, CrossFitMaps(rooms, half, room(60)), log)
        for grid, mine in ((rooms[1], half == 0), (rooms[0], half == 1)):
            expected = fit_statistics(on(grid), log.ranges[mine], log.finder, log.poses[mine])
            for name in ("surprise", "misfit", "through", "short", "n_beams"):
                np.testing.assert_array_equal(getattr(found, name)[mine], getattr(expected, name))
        assert found.misfit[half != other].max() < found.misfit[half == other].min()


def test_maps_of_another_log_are_refused(log):
    maps = CrossFitMaps((room(60), room(60)), np.zeros(5, dtype=np.int8), room(60))
    with pytest.raises(InvalidInputError, match="expected the 5 scans that the maps were built from, got 12"):
        cross_fit_statistics(on, maps, log)
