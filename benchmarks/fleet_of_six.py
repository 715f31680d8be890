"""The real logs of ../shared/data as a fleet of six: scanned, scanned again, and how much room a beam takes.

Three runs of CMU's robot in Wean Hall (the third with reference poses), a TurtleBot 4 without poses, Stage's exact
poses, and a Pioneer in a map drawn from its own log.

Run: python benchmarks/fleet_of_six.py [WORKERS]     (2 processes)
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

import beamfield as bf
from beamfield.fleet.engine import Engine
from beamfield.fleet.scan import FleetScan, scan_fleet
from tables import print_table

DATA = Path(os.environ.get("BEAMFIELD_SHARED", Path(__file__).resolve().parents[2] / "shared")) / "data"
WEAN, STAGE, PIONEER = DATA / "wean_hall", DATA / "uob_stage_sim", DATA / "uob_pioneer_real"
OLIN = DATA / "olin_mac_tb4"


def write_manifest(folder: Path) -> Path:
    pioneer = folder / "pioneer.yaml"
    bf.write_map(
        bf.build_map(bf.read_log(PIONEER / "trace1.bag").only_sensor(), resolution=0.05), pioneer, mode="trinary"
    )
    wean = WEAN / "wean.dat.gz"
    rows = [
        (WEAN / "robotdata1.log.gz", wean, "scout", "Pittsburgh", ""),
        (WEAN / "robotdata3.log.gz", wean, "scout", "Pittsburgh", ""),
        (WEAN / "robotdata5.log.gz", wean, "scout", "Pittsburgh", WEAN / "reference_robotdata5.csv.gz"),
        (OLIN / "macfirst_floor_take_2", OLIN / "map/mac_1st_floor_final.yaml", "turtlebot4", "Olin", ""),
        (STAGE / "simpath2.bag", STAGE / "derived_meeting_stageframe.yaml", "stage", "Birmingham", ""),
        (PIONEER / "trace1.bag", pioneer, "pioneer", "Birmingham", ""),
    ]
    lines = ["log,map,robot,site,poses", *(",".join(map(str, row)) for row in rows)]
    (folder / "fleet.csv").write_text("\n".join(lines) + "\n")
    return folder / "fleet.csv"


def print_runs(done: FleetScan) -> None:
    rows: list[dict[str, object]] = []
    for record in done.records:
        yaw = None if record.odometry is None else record.odometry.estimate("yaw")
        rows.append({
            "robot": record.robot, "run": record.run.rpartition("-")[0], "poses": record.pose_source,
            "trusted": f"{record.share_trusted:.0%}", "scans": record.scans, "beams": f"{record.beams:,}",
            "bytes a beam": f"{sum(file.size for file in record.files) / record.beams:.1f}",
            "laser yaw [mrad]": "-" if yaw is None else f"{1e3 * yaw[0]:.0f} +- {1e3 * yaw[1]:.0f}",
        })  # fmt: skip
    print_table(rows)


def main() -> None:
    workers = int(sys.argv[1]) if len(sys.argv) > 1 else 2
    with tempfile.TemporaryDirectory() as name, Engine("processes", workers) as engine:
        folder = Path(name)
        manifest = write_manifest(folder)
        seconds = []
        for _ in range(2):
            start = time.perf_counter()
            done = scan_fleet(manifest, str(folder / "catalogue"), engine)
            seconds.append(time.perf_counter() - start)
        print_runs(done)
        print(f"\n{workers} processes: {seconds[0]:.1f} s, and {seconds[1]:.1f} s once more, with nothing to do")


if __name__ == "__main__":
    main()
