"""How scans agree with a map along their beams."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.ray_agreement import scan_agreement
from beamfield.sensors import RangeFinder, SensorLog

FINDER = RangeFinder.from_bearings(np.radians(np.linspace(-180.0, 150.0, 12)), max_range=5.0)


def agreement(ranges: list[float], pose: tuple[float, float, float]) -> float:
    """Return that of one scan in a hall of 20 by 20 metres with a wall along its left side."""
    cells = np.zeros((200, 200), np.float32)
    cells[:, 0] = 1.0
    at = np.array([pose])
    log = SensorLog(finder=FINDER, stamps=np.zeros(1), ranges=np.array([ranges]), poses=at, odometry=at)
    return float(scan_agreement(log, OccupancyGrid(cells, 0.1), at)[0])


# From 1.1 m off the wall, whose face is at 0.1 m, five beams reach it: 1, 1.15 and 2 m long.
WALL = {0: 1.0, 1: 1.0 / np.cos(np.radians(30)), 11: 1.0 / np.cos(np.radians(30)), 2: 2.0, 10: 2.0}


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({}, 1.0),
        ({0: 0.4}, 4 / 5),
        ({0: 5.0}, 4 / 5),
        # Somebody stands where nothing is expected: of six readings, three quarters of them have to be.
        ({6: 2.0}, 1.0),
        ({6: 2.0, 7: 2.0, 5: 2.0}, 5 / 6),
    ],
)
def test_shares_of_beams_that_meet_a_wall(changed, expected):
    ranges = [{**WALL, **changed}.get(i, 5.0) for i in range(12)]
    assert agreement(ranges, (1.1, 10.05, 0.0)) == pytest.approx(expected)


def test_walls_where_none_should_be_disagree_and_an_empty_scan_says_nothing():
    assert agreement([2.0] * 12, (10.0, 10.05, 0.0)) == 0.0
    assert np.isnan(agreement([5.0] * 12, (10.0, 10.05, 0.0)))
