"""Manifests of a fleet, and records of its runs."""

from __future__ import annotations

from beamfield.fleet.run_record import MapInfo, OdometryErrors, RunRecord, ShardFile
from tests.fuzz.case import Case, one_file

CSV = '''\
# our fleet
log,map,robot,site,poses,start,sensor
bags/monday,maps/hall.yaml,ann,hall,,1.5 2 -90,/scan
s3://bucket/bob.mcap,/maps/hall.yaml,bob,hall,bob.tum,,
"a, b.log",maps/hall.yaml,bob,"hall ""2""",,,
'''
YAML = """\
runs:
  - {log: bags/monday, map: maps/hall.yaml, robot: ann, site: hall, start: [1.5, 2, -90], sensor: /scan}
  - log: s3://bucket/bob.mcap
    map: /maps/hall.yaml
    robot: bob
    site: hall
    poses: bob.tum
"""
USED = RunRecord(
    run="monday-0123456789ab", robot="ann", site="hall", key="0123456789ab", log="bags/monday", map="maps/hall.yaml",
    poses="", log_sensor="", log_hash="ab", status="used", first_stamp=1793620800.0, last_stamp=1793620860.5, scans=60,
    beams=3600,
    files=(ShardFile("beams/site=hall/robot=ann/day=2026-11-02/monday.parquet", "2026-11-02", 3600, 40000),),
    sensor={"mounts": [[0.0, 0.0, -0.1], [0.0, 0.0, 0.1]], "max_range": 10.0, "min_range": 0.0, "name": "/scan"},
    map_info=MapInfo(0.05, (0.0, -1.0, 0.1), (30, 40), "a" * 64), pose_source="fitted", share_trusted=0.9,
    odometry=OdometryErrors(("distance_scale", "yaw"), (0.01, 0.002), ((1e-4, 0.0), (0.0, 1e-5))),
    selection={"used": 60}, left_out={"no measurement": 3},
)  # fmt: skip
LEFT_OUT = RunRecord(
    run="none-0123456789ab", robot="ann", site="hall", key="", log="none", map="m.yaml", poses="", log_sensor="",
    log_hash="", status="left out", reason="none: No such file or directory",
)  # fmt: skip


def manifests() -> list[Case]:
    return [one_file("fleet.csv", CSV), one_file("fleet.yaml", YAML)]


def records() -> list[Case]:
    return [one_file("run.json", record.to_json()) for record in (USED, LEFT_OUT)]
