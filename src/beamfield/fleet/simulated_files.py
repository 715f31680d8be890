"""Write a simulated fleet: maps, raw logs, the manifest that lists them, and what is true."""

from __future__ import annotations

import gzip
import json
import math
from dataclasses import asdict
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from beamfield.fleet.engine import Engine, Progress
from beamfield.fleet.simulated import FleetPlan, changed_site, simulate_drive, site_map
from beamfield.io.files.atomic import write_file
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.sensors import SensorLog

MANIFEST, TRUTH = "manifest.yaml", "truth.json"
# Of a fleet with so many logs, the first one is cut off in the middle, as by a full disk.
LOGS_WITH_A_CUT = 20
HEAD = "# A simulated fleet. Logs hold scans and odometry; poses are found in the maps.\nruns:\n"


class _Drive(NamedTuple):
    folder: Path
    plan: FleetPlan
    robot: int
    day: int


def write_fleet(folder: Path, plan: FleetPlan, engine: Engine, *, progress: Progress | None = None) -> dict[str, Any]:
    """Write all files of a simulated fleet into an empty folder of this machine, which the engine's processes reach.

    What is true comes back, as truth.json has it: "cut_off" names the log that was cut off in the middle.
    """
    (folder / "maps").mkdir()
    for site in plan.sites:
        write_map(site_map(plan.size, site), folder / f"maps/{site.name}.yaml", mode="trinary")
    drives = [
        _Drive(folder, plan, robot, day) for day in range(plan.size.days) for robot in range(len(plan.robots))
    ]  # fmt: skip
    logs = engine.map(_write_drive, drives, progress=progress)
    runs = [
        f"  - {{log: {log}, map: maps/{site}.yaml, robot: {plan.robots[drive.robot].name}, site: {site}}}\n"
        for drive, log in zip(drives, logs, strict=True)
        for site in [plan.sites[plan.robots[drive.robot].site].name]
    ]
    (folder / MANIFEST).write_text(HEAD + "".join(runs), encoding="utf-8")
    truth = true_state(plan)
    if len(logs) >= LOGS_WITH_A_CUT:
        content = (folder / logs[0]).read_bytes()
        (folder / logs[0]).write_bytes(content[: len(content) // 2])
        truth["cut_off"] = logs[0]
    (folder / TRUTH).write_text(json.dumps(truth, indent=1) + "\n", encoding="utf-8")
    return truth


def true_state(plan: FleetPlan) -> dict[str, Any]:
    """Return what is true of a fleet, as plain values: sites with their changes, robots with their faults."""
    size = plan.size
    sites = []
    for site in plan.sites:
        since = None if site.changed_since is None else size.date(site.changed_since).isoformat()
        changes = [] if since is None else [asdict(change) for change in changed_site(size, site)[1]]
        sites.append({"site": site.name, "map": f"maps/{site.name}.yaml", "changed_since": since, "changes": changes})
    robots = []
    for robot in plan.robots:
        fault = None
        if robot.fault is not None:
            fault = {**asdict(robot.fault), "since": size.date(robot.fault.since).isoformat(),
                     "sector": list(robot.fault.sector) if robot.fault.kind == "dirty-lens" else None}  # fmt: skip
        robots.append({
            "robot": robot.name, "site": plan.sites[robot.site].name, "parameters": asdict(robot.parameters),
            "odometry": asdict(robot.odometry), "yaw": robot.yaw, "fault": fault,
        })  # fmt: skip
    shape = {**asdict(size), "first_day": size.first_day.isoformat()}
    return {"seed": plan.seed, "size": shape, "sites": sites, "robots": robots, "cut_off": None}


def _write_drive(drive: _Drive) -> str:
    """Simulate and write a drive; return the log's name in the folder."""
    robot, date = drive.plan.robots[drive.robot], drive.plan.size.date(drive.day)
    name = f"logs/{robot.name}/{date.isoformat()}.log.gz"
    log, _ = simulate_drive(drive.plan, drive.robot, drive.day)
    write_raw_carmen(drive.folder / name, log.only_sensor())
    return name


def write_raw_carmen(path: Path, sensor: SensorLog) -> None:
    """Write scans and odometry as a robot records them in CARMEN: RAWLASER1 and ODOM lines, compressed.

    The laser is on the robot's axis and has equal steps.
    """
    finder, mounts = sensor.finder, sensor.finder.mounts
    step = float(mounts[1, 2] - mounts[0, 2]) if len(mounts) > 1 else math.radians(1.0)
    start = float(mounts[0, 2])
    laser = f"RAWLASER1 0 {start!r} {step * (len(mounts) - 1)!r} {step!r} {finder.max_range:g} 0.01 0 {len(mounts)}"
    lines = [f"PARAM robot_frontlaser_offset {float(mounts[0, 0])!r}"]
    ranges = np.minimum(sensor.ranges, finder.max_range)
    for stamp, z, (x, y, heading) in zip(sensor.stamps, ranges.tolist(), sensor.odometry.tolist(), strict=True):
        time = f"{stamp:.6f} robot {stamp:.6f}"
        lines.append(f"ODOM {x:.6f} {y:.6f} {heading:.6f} 0 0 0 {time}")
        lines.append(f"{laser} {' '.join(f'{value:.3f}' for value in z)} 0 {time}")
    # No time inside, so that the same drive gives the same bytes.
    write_file(path, gzip.compress(("\n".join(lines) + "\n").encode("ascii"), mtime=0))
