from __future__ import annotations

import pickle

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.sensors.range_finder import RangeFinder
from beamfield.sensors.scan import Scan, usable_ranges
from beamfield.sensors.scan_log import ScanLog
from beamfield.sensors.sensor_log import SensorLog

FINDER = RangeFinder.from_bearings([-1.0, 0.0, 1.0], 10.0, min_range=0.2, mount=[0.3, 0.1, np.pi / 2], name="front")


def test_mounts_are_the_sensor_mount_turned_by_each_bearing():
    np.testing.assert_allclose(FINDER.mounts[:, :2], [[0.3, 0.1]] * 3)
    np.testing.assert_allclose(FINDER.bearings, np.pi / 2 + np.array([-1.0, 0.0, 1.0]))


def test_a_finder_cannot_be_changed():
    with pytest.raises(ValueError, match="read-only"):
        FINDER.mounts[0, 0] = 1.0


def test_usable_ranges_follow_rep_117():
    z = usable_ranges([0.1, np.inf, -np.inf], FINDER)
    np.testing.assert_array_equal(z, [np.nan, 10.0, np.nan])
    np.testing.assert_array_equal(usable_ranges([np.nan, 10.0, 25.0], FINDER), [np.nan, 10.0, 10.0])
    np.testing.assert_array_equal(usable_ranges([0.2, 9.99, 0.0], FINDER), [0.2, 9.99, np.nan])


@pytest.mark.parametrize("limits", [(-0.1, 5.0), (5.0, 5.0), (0.0, np.inf), (0.0, np.nan)])
def test_limits_that_make_no_sense_are_refused(limits):
    with pytest.raises(InvalidInputError, match="range limits"):
        RangeFinder.from_bearings([0.0], limits[1], min_range=limits[0])


def test_a_cone_wider_than_a_half_turn_is_refused():
    with pytest.raises(InvalidInputError, match="opening_angle"):
        RangeFinder.from_bearings([0.0], 5.0, opening_angle=4.0)


def test_a_scan_needs_a_range_per_beam():
    with pytest.raises(InvalidInputError, match=r"expected shape \(3,\), got \(2,\)"):
        Scan(np.ones(2), FINDER)


def test_every_picks_equally_spaced_beams_with_their_mounts():
    finder = RangeFinder.from_bearings(np.linspace(-1, 1, 11), 5.0)
    scan = Scan(np.arange(11.0) / 10, finder).every(3)
    np.testing.assert_allclose(scan.ranges, [0.0, 0.5, 1.0])
    np.testing.assert_allclose(scan.finder.bearings, [-1.0, 0.0, 1.0])
    assert scan.every(10) is scan
    with pytest.raises(InvalidInputError, match="n_beams"):
        scan.every(0)


def test_selecting_scans_keeps_columns_together():
    log = SensorLog(FINDER, np.arange(4.0), np.arange(12.0).reshape(4, 3), np.zeros((4, 3)), np.full((4, 3), np.nan))
    some = log.select([3, 1])
    np.testing.assert_array_equal(some.stamps, [3.0, 1.0])
    np.testing.assert_array_equal(some.ranges[:, 0], [9.0, 3.0])
    assert len(log.select([])) == 0
    np.testing.assert_array_equal(log.select(np.array([False, True, True, False])).stamps, [1.0, 2.0])
    assert log.has_poses
    assert not log.has_odometry
    assert [scan.stamp for scan in log] == [0.0, 1.0, 2.0, 3.0]
    with pytest.raises(InvalidInputError, match=r"poses: .* got an array with 4 of 12 masked"):
        log.with_poses(np.ma.masked_greater(np.tile([0.0, 0.0, 4.0], (4, 1)), 3.0))


def test_a_stamp_is_shown_to_the_millisecond():
    finder = RangeFinder.from_bearings([0.0], 8.0)
    assert "stamp=1663971234.568" in repr(Scan([1.0], finder, stamp=1663971234.5678))
    assert "stamp=12.3457" in repr(Scan([1.0], finder, stamp=12.345678))


def test_a_pickled_copy_prints_as_the_original():
    scan = Scan([1.0], RangeFinder.from_bearings([0.0], 5.0))
    assert repr(pickle.loads(pickle.dumps(scan))) == repr(scan)


def test_columns_of_the_wrong_length_are_refused():
    with pytest.raises(InvalidInputError, match=r"ranges: expected shape \(4, 3\)"):
        SensorLog(FINDER, np.arange(4.0), np.ones((4, 2)), np.zeros((4, 3)), np.zeros((4, 3)))


def test_asking_for_an_unknown_sensor_lists_the_known():
    log = SensorLog(FINDER, np.zeros(1), np.ones((1, 3)), np.zeros((1, 3)), np.zeros((1, 3)))
    both = ScanLog({"front": log, "rear": log}, source="run.bag")
    with pytest.raises(InvalidInputError, match=r"run.bag: no sensor 'side'; the log has 'front', 'rear'"):
        both.only_sensor("side")
    with pytest.raises(InvalidInputError, match="which sensor"):
        both.only_sensor()
    assert both.only_sensor("rear") is log


class TestIndexing:
    def test_a_log_gives_scans_and_shorter_logs(self):
        log = three_scans()
        assert log[1].stamp == log[-2].stamp == 1.0
        assert log[1:].stamps.tolist() == log[[1, 2]].stamps.tolist() == log[log.stamps > 0.5].stamps.tolist()
        assert log[::-1].ranges[0].tolist() == log.ranges[2].tolist()

    @pytest.mark.parametrize("index", [3, -4, 9999])
    def test_a_scan_that_is_not_there_is_named(self, index):
        for ask in (three_scans().scan, three_scans().__getitem__):
            with pytest.raises(IndexError, match=f"expected a scan from -3 to 2, got {index}"):
                ask(index)

    def test_a_truth_value_is_no_number_of_a_scan(self):
        with pytest.raises(InvalidInputError, match="index: expected a whole number, got True"):
            three_scans()[True]

    def test_a_scan_gives_scans_of_some_beams(self):
        scan = three_scans()[0]
        assert scan[1:].ranges.tolist() == scan[[1, 2]].ranges.tolist() == [2.0, 3.0]
        assert scan[-1].finder.bearings.tolist() == [scan.finder.bearings[2]]
        with pytest.raises(TypeError, match="not iterable"):
            iter(scan)

    def test_a_log_of_sensors_is_asked_by_name(self):
        log = ScanLog({"/scan": three_scans(), "/back": three_scans()}, source="run.bag")
        assert log["/scan"] is log.sensors["/scan"]
        with pytest.raises(InvalidInputError, match=r"no sensor '/front'; the log has '/scan', '/back'"):
            log["/front"]
        with pytest.raises(InvalidInputError, match=r"got 0; .only_sensor\(\)\[...\] chooses scans"):
            log[0]


def three_scans() -> SensorLog:
    finder = RangeFinder.from_bearings([-0.1, 0.0, 0.1], 8.0)
    return SensorLog(finder, [0.0, 1.0, 2.0], [[1, 2, 3], [2, 3, 4], [3, 4, 5]], np.zeros((3, 3)), np.zeros((3, 3)))


@pytest.mark.parametrize(
    ("bearings", "mount"), [(np.linspace(-90, 90, 181), (0.0, 0.0, 0.0)), ([0.0, 0.1], (0.2, 0.0, 90.0))]
)
def test_degrees_are_not_taken_for_radians(bearings, mount):
    with pytest.raises(InvalidInputError, match=r"expected radians, at most a full turn, got 90; np.radians"):
        RangeFinder.from_bearings(bearings, 12.0, mount=mount)
