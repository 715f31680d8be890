"""When a filter's robot is said to be elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.localization.lost_robot import find_lost_robot
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder, SensorLog
from tests.pillar_hall import POSES as HALL_POSES
from tests.pillar_hall import drive, hall

FINDER = RangeFinder.from_bearings(np.linspace(-3.0, 3.0, 20), 20.0)
CELLS = np.zeros((100, 200))
CELLS[[0, -1]] = CELLS[:, [0, -1]] = 1.0
GRID = OccupancyGrid(CELLS, 0.1)
# Along x to the middle, then along y, turning to the right all the time.
POSES = np.zeros((21, 3))
POSES[:, 0], POSES[:, 1] = 5.0 + 0.5 * np.minimum(np.arange(21), 10), 3.0 + 0.2 * np.maximum(np.arange(21) - 10, 0)
POSES[:, 2] = -0.1 * np.arange(21)


def log(n_wrong: int = 0) -> SensorLog:
    """Return a drive in which so many of the 20 beams of each scan read 1 m too little."""
    ranges = RayCaster(GRID).expected_ranges(POSES, FINDER)
    ranges[:, :n_wrong] -= 1.0
    return SensorLog(FINDER, np.arange(21.0), ranges, np.full((21, 3), np.nan), POSES)


def test_a_robot_is_lost_whose_scans_agree_by_less_than_45_percent():
    assert find_lost_robot(log(), GRID, POSES) is None
    assert find_lost_robot(log(11), GRID, POSES) is None
    lost = find_lost_robot(log(12), GRID, POSES)
    assert lost is not None
    assert "40% of a scan's readings agree" in lost.text
    assert lost.values == {
        "median_agreement": pytest.approx(0.4), "path_length_m": pytest.approx(7.0), "turn_rad": pytest.approx(2.0),
    }  # fmt: skip


def test_one_whose_scans_agree_far_better_there_than_anywhere_near_is_not_lost_its_map_is_out_of_date():
    found = find_lost_robot(drive(hall(), 25), hall(), HALL_POSES)
    assert found is not None
    assert found.name == "map-out-of-date"
    assert find_lost_robot(drive(hall(0), 25), hall(0), HALL_POSES).name == "robot-lost"


def test_where_nothing_can_be_compared_nobody_is_lost():
    assert find_lost_robot(replace(log(), ranges=np.full((21, 20), np.nan)), GRID, POSES) is None
    assert find_lost_robot(log(20), GRID, np.full((21, 3), np.nan)) is None
    assert find_lost_robot(replace(log(20), finder=replace(FINDER, opening_angle=0.5)), GRID, POSES) is None


@pytest.mark.parametrize(("n_jumps", "is_lost"), [(2, False), (3, True)])
def test_odometry_of_which_more_than_a_tenth_of_the_steps_jump_is_no_robots(n_jumps, is_lost):
    odometry = POSES.copy()
    for first in (5, 10, 15)[:n_jumps]:
        odometry[first:, 0] += 5.0
    found = find_lost_robot(replace(log(), odometry=odometry, stamps=np.zeros(21)), GRID, POSES)
    assert (found is not None) is is_lost
    assert found is None or found.text.startswith("3 of 20 steps of the odometry are longer")
    # Clocks that run backwards take as long.
    backwards = replace(log(), stamps=-np.arange(21.0))
    assert find_lost_robot(backwards, GRID, POSES) is None
