"""What `read_bag` makes of small bags whose content is known by hand."""

from __future__ import annotations

import os
import sys

import numpy as np
import pytest

from beamfield.errors import FormatError, InvalidInputError, MissingDependencyError
from beamfield.geometry import compose
from beamfield.io.bags.reader import read_bag, read_bag_map
from beamfield.io.read_log import read_log
from tests.io.mini_bag import LASER_SCAN, STORAGES, MiniBag, quaternion


def drive(bag: MiniBag, seconds: float = 3.0) -> MiniBag:
    """A robot that drives along x at 1 m/s and turns by 0.2 rad/s, with its laser 0.2 m ahead, turned by 90 degrees."""
    bag.tf("base_link", "laser", 100.0, (0.2, 0.0, 0.3), quaternion(yaw=np.pi / 2), static=True)
    for time in np.arange(0.0, seconds + 0.01, 0.1):
        bag.tf("odom", "base_link", 100.0 + time, (time, 0.0, 0.0), quaternion(yaw=0.2 * time))
    return bag


@pytest.mark.parametrize("storage", STORAGES)
def test_scans_odometry_and_mount_come_out_of_every_storage(storage, tmp_path):
    bag = drive(MiniBag(storage))
    for time in (0.05, 1.0, 2.55):
        bag.scan(100.0 + time, [1.0, 2.0, np.inf])
    log = read_bag(bag.write(tmp_path))
    sensor = log.only_sensor("/scan")
    assert sensor.stamps.tolist() == [100.05, 101.0, 102.55]
    assert np.array_equal(sensor.ranges, [[1.0, 2.0, np.inf]] * 3)
    expected = [[0.2, 0.0, np.pi / 2 - 0.25], [0.2, 0.0, np.pi / 2], [0.2, 0.0, np.pi / 2 + 0.25]]
    assert np.allclose(sensor.finder.mounts, expected, atol=1e-12)
    assert (sensor.finder.min_range, sensor.finder.max_range) == (pytest.approx(0.1), 10.0)
    assert np.allclose(sensor.odometry, [[0.05, 0, 0.01], [1.0, 0, 0.2], [2.55, 0, 0.51]], atol=1e-6)
    assert not sensor.has_poses
    assert log.odometry is not None
    assert len(log.odometry) == 31
    assert np.allclose(log.odometry.poses[-1], [3.0, 0.0, 0.6])
    assert any("no reference" in note or "reference poses: none" in note for note in log.notes)


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_bag_that_was_split_is_read_whole_and_a_note_says_so_where_one_file_is_named(storage, tmp_path):
    first = drive(MiniBag(storage)).scan(101.0).write(tmp_path)
    second = MiniBag(storage).scan(102.0).write(tmp_path, "b")
    suffix = {"sqlite3": ".db3", "mcap": ".mcap"}[storage]
    (second / f"b{suffix}").rename(first / f"b{suffix}")
    metadata = (first / "metadata.yaml").read_text()
    (first / "metadata.yaml").write_text(metadata.replace(f"  - log{suffix}\n", f"  - log{suffix}\n  - b{suffix}\n"))
    for path, n_notes in ((first, 0), (first / f"b{suffix}", 1)):
        log = read_bag(path)
        assert log.only_sensor().stamps.tolist() == [101.0, 102.0]
        assert sum("is one of 2 files of a bag: all of them were read" in note for note in log.notes) == n_notes


def test_a_sensor_upside_down_has_clockwise_bearings_and_its_mount_mirrored(tmp_path):
    bag = MiniBag().tf("base_link", "laser", 0.0, (0.3, 0.1, 0.5), quaternion(roll=np.pi, yaw=0.4), static=True)
    bag.scan(1.0, [1.0, 2.0, 3.0], angle_min=-0.5, increment=0.5)
    log = read_bag(bag.write(tmp_path))
    # The sensor's x axis points to 0.4 rad; a beam that it calls 0.5 rad to the left leaves to the right.
    assert np.allclose(log.only_sensor().finder.mounts, [[0.3, 0.1, 0.9], [0.3, 0.1, 0.4], [0.3, 0.1, -0.1]])
    assert any("upside down" in note for note in log.notes)


def test_a_negative_increment_is_kept(tmp_path):
    path = MiniBag().scan(1.0, [1.0, 2.0, 3.0], angle_min=1.0, increment=-1.0).write(tmp_path)
    assert np.allclose(read_bag(path).only_sensor().finder.bearings, [1.0, 0.0, -1.0])


def test_bearings_are_those_of_the_message_to_a_millionth_of_a_radian(tmp_path):
    step = 2 * np.pi / 1440
    path = MiniBag().scan(1.0, np.ones(1440), angle_min=-np.pi, increment=step).write(tmp_path)
    expected = -np.pi + step * np.arange(1440)
    assert np.abs(np.angle(np.exp(1j * (read_bag(path).only_sensor().finder.bearings - expected)))).max() < 1e-6


def test_a_mount_comes_through_chains_of_static_and_moving_frames_with_ros1_slashes(tmp_path):
    bag = MiniBag("ros1").tf("/base_link", "/plate", 1.0, (0.1, 0.0, 0.0))
    bag.tf("/base_link", "/plate", 2.0, (0.1, 0.0, 0.0))
    bag.tf("/plate", "/laser", 1.5, (0.0, 0.2, 0.0), quaternion(yaw=1.0), static=True)
    bag.scan(0.5, frame="/laser").scan(1.5, frame="laser")  # the first one lies before all transforms
    log = read_bag(bag.write(tmp_path))
    assert np.allclose(log.only_sensor().finder.mounts[1], [0.1, 0.2, 1.0])
    assert any("sits at (0.100, 0.200) m, turned by 57.3 degrees, on 'base_link'" in note for note in log.notes)


def test_a_sensor_that_moves_on_the_robot_is_refused(tmp_path):
    bag = MiniBag()
    for time in (1.0, 2.0):
        bag.tf("base_link", "laser", time, (0.0, 0.0, 0.0), quaternion(yaw=time)).scan(time)
    with pytest.raises(FormatError, match="'laser' moves on 'base_link'"):
        read_bag(bag.write(tmp_path))


@pytest.mark.parametrize(("x", "yaw_deg", "is_fixed"), [(0.119, 1.9, True), (0.121, 0.0, False), (0.1, 2.1, False)])
def test_a_mount_may_wander_by_two_centimetres_and_two_degrees(tmp_path, x, yaw_deg, is_fixed):
    bag = MiniBag()
    # Quaternions of both signs turn alike.
    places = [(x, quaternion(yaw=0.0)), (0.1, [-v for v in quaternion(yaw=np.deg2rad(yaw_deg))]), (0.1, quaternion())]
    for time, (at, q) in enumerate(places):
        bag.tf("base_link", "laser", float(time), (at, 0.0, 0.0), tuple(q)).scan(float(time))
    path = bag.write(tmp_path)
    if is_fixed:
        assert np.allclose(read_bag(path).only_sensor().finder.mounts[1], [0.1, 0.0, 0.0])
    else:
        with pytest.raises(FormatError, match="'laser' moves on 'base_link'"):
            read_bag(path)


def test_a_tilted_sensor_is_refused_and_a_slight_tilt_noted(tmp_path):
    bag = MiniBag().tf("base_link", "laser", 0.0, q=quaternion(pitch=np.deg2rad(4.9)), static=True).scan(1.0)
    assert any("tilted by 4.9 degrees" in note for note in read_bag(bag.write(tmp_path, "slight")).notes)
    bag = MiniBag().tf("base_link", "laser", 0.0, q=quaternion(pitch=np.deg2rad(5.1)), static=True).scan(1.0)
    with pytest.raises(FormatError, match=r"/scan: .*'laser' is tilted by 5\.1 degrees"):
        read_bag(bag.write(tmp_path, "steep"))


def test_without_transforms_the_sensor_sits_at_the_robots_origin_and_a_note_says_so(tmp_path):
    log = read_bag(MiniBag().scan(1.0).write(tmp_path))
    assert np.allclose(log.only_sensor().finder.mounts[:, :2], 0.0)
    assert any("no transforms" in note for note in log.notes)


def test_a_bag_without_static_transforms_says_so_and_what_to_do(tmp_path):
    bag = MiniBag().scan(1.0).tf("odom", "base_link", 1.0)
    with pytest.raises(FormatError, match=r"frame 'laser' of /scan; .*no /tf_static was recorded; give mount \(with 0"):
        read_bag(bag.write(tmp_path))
    bag.tf("base_link", "imu", 1.0, static=True)
    with pytest.raises(FormatError, match=r"'imu'\}; give mount \(with 0 0 0"):
        read_bag(bag.write(tmp_path, "other"))


@pytest.mark.parametrize("has_footprint", [False, True])
def test_a_given_mount_replaces_the_one_that_the_bag_lacks(has_footprint, tmp_path):
    bag = MiniBag().tf("odom", "base_link", 1.0).tf("odom", "base_link", 2.0, (1.0, 0.0, 0.0)).scan(1.5)
    if has_footprint:
        bag.tf("base_link", "base_footprint", 1.0).tf("base_link", "base_footprint", 2.0)
    path = bag.write(tmp_path)
    with pytest.raises(FormatError, match="'laser'"):
        read_bag(path)
    sensor = read_bag(path, mount=(0.3, 0.0, 0.1)).only_sensor()
    assert np.allclose(sensor.finder.mounts[1], [0.3, 0.0, 0.1])
    assert np.allclose(sensor.odometry, [[0.5, 0.0, 0.0]])


def test_the_robots_frame_can_be_named(tmp_path):
    bag = MiniBag().tf("base_link", "tower", 0.0, (0.0, 1.0, 0.0), static=True)
    bag.tf("tower", "laser", 0.0, (0.0, 1.0, 0.0), static=True).scan(1.0)
    path = bag.write(tmp_path)
    assert read_bag(path).only_sensor().finder.mounts[0, 1] == 2.0
    assert read_bag(path, base_frame="/tower").only_sensor().finder.mounts[0, 1] == 1.0
    with pytest.raises(InvalidInputError, match=r"no frame 'mast'.*'tower'"):
        read_bag(path, base_frame="mast")


def test_a_namespaced_robot_is_found(tmp_path):
    bag = MiniBag().tf("r1/base_link", "r1/laser", 0.0, (0.5, 0.0, 0.0), static=True)
    bag.tf("r1/odom", "r1/base_link", 1.0).scan(1.0, frame="r1/laser")
    sensor = read_bag(bag.write(tmp_path)).only_sensor()
    assert sensor.finder.mounts[0, 0] == 0.5
    assert sensor.has_odometry


def test_reference_poses_come_from_tf_at_the_scans_stamp_and_never_beyond(tmp_path):
    bag = drive(MiniBag())
    for time in np.arange(0.5, 2.51, 0.5):
        bag.tf("map", "odom", 100.0 + time, (10.0, 0.0, 0.0), quaternion(yaw=np.pi / 2))
    for time in (0.2, 0.75, 2.5, 2.8):
        bag.scan(100.0 + time)
    log = read_bag(bag.write(tmp_path))
    poses = log.only_sensor().poses
    assert np.isnan(poses[[0, 3]]).all()
    assert np.allclose(poses[1:3], [[10.0, 0.75, np.pi / 2 + 0.15], [10.0, 2.5, np.pi / 2 + 0.5]], atol=1e-6)
    assert any("2 of 4 scans have no reference pose" in note for note in log.notes)


def test_transforms_far_apart_in_time_are_not_interpolated(tmp_path):
    bag = MiniBag().tf("base_link", "laser", 0.0, static=True).scan(1.0).scan(6.0)
    for time in (0.5, 1.5, 11.5):
        bag.tf("odom", "base_link", time).tf("map", "base_link", time)
    sensor = read_bag(bag.write(tmp_path)).only_sensor()
    assert np.isfinite(sensor.odometry[:, 0]).tolist() == np.isfinite(sensor.poses[:, 0]).tolist() == [True, False]


def test_poses_of_topics_far_apart_in_time_are_not_interpolated(tmp_path):
    bag = MiniBag().scan(1.0).scan(6.0)
    for time in (0.5, 1.5, 11.5):
        bag.odometry(time, (time, 0.0))
    sensor = read_bag(bag.write(tmp_path, "odometry")).only_sensor()
    assert np.isfinite(sensor.odometry[:, 0]).tolist() == [True, False]
    bag = MiniBag().scan(1.0).scan(6.0)
    for time in (0.5, 1.5, 11.5):
        bag.pose(time, (time, 0.0))
    sensor = read_bag(bag.write(tmp_path, "poses")).only_sensor()
    assert np.isfinite(sensor.poses[:, 0]).tolist() == [True, False]


def test_poses_of_a_topic_are_sorted_the_last_of_one_stamp_counts_and_quaternions_are_normalised(tmp_path):
    bag = MiniBag().scan(2.95)
    bag.pose(1.0, (1.0, 0.0)).pose(3.0, (9.0, 0.0)).pose(2.9, (7.0, 0.0)).pose(3.0, (3.0, 0.0), 1.0)
    bag.messages = [(topic, kind, 3.0 + 0.1 * i, message) for i, (topic, kind, _, message) in enumerate(bag.messages)]
    log = read_bag(bag.write(tmp_path, "poses"))
    assert np.allclose(log.only_sensor().poses, [[5.0, 0.0, 0.5]])
    assert any("1 of 4 messages came after later ones" in note for note in log.notes)
    bag = MiniBag().scan(2.0)
    bag.odometry(2.0, (8.0, 0.0)).odometry(2.0, (5.0, 0.0), q=tuple(1.009 * v for v in quaternion(yaw=1.0)))
    sensor = read_bag(bag.odometry(3.0, (0.0, 0.0)).write(tmp_path, "odometry")).only_sensor()
    assert np.allclose(sensor.odometry, [[5.0, 0.0, 1.0]])


def test_odometry_is_that_of_the_topic_called_so_in_the_frame_that_it_names(tmp_path):
    bag = MiniBag().scan(1.0)
    for time in (0.5, 1.5):
        bag.odometry(time, (1.0, 0.0), topic="/visual").odometry(time, (2.0, 0.0), topic="/wheel_odometry")
        bag.odometry(time, (3.0, 0.0), topic="/ground_truth/odom").pose(time, (4.0, 0.0), topic="/slam/odom")
        bag.pose(time, (5.0, 0.0), topic="/amcl_pose")
    sensor = read_bag(bag.write(tmp_path, "near")).only_sensor()
    assert (sensor.odometry[0, 0], sensor.poses[0, 0]) == (2.0, 3.0)
    for time in (0.5, 1.5):
        bag.odometry(time, (6.0, 0.0), topic="/base/odom", frame="wheels")
    assert read_bag(bag.write(tmp_path, "exact")).only_sensor().odometry[0, 0] == 6.0
    bag.tf("base_link", "laser", 0.0, static=True)
    for time in (0.5, 1.5):
        bag.tf("odom", "base_link", time, (7.0, 0.0, 0.0)).tf("wheels", "base_link", time, (8.0, 0.0, 0.0))
    assert read_bag(bag.write(tmp_path, "frames")).only_sensor().odometry[0, 0] == 8.0


@pytest.mark.parametrize(
    ("xyz", "yaw", "said"), [((0.1, 0.0, 0.0), 0.0, False), ((0.3, 0.0, 0.0), 0.0, True), ((0.1, 0.0, 0.0), 0.1, True)]
)
def test_a_mount_that_two_nodes_publish_with_other_values_is_said(tmp_path, xyz, yaw, said):
    # Quaternions need not have the length 1 to the last digit.
    bag = MiniBag().tf("base_link", "laser", 1.0, (0.1, 0.0, 0.0), (0.0, 0.0, 0.0, 0.995), static=True).scan(1.0)
    bag.tf("base_link", "laser", 1.1, xyz, quaternion(yaw=yaw), static=True)
    log = read_bag(bag.write(tmp_path))
    assert log.only_sensor().finder.mounts[1] == pytest.approx([xyz[0], 0.0, yaw])
    note = "/scan: /tf_static from 'base_link' to 'laser' was published with several values"
    assert any(note in found for found in log.notes) == said


def test_the_parts_of_a_ros1_bag_that_was_split_are_read_as_one(tmp_path):
    parts, whole = tmp_path / "parts", MiniBag("ros1").tf("base_link", "laser", 0.0, static=True)
    parts.mkdir()
    for part in range(11):
        bag = MiniBag("ros1")
        if part == 0:
            bag.tf("base_link", "laser", 0.0, static=True)
        for i in range(3):
            for either in (bag, whole):
                either.scan(part + 0.1 * i, [1.0 + part + 0.1 * i] * 3).odometry(part + 0.1 * i, (part + 0.1 * i, 0.0))
        bag.write(parts, f"drive_2026-01-01-10-{part:02}-00_{part}")
    together, alone = read_bag(parts).only_sensor(), read_bag(whole.write(tmp_path)).only_sensor()
    assert together.stamps.tolist() == alone.stamps.tolist()
    assert np.array_equal(together.ranges, alone.ranges)
    assert np.array_equal(together.odometry, alone.odometry, equal_nan=True)


@pytest.mark.parametrize(
    ("static", "stamps", "why"),
    [
        (True, [], "is static"),
        (False, [0.0] * 20, "has one stamp, 0"),
        (True, [*range(20)], "is static, but was published with several values (do two nodes publish it?)"),
    ],
    ids=["static", "not stamped", "both"],
)
def test_a_map_that_odometry_does_not_move_in_is_no_reference(tmp_path, static, stamps, why):
    bag = MiniBag().tf("base_link", "laser", 0.0, static=True)
    if static:
        bag.tf("map", "odom", 0.0, static=True)
    for i in range(20):
        bag.scan(1.0 + 0.1 * i).tf("odom", "base_link", 0.95 + 0.1 * i, (0.1 * i, 0.0, 0.0))
    for i, stamp in enumerate(stamps):
        bag.tf("map", "odom", stamp, (0.01 * i, 0.0, 0.0), recorded=1.0 + 0.1 * i)
    path = bag.write(tmp_path, "alone")
    log = read_bag(path)
    note = f"/tf from 'map' to 'odom' {why}: odometry alone, no reference (if it is exact, give map_frame)"
    assert note in log.notes
    assert "reference poses: none in this bag" in log.notes
    assert np.isnan(log.only_sensor().poses).all()
    if not stamps:
        assert np.isfinite(read_bag(path, map_frame="map").only_sensor().poses[:-1]).all()
    for i in range(20):
        bag.pose(1.0 + 0.1 * i, (5.0 + 0.1 * i, 0.0))
    poses = read_bag(bag.write(tmp_path, "amcl")).only_sensor().poses
    assert poses[:, 0] == pytest.approx(5.0 + 0.1 * np.arange(20))


def test_a_pose_topic_that_was_asked_for_goes_before_tf(tmp_path):
    bag = drive(MiniBag())
    for time in (0.0, 0.1, 0.2):
        bag.tf("map", "odom", 100.0 + time).pose(100.0 + time, (5.0, 6.0), 0.1, topic="/mocap", covariance=False)
    path = bag.scan(100.1).write(tmp_path)
    assert np.allclose(read_bag(path).only_sensor().poses, [[0.1, 0.0, 0.02]], atol=1e-6)
    asked = read_bag(path, poses_topic="mocap")
    assert np.allclose(asked.only_sensor().poses, [[5.0, 6.0, 0.1]])
    assert not any("odometry between its poses" in note for note in asked.notes)  # ten a second need none


def test_ground_truth_is_found_by_name_and_is_not_taken_for_odometry(tmp_path):
    bag = MiniBag()
    for time in (1.0, 2.0):
        bag.odometry(time, (7.0, time), topic="/base_pose_ground_truth")
        bag.odometry(time, (0.0, time), topic="/robot/wheel_odometry")
    log = read_bag(bag.scan(1.5).write(tmp_path))
    assert np.allclose(log.only_sensor().poses, [[7.0, 1.5, 0.0]])
    assert np.allclose(log.only_sensor().odometry, [[0.0, 1.5, 0.0]])
    assert any("/base_pose_ground_truth" in note for note in log.notes)


@pytest.mark.parametrize("robots", [("",), ("/robot1", "/robot2")])
def test_ground_truth_is_the_robots_own_though_its_last_name_is_that_of_the_odometry(robots, tmp_path):
    bag = MiniBag()
    for x, name in enumerate(robots, start=1):
        bag.scan(1.0, topic=f"{name}/scan").odometry(1.0, (x, 0.0), topic=f"{name}/odom")
        bag.odometry(1.0, (7.0 * x, 0.0), topic=f"{name}/ground_truth/odom", frame="world")
    path = bag.write(tmp_path)
    for x, name in enumerate(robots, start=1):
        sensor = read_bag(path, sensor_topic=f"{name}/scan").only_sensor()
        assert (sensor.odometry[0, 0], sensor.poses[0, 0]) == (x, 7.0 * x)


@pytest.mark.parametrize(
    ("step", "scans", "is_noted"), [(1.0, 0.2, True), (0.5, 0.2, True), (0.25, 0.1, False), (1.0, 1.0, False)]
)
def test_odometry_that_comes_too_seldom_to_interpolate_turns_is_noted(step, scans, is_noted, tmp_path):
    bag = MiniBag()
    for time in np.arange(0.0, 5.01, step):
        bag.odometry(10.0 + time, (time, 0.0))
    for time in np.arange(0.0, 5.01, scans):
        bag.scan(10.0 + time)
    (text,) = [note for note in read_bag(bag.write(tmp_path)).notes if "has a pose every" in note] or [""]
    assert (
        text.startswith(f"/scan: the odometry has a pose every {step:.1f} s, the scans come every 0.2 s: ") == is_noted
    )
    assert bool(text) == is_noted


def test_odometry_on_tf_may_have_a_frame_that_is_only_named_after_it(tmp_path):
    bag = MiniBag().scan(99.5).scan(100.0).tf("base_link", "laser", 0.0, static=True)
    for time in (99.0, 101.0):
        bag.tf("base_link", "odom_encoder", time).tf("odom_combined", "base_link", time, (time, 0.0, 0.0))
    log = read_bag(bag.write(tmp_path))
    assert np.allclose(log.only_sensor().odometry, [[99.5, 0.0, 0.0], [100.0, 0.0, 0.0]])
    assert "odometry: /tf from 'odom_combined' to 'base_link'" in log.notes


def test_ground_truth_in_a_frame_that_is_fixed_to_the_map_is_moved_there(tmp_path):
    bag = MiniBag().scan(1.0).scan(2.0).tf("base_link", "laser", 0.0, static=True)
    bag.tf("world", "map", 0.0, (1.0, 2.0, 0.0), quaternion(yaw=np.pi / 2), static=True)
    for time in (1.0, 2.0):
        bag.pose(time, (1.0, 5.0 + time), np.pi / 2, topic="/ground_truth/pose", frame="world", covariance=False)
        bag.tf("world", "odom", time, (time, 0.0, 0.0)).odometry(time, (time, 0.0), topic="/ground_truth/odom")
    path = bag.write(tmp_path)
    log = read_bag(path, poses_topic="/ground_truth/pose")
    assert np.allclose(log.only_sensor().poses, [[4.0, 0.0, 0.0], [5.0, 0.0, 0.0]])
    assert any(note.endswith("/ground_truth/pose in frame 'world', moved to 'map' by /tf") for note in log.notes)
    # One whose frame moves in the map is taken as it is.
    moving = read_bag(path, poses_topic="/ground_truth/odom")
    assert np.allclose(moving.only_sensor().poses, [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]])


def test_sparse_localisation_is_bridged_by_odometry(tmp_path):
    bag = drive(MiniBag(), 10.0)
    # The localiser speaks every 5 s; the correction of the odometry drifts from (0, 0) by 0.1 m each time.
    for time, drift in ((0.0, 0.0), (5.0, 0.1), (10.0, 0.2)):
        bag.pose(100.0 + time, (time, drift), 0.2 * time)
    for time in (2.5, 7.5):
        bag.scan(100.0 + time)
    log = read_bag(bag.write(tmp_path))
    assert np.allclose(log.only_sensor().poses, [[2.5, 0.05, 0.5], [7.5, 0.15, 1.5]], atol=1e-6)
    assert any("odometry between its poses" in note for note in log.notes)


def test_where_the_odometrys_frame_lies_changes_nothing_between_sparse_poses(tmp_path):
    """The localiser errs by up to 0.1 rad; a robot that has come far has its odometry's origin far away."""
    found = []
    for name, far in (("near", (0.0, 0.0, 0.0)), ("far", (200.0, -90.0, 1.0))):
        bag = MiniBag().tf("base_link", "laser", 100.0, static=True)
        for time in np.arange(0.0, 4.05, 0.1):
            x, y, heading = compose(far, [time, 0.1 * time, 0.2 * time]).tolist()
            bag.tf("odom", "base_link", 100.0 + time, (x, y, 0.0), quaternion(yaw=heading))
        for time, error in ((0.0, 0.1), (2.0, -0.1), (4.0, 0.1)):
            bag.pose(100.0 + time, (time, 0.0), 0.2 * time + error)
        for time in (0.5, 1.0, 3.0):
            bag.scan(100.0 + time)
        found.append(read_bag(bag.write(tmp_path, name)).only_sensor().poses)
    np.testing.assert_allclose(found[1], found[0], atol=1e-6)


def test_the_odometry_topic_serves_where_tf_has_none_and_is_moved_to_the_robots_frame(tmp_path):
    bag = MiniBag().tf("base_link", "laser", 0.0, static=True)
    bag.tf("base_link", "base_footprint", 0.0, (-0.5, 0.0, 0.0), static=True)
    for time in (1.0, 2.0):
        bag.odometry(time, (time, 0.0), np.pi / 2, child="base_footprint")
    log = read_bag(bag.scan(1.5).write(tmp_path))
    # base_link sits half a metre ahead of base_footprint, which looks along y.
    assert np.allclose(log.only_sensor().odometry, [[1.5, 0.5, np.pi / 2]])
    assert log.odometry is not None
    assert len(log.odometry) == 2


def test_odometry_of_a_camera_that_looks_down_is_that_of_the_robot_below_it(tmp_path):
    """The camera sits 0.2 m ahead and 1 m up, pitched by half a radian: seen from it, the robot is not just behind."""
    bag = MiniBag().tf("base_link", "laser", 0.0, static=True)
    bag.tf("base_link", "camera", 0.0, (0.2, 0.0, 1.0), quaternion(pitch=0.5), static=True)
    driven = np.array([[1.0, 0.0, 0.0], [1.5, 0.4, 1.0], [1.6, 1.0, 2.0]])
    for time, (x, y, heading) in enumerate(driven.tolist(), start=1):
        at = (x + 0.2 * np.cos(heading), y + 0.2 * np.sin(heading))
        bag.odometry(float(time), at, q=quaternion(pitch=0.5, yaw=heading), child="camera").scan(float(time))
    log = read_bag(bag.write(tmp_path))
    np.testing.assert_allclose(log.only_sensor().odometry, driven, atol=1e-9)


def test_poses_of_a_motion_capture_whose_y_points_upwards_are_turned_into_the_map(tmp_path):
    bag = MiniBag().tf("base_link", "laser", 0.0, static=True)
    bag.tf("map", "capture", 0.0, (3.0, 1.0, 0.0), quaternion(roll=np.pi / 2), static=True)
    for time, heading in ((1.0, 0.3), (1.1, -2.5)):
        turned = quaternion(roll=-np.pi / 2, pitch=heading)  # the robot's heading turns about y there
        bag.odometry(time, (time, 0.0), q=turned, topic="/ground_truth/odom", frame="capture").scan(time)
    log = read_bag(bag.write(tmp_path))
    np.testing.assert_allclose(log.only_sensor().poses, [[4.0, 1.0, 0.3], [4.1, 1.0, -2.5]], atol=1e-9)
    assert not any("tilted" in note for note in log.notes)


def test_a_topic_whose_frame_has_no_z_upwards_is_named_where_nothing_turns_it(tmp_path):
    bag = MiniBag().tf("base_link", "laser", 0.0, static=True)
    lying, topic = quaternion(roll=-np.pi / 2), "/ground_truth/odom"
    for time in (1.0, 1.1):
        bag.odometry(time, (time, 0.0), q=lying, topic=topic, frame="capture").scan(time)
    (note,) = (note for note in read_bag(bag.write(tmp_path), poses_topic=topic).notes if "tilted" in note)
    assert note.startswith(f"{topic}: by its poses the robot is tilted by 90 degrees (median)")


def test_beams_at_the_ends_of_a_mask_are_masked_though_bags_have_single_precision(tmp_path):
    step = np.pi / 180.0
    bag = MiniBag().scan(1.0, np.ones(181), angle_min=-np.pi / 2, increment=step)
    path = bag.write(tmp_path)
    for first, last in ((-90, -60), (-31, -15), (60, 90)):
        ranges = read_log(path, mask=[(np.radians(first), np.radians(last))]).only_sensor().ranges[0]
        masked = np.arange(-90, 91)[np.isnan(ranges)]
        assert (masked[0], masked[-1], len(masked)) == (first, last, last - first + 1)
    for first, last in ((-180, 180), (-400, 0)):
        assert np.isnan(read_log(path, mask=[(np.radians(first), np.radians(last))]).only_sensor().ranges).all()


def test_several_sensors_are_read_unless_one_is_chosen(tmp_path):
    bag = MiniBag().scan(1.0, topic="/front", frame="f").scan(1.0, [1.0], topic="/rear", frame="r")
    path = bag.write(tmp_path)
    assert list(read_bag(path).sensors) == ["/front", "/rear"]
    assert list(read_bag(path, sensor_topic="rear").sensors) == ["/rear"]
    assert list(read_bag(path, sensor_topic=["/rear", "/front"]).sensors) == ["/rear", "/front"]


def add_robot(bag: MiniBag, name: str, speed: float, *, tf: str = "", frames: str = "", with_map: bool = False) -> None:
    """Add a robot that drives along x, with its laser ahead by a tenth of the speed; its topics have its name."""
    laser, base, odom = f"{frames}laser", f"{frames}base_link", f"{frames}odom"
    n_before = len(bag.messages)
    bag.tf(base, laser, 100.0, (0.1 * speed, 0.0, 0.3), static=True)
    for time in np.arange(0.0, 3.05, 0.1):
        bag.tf(odom, base, 100.0 + time, (speed * time, 0.0, 0.0))
        if with_map:
            bag.tf("map", odom, 100.0 + time, (7.0 * speed, 0.0, 0.0))
    moved = [(f"{tf}{topic}", *rest) for topic, *rest in bag.messages[n_before:]]
    bag.messages[n_before:] = moved
    bag.topics = {topic: msgtype for topic, msgtype, *_ in bag.messages}
    for time in (100.0, 101.0, 102.0, 103.0):
        bag.scan(time, topic=f"/{name}/scan", frame=laser)
        bag.odometry(time, (speed * (time - 100.0), 0.0), topic=f"/{name}/odom", frame=odom, child=base)
        bag.pose(time, (50.0 + speed, 0.0), topic=f"/{name}/amcl_pose")


@pytest.mark.parametrize(("name", "speed"), [("robot1", 1.0), ("robot2", 2.0)])
@pytest.mark.parametrize("with_map", [True, False])
def test_of_robots_whose_frames_have_prefixes_each_has_its_own_mount_odometry_and_poses(
    name, speed, with_map, tmp_path
):
    bag = MiniBag()
    for one, fast in (("robot1", 1.0), ("robot2", 2.0)):
        add_robot(bag, one, fast, frames=f"{one}/", with_map=with_map)
    sensor = read_bag(bag.write(tmp_path), sensor_topic=f"/{name}/scan").only_sensor()
    assert np.allclose(sensor.finder.mounts[:, 0], 0.1 * speed)
    assert np.allclose(sensor.odometry[:, 0], speed * np.arange(4.0))
    assert np.allclose(sensor.poses[:, 0], speed * (7.0 + np.arange(4.0)) if with_map else 50.0 + speed)


@pytest.mark.parametrize(("name", "speed"), [("robot1", 1.0), ("robot2", 2.0)])
def test_of_robots_with_topics_of_transforms_of_their_own_each_has_its_own_frames(name, speed, tmp_path):
    bag = MiniBag()
    for one, fast in (("robot1", 1.0), ("robot2", 2.0)):
        add_robot(bag, one, fast, tf=f"/{one}")
    path = bag.write(tmp_path)
    sensor = read_bag(path, sensor_topic=f"/{name}/scan").only_sensor()
    assert np.allclose(sensor.finder.mounts[:, 0], 0.1 * speed)
    assert np.allclose(sensor.odometry[:, 0], speed * np.arange(4.0))
    assert np.allclose(sensor.poses[:, 0], 50.0 + speed)
    with pytest.raises(InvalidInputError, match=r"of several robots.*choose one by sensor_topic: the bag has '/robot1"):
        read_bag(path)


@pytest.mark.parametrize("own_first", [True, False])
def test_of_transforms_on_the_robots_own_topic_and_on_the_common_one_its_own_count(own_first, tmp_path):
    bag = MiniBag()
    robots = [("robot1", 1.0, "/robot1"), ("robot2", 2.0, "")]
    for name, speed, tf in robots if own_first else robots[::-1]:
        add_robot(bag, name, speed, tf=tf)
    path = bag.write(tmp_path)
    own, common = (read_bag(path, sensor_topic=f"/{name}/scan").only_sensor() for name in ("robot1", "robot2"))
    assert np.allclose(own.odometry[:, 0], np.arange(4.0))
    assert np.allclose(own.finder.mounts[:, 0], 0.1)
    assert np.allclose(common.odometry[:, 0], 2.0 * np.arange(4.0))


def test_scans_of_several_robots_are_refused_with_what_to_do(tmp_path):
    bag = MiniBag()
    for one, fast in (("robot1", 1.0), ("robot2", 2.0)):
        add_robot(bag, one, fast, frames=f"{one}/", with_map=True)
    with pytest.raises(
        FormatError, match=r"/robot2/scan: .* moves on 'robot1/base_link'.*choose scans by sensor_topic"
    ):
        read_bag(bag.write(tmp_path))


def test_of_scans_of_robots_that_nothing_connects_one_has_to_be_chosen(tmp_path):
    bag = MiniBag()
    for one, fast in (("robot1", 1.0), ("robot2", 2.0)):
        add_robot(bag, one, fast, frames=f"{one}/")
    with pytest.raises(FormatError, match=r"of several robots.*choose one by sensor_topic: the bag has '/robot1/scan'"):
        read_bag(bag.write(tmp_path))


def test_odometry_of_another_robot_is_not_taken_where_no_bag_has_transforms(tmp_path):
    bag = MiniBag()
    for one, x in (("robot1", 1.0), ("robot2", 2.0)):
        bag.scan(100.0, topic=f"/{one}/scan").odometry(100.0, (x, 0.0), topic=f"/{one}/odom")
    sensor = read_bag(bag.write(tmp_path), sensor_topic="/robot2/scan").only_sensor()
    assert sensor.odometry[0, 0] == 2.0


def test_header_stamps_count_not_the_times_of_recording(tmp_path):
    path = MiniBag().scan(5.0, recorded=100.0).scan(6.0, recorded=101.0).write(tmp_path)
    assert read_bag(path).only_sensor().stamps.tolist() == [5.0, 6.0]


def test_times_of_recording_replace_stamps_that_are_all_equal_with_a_note(tmp_path):
    for stamp in (0.0, 5.0):
        log = read_bag(MiniBag().scan(stamp, recorded=7.0).scan(stamp, recorded=8.0).write(tmp_path / f"{stamp:g}"))
        assert log.only_sensor().stamps.tolist() == [7.0, 8.0]
        assert any(f"stamp is {stamp:g};" in note for note in log.notes)
    bag = MiniBag().scan(7.5).odometry(0.0, (0.0, 0.0), recorded=7.0).odometry(0.0, (1.0, 0.0), recorded=8.0)
    log = read_bag(bag.write(tmp_path / "odometry"))
    assert log.only_sensor().odometry.tolist() == [[0.5, 0.0, 0.0]]
    assert any(note.startswith("/odom: every header stamp is 0; receive times") for note in log.notes)
    assert not any("clock" in note for note in log.notes)


def test_transforms_that_nobody_stamped_do_not_hide_the_odometry_topic(tmp_path):
    bag = MiniBag().scan(7.5)
    for time in (7.0, 8.0):
        bag.odometry(time, (time, 0.0)).tf("odom", "base_link", 0.0, (time, 0.0, 0.0), recorded=time)
    log = read_bag(bag.tf("base_link", "laser", 0.0, static=True).write(tmp_path))
    assert log.only_sensor().odometry.tolist() == [[7.5, 0.0, 0.0]]
    assert "/tf from 'odom' to 'base_link': every stamp is 0; /odom is used instead" in log.notes


def test_scans_that_swapped_places_on_the_network_are_sorted_with_a_note(tmp_path):
    bag = MiniBag().scan(1.0, [1, 1, 1], recorded=1.0).scan(1.2, [3, 3, 3], recorded=1.1)
    log = read_bag(bag.scan(1.1, [2, 2, 2], recorded=1.2).write(tmp_path))
    assert log.only_sensor().stamps.tolist() == [1.0, 1.1, 1.2]
    assert log.only_sensor().ranges[:, 0].tolist() == [1.0, 2.0, 3.0]
    assert any("sorted by their stamps" in note for note in log.notes)


def test_scans_that_are_published_twice_are_noted(tmp_path):
    bag = MiniBag()
    for i in range(4):
        for _ in range(2):
            bag.scan(1.0 + i, [1.0 + i, np.nan, 3.0])
    log = read_bag(bag.scan(4.0, [9.0, np.nan, 3.0]).write(tmp_path))
    assert "/scan: 4 of 9 scans repeat the one before, stamp and readings" in log.notes


def test_single_scans_that_were_long_under_way_are_sorted_with_a_note(tmp_path):
    stamps = np.arange(300) * 0.1
    arrived = np.r_[stamps[:50], stamps[51:100], stamps[50], stamps[100:]]
    bag = MiniBag()
    for recorded, stamp in zip(stamps, arrived, strict=True):
        bag.scan(stamp, [1.0 + stamp / 10.0] * 3, recorded=recorded)
    log = read_bag(bag.write(tmp_path))
    assert np.allclose(log.only_sensor().stamps, stamps)
    assert np.allclose(log.only_sensor().ranges[:, 0], 1.0 + stamps / 10.0)
    assert "/scan: 1 of 300 messages came after later ones, by up to 4.9 s, and are sorted by their stamps" in log.notes


def test_given_limits_replace_the_declared_ones_and_include_what_float32_rounded(tmp_path):
    path = MiniBag().scan(1.0, [0.05, 5.6, 2.0], range_max=30.0).write(tmp_path)
    finder = read_bag(path, max_range=5.6, min_range=0.2).only_sensor().finder
    assert np.float32(5.6) >= finder.max_range
    assert finder.max_range == pytest.approx(5.6)
    assert finder.min_range == pytest.approx(0.2)


def bag_of(tmp_path, ranges, **limits):
    bag = MiniBag()
    for i, row in enumerate(ranges):
        bag.scan(float(i + 1), row, **limits)
    tmp_path.mkdir(exist_ok=True)
    return bag.write(tmp_path)


def scans_of(tmp_path, ranges, **options):
    limits = {k: options.pop(k) for k in ("range_min", "range_max") if k in options}
    return read_bag(bag_of(tmp_path, ranges, **limits), **options).only_sensor()


def ordinary_ranges(rng, n=100, k=20, low=0.5, high=6.0):
    return rng.uniform(low, high, (n, k)).astype(np.float32)


def test_declared_limits_may_change_if_others_are_given(tmp_path):
    path = MiniBag().scan(1.0, range_max=0.0).scan(2.0).write(tmp_path)
    assert read_bag(path, max_range=2.5).only_sensor().finder.max_range == 2.5


def test_rep117_needs_no_conversion(tmp_path):
    sensor = scans_of(tmp_path, [[np.inf, np.nan, -np.inf, 10.0, 0.05, 2.0]])
    assert np.array_equal(
        sensor.ranges[0], np.array([np.inf, np.nan, -np.inf, 10.0, np.float32(0.05), 2.0]), equal_nan=True
    )
    assert sensor.no_return.origin == "declared"
    assert sensor.no_return.share == pytest.approx(2 / 6)


def test_frequent_zeros_mean_no_return_if_nothing_else_does(rng, tmp_path):
    ranges = ordinary_ranges(rng)
    ranges[rng.random(ranges.shape) < 0.3] = 0.0
    sensor = scans_of(tmp_path, ranges)
    assert np.array_equal(np.isposinf(sensor.ranges), ranges == 0.0)
    assert (sensor.no_return.values, sensor.no_return.origin) == ((0.0,), "detected")
    assert sensor.no_return.share == pytest.approx((ranges == 0.0).mean())


def test_zeros_are_too_close_where_infinity_means_no_return(rng, tmp_path):
    ranges = ordinary_ranges(rng)
    ranges[:, 0], ranges[:, 1] = 0.0, np.inf
    sensor = scans_of(tmp_path, ranges)
    assert (sensor.ranges[:, 0] == 0.0).all()
    assert sensor.no_return.values == ()


def test_zeros_mean_no_return_beside_measurements_beyond_the_limit(rng, tmp_path):
    ranges = ordinary_ranges(rng)
    ranges[rng.random(ranges.shape) < 0.3] = 0.0
    far = rng.random(ranges.shape) < 0.02
    ranges[far] = rng.uniform(10.5, 25.0, int(far.sum()))
    sensor = scans_of(tmp_path, ranges)
    assert np.array_equal(np.isposinf(sensor.ranges), ranges == 0.0)
    assert (sensor.no_return.values, sensor.no_return.origin) == ((0.0,), "detected")
    assert "are numbers beyond 10 m: give max_range" in sensor.no_return.explanation
    ranges[far] = 10.5  # one value is the sensor's word for it
    sensor = scans_of(tmp_path / "word", ranges)
    assert sensor.no_return.values == ()
    assert "are 0, taken as too close, unless no_return names 0 as well" in sensor.no_return.explanation


def test_a_declared_limit_that_many_readings_pass_is_doubted_once_and_not_one_that_was_given(rng, tmp_path):
    ranges = ordinary_ranges(rng)
    far = rng.random(ranges.shape) < 0.1
    ranges[far] = 60.0  # one value is the sensor's word for "no return"
    assert not any("range_max" in note for note in read_bag(bag_of(tmp_path, ranges)).notes)
    ranges[far] = np.round(rng.uniform(11.0, 24.0, int(far.sum())), 2)
    path = bag_of(tmp_path / "different", ranges)
    (note,) = (note for note in read_bag(path).notes if "range_max" in note)
    assert note.startswith("/scan: 10% of the readings are beyond the declared range_max of 10 m, up to 23.86 m")
    assert not any("range_max" in note for note in read_bag(path, max_range=8.0).notes)


def test_rare_zeros_of_a_sensor_without_lower_limit_are_no_measurement(rng, tmp_path):
    ranges = ordinary_ranges(rng)
    ranges[3, 3] = 0.0
    sensor = scans_of(tmp_path, ranges, range_min=0.0)
    assert np.argwhere(np.isnan(sensor.ranges)).tolist() == [[3, 3]]
    assert "0.05% are 0" in sensor.no_return.explanation


def test_a_repeated_greatest_value_below_the_limit_means_no_return(rng, tmp_path):
    ranges = ordinary_ranges(rng)
    ranges[rng.random(ranges.shape) < 0.1] = 8.0
    sensor = scans_of(tmp_path, ranges)
    assert np.array_equal(np.isposinf(sensor.ranges), ranges == 8.0)
    assert (sensor.no_return.values, sensor.no_return.origin) == ((8.0,), "detected")
    assert sensor.finder.max_range == 8.0  # where the sensor falls silent, whatever it declares
    given = scans_of(tmp_path / "given", ranges, max_range=9.0)
    assert given.finder.max_range == 9.0
    assert np.array_equal(np.isposinf(given.ranges), ranges == 8.0)


def test_a_far_wall_with_noise_is_not_taken_for_no_return(rng, tmp_path):
    ranges = ordinary_ranges(rng)
    for step in (0.01, 0.001):
        ranges[:, :5] = np.round(rng.normal(8.0, 0.01, (100, 5)) / step) * step
        assert scans_of(tmp_path / str(step), ranges).no_return.origin == "none"


def test_a_sensor_that_only_says_too_close_has_no_special_value(rng, tmp_path):
    ranges = rng.uniform(0.01, 0.09, (100, 20)).astype(np.float32)
    ranges[:, :10] = 0.095
    assert scans_of(tmp_path, ranges).no_return.origin == "none"


def test_a_simulated_robot_that_stands_shows_no_special_value(rng, tmp_path):
    ranges = np.tile(ordinary_ranges(rng, n=1), (100, 1))
    ranges[:, 7] = 9.0  # one beam through a door
    assert scans_of(tmp_path, ranges).no_return.origin == "none"


def test_a_policy_can_be_given_or_switched_off(rng, tmp_path):
    ranges = ordinary_ranges(rng)
    ranges[:, 0], ranges[:, 1], ranges[:, 2] = 0.0, np.nan, 65.533
    path = MiniBag()
    for i, row in enumerate(ranges):
        path.scan(float(i + 1), row, range_max=80.0)
    path = path.write(tmp_path)
    given = read_bag(path, no_return=(65.533, float("nan"))).only_sensor()
    assert np.isposinf(given.ranges[:, 1:3]).all()
    assert (given.ranges[:, 0] == 0.0).all()
    assert (given.no_return.origin, given.no_return.share) == ("given", pytest.approx(0.1))
    off = read_bag(path, no_return="none").only_sensor()
    assert np.array_equal(off.ranges, ranges.astype(float), equal_nan=True)
    with pytest.raises(InvalidInputError, match="'guess'"):
        read_bag(path, no_return="guess")


def test_four_rangers_of_a_drone_are_read_with_their_flow_odometry(tmp_path):
    bag = MiniBag("ros1")
    for time in (1.0, 1.1, 1.2):
        q = quaternion(yaw=0.5)
        bag.raw(time, [time, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0], "/cf/state_xyzv")
        bag.raw(time + 0.05, [0.5, 1.0, 1.5, 4.5, 2.4, *q], "/cf/state_ranger_qxyzw")
    log = read_bag(bag.write(tmp_path))
    sensor = log.only_sensor("/cf/state_ranger_qxyzw")
    assert np.allclose(np.rad2deg(sensor.finder.bearings), [-90, 0, 90, 180])
    assert np.allclose(sensor.ranges[0], [0.5, 1.0, 1.5, 4.5])
    assert np.allclose(sensor.odometry, [[1.05, 0, 0.5], [1.15, 0, 0.5], [np.nan] * 3], equal_nan=True, atol=1e-6)
    assert np.rad2deg(sensor.finder.opening_angle) == pytest.approx(27.0)
    assert (sensor.finder.min_range, sensor.finder.max_range) == (0.04, 4.0)


def test_what_was_done_to_the_positions_of_a_drone_is_noted(tmp_path):
    bag = MiniBag("ros1")
    for time, recorded in ((1.0, 1.0), (1.1, 1.22), (1.2, 1.2), (1.3, 1.3)):
        bag.raw(time, [time, 0.0, 0.3, 0.0, 0.0, 0.0, 0.0], "/cf/state_xyzv", recorded=recorded)
    for time in (1.05, 1.15, 1.25):
        bag.raw(time, [0.5, 1.0, 1.5, 4.5, 2.4, *quaternion(yaw=0.5)], "/cf/state_ranger_qxyzw")
    notes = read_bag(bag.write(tmp_path)).notes
    assert any("/cf/state_xyzv: 1 of 4 messages came after later ones" in note for note in notes)


def test_a_single_file_of_a_bag_and_a_folder_that_lost_its_metadata_are_read(tmp_path):
    for storage in ("sqlite3", "mcap"):
        folder = MiniBag(storage).scan(1.0).scan(2.0).write(tmp_path, storage)
        file = next(f for f in folder.iterdir() if f.suffix in (".db3", ".mcap"))
        assert len(read_bag(file).only_sensor()) == 2
        (folder / "metadata.yaml").unlink()
        assert len(read_bag(file).only_sensor()) == 2
        assert len(read_bag(folder).only_sensor()) == 2


def test_a_file_whose_name_is_not_valid_utf_8_is_read_beside_metadata(tmp_path):
    file = next(MiniBag("mcap").scan(1.0).write(tmp_path).glob("*.mcap"))
    renamed = file.rename(file.with_name(os.fsdecode(b"f\xe4.mcap")))
    assert len(read_bag(renamed).only_sensor()) == 1


def test_a_map_is_the_last_one_published_with_its_origin_turned(tmp_path):
    for storage in STORAGES:
        bag = MiniBag(storage).grid(1.0, 1, 1, [0])
        bag.grid(2.0, 3, 2, [0, 100, -1, 50, 0, 0], xy=(1.0, 2.0), q=quaternion(yaw=0.5), resolution=0.25)
        grid = read_bag_map(bag.write(tmp_path, storage))
        assert np.allclose(grid.probability, [[0.0, 1.0, np.nan], [0.5, 0.0, 0.0]], equal_nan=True)
        assert grid.resolution == 0.25
        assert np.allclose(grid.origin, [1.0, 2.0, 0.5])


def test_maps_are_chosen_by_topic_and_four_zeros_are_no_rotation(tmp_path):
    bag = MiniBag().grid(1.0, 1, 1, [0], topic="/map").grid(1.0, 1, 1, [100], topic="/costmap", q=(0.0, 0.0, 0.0, 0.0))
    path = bag.scan(1.0).write(tmp_path)
    assert read_bag_map(path).free.all()
    assert read_bag_map(path, "costmap").occupied.all()
    with pytest.raises(InvalidInputError, match=r"'/scan' holds sensor_msgs/msg/LaserScan"):
        read_bag_map(path, "/scan")


def test_without_rosbags_the_error_names_the_extra(tmp_path, monkeypatch):
    path = MiniBag().scan(1.0).write(tmp_path)
    monkeypatch.setitem(sys.modules, "rosbags.highlevel", None)
    with pytest.raises(MissingDependencyError, match=r"beamfield\[ros\]"):
        read_bag(path)


def test_topics_without_messages_are_passed_over(tmp_path):
    path = MiniBag().declare("/dead_scan", LASER_SCAN).scan(1.0).write(tmp_path)
    assert list(read_bag(path).sensors) == ["/scan"]


@pytest.mark.parametrize(("apart", "twice"), [(0.05, ""), (0.4, "odometry: back and forth 98 times, by up to 0.40 m")])
def test_odometry_that_two_nodes_publish_is_noted(apart, twice, tmp_path):
    bag = MiniBag().tf("base_link", "laser", 100.0, static=True)
    for i in range(100):
        bag.tf("odom", "base_link", 100.0 + 0.02 * i, (0.01 * i, apart * (i % 2), 0.0)).scan(100.0 + 0.02 * i)
    notes = [note for note in read_bag(bag.write(tmp_path)).notes if "two nodes" in note]
    assert [note.partition(":")[0] for note in notes] == (["odometry"] if twice else [])
    assert "".join(notes).startswith(twice)


def test_a_filter_that_two_nodes_run_is_noted_once_odometry_is_whole(tmp_path):
    bag = MiniBag().tf("base_link", "laser", 100.0, static=True)
    for i in range(100):
        stamp = 100.0 + 0.02 * i
        bag.tf("odom", "base_link", stamp, (0.01 * i, 0.0, 0.0)).tf("map", "odom", stamp, (5.0, i % 2, 0.0)).scan(stamp)
    (note,) = [note for note in read_bag(bag.write(tmp_path)).notes if "two nodes" in note]
    assert note.startswith("/scan: reference poses: back and forth 98 times, by up to 1.00 m")


def test_a_second_localizer_is_noted_though_the_scans_have_the_poses_of_one(tmp_path):
    bag = MiniBag().tf("base_link", "laser", 100.0, static=True)
    for i in range(100):
        stamp = 100.0 + 0.04 * i
        bag.tf("odom", "base_link", stamp, (0.01 * i, 0.0, 0.0)).scan(stamp).tf("map", "odom", stamp, (5.0, 0.0, 0.0))
        bag.tf("map", "odom", stamp + 0.02, (5.0, 1.0, 0.0))
    (note,) = [note for note in read_bag(bag.write(tmp_path)).notes if "two nodes" in note]
    assert note.startswith("reference poses: back and forth 197 times, by up to 1.00 m")


@pytest.mark.parametrize(("late", "noted"), [(0.9, ""), (30.0, "30.0 s earlier"), (-2.0, "2.0 s later")])
def test_scans_of_another_clock_are_noted_by_the_times_of_recording(late, noted, tmp_path):
    bag = MiniBag().tf("base_link", "laser", 100.0, static=True, recorded=5000.0)
    for i in range(10):
        stamp = 100.0 + 0.1 * i
        bag.tf("odom", "base_link", stamp, (0.01 * i, 0.0, 0.0)).tf("map", "odom", stamp + 20.0, recorded=stamp)
        bag.tf("base_link", "wheel", 0.0, recorded=stamp).scan(stamp, recorded=stamp + late)
    notes = [note for note in read_bag(bag.write(tmp_path)).notes if "stamped" in note]
    assert [noted in note for note in notes] == ([True] if noted else [])
