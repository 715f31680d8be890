"""Beams that see the robot itself, in logs of robots that look around."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import beamfield as bf
from beamfield.cli.inspect_summary import log_facts
from beamfield.sensors import ScanLog, SensorLog
from beamfield.sensors.robot_in_sight import robot_in_sight
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from beamfield.stacks.doctor.examine import examine
from beamfield.stacks.files.parameter_file import read_stack_file

LASER = bf.RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 72, endpoint=False), max_range=8.0, min_range=0.1)
TRUTH = bf.BeamParameters(0.9, 0.05, 0.02, 0.03, sigma_hit=0.02, lambda_short=0.5)


@pytest.fixture(scope="module")
def log() -> SensorLog:
    return simulate_log(draw_floor_plan(seed=3), LASER, TRUTH, duration=60.0, scan_rate=2.0, seed=1).only_sensor()


def seeing(log: SensorLog, beams: list[int], ranges: np.ndarray) -> SensorLog:
    seen = np.array(log.ranges)
    seen[:, beams] = np.fmin(np.nan_to_num(seen[:, beams], nan=np.inf), ranges)
    return replace(log, ranges=seen)


def test_nothing_is_said_of_a_laser_that_sees_only_the_world(log: SensorLog) -> None:
    assert not list(robot_in_sight(log))


def test_posts_of_the_robot_are_named_by_bearing_and_range(log: SensorLog) -> None:
    noise = np.random.default_rng(0).normal(0.0, 0.005, (len(log), 5))
    (found,) = robot_in_sight(seeing(log, [3, 4, 5, 36, 70], 0.25 + noise))
    assert found.name == "robot-in-sight"
    where = "At bearings -165.1 to -154.9, 0, 170 degrees the readings are 0.25 m wherever the robot was: "
    assert found.text.startswith(where)
    assert "(--mask=-165.1:-154.9 --mask=-0.1:0.1 --mask=" in found.do
    assert found.values["share_of_beams"] == pytest.approx(5 / 72)


def test_the_floor_before_a_tilted_laser_is_named(log: SensorLog) -> None:
    bearings = LASER.mounts[:, 2]
    ahead = np.flatnonzero(np.abs(bearings) < 0.6)
    noise = np.random.default_rng(0).normal(0.0, 0.01, (len(log), len(ahead)))
    (found,) = robot_in_sight(seeing(log, list(ahead), (1.2 + noise) / np.cos(bearings[ahead])))
    assert found.text.startswith("At bearings -30.1 to 30.1 degrees the readings are 1.20 to 1.39 m wherever")


@pytest.mark.parametrize("reading", [0.05, 8.0, np.nan])
def test_what_is_no_measurement_is_not_the_robot(log: SensorLog, reading: float) -> None:
    ranges = np.array(log.ranges)
    ranges[:, :4] = reading
    assert not list(robot_in_sight(replace(log, ranges=ranges)))


def test_a_robot_that_does_not_turn_may_drive_along_a_wall(log: SensorLog) -> None:
    odometry = np.array(log.odometry)
    odometry[:, 2] *= 0.1
    beside = replace(seeing(log, [18], np.full((len(log), 1), 0.4)), odometry=odometry)
    assert not list(robot_in_sight(beside))


def test_without_odometry_poses_tell_where_the_robot_was(log: SensorLog) -> None:
    posts = seeing(log, [36], np.full((len(log), 1), 0.25))
    nowhere = np.full((len(log), 3), np.nan)
    assert len(list(robot_in_sight(replace(posts, odometry=nowhere)))) == 1
    assert not list(robot_in_sight(replace(posts, odometry=nowhere, poses=nowhere)))


def test_commands_that_read_a_log_say_so(log: SensorLog, tmp_path: Path) -> None:
    posts = seeing(log, [36], np.full((len(log), 1), 0.25))
    (tmp_path / "nav2.yaml").write_text("amcl:\n  ros__parameters:\n    max_beams: 30\n")
    examined = examine(read_stack_file(tmp_path / "nav2.yaml"), log=posts)
    fitted = bf.fit_trajectory(posts, draw_floor_plan(seed=3), start=log.poses[0])
    learned = bf.calibrate(posts, draw_floor_plan(seed=3))
    for findings in (examined, fitted.findings, learned.findings):
        assert [finding.name for finding in findings].count("robot-in-sight") == 1
    notes = log_facts(ScanLog({"front": posts}))["notes"]
    assert any(note.startswith("front: At bearing 0 degrees the readings are 0.25 m") for note in notes)
