"""Real logs with the reference poses that lie beside them."""

from __future__ import annotations

from pathlib import Path

from beamfield.io.read_log import read_log
from beamfield.io.trajectory import attach_poses, read_trajectory
from beamfield.sensors import SensorLog


def posed_log(data: Path, log: str, poses: str, **options: float) -> SensorLog:
    return attach_poses(read_log(data / log, **options), read_trajectory(data / poses)).only_sensor()


def wean_log(data: Path, number: int, **options: float) -> SensorLog:
    names = f"wean_hall/robotdata{number}.log.gz", f"wean_hall/reference_robotdata{number}.csv.gz"
    return posed_log(data, *names, **options)


def turtlebot_log(data: Path) -> SensorLog:
    return posed_log(data, "olin_mac_tb4/macfirst_floor_take_2", "olin_mac_tb4/derived_ref_take_2.csv.gz")
