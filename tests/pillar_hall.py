"""A hall of pillars whose scans agree with the map only at the poses at which they were taken."""

from __future__ import annotations

import numpy as np

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder, SensorLog

N_BEAMS = 40
FINDER = RangeFinder.from_bearings(np.radians(np.arange(0.0, 360.0, 360.0 / N_BEAMS)), 30.0)
# So that beams which are wrong lie all around.
ORDER = 7 * np.arange(N_BEAMS) % N_BEAMS
POSES = np.column_stack([np.linspace(5.0, 10.0, 15), np.linspace(5.0, 8.0, 15), np.linspace(0.0, 2.0, 15)])


def hall(n_pillars: int = 300) -> OccupancyGrid:
    """Return a hall with so many pillars of a cell."""
    rng, cells = np.random.default_rng(1), np.zeros((140, 160))
    cells[[0, -1]] = cells[:, [0, -1]] = 1.0
    cells[rng.integers(140, size=n_pillars), rng.integers(160, size=n_pillars)] = 1.0
    return OccupancyGrid(cells, 0.1)


def drive(grid: OccupancyGrid, n_wrong: int) -> SensorLog:
    """Return scans of which so many of 40 beams end 3 m behind what the map shows."""
    ranges = RayCaster(grid).expected_ranges(POSES, FINDER)
    ranges[:, ORDER[:n_wrong]] += 3.0
    return SensorLog(FINDER, np.arange(15.0), ranges, POSES, POSES)
