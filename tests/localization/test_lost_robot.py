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


def long_log(first: int, end: int, n_wrong: int = 16) -> SensorLog:
    """Return the drive three times, of which so many beams of the scans between two are 1 m too short."""
    long = log()[np.repeat(np.arange(21), 3)]
    ranges = long.ranges.copy()
    ranges[first:end, :n_wrong] -= 1.0
    return replace(long, ranges=ranges, stamps=np.arange(63.0))


def test_one_whose_last_scans_disagree_after_most_agreed_is_most_likely_lost_since_then():
    poses = np.repeat(POSES, 3, axis=0)
    found = find_lost_robot(long_log(40, 63), GRID, poses)
    assert found is not None
    assert found.name == "lost-at-end"
    assert found.text.startswith("From 40 s after the first scan on, 20% of a scan's readings agree with the map")
    assert found.values == {
        "time_s": 40.0, "median_agreement": pytest.approx(0.2), "median_agreement_before": 1.0,
    }  # fmt: skip
    # Fewer scans, more that agree, scans that agree again, or a robot that stands still: nobody knows.
    assert find_lost_robot(long_log(44, 63), GRID, poses) is None
    assert find_lost_robot(long_log(40, 63, 14), GRID, poses) is None
    assert find_lost_robot(long_log(30, 55), GRID, poses) is None
    standing = replace(long_log(40, 63), odometry=np.where(np.arange(63)[:, None] < 40, poses, poses[40]))
    assert find_lost_robot(standing, GRID, poses) is None


def test_one_that_was_lost_for_longer_than_not_is_lost_and_said_since_when():
    found = find_lost_robot(long_log(25, 63), GRID, np.repeat(POSES, 3, axis=0))
    assert found is not None
    assert found.name == "robot-lost"
    assert "(until 25 s after the first scan 100%, from then on 20%)" in found.text


def test_one_whose_scans_agree_far_better_there_than_anywhere_near_is_not_lost_its_map_is_out_of_date():
    found = find_lost_robot(drive(hall(), 25), hall(), HALL_POSES)
    assert found is not None
    assert found.name == "map-out-of-date"
    assert find_lost_robot(drive(hall(0), 25), hall(0), HALL_POSES).name == "robot-lost"


def test_scans_from_beyond_the_map_count_only_where_there_are_hardly_others():
    moved = log()
    ranges = moved.ranges.copy()
    ranges[5:] -= 1.0
    moved = replace(moved, ranges=ranges)
    assert find_lost_robot(moved, GRID, POSES).name == "robot-lost"
    # From x = 7.25 m on nothing is known: 5 of the 21 scans are from within the map, and agree.
    assert (
        find_lost_robot(moved, replace(GRID, probability=np.where(np.arange(200) < 72, CELLS, np.nan)), POSES) is None
    )
    # From x = 6.75 m on: 4 are.
    grid = replace(GRID, probability=np.where(np.arange(200) < 67, CELLS, np.nan))
    assert find_lost_robot(moved, grid, POSES).name == "robot-lost"


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
