"""CARMEN logs: messages, poses, mounts, limits, bad input, and writing."""

from __future__ import annotations

import gzip
from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import compose, wrap_angle
from beamfield.io.logs.carmen import read_carmen, write_carmen
from beamfield.io.logs.text_scans import TextOptions
from beamfield.sensors import RangeFinder, ScanLog, SensorLog, Track

TIME = "{0} host {0}"


def flaser(i, ranges="1 2 3 4", laser=None, robot=None, kind="FLASER", stamp=None):
    """One old-style line; a robot that drives along x and turns a little."""
    pose = laser or f"{0.5 * i} {0.1 * i} {0.01 * i}"
    n = len(ranges.split())
    return f"{kind} {n} {ranges} {pose} {robot or pose} " + TIME.format(i if stamp is None else stamp)


def robotlaser(i, n=4, ranges="1 2 3 4", mount_x=0.0, kind="ROBOTLASER1", limit=20.0, turned=0.0):
    return (
        f"{kind} 0 -1.5 3.0 1.0 {limit} 0.01 0 {n} {ranges} 2 7 8 "
        f"{0.5 * i + mount_x} 0 {turned} {0.5 * i} 0 0 0 0 0 0 0 " + TIME.format(i)
    )


def write(tmp_path, *lines, name="run.log"):
    path = tmp_path / name
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def read_one(tmp_path, *lines, **options):
    return read_carmen(write(tmp_path, *lines), TextOptions(**options)).only_sensor()


def test_two_poses_are_the_reference_and_the_odometry(tmp_path):
    lines = [flaser(i, laser=f"{i} 0 0.1", robot=f"{0.9 * i} {0.05 * i * i} 0.2") for i in range(5)]
    log = read_one(tmp_path, "# a comment", "", *lines)
    np.testing.assert_allclose(log.poses, [[i, 0.0, 0.1] for i in range(5)])
    np.testing.assert_allclose(log.odometry, [[0.9 * i, 0.05 * i * i, 0.2] for i in range(5)])
    np.testing.assert_array_equal(log.stamps, np.arange(5))
    np.testing.assert_array_equal(log.ranges[:, :3], np.tile([1.0, 2.0, 3.0], (5, 1)))


def test_the_second_pose_of_a_robot_that_stands_is_no_mount_far_away(tmp_path):
    log = read_one(tmp_path, *[flaser(i, laser="8 3 0.1", robot="60 -20 2", stamp=i) for i in range(3)])
    np.testing.assert_allclose(log.poses, np.tile([8.0, 3.0, 0.1], (3, 1)))
    np.testing.assert_allclose(log.odometry, np.tile([60.0, -20.0, 2.0], (3, 1)))
    assert (log.finder.mounts[:, :2] == 0.0).all()


def test_headings_are_wrapped(tmp_path):
    log = read_one(tmp_path, *[flaser(i, laser=f"{i} 0 7.0", robot=f"0 {i} -{np.pi!r}") for i in range(3)])
    np.testing.assert_allclose(log.poses[:, 2], 7.0 - 2.0 * np.pi)
    np.testing.assert_allclose(log.odometry[:, 2], np.pi)


def test_equal_poses_are_the_reference_and_a_note_says_so(tmp_path):
    log = read_carmen(write(tmp_path, *[flaser(i) for i in range(5)]))
    sensor = log.only_sensor()
    np.testing.assert_allclose(sensor.poses[:, 0], 0.5 * np.arange(5))
    assert not sensor.has_odometry
    assert any("one pose per scan" in note for note in log.notes)


def test_equal_poses_can_be_read_as_odometry(tmp_path):
    sensor = read_one(tmp_path, *[flaser(i) for i in range(5)], lone_poses="odometry")
    np.testing.assert_allclose(sensor.odometry[:, 0], 0.5 * np.arange(5))
    assert not sensor.has_poses


def test_a_constant_transform_between_the_poses_is_the_mount(tmp_path):
    robot = np.column_stack([np.arange(6.0), np.zeros(6), 0.3 * np.arange(6)])
    laser = compose(robot, [0.2, 0.0, 0.0])
    lines = [
        flaser(i, laser=" ".join(f"{v:.6f}" for v in laser[i]), robot=" ".join(f"{v:.6f}" for v in robot[i]))
        for i in range(6)
    ]
    sensor = read_one(tmp_path, *lines)
    np.testing.assert_allclose(sensor.finder.mounts[:, :2], np.tile([0.2, 0.0], (4, 1)), atol=2e-6)
    np.testing.assert_allclose(sensor.poses, robot, atol=1e-6)


@pytest.mark.parametrize(("jitter", "is_mount"), [(1.5e-3, True), (2.5e-3, False)])
def test_a_transform_is_constant_to_two_millimetres(tmp_path, jitter, is_mount):
    lines = [flaser(i, laser=f"{0.5 * i + 0.2 + jitter * (i == 3)} 0 0", robot=f"{0.5 * i} 0 0") for i in range(6)]
    sensor = read_one(tmp_path, *lines)
    assert sensor.finder.mounts[0, 0] == pytest.approx(0.2 if is_mount else 0.0)
    assert sensor.has_odometry is not is_mount


def test_the_declared_offset_is_the_mount_and_the_first_pose_is_the_lasers(tmp_path):
    lines = [flaser(i, laser=f"{i} 0 1.5", robot=f"{i} {i} 0") for i in range(5)]
    sensor = read_one(tmp_path, "PARAM robot_frontlaser_offset 0.3 host 0", *lines)
    np.testing.assert_allclose(compose(sensor.poses, [0.3, 0.0, 0.0]), [[i, 0.0, 1.5] for i in range(5)], atol=1e-12)
    np.testing.assert_allclose(sensor.finder.mounts[:, 0], 0.3)
    np.testing.assert_allclose(sensor.odometry[:, 1], np.arange(5))


@pytest.mark.parametrize(
    ("n", "first", "step"), [(180, -90.0, 1.0), (181, -90.0, 1.0), (360, -90.0, 0.5), (361, -90.0, 0.5)]
)
def test_usual_numbers_of_beams_have_the_bearings_of_a_sick_scanner(tmp_path, n, first, step):
    sensor = read_one(tmp_path, *[flaser(i, " ".join(str(1 + j % 7) for j in range(n))) for i in range(3)])
    np.testing.assert_allclose(np.degrees(sensor.finder.bearings), first + step * np.arange(n))


def test_another_number_of_beams_spans_what_the_log_says_or_half_a_turn(tmp_path):
    lines = [flaser(i) for i in range(3)]
    log = read_carmen(write(tmp_path, *lines))
    np.testing.assert_allclose(np.degrees(log.only_sensor().finder.bearings), [-90, -30, 30, 90])
    assert any("4 beams is an unusual number" in note for note in log.notes)
    sensor = read_one(tmp_path, "PARAM laser_front_laser_fov 1.5 host 0", *lines)
    np.testing.assert_allclose(sensor.finder.bearings, [-0.75, -0.25, 0.25, 0.75])
    sensor = read_one(tmp_path, "PARAM laser_front_laser_fov 180 host 0", *lines)  # degrees, it seems
    np.testing.assert_allclose(np.degrees(sensor.finder.bearings), [-90, -30, 30, 90])


def test_the_rear_laser_looks_backwards(tmp_path):
    lines = [flaser(i, laser=f"{i} 0 0", robot=f"0 {i} 0", kind="RLASER") for i in range(3)]
    sensor = read_one(tmp_path, "PARAM robot_rearlaser_offset -0.2 host 0", *lines)
    assert sensor.finder.name == "RLASER"
    np.testing.assert_allclose(sensor.finder.mounts[:, 0], -0.2)
    np.testing.assert_allclose(np.degrees(sensor.finder.bearings), [90, 150, -150, -90])
    said = [f"PARAM {name} host 0" for name in (
        "laser_front_laser_start_angle -0.3", "laser_front_laser_resolution 1", "robot_front_laser_max 20",
        "laser_rear_laser_start_angle -1.0", "laser_rear_laser_resolution 30", "robot_rear_laser_max 10",
        "robot_rearlaser_offset -0.2",
    )]  # fmt: skip
    log = read_carmen(write(tmp_path, *said, *lines))
    finder = log.only_sensor().finder
    np.testing.assert_allclose(wrap_angle(finder.bearings - np.pi), -1.0 + np.radians([0, 30, 60, 90]))
    assert finder.max_range == 10.0
    assert "RLASER: the laser is at (-0.2 m, 0 m, 180 degrees) on the robot" in log.notes
    no_limit = read_one(tmp_path, "PARAM robot_rear_laser_max 0 host 0", *lines)
    assert no_limit.finder.max_range == pytest.approx(4.0, abs=0.02)


@pytest.mark.parametrize(("number", "mount"), [(1, [0.3, 0.0, 0.0]), (2, [-0.2, 0.0, np.pi]), (3, [0.0, 0.0, 0.0])])
def test_raw_scans_are_of_the_front_or_the_rear_laser(tmp_path, number, mount):
    raw = [f"RAWLASER{number} 0 0 3.0 1.0 20 0.01 0 4 1 2 3 4 0 {TIME.format(i)}" for i in range(3)]
    said = ["PARAM robot_frontlaser_offset 0.3 host 0", "PARAM robot_rearlaser_offset -0.2 host 0"]
    sensor = read_one(tmp_path, *said, *raw)
    np.testing.assert_allclose(sensor.finder.mounts[0], mount)
    np.testing.assert_array_equal(sensor.ranges[:, :3], np.tile([1.0, 2.0, 3.0], (3, 1)))


@pytest.mark.parametrize("kind", ["ROBOTLASER2", "RLASER"])
def test_a_laser_at_the_rear_is_there_whichever_way_its_heading_was_rounded(tmp_path, kind):
    turned = [3.141592, 3.141593, 3.141592, 3.141593]  # pi lies between: half of them are read as nearly -pi
    lines = [robotlaser(i, mount_x=-0.2, kind=kind, turned=angle) for i, angle in enumerate(turned)]
    if kind == "RLASER":
        poses = [(f"{0.5 * i - 0.2} 0 {angle}", f"{0.5 * i} 0 0") for i, angle in enumerate(turned)]
        lines = [flaser(i, laser=laser, robot=robot, kind=kind) for i, (laser, robot) in enumerate(poses)]
    sensor = read_one(tmp_path, *lines)
    np.testing.assert_allclose(sensor.poses, [[0.5 * i, 0.0, 0.0] for i in range(4)])
    np.testing.assert_allclose(sensor.finder.mounts[:, :2], np.tile([-0.2, 0.0], (4, 1)), atol=1e-6)
    behind = np.pi + np.array([-1.5, -0.5, 0.5, 1.5] if kind == "ROBOTLASER2" else np.radians([-90, -30, 30, 90]))
    np.testing.assert_allclose(wrap_angle(sensor.finder.bearings - behind), 0.0, atol=2e-6)


def test_robotlaser_says_its_angles_limit_and_mount(tmp_path):
    lines = [robotlaser(i, ranges="1 2 3 81.91", mount_x=0.25) for i in range(5)]
    sensor = read_one(tmp_path, *lines)
    assert sensor.finder.name == "ROBOTLASER1"
    np.testing.assert_allclose(sensor.finder.mounts, [[0.25, 0.0, b] for b in (-1.5, -0.5, 0.5, 1.5)])
    assert sensor.finder.max_range == 20.0
    np.testing.assert_array_equal(sensor.ranges, np.tile([1.0, 2.0, 3.0, np.inf], (5, 1)))
    np.testing.assert_allclose(sensor.poses[:, 0], 0.5 * np.arange(5))
    # A resolution that makes more than a full turn gives way to the field of view; a limit of 0 is none.
    lines = [robotlaser(i, limit=0.0).replace(" 1.0 0.0 ", " 3.0 0.0 ") for i in range(5)]
    log = read_carmen(write(tmp_path, *lines))
    np.testing.assert_allclose(log.only_sensor().finder.bearings, [-1.5, -0.5, 0.5, 1.5])
    assert any("resolution is implausible, 57.3 degrees from the field of view" in note for note in log.notes)
    assert log.only_sensor().finder.max_range == pytest.approx(4.0, abs=0.02)


def test_odometry_lines_that_differ_from_the_lone_poses_are_the_odometry(tmp_path):
    odometry = [f"ODOM {-1.0 * i} 3 0 0 0 0 " + TIME.format(i) for i in range(6)]
    log = read_carmen(write(tmp_path, *odometry, *[robotlaser(i) for i in range(5)]))
    np.testing.assert_allclose(log.only_sensor().odometry[:, 0], -np.arange(5.0))
    assert log.odometry is not None
    assert len(log.odometry) == 6


def test_odometry_lines_that_follow_the_lone_poses_are_left_out_with_a_note(tmp_path):
    odometry = [f"ODOM {0.5 * i} 0 0 0 0 0 " + TIME.format(i) for i in range(6)]
    log = read_carmen(write(tmp_path, *odometry, *[robotlaser(i) for i in range(5)]))
    assert log.odometry is None
    assert not log.only_sensor().has_odometry
    assert any("follow the corrected poses" in note for note in log.notes)


@pytest.mark.parametrize(("apart", "follows"), [(0.09, True), (0.11, False)])
def test_odometry_lines_follow_at_less_than_a_decimetre_whatever_a_few_do(tmp_path, apart, follows):
    x = [0.5 * i + (30.0 if i == 1 else apart) for i in range(6)]
    lines = [f"ODOM {x[i]} 0 0 0 0 0 " + TIME.format(i) for i in range(6)] + [robotlaser(i) for i in range(5)]
    log = read_carmen(write(tmp_path, *lines))
    assert (log.odometry is None) is follows
    # Another laser of the same log, which has no poses of its own, does not change that.
    raw = [f"RAWLASER2 0 -1.5 3.0 1.0 20 0.01 0 4 1 2 3 4 0 {TIME.format(i)}" for i in range(5)]
    assert (read_carmen(write(tmp_path, *lines, *raw)).odometry is None) is follows


def test_odometry_lines_of_another_time_follow_nothing_and_are_left_out(tmp_path):
    odometry = [f"ODOM {9 - i} 7 0 0 0 0 " + TIME.format(100 + i) for i in range(6)]
    assert read_carmen(write(tmp_path, *odometry, *[robotlaser(i) for i in range(5)])).odometry is None


def test_where_the_first_stamps_are_lost_scans_and_odometry_have_the_loggers(tmp_path):
    lines = [f"ODOM {-i} 3 0 0 0 0 7 host {i}" for i in range(6)] + [
        robotlaser(i).replace(TIME.format(i), f"7 host {i}") for i in range(5)
    ]
    log = read_carmen(write(tmp_path, *lines))
    np.testing.assert_array_equal(log.only_sensor().stamps, np.arange(5))
    np.testing.assert_array_equal(log.only_sensor().odometry[:, 0], -np.arange(5.0))
    both = [line.replace("7 host", f"{20 + i % 6} host") for i, line in enumerate(lines)]
    np.testing.assert_array_equal(read_one(tmp_path, *both).stamps, 20 + np.arange(5))


def test_odometry_that_arrives_out_of_order_is_sorted_with_a_note(tmp_path):
    odometry = [f"ODOM {-i} 3 0 0 0 0 " + TIME.format(i) for i in (0, 2, 1, 3, 4)]
    log = read_carmen(write(tmp_path, *odometry, *[robotlaser(i) for i in range(4)]))
    assert log.odometry is not None
    np.testing.assert_array_equal(log.odometry.stamps, np.arange(5))
    np.testing.assert_array_equal(log.odometry.poses[:, 0], -np.arange(5.0))
    assert any("ODOM: 1 of 5 messages come before" in note for note in log.notes)


def test_raw_scans_are_read_only_where_there_are_none_with_poses(tmp_path):
    raw = [f"RAWLASER1 0 -1.5 3.0 1.0 20 0.01 0 4 1 2 3 4 0 " + TIME.format(i) for i in range(4)]  # noqa: F541
    odometry = [f"ODOM {i} 0 0 0 0 0 " + TIME.format(i) for i in range(5)]
    alone = read_carmen(write(tmp_path, *odometry, *raw)).only_sensor()
    assert not alone.has_poses
    np.testing.assert_allclose(alone.odometry[:, 0], np.arange(4))
    gap = read_carmen(write(tmp_path, odometry[0], odometry[3], *raw)).only_sensor()
    np.testing.assert_allclose(gap.odometry[:, 0], [0.0, np.nan, np.nan, 3.0])
    both = read_carmen(write(tmp_path, *raw, *[robotlaser(i) for i in range(4)]))
    assert list(both.sensors) == ["ROBOTLASER1"]
    assert any("RAWLASER1: not read" in note for note in both.notes)


def test_true_poses_of_a_simulator_are_the_reference(tmp_path):
    truth = [f"TRUEPOS {3.0 * i} 0 0 {i} 0 0 " + TIME.format(i) for i in range(5)]
    sensor = read_one(tmp_path, *truth, *[robotlaser(i) for i in range(5)])
    np.testing.assert_allclose(sensor.poses[:, 0], 3.0 * np.arange(5))


def test_parameters_and_other_messages_are_reported(tmp_path):
    log = read_carmen(write(tmp_path, "PARAM robot_length 0.5 host 0", "NEFF 15", "SYNC x", "NEFF 14", flaser(0)))
    assert log.parameters == {"robot_length": "0.5"}
    assert any("2 NEFF, 1 SYNC" in note for note in log.notes)


def test_a_declared_maximum_is_the_limit(tmp_path):
    lines = [flaser(i, "1 2 3 81.91") for i in range(5)]
    assert read_one(tmp_path, "PARAM robot_front_laser_max 50 host 0", *lines).finder.max_range == 50.0


def test_a_beam_that_is_stuck_while_the_robot_moves_is_no_measurement(tmp_path):
    rng = np.random.default_rng(3)
    lines = [flaser(i, " ".join(f"{v:.2f}" for v in rng.uniform(1, 9, 3)) + " 7") for i in range(60)]
    log = read_carmen(write(tmp_path, *lines))
    assert np.isnan(log.only_sensor().ranges[:, 3]).all()
    assert np.isfinite(log.only_sensor().ranges[:, :3]).all()
    assert any("beam 3 reads 7 m in all 60 scans" in note for note in log.notes)
    seen = read_one(tmp_path, *lines, no_return=(np.nan,)).ranges
    assert np.isnan(seen[:, 3]).all()
    still = [flaser(i, "1 2 3 4", laser="0 0 0", robot="0 0 0") for i in range(60)]
    assert np.isfinite(read_one(tmp_path, *still, no_return="none").ranges).all()


def test_scans_without_any_number_are_counted(tmp_path):
    lines = [flaser(0), flaser(1, "nan nan nan nan"), flaser(2)]
    log = read_carmen(write(tmp_path, *lines))
    assert any("1 of 3 scans have no measurement at all" in note for note in log.notes)


BAD = {
    "cut off": (flaser(2).rsplit(" ", 1)[0], "expected 15 words .*got 14: the line is truncated"),
    "cut off in the ranges": ("FLASER 4 1 2", "expected 15 words .*got 4"),
    "cut off before the count": ("FLASER", "truncated after 1 words"),
    "count too large": (flaser(2).replace("FLASER 4", "FLASER 5"), "expected 16 words .*got 15"),
    "count too small": (flaser(2).replace("FLASER 4", "FLASER 3"), "expected 14 words .*got 15"),
    "count absurd": (flaser(2).replace("FLASER 4", "FLASER 999999999999"), "expected a number of readings"),
    "no number in the ranges": (flaser(2, "1 2 x3 4"), "expected a number, got 'x3'"),
    "no number in the stamp": (flaser(2, stamp="noon"), "timestamp: expected a number, got 'noon'"),
    "other number of beams": (flaser(2, "1 2 3"), r"the scan has 3 beams, the first one \(line 1\) has 4"),
    "empty scan": ("FLASER 0 0 0 0 0 0 0 2 host 2", "the scan has no readings"),
    "nan pose": (flaser(2, laser="nan 0 0"), "expected a finite pose, got nan 0"),
    "infinite odometry": (flaser(2, robot="0 inf 0"), "expected a finite pose, got 0.0 inf"),
    "absurd pose": (flaser(2, laser="1e300 0 0"), r"expected a finite pose, got 1e\+300"),
    "absurd range": (flaser(2, "1 2 1e300 4"), r"expected a range in metres, got 1e\+300"),
    "degrees a million times": (robotlaser(2).replace("0 -1.5 3.0", "0 -1.5 2000", 1), "expected angles in radians"),
    "junk": ("12 monkeys", "expected the name of a CARMEN message, got '12'"),
    "short odometry": ("ODOM 1 2 3", "expected 10 words"),
    "nan odometry": ("ODOM 1 nan 3 0 0 0 1 host 1", "expected a finite pose"),
    "short truth": ("TRUEPOS 1 2 3", "expected 10 words"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_line_is_named(tmp_path, case):
    line, message = BAD[case]
    path = write(tmp_path, flaser(0), flaser(1), line)
    with pytest.raises(FormatError, match=message) as caught:
        read_carmen(path)
    assert caught.value.line == 3
    assert str(caught.value).startswith(f"{path}:3: ")


def test_robotlaser_that_changes_its_angles_or_mount_is_named(tmp_path):
    changed = robotlaser(2).replace(" -1.5 ", " -1.0 ")
    with pytest.raises(FormatError, match=r":3: ROBOTLASER1: start angle.*differ"):
        read_carmen(write(tmp_path, robotlaser(0), robotlaser(1), changed))
    with pytest.raises(FormatError, match=r":3: ROBOTLASER1: the laser moves on the robot"):
        read_carmen(write(tmp_path, robotlaser(0), robotlaser(1), robotlaser(2, mount_x=0.3)))


def test_all_nan_scans_are_refused(tmp_path):
    with pytest.raises(FormatError, match="every reading of all 3 scans is NaN"):
        read_carmen(write(tmp_path, *[flaser(i, "nan nan nan nan") for i in range(3)]))


def test_a_log_without_scans_is_refused(tmp_path):
    with pytest.raises(FormatError, match="no scans"):
        read_carmen(write(tmp_path, "PARAM robot_length 0.5 host 0", "ODOM 1 2 3 0 0 0 1 host 1"))


def test_stamps_that_run_backwards_name_line_and_value(tmp_path):
    lines = [flaser(i, stamp=i if i < 5 else i - 4) for i in range(10)]
    with pytest.raises(FormatError, match=r":6: FLASER: the stamps run backwards: 1\.0+ s after 4\.0+ s"):
        read_carmen(write(tmp_path, *lines))
    assert len(read_one(tmp_path, *lines, stamps="order")) == 10


@pytest.fixture
def simulated(rng):
    """A log as a simulator makes it."""
    n, k = 40, 31
    stamps = 1.7e9 + 0.1 * np.arange(n)
    poses = np.column_stack([0.1 * np.arange(n), np.sin(0.1 * np.arange(n)), rng.uniform(-3.1, 3.1, n)])
    odometry = poses + np.cumsum(rng.normal(0.0, 0.05, (n, 3)), axis=0)
    odometry[:, 2] = np.clip(odometry[:, 2], -3.1, 3.1)
    ranges = rng.uniform(0.2, 5.6, (n, k))
    ranges[rng.random((n, k)) < 0.1] = np.inf
    ranges[3, 4] = np.nan
    finder = RangeFinder.from_bearings(np.linspace(-2.0, 1.9, k), 5.6123456789, mount=(0.17, 0.0, 0.05))
    sensor = SensorLog(finder, stamps, ranges, poses, odometry)
    return ScanLog({"scan": sensor}, Track(stamps[::2], odometry[::2]))


@pytest.mark.parametrize("name", ["out.log", "out.log.gz"])
def test_a_written_log_reads_the_same(tmp_path, simulated, name):
    path = tmp_path / name
    write_carmen(path, simulated)
    log = read_carmen(path)
    got, expected = log.only_sensor(), simulated.only_sensor()
    np.testing.assert_allclose(got.finder.mounts, expected.finder.mounts, atol=1e-12)
    assert got.finder.max_range == expected.finder.max_range
    np.testing.assert_allclose(got.ranges, expected.ranges, atol=5.1e-7)
    np.testing.assert_allclose(got.stamps, expected.stamps, rtol=0, atol=1e-6)
    np.testing.assert_allclose(got.poses, expected.poses, atol=3e-9)
    np.testing.assert_allclose(got.odometry, expected.odometry, atol=1e-9)
    assert log.odometry is not None
    assert simulated.odometry is not None
    np.testing.assert_allclose(log.odometry.poses, simulated.odometry.poses, atol=1e-9)


def test_the_same_log_gives_the_same_bytes(tmp_path, simulated):
    for name in ("a.log.gz", "b.log.gz"):
        write_carmen(tmp_path / name, simulated)
    assert (tmp_path / "a.log.gz").read_bytes() == (tmp_path / "b.log.gz").read_bytes()
    assert gzip.decompress((tmp_path / "a.log.gz").read_bytes()).startswith(b"# CARMEN log")


def test_a_log_without_odometry_is_written_as_slam_programs_do(tmp_path, simulated):
    sensor = replace(simulated.only_sensor(), odometry=np.full((40, 3), np.nan))
    write_carmen(tmp_path / "out.log", ScanLog({"scan": sensor}))
    got = read_carmen(tmp_path / "out.log").only_sensor()
    np.testing.assert_allclose(got.poses, sensor.poses, atol=3e-9)
    assert not got.has_odometry


def test_a_log_without_reference_poses_is_written_as_robots_do(tmp_path, simulated):
    sensor = simulated.only_sensor().with_poses(np.full((40, 3), np.nan))
    write_carmen(tmp_path / "out.log", replace(simulated, sensors={"scan": sensor}))
    got = read_carmen(tmp_path / "out.log", TextOptions(lone_poses="odometry")).only_sensor()
    np.testing.assert_allclose(got.odometry, sensor.odometry, atol=3e-9)
    np.testing.assert_allclose(got.finder.mounts, sensor.finder.mounts, atol=1e-6)
    assert not got.has_poses


def test_parameters_of_a_single_beam_are_plain_numbers(tmp_path):
    poses = np.column_stack([np.arange(3.0), np.zeros((3, 2))])
    log = SensorLog(RangeFinder.from_bearings([0.5], 5.0), np.arange(3.0), np.ones((3, 1)), poses, poses)
    write_carmen(tmp_path / "out.log", ScanLog({"scan": log}))
    parameters = read_carmen(tmp_path / "out.log").parameters
    assert float(parameters["laser_front_laser_fov"]) == 0.0
    assert float(parameters["laser_front_laser_start_angle"]) == 0.5


def test_what_a_flaser_line_cannot_say_is_refused_and_nothing_is_written(tmp_path, simulated):
    sensor = simulated.only_sensor()
    clockwise = replace(sensor, finder=RangeFinder.from_bearings(np.linspace(1.0, -1.0, 31), 5.0))
    aside = replace(sensor, finder=RangeFinder.from_bearings(np.linspace(-1.0, 1.0, 31), 5.0, mount=(0.0, 0.1, 0.0)))
    no_poses = replace(sensor, poses=np.full((40, 3), np.nan), odometry=np.full((40, 3), np.nan))
    some_odometry = replace(sensor, odometry=np.where(np.arange(40)[:, None] < 3, np.nan, sensor.odometry))
    for bad, message in (
        (clockwise, "equal steps counter-clockwise"),
        (aside, "one point"),
        (no_poses, "40 have none"),
        (some_odometry, "3 of 40 scans have none"),
    ):
        with pytest.raises(InvalidInputError, match=message):
            write_carmen(tmp_path / "out.log", ScanLog({"scan": bad}))
    assert list(tmp_path.iterdir()) == []


def ring_lines(*parameters):
    return [*[f"PARAM {name} {value}" for name, value in parameters], *[flaser(i) for i in range(3)]]


def test_a_ring_of_cones_is_told_by_parameters_of_our_own(tmp_path):
    lines = ring_lines(("beamfield_ring_radius", 0.2), ("beamfield_opening_angle", 0.5), ("laser_front_laser_fov", 3.0))
    finder = read_one(tmp_path, *lines).finder
    assert finder.opening_angle == 0.5
    np.testing.assert_allclose(finder.mounts, compose(np.outer([-1.5, -0.5, 0.5, 1.5], [0, 0, 1]), [0.2, 0, 0]))
    assert read_one(tmp_path, *ring_lines()).finder.opening_angle == 0.0
    inwards = read_one(tmp_path, *ring_lines(("beamfield_ring_radius", -0.2))).finder
    np.testing.assert_allclose(inwards.mounts[0], [0.0, 0.2, -np.pi / 2], atol=1e-12)
    rear = [flaser(i, kind="RLASER") for i in range(3)]
    assert read_one(tmp_path, *ring_lines(("beamfield_opening_angle", 0.5))[:1], *rear).finder.opening_angle == 0.0


def test_a_ring_before_the_robots_centre_survives_writing(tmp_path):
    bearings = np.radians(np.arange(0.0, 360.0, 45.0))
    mounts = compose([0.1, 0.0, 0.0], compose(np.outer(bearings, [0, 0, 1]), [0.25, 0.0, 0.0]))
    finder = RangeFinder(mounts, 5.0, opening_angle=0.4, name="FLASER")
    poses = np.column_stack([np.arange(4.0), np.zeros(4), 0.1 * np.arange(4)])
    log = SensorLog(finder, np.arange(4.0), np.ones((4, 8)), poses, np.full((4, 3), np.nan))
    write_carmen(tmp_path / "ring.log", ScanLog({"FLASER": log}))
    read = read_carmen(tmp_path / "ring.log").only_sensor()
    np.testing.assert_allclose(read.finder.mounts, mounts, atol=1e-12)
    np.testing.assert_allclose(read.poses, poses, atol=1e-8)
    assert read.finder.opening_angle == 0.4


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("beamfield_ring_radius", "inf"),
        ("beamfield_ring_radius", "wide"),
        ("beamfield_opening_angle", "-0.1"),
        ("beamfield_opening_angle", "30"),
    ],
)
def test_a_ring_that_is_none_is_refused_by_name(tmp_path, name, value):
    with pytest.raises(FormatError, match=f"{name}: expected a number below .*, got '{value}'"):
        read_one(tmp_path, *ring_lines((name, value)))
