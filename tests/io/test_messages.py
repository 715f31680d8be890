"""Messages of ROS become scans and grids without ROS, whatever library made them."""

from __future__ import annotations

from array import array
from types import SimpleNamespace as Message

import numpy as np
import pytest

import beamfield as bf
from beamfield.errors import InvalidInputError
from beamfield.sensors import usable_ranges
from tests.io.mini_bag import MiniBag

HEADER = Message(stamp=Message(sec=12, nanosec=500_000_000), frame_id="laser")


def laser_scan(**changes) -> Message:
    fields = {"header": HEADER, "angle_min": -0.5, "angle_max": 0.5, "angle_increment": 0.5, "range_min": 0.1,
              "range_max": 12.0, "ranges": array("f", [2.0, float("inf"), float("nan")])}  # fmt: skip
    return Message(**fields | changes)


def occupancy_grid(**changes) -> Message:
    origin = Message(
        position=Message(x=1.0, y=2.0, z=0.0), orientation=Message(x=0.0, y=0.0, z=np.sin(0.1), w=np.cos(0.1))
    )
    info = {"width": 3, "height": 2, "resolution": 0.05, "origin": origin}
    data = array("b", [0, -1, 100, 100, 0, 0])
    return Message(info=Message(**info | changes), data=changes.pop("data", data))


def test_a_laser_scan_is_a_scan_with_its_finder():
    scan = bf.scan_from_message(laser_scan(), mount=(0.2, 0.1, np.pi / 2))
    assert scan.ranges[:2].tolist() == [2.0, np.inf]
    assert np.isnan(scan.ranges[2])
    assert (scan.stamp, scan.finder.name, scan.finder.min_range, scan.finder.max_range) == (12.5, "laser", 0.1, 12.0)
    np.testing.assert_allclose(scan.finder.mounts[:, 2], np.pi / 2 + np.array([-0.5, 0.0, 0.5]))
    np.testing.assert_allclose(scan.finder.mounts[:, :2], [[0.2, 0.1]] * 3)


def test_stamps_of_ros_1_are_read_too():
    header = Message(stamp=Message(secs=3, nsecs=250_000_000), frame_id="")
    assert bf.scan_from_message(laser_scan(header=header, ranges=(1.0, 2.0, 3.0))).stamp == 3.25


def test_values_that_mean_no_return_are_those_of_float32():
    message = laser_scan(ranges=np.array([5.6, 0.0, 5.5], np.float32))
    assert bf.scan_from_message(message, no_return=(0.0, 5.6)).ranges[:2].tolist() == [np.inf, np.inf]
    assert bf.scan_from_message(message).ranges[1] == 0.0


def test_no_measurement_may_mean_no_return():
    message = laser_scan(ranges=np.array([np.nan, 0.0, 5.5], np.float32))
    assert bf.scan_from_message(message, no_return=(np.nan,)).ranges.tolist() == [np.inf, 0.0, 5.5]


@pytest.mark.parametrize("declared", [0.0, np.inf, 30.0])
def test_the_callers_limit_takes_the_place_of_the_messages(declared):
    message = laser_scan(ranges=np.array([5.6, 5.5, np.inf], np.float32), range_max=declared)
    scan = bf.scan_from_message(message, max_range=5.6)
    assert usable_ranges(scan.ranges, scan.finder).tolist() == [scan.finder.max_range, 5.5, scan.finder.max_range]
    assert scan.finder.max_range == pytest.approx(5.6)


def test_a_scan_is_what_read_log_makes_of_the_same_message(tmp_path):
    pytest.importorskip("rosbags")
    from rosbags.highlevel import AnyReader

    bag = MiniBag("ros1").tf("base_link", "laser", 0.0, static=True)
    bag.scan(1.5, np.linspace(1.0, 3.0, 7), angle_min=-0.3, increment=0.1, range_max=8.0)
    path = bag.write(tmp_path, "run")
    logged = bf.read_log(path).only_sensor()
    with AnyReader([path]) as reader:
        connection = next(c for c in reader.connections if c.msgtype.endswith("LaserScan"))
        _, _, raw = next(reader.messages([connection]))
        scan = bf.scan_from_message(reader.deserialize(raw, connection.msgtype))
    assert scan.ranges.tolist() == logged.ranges[0].tolist()
    np.testing.assert_allclose(scan.finder.bearings, logged.finder.bearings, atol=1e-12)
    assert (scan.stamp, scan.finder.max_range) == (logged.stamps[0], logged.finder.max_range)


def test_an_occupancy_grid_is_a_grid():
    grid = bf.grid_from_message(occupancy_grid())
    np.testing.assert_array_equal(grid.probability, np.array([[0, np.nan, 1], [1, 0, 0]], np.float32))
    np.testing.assert_allclose(grid.origin, [1.0, 2.0, 0.2])
    assert grid.resolution == 0.05


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda: bf.scan_from_message(laser_scan(ranges=[])), r"ranges: expected shape \(k,\)"),
        (lambda: bf.scan_from_message(laser_scan(angle_increment=0.0)), "angle_increment"),
        (lambda: bf.scan_from_message(laser_scan(angle_increment=30.0)), "degrees"),
        (lambda: bf.scan_from_message(laser_scan(range_max=0.0)), "range_max: expected .* got 0.0; give max_range"),
        (lambda: bf.scan_from_message(laser_scan(), max_range=-1.0), "max_range"),
        (lambda: bf.scan_from_message(occupancy_grid()), "message: expected a LaserScanMessage"),
        (lambda: bf.grid_from_message(laser_scan()), "message: expected an OccupancyGridMessage"),
        (lambda: bf.grid_from_message(occupancy_grid(width=4)), "expected width 4 x height 2 cells, got 6"),
    ],
)
def test_what_is_no_such_message_is_refused(call, words):
    with pytest.raises(InvalidInputError, match=words):
        call()
