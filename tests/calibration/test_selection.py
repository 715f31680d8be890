from __future__ import annotations

import numpy as np
import pytest

from beamfield.calibration.selection import SelectionOptions, select_scans, thinned
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, SensorLog

FINDER = RangeFinder.from_bearings(np.linspace(-1.0, 1.0, 5), 8.0, name="/scan")


def room() -> OccupancyGrid:
    """A room of 10 m x 4 m with walls of one cell."""
    cells = np.zeros((40, 100))
    cells[0] = cells[-1] = 1.0
    cells[:, 0] = cells[:, -1] = 1.0
    return OccupancyGrid(cells, 0.1)


def drive(n: int = 60, step: float = 0.1) -> SensorLog:
    """A robot that drives along the room with perfect odometry in a frame of its own."""
    x = 1.0 + step * np.arange(n)
    poses = np.column_stack([x, np.full(n, 2.0), np.zeros(n)])
    odometry = np.column_stack([x - 1.0, np.zeros(n), np.zeros(n)])
    return SensorLog(FINDER, 0.1 * np.arange(n), np.ones((n, 5)), poses, odometry)


def changed(log: SensorLog, **columns: np.ndarray) -> SensorLog:
    base = {name: getattr(log, name) for name in ("finder", "stamps", "ranges", "poses", "odometry")}
    return SensorLog(**{**base, **columns})


def test_a_good_log_is_used_whole():
    selection = select_scans(drive(), room())
    assert selection.used.all()
    assert selection.dropped == {}
    assert selection.describe() == "60 of 60 scans used"


def test_scans_of_a_standing_robot_are_dropped():
    log = drive()
    poses, odometry = log.poses.copy(), log.odometry.copy()
    poses[20:30] = poses[20]
    odometry[20:30] = odometry[20]
    poses[30:, 0] = poses[20, 0] + 0.1 * np.arange(1, 31)
    odometry[30:, 0] = odometry[20, 0] + 0.1 * np.arange(1, 31)
    selection = select_scans(changed(log, poses=poses, odometry=odometry), room())
    assert selection.dropped == {"standing still": 9}
    assert selection.used[20]
    assert not selection.used[21:30].any()


def test_slow_motion_adds_up_to_motion():
    selection = select_scans(drive(n=100, step=0.005), room())
    assert 20 <= selection.used.sum() <= 26


def test_scans_without_pose_or_range_are_dropped_with_their_reason():
    log = drive()
    poses, ranges = log.poses.copy(), log.ranges.copy()
    poses[3, 1] = np.nan
    ranges[7] = np.nan
    selection = select_scans(changed(log, poses=poses, ranges=ranges), room())
    assert selection.dropped == {"no reference pose": 1, "no usable range": 1}


def test_scans_off_the_map_and_inside_walls_are_dropped():
    log = drive()
    poses = log.poses.copy()
    poses[5, :2] = (-3.0, 2.0)
    poses[9, :2] = (1.9, 0.05)
    options = SelectionOptions(max_jump=np.inf, max_jump_turn=np.inf)
    assert select_scans(changed(log, poses=poses), room(), options).dropped == {
        "off the map": 1,
        "sensor inside a wall": 1,
    }


def test_a_jump_of_the_reference_that_the_odometry_did_not_make_drops_both_sides():
    log = drive()
    poses = log.poses.copy()
    poses[30:, 1] += 0.8
    selection = select_scans(changed(log, poses=poses), room())
    assert selection.dropped == {"reference pose jumps": 2}
    np.testing.assert_array_equal(np.flatnonzero(~selection.used), [29, 30])


def test_fast_turns_are_dropped():
    log = drive()
    poses, odometry = log.poses.copy(), log.odometry.copy()
    poses[30:, 2] += 0.3
    odometry[30:, 2] += 0.3
    assert select_scans(changed(log, poses=poses, odometry=odometry), room()).dropped == {"turning too fast": 2}


def test_a_log_without_odometry_can_be_used():
    log = drive()
    blind = changed(log, odometry=np.full((60, 3), np.nan))
    assert select_scans(blind, room()).used.all()
    # Its turns are then those of the reference; else they are the odometry's.
    poses = log.poses.copy()
    poses[30:, 2] += 0.3
    assert select_scans(changed(blind, poses=poses), room()).dropped == {"turning too fast": 2}
    assert select_scans(changed(log, poses=poses), room()).dropped == {}
    poses[30:, 2] += 0.1
    assert select_scans(changed(log, poses=poses), room()).dropped == {"reference pose jumps": 2}


def test_a_scan_that_comes_twice_turns_by_rounding_alone():
    log = drive()
    stamps, poses, odometry = log.stamps.copy(), log.poses.copy(), log.odometry.copy()
    stamps[31], poses[31], odometry[31] = stamps[30], poses[30], odometry[30] + [0.0, 0.0, 1e-12]
    found = select_scans(changed(log, stamps=stamps, poses=poses, odometry=odometry), room())
    assert found.dropped == {"standing still": 1}


def test_it_is_the_sensor_that_must_be_on_the_map():
    log = drive()
    ahead = RangeFinder.from_bearings(np.linspace(-1.0, 1.0, 5), 8.0, mount=(3.05, 0.0, 0.0))
    # It reaches the wall at 9.9 m from 6.85 m on.
    assert select_scans(changed(log, finder=ahead), room()).dropped == {"sensor inside a wall": 1}


def test_a_log_off_the_map_is_an_error_that_names_both_places():
    log = drive()
    with pytest.raises(InvalidInputError, match=r"all 60 reference poses lie off the map.*x 101\.00 to 106\.90 m"):
        select_scans(changed(log, poses=log.poses + np.array([100.0, 0.0, 0.0])), room())


def test_a_log_without_poses_is_an_error():
    with pytest.raises(InvalidInputError, match="no scan has a reference pose"):
        select_scans(changed(drive(), poses=np.full((60, 3), np.nan)), room())


def test_too_few_scans_say_where_the_others_went():
    log = drive()
    poses = np.repeat(log.poses[:1], 60, axis=0)
    with pytest.raises(TooLittleDataError, match="1 of 60 scans used; dropped: 59 standing still; need 10"):
        select_scans(changed(log, poses=poses, odometry=np.zeros((60, 3))), room())


def test_options_that_make_no_sense_are_refused():
    with pytest.raises(InvalidInputError, match="min_travel"):
        SelectionOptions(min_travel=-1.0)


def test_of_more_beams_than_a_fit_needs_every_second_scan_is_used(monkeypatch):
    monkeypatch.setattr("beamfield.calibration.selection.MOST_BEAMS", 60 * 5 - 1)
    selection = thinned(select_scans(drive(), room()), 5)
    assert selection.dropped == {"not needed": 30}
    assert selection.used[::2].all()


def test_no_scan_of_a_common_log_is_left_out():
    selection = select_scans(drive(), room())
    assert thinned(selection, 5).used.all()
