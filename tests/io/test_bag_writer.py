"""Bags that `write_bag` makes: read back by `read_bag`, and by rosbags alone."""

from __future__ import annotations

import sys

import numpy as np
import pytest
from rosbags.highlevel import AnyReader

from beamfield.errors import InvalidInputError, MissingDependencyError
from beamfield.geometry import compose
from beamfield.io.bags.reader import read_bag
from beamfield.io.bags.writer import write_bag
from beamfield.sensors import RangeFinder, ScanLog, SensorLog, Track

START = 1.7e9


def make_log(rng, *, odometry=True, poses=True, n=40, names=("scan",)) -> ScanLog:
    """Scans at 10 Hz; odometry at 25 Hz that drifts away from the true poses."""
    track_stamps = START + 0.04 * np.arange(int(n * 2.5) + 1)
    steps = np.column_stack(
        [0.05 * rng.random(len(track_stamps)), np.zeros(len(track_stamps)), rng.normal(0, 0.1, len(track_stamps))]
    )
    walk = [np.array([1.0, 2.0, 3.0])]
    for step in steps[1:]:
        walk.append(compose(walk[-1], step))
    track = Track(track_stamps, np.array(walk))
    sensors = {}
    for i, name in enumerate(names):
        stamps = START + 0.013 * i + 0.1 * np.arange(n)
        sensor = RangeFinder.from_bearings(
            np.linspace(-np.pi, np.pi, 90, endpoint=False), 12.0, mount=(0.2, -0.1 * i, 2.5), min_range=0.1, name=name
        )
        ranges = rng.uniform(0.5, 11.0, (n, sensor.n_beams))
        ranges[0, :3] = np.inf, np.nan, -np.inf
        in_map = np.column_stack([rng.uniform(-9, 9, (n, 2)), rng.uniform(-np.pi, np.pi, n)])
        in_odometry = interpolated(track, stamps)
        none = np.full((n, 3), np.nan)
        sensors[name] = SensorLog(sensor, stamps, ranges, in_map if poses else none, in_odometry if odometry else none)
    return ScanLog(sensors, track if odometry else None, "test")


def interpolated(track, stamps):
    """Straight from the definition, heading by heading."""
    heading = np.interp(stamps, track.stamps, np.unwrap(track.poses[:, 2]))
    return np.column_stack([np.interp(stamps, track.stamps, track.poses[:, i]) for i in (0, 1)] + [heading])


def close(a, b, atol):
    difference = np.asarray(a) - np.asarray(b)
    difference[..., 2] = np.angle(np.exp(1j * difference[..., 2]))
    return bool(np.abs(difference).max() < atol)


def test_a_log_comes_back_as_it_was_written(rng, tmp_path):
    log = make_log(rng)
    write_bag(tmp_path / "run", log)
    back = read_bag(tmp_path / "run")
    new, old = back.only_sensor("/scan"), log.only_sensor()
    assert np.array_equal(new.stamps, old.stamps)
    assert np.array_equal(new.ranges, old.ranges.astype(np.float32), equal_nan=True)
    assert close(new.finder.mounts, old.finder.mounts, 1e-6)
    assert (new.finder.min_range, new.finder.max_range) == (pytest.approx(0.1), 12.0)
    assert close(new.poses, old.poses, 1e-5)
    assert close(new.odometry, old.odometry, 1e-5)
    assert np.array_equal(back.odometry.stamps, log.odometry.stamps)
    assert close(back.odometry.poses, log.odometry.poses, 1e-9)


def test_poses_and_odometry_agree_to_the_rounding_of_stamps(rng, tmp_path):
    # Stamps near zero keep all digits, so that only arithmetic is left.
    log = make_log(rng)
    sensor = log.only_sensor()
    shifted = Track(np.round(log.odometry.stamps - START, 9), log.odometry.poses)
    stamps = np.round(sensor.stamps - START, 9)
    moved = SensorLog(sensor.finder, stamps, sensor.ranges, sensor.poses, interpolated(shifted, stamps))
    write_bag(tmp_path / "run", ScanLog({"scan": moved}, shifted, "test"))
    back = read_bag(tmp_path / "run").only_sensor()
    assert close(back.poses, moved.poses, 1e-9)
    assert close(back.odometry, moved.odometry, 1e-9)


def test_several_sensors_keep_their_mounts_and_topics(rng, tmp_path):
    log = make_log(rng, names=("/front", "rear"))
    write_bag(tmp_path / "run", log)
    back = read_bag(tmp_path / "run")
    assert list(back.sensors) == ["/front", "/scan_2"]
    for new, old in zip(back.sensors.values(), log.sensors.values(), strict=True):
        assert close(new.finder.mounts, old.finder.mounts, 1e-6)
        assert close(new.poses, old.poses, 1e-5)


def test_scans_whose_own_odometry_differs_from_the_track_keep_it(rng, tmp_path):
    log = make_log(rng)
    sensor = log.only_sensor()
    own = np.column_stack([rng.normal(size=(len(sensor), 2)), rng.uniform(-3, 3, len(sensor))])
    log = ScanLog({"scan": SensorLog(sensor.finder, sensor.stamps, sensor.ranges, sensor.poses, own)}, log.odometry)
    write_bag(tmp_path / "run", log)
    back = read_bag(tmp_path / "run").only_sensor()
    assert close(back.odometry, own, 1e-5)
    assert close(back.poses, sensor.poses, 1e-5)


def test_poses_without_odometry_are_the_robots_in_the_map(rng, tmp_path):
    log = make_log(rng, odometry=False)
    write_bag(tmp_path / "run", log)
    back = read_bag(tmp_path / "run")
    assert close(back.only_sensor().poses, log.only_sensor().poses, 1e-9)
    assert back.odometry is None
    assert not back.only_sensor().has_odometry


def test_scans_alone(rng, tmp_path):
    write_bag(tmp_path / "run", make_log(rng, odometry=False, poses=False))
    back = read_bag(tmp_path / "run").only_sensor()
    assert not back.has_poses
    assert not back.has_odometry


def test_the_messages_are_what_ros_expects(rng, tmp_path):
    log = make_log(rng, n=5)
    write_bag(tmp_path / "run", log)
    assert sorted(f.name for f in (tmp_path / "run").iterdir()) == ["metadata.yaml", "run.mcap"]
    with AnyReader([tmp_path / "run"]) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
        assert kinds == {
            "/scan": "sensor_msgs/msg/LaserScan",
            "/odom": "nav_msgs/msg/Odometry",
            "/tf": "tf2_msgs/msg/TFMessage",
            "/tf_static": "tf2_msgs/msg/TFMessage",
        }
        links = set()
        times = []
        for connection, time, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            times.append(time)
            if connection.topic.startswith("/tf"):
                links |= {(t.header.frame_id, t.child_frame_id) for t in message.transforms}
            elif connection.topic == "/scan":
                assert (message.header.frame_id, len(message.ranges)) == ("laser", 90)
                assert message.angle_max - message.angle_min == pytest.approx(89 * message.angle_increment, abs=1e-6)
        assert times == sorted(times)
        assert links == {("map", "odom"), ("odom", "base_link"), ("base_link", "laser")}
        latched = next(c for c in reader.connections if c.topic == "/tf_static")
        assert latched.ext.offered_qos_profiles[0].durability.name == "TRANSIENT_LOCAL"


@pytest.mark.parametrize(
    ("mounts", "pattern"),
    [
        ([[0, 0, 0.0], [0, 0, 0.1], [0, 0, 0.3]], "evenly spaced.*0.05 rad"),
        ([[0, 0, 0.0], [0.1, 0, 0.1]], "start at one point"),
    ],
)
def test_what_no_laser_scan_can_hold_is_refused_and_nothing_is_left(mounts, pattern, tmp_path):
    finder = RangeFinder(np.array(mounts, dtype=float), 10.0)
    ranges = np.ones((1, len(mounts)))
    none = np.full((1, 3), np.nan)
    log = ScanLog({"ring": SensorLog(finder, np.ones(1), ranges, none, none)})
    with pytest.raises(InvalidInputError, match=pattern):
        write_bag(tmp_path / "run", log)
    assert list(tmp_path.iterdir()) == []


def test_logs_that_no_bag_can_hold(rng, tmp_path):
    sensor = make_log(rng, odometry=False, poses=False).only_sensor()
    with pytest.raises(InvalidInputError, match="scans to write"):
        write_bag(tmp_path / "run", ScanLog({"a": sensor.select(np.zeros(len(sensor), dtype=bool))}))
    early = SensorLog(sensor.finder, sensor.stamps - 2 * START, sensor.ranges, sensor.poses, sensor.odometry)
    with pytest.raises(InvalidInputError, match=r"stamps: expected seconds within \[0, 2\^31\)"):
        write_bag(tmp_path / "run", ScanLog({"a": early}))
    log = make_log(rng)
    late = log.only_sensor()
    moved = SensorLog(late.finder, late.stamps + 1.0, late.ranges, late.poses, np.full((len(late), 3), np.nan))
    with pytest.raises(InvalidInputError, match="reference pose but no odometry"):
        write_bag(tmp_path / "run", ScanLog({"a": moved}, log.odometry))
    assert list(tmp_path.iterdir()) == []


def test_an_error_while_writing_leaves_an_older_bag_as_it_was(rng, tmp_path, monkeypatch):
    write_bag(tmp_path / "run", make_log(rng, n=3))
    before = {f.name: f.read_bytes() for f in (tmp_path / "run").iterdir()}

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("rosbags.rosbag2.Writer.write", full)
    with pytest.raises(OSError, match="No space left"):
        write_bag(tmp_path / "run", make_log(rng, n=6))
    assert {f.name: f.read_bytes() for f in (tmp_path / "run").iterdir()} == before
    assert [f.name for f in tmp_path.iterdir()] == ["run"]


def test_writing_twice_replaces_the_bag(rng, tmp_path):
    write_bag(tmp_path / "run", make_log(rng, n=3))
    write_bag(tmp_path / "run", make_log(rng, n=6))
    assert len(read_bag(tmp_path / "run").only_sensor()) == 6


def test_without_rosbags_the_error_names_the_extra(rng, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(MissingDependencyError, match=r"beamfield\[ros\]"):
        write_bag(tmp_path / "run", make_log(rng, n=3))
    assert list(tmp_path.iterdir()) == []
