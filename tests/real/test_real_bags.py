"""The bags of `shared/data`: counts as its README has them, poses as derived there or as another reader sees them."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from beamfield.geometry import between, compose
from beamfield.io.bags.reader import read_bag
from beamfield.io.read_log import read_log

pytestmark = pytest.mark.real


def table(path) -> np.ndarray:
    with gzip.open(path, "rt") as file:
        return np.loadtxt(file, delimiter=",", skiprows=1)


def angles(difference):
    return np.abs(np.angle(np.exp(1j * difference)))


def finite(poses):
    return np.isfinite(poses).all(axis=1)


@pytest.mark.parametrize("name", ["macfirst_floor_take_2", "mac_take_2_bag_pf"])
def test_the_turtlebots_bags_before_ros_carried_definitions(data, name):
    log = read_bag(data / "olin_mac_tb4" / name)
    sensor = log.only_sensor("/scan")
    assert sensor.ranges.shape == (357, 720)
    assert 45.0 < np.ptp(sensor.stamps) < 47.0
    assert np.isposinf(sensor.ranges).mean() == pytest.approx(0.229, abs=0.001)
    assert sensor.finder.max_range == 12.0
    assert sensor.no_return.origin == "declared"
    # rplidar_link: 4 mm off the middle, turned by +90 degrees; the first beam of the message is at -3.124 rad.
    assert np.allclose(sensor.finder.mounts[0], [0.00393584, 0.0, -3.1241393 + np.pi / 2], atol=1e-6)
    assert len(log.odometry) == 953
    assert sensor.has_poses == (name == "mac_take_2_bag_pf")
    reference = table(data / "olin_mac_tb4" / "derived_ref_take_2.csv.gz")
    assert np.allclose(sensor.stamps, reference[:, 1], atol=1e-6)
    known = finite(sensor.odometry)
    assert known.sum() >= 355
    # The last columns are the odometry, interpolated by another program.
    assert np.median(np.linalg.norm(sensor.odometry[known, :2] - reference[known, 6:8], axis=1)) < 2e-4
    assert np.median(angles(sensor.odometry[known, 2] - reference[known, 8])) < 2e-4


def test_the_pioneers_poses_from_tf_are_those_of_amcl(data):
    log = read_bag(data / "uob_pioneer_real" / "trace1.bag")
    sensor = log.only_sensor("/base_scan")
    assert sensor.ranges.shape == (906, 726)
    assert np.isnan(sensor.ranges).mean() == pytest.approx(0.163, abs=0.001)
    assert np.allclose(sensor.finder.mounts[:, :2], [0.135, 0.0])
    assert np.allclose(sensor.finder.bearings[[0, -1]], [-2.35619, 2.09235], atol=1e-5)
    reference = table(data / "uob_pioneer_real" / "derived_amcl_poses_trace1.csv.gz")
    assert np.allclose(sensor.stamps, reference[:, 1], atol=1e-6)
    known = finite(sensor.poses)
    assert known.sum() == 905  # the last scan is 28 ms younger than the last transform
    odometry = np.linalg.norm(sensor.odometry[known, :2] - reference[known, 5:7], axis=1)
    poses = np.linalg.norm(sensor.poses[known, :2] - reference[known, 2:4], axis=1)
    # The file is rounded to 0.1 mm and 0.1 mrad; it interpolated the corrections otherwise where they jump.
    assert odometry.max() < 1e-4
    assert np.percentile(poses, 99) < 1e-4
    assert poses.max() < 2e-3
    assert angles(sensor.poses[known, 2] - reference[known, 4]).max() < 2e-3


def test_the_simulated_pioneers_truth_goes_with_its_odometry(data):
    log = read_bag(data / "uob_stage_sim" / "simpath2.bag")
    sensor = log.only_sensor("/base_scan")
    assert sensor.ranges.shape == (634, 500)
    assert sensor.no_return.share == pytest.approx(0.178, abs=0.001)
    assert finite(sensor.poses).all()
    assert any("/base_pose_ground_truth" in note for note in log.notes)
    # The simulator's odometry is perfect, and published one sample late.
    assert np.abs(sensor.poses[:-1, :2] - sensor.odometry[1:, :2]).max() < 1e-9
    assert angles(sensor.poses[:-1, 2] - sensor.odometry[1:, 2]).max() < 1e-9
    assert np.linalg.norm(sensor.poses[:, :2] - sensor.odometry[:, :2], axis=1).max() == pytest.approx(0.1)


def test_two_lidars_without_a_robot(data):
    log = read_bag(data / "hokuyo_pair" / "scans_demo.bag")
    assert {name: s.ranges.shape for name, s in log.sensors.items()} == {
        "/rear_scan": (330, 726),
        "/front_scan": (331, 726),
    }
    for sensor in log.sensors.values():
        assert 32.0 < np.ptp(sensor.stamps) < 34.0
        assert not sensor.has_odometry
    assert len(read_bag(data / "hokuyo_pair" / "scans_demo.bag", sensor_topic="/front_scan").sensors) == 1


@pytest.mark.parametrize(("name", "scans", "seconds"), [("olsson-3loop", 3818, 381), ("olsson-demo", 3431, 343),
                                                        ("rice", 3150, 315)])  # fmt: skip
def test_the_drones_four_rangers(data, name, scans, seconds):
    log = read_bag(data / "crazyflie_multiranger" / f"{name}.bag")
    sensor = log.only_sensor()
    assert sensor.ranges.shape == (scans, 4)
    assert np.ptp(sensor.stamps) == pytest.approx(seconds, abs=1.0)
    assert finite(sensor.odometry).mean() > 0.99
    # At 10 Hz a drone of 1 m/s moves by about a decimetre.
    step = between(log.odometry.poses[:-1], log.odometry.poses[1:])
    assert np.linalg.norm(step[:, :2], axis=1).max() < 0.5


def test_the_mcap_has_the_numbers_of_the_text_that_it_was_made_from(data):
    sensor = read_bag(data / "derived_wean_mcap" / "bag").only_sensor("/scan")
    assert sensor.ranges.shape == (713, 180)
    stamps, ranges, odometry = [], [], []
    with gzip.open(data / "wean_hall" / "robotdata1.log.gz", "rt") as file:
        for line in file:
            kind, *rest = line.split()
            numbers = np.array(rest, dtype=float)
            if kind == "L":  # x y theta xl yl thetal r1..r180 ts, centimetres
                ranges.append(numbers[6:186] / 100.0)
                stamps.append(numbers[186])
            else:  # O x y theta ts
                odometry.append(numbers / [100.0, 100.0, 1.0, 1.0])
    stamps, ranges, odometry = np.array(stamps), np.array(ranges), np.array(odometry)
    assert np.allclose(sensor.stamps - 1e9, stamps, atol=1e-6)
    measured = ranges < 81.0
    assert np.abs(sensor.ranges - ranges)[measured].max() < 4e-6  # half a step of float32 at 50 m
    assert (sensor.ranges[~measured] >= sensor.finder.max_range).all()
    assert np.allclose(sensor.finder.mounts[:, :2], [0.25, 0.0])
    assert np.allclose(np.rad2deg(sensor.finder.bearings), np.arange(-90, 90), atol=1e-4)
    when = stamps[finite(sensor.odometry)]
    assert len(when) >= 712
    expected = [np.interp(when, odometry[:, 3], column) for column in (*odometry[:, :2].T, np.unwrap(odometry[:, 2]))]
    found = sensor.odometry[finite(sensor.odometry)]
    gap = np.linalg.norm(found[:, :2] - np.column_stack(expected)[:, :2], axis=1)
    turn = angles(found[:, 2] - expected[2])
    assert gap.max() < 1e-6
    assert turn.max() < 1e-6


def test_the_mcap_and_the_text_give_the_same_log(data):
    bag, text = read_log(data / "derived_wean_mcap" / "bag"), read_log(data / "wean_hall" / "robotdata1.log.gz")
    in_bag, in_text = bag.only_sensor(), text.only_sensor()
    assert np.allclose(in_bag.stamps - 1e9, in_text.stamps, atol=1e-6)
    assert np.allclose(in_bag.finder.mounts, in_text.finder.mounts, atol=1e-6)
    assert in_bag.finder.max_range == pytest.approx(in_text.finder.max_range, abs=0.01)
    silent = np.isposinf(in_text.ranges)
    assert np.array_equal(in_bag.ranges >= in_bag.finder.max_range, silent)
    assert np.abs(in_bag.ranges - in_text.ranges)[~silent].max() < 4e-6
    assert np.allclose(bag.odometry.stamps - 1e9, text.odometry.stamps, atol=1e-6)
    assert np.allclose(bag.odometry.poses, text.odometry.poses, atol=1e-9)


def test_a_laser_at_its_mount_sees_what_the_chain_of_frames_says(data):
    """The same point, once through the finder's mounts and once through robot and sensor poses by hand."""
    sensor = read_bag(data / "uob_stage_sim" / "simpath2.bag").only_sensor()
    beam = compose(sensor.poses[100], sensor.finder.mounts[250])
    by_hand = compose(
        compose(sensor.poses[100], [0.135, 0.0, 0.0]), [0.0, 0.0, -np.pi / 2 + 250 * 0.006295776925981045]
    )
    assert np.allclose(beam, by_hand, atol=1e-6)


@pytest.mark.parametrize("bag", ["fiducial_ceiling/aruco_images.bag"])
def test_a_bag_of_images_has_no_scans(data, bag):
    with pytest.raises(ValueError, match=r"no scans.*sensor_msgs/msg/CameraInfo"):
        read_bag(data / bag)
