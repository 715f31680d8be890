"""Logs of a few robots in one office, for scans of some tenths of a second."""

from __future__ import annotations

import datetime
from pathlib import Path

import numpy as np

from beamfield.io.logs.carmen_writer import write_carmen
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import ScanLog, SensorLog

NOON = datetime.datetime(2026, 11, 2, 12, tzinfo=datetime.UTC).timestamp()


def part_of(drive: SensorLog, first: int, begin: float, n: int = 60) -> SensorLog:
    """Return some scans of a drive, recorded at another time; stamps as a file holds them, to a microsecond."""
    part = drive.select(np.arange(first, first + n))
    stamps = np.round(part.stamps - part.stamps[0] + begin, 6)
    return SensorLog(part.finder, stamps, part.ranges, part.poses, part.odometry)


def write_log(path: Path, log: SensorLog) -> None:
    write_carmen(path, ScanLog({"FLASER": log}, source=path.name))


def write_small_fleet(folder: Path, drive: SensorLog, office: OccupancyGrid) -> Path:
    """Write a map, logs of two robots and a manifest; return the manifest."""
    write_map(office, folder / "office.yaml")
    lines = ["log,map,robot,site"]
    for i, robot in enumerate(("ann", "ann", "bob", "bob")):
        write_log(folder / f"run{i}.log", part_of(drive, 60 * i, NOON + 3600.0 * i))
        lines.append(f"run{i}.log,office.yaml,{robot},hall")
    (folder / "fleet.csv").write_text("\n".join(lines) + "\n")
    return folder / "fleet.csv"


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
