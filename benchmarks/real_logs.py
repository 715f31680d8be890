"""Calibrate real logs and print their tables: ``python benchmarks/real_logs.py [FOLDER]``.

FOLDER holds the logs and maps (default: ../shared/data beside the checkout). They are other people's data and not part
of this repository.
"""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from beamfield.calibration.calibrate import Calibration, calibrate
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.io.trajectory import attach_poses, read_trajectory
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.report.text_table import parameter_table, score_table
from beamfield.sensors import SensorLog

LOGS = (
    ("Wean Hall log 1, text", "wean_hall/robotdata1.log.gz", "wean_hall/derived_wean.yaml",
     "wean_hall/reference_robotdata1.csv.gz"),
    ("Wean Hall log 1, mcap", "derived_wean_mcap/bag", "wean_hall/derived_wean.yaml",
     "wean_hall/reference_robotdata1.csv.gz"),
    ("TurtleBot 4, Olin College", "olin_mac_tb4/macfirst_floor_take_2", "olin_mac_tb4/map/mac_1st_floor_final.yaml",
     "olin_mac_tb4/derived_ref_take_2.csv.gz"),
    ("Simulated Pioneer (Stage)", "uob_stage_sim/simpath2.bag", "uob_stage_sim/derived_meeting_stageframe.yaml", None),
)  # fmt: skip


def run(folder: Path) -> list[dict[str, Any]]:
    """Return one row per log: its name and its calibration."""
    return [{"log": name, "calibration": calibrate(*read_log_and_map(folder, *paths))} for name, *paths in LOGS]


def read_log_and_map(
    folder: Path, log_path: str, map_path: str, poses_path: str | None
) -> tuple[SensorLog, OccupancyGrid]:
    """Return the only sensor of a log, with its reference poses, and the map."""
    log = read_log(folder / log_path)
    if poses_path is not None:
        log = attach_poses(log, read_trajectory(folder / poses_path))
    return log.only_sensor(), read_map(folder / map_path)


def main(folder: Path) -> None:
    """Print the tables as markdown."""
    for row in run(folder):
        result: Calibration = row["calibration"]
        print(f"## {row['log']}\n\n{result.selection.describe()}.\n")
        print(f"```\n{parameter_table(result)}\n\n{score_table(result)}\n```\n")
        for finding in result.findings:
            if finding.severity == "warning":
                print(f"- **{finding.name}**: {finding.full_text}")
        print()


if __name__ == "__main__":
    here = Path(__file__).resolve().parents[1]
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else here.parent / "shared" / "data")
