"""Whether readings can be metres: only measurements say so."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.range_scale import require_metres
from beamfield.sensors import RangeFinder, SensorLog

GRID = OccupancyGrid(np.zeros((100, 100)), 0.05)


def log_of(ranges: list[float]) -> SensorLog:
    finder = RangeFinder.from_bearings(np.linspace(-1.0, 1.0, len(ranges)), max_range=5000.0, min_range=0.1)
    return SensorLog(finder, np.zeros(1), np.array([ranges]), np.zeros((1, 3)), np.zeros((1, 3)))


def test_readings_below_the_least_range_are_no_measurements():
    require_metres(log_of([0.0, 0.0, 0.0, 3.0]), GRID)
    require_metres(log_of([0.0, 0.0]), GRID)


def test_readings_in_millimetres_and_in_kilometres_are_refused():
    with pytest.raises(InvalidInputError, match="longer than 3000 m"):
        require_metres(log_of([0.0, 3000.0]), GRID)
    with pytest.raises(InvalidInputError, match=r"shorter than 0\.2 m"):
        require_metres(log_of([0.2, 0.2]), OccupancyGrid(np.zeros((9, 9)), 0.5))
