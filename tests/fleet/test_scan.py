"""A fleet's logs become beams in Parquet: those of `build_beam_table`, once each, whole or not at all."""

from __future__ import annotations

import datetime
import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from beamfield.calibration.beam_table import build_beam_table
from beamfield.calibration.selection import select_scans
from beamfield.calibration.time_split import held_out_mask
from beamfield.errors import MissingDependencyError
from beamfield.fleet import scan_run as scanning
from beamfield.fleet.beam_rows import days_of
from beamfield.fleet.beam_schema import COLUMNS
from beamfield.fleet.catalogue import Catalogue, open_catalogue
from beamfield.fleet.engine import Engine
from beamfield.fleet.folder import Folder
from beamfield.fleet.scan import FleetScan, scan_fleet
from beamfield.geometry import compose
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.sensors import SensorLog
from tests.fleet.small_fleet import NOON, contents, part_of, write_log
from tests.io.test_atomic import KILLED


@pytest.fixture
def own(world: Path, tmp_path: Path) -> Path:
    """The logs and their catalogue, for a test of its own."""
    shutil.copytree(world, tmp_path / "own")
    return tmp_path / "own"


def scan(manifest: Path, catalogue: Path) -> FleetScan:
    with Engine("serial") as engine:
        return scan_fleet(manifest, str(catalogue), engine)


def again(own: Path) -> FleetScan:
    return scan(own / "fleet.csv", own / "catalogue")


def test_the_rows_are_those_of_a_beam_table(scanned: FleetScan, world: Path):
    log, grid = read_log(world / "run2.log").only_sensor(), read_map(world / "office.yaml")
    used = select_scans(log, grid).used
    table = build_beam_table(log, grid, used)
    (shard,) = (one for one in scanned.catalogue.shards(robot="bob") if one.run == scanned.records[2].run)
    rows = shard.read(list(COLUMNS))
    assert shard.day == datetime.date(2026, 11, 2)
    assert (shard.rows, len(rows["run"])) == (len(table), len(table))
    np.testing.assert_array_equal(rows["range"], table.ranges.astype(np.float32))
    np.testing.assert_array_equal(rows["expected_range"], table.expected_ranges.astype(np.float32))
    for name, expected in (("scan", table.scan), ("beam", table.beam), ("stamp", table.stamps)):
        np.testing.assert_array_equal(rows[name], expected)
    np.testing.assert_array_equal(np.column_stack([rows["x"], rows["y"], rows["heading"]]), log.poses[table.scan])
    np.testing.assert_array_equal(rows["bearing"], log.finder.bearings[table.beam].astype(np.float32))
    np.testing.assert_array_equal(rows["held_out"], held_out_mask(log.stamps[table.scan]))
    assert set(rows["run"]) == {scanned.records[2].run}
    # Without poses' covariances.
    assert all((rows[name] == 0).all() for name in ("var_x", "var_y", "var_heading", "cov_xy"))


def test_beams_end_in_the_cells_that_they_are_said_to_meet(scanned: FleetScan):
    record, (shard, *_) = scanned.records[0], scanned.catalogue.shards()
    grid = scanned.catalogue.grid(record)
    rows = shard.read(list(COLUMNS))
    met = rows["hit_row"] >= 0
    np.testing.assert_array_equal(met, rows["expected_range"] < record.finder.max_range)
    assert np.isnan(rows["incidence"][~met]).all()
    assert grid.occupied[rows["hit_row"][met], rows["hit_col"][met]].all()
    poses = np.column_stack([rows["x"], rows["y"], rows["heading"]])[met]
    beams = compose(poses, record.mounts[rows["beam"][met]])
    # A little further on: into the cell.
    reach = rows["expected_range"][met] + 1e-4
    ends = beams[:, :2] + reach[:, None] * np.column_stack([np.cos(beams[:, 2]), np.sin(beams[:, 2])])
    cells = np.floor(grid.to_cells(ends))[:, ::-1]
    same = (cells == np.column_stack([rows["hit_row"], rows["hit_col"]])[met]).all(axis=1)
    assert same.mean() > 0.99  # those through corners may be in the next one
    # The office's walls lie along x and y.
    angles = np.abs(np.stack([np.cos(beams[:, 2]), np.sin(beams[:, 2])]))
    known = np.isfinite(rows["incidence"][met])
    nearest = np.abs(np.cos(rows["incidence"][met]) - angles).min(axis=0)[known]
    assert known.mean() > 0.5
    assert np.median(nearest) < 1e-6


def test_files_say_their_units_and_version_and_are_read_with_filters(scanned: FleetScan):
    (shard, *_) = scanned.catalogue.shards()
    schema = pq.read_schema(shard.folder.path(shard.path))
    assert schema.metadata[b"beamfield.schema"] == b"2"
    assert schema.field("range").metadata[b"unit"] == b"m"
    # Runs of one sensor share it: thousands of records fit in memory.
    assert len({id(record.sensor) for record in scanned.catalogue.used}) == 1
    everything = shard.read(["scan", "beam", "range", "held_out"])
    part = shard.read(["beam", "held_out"], fit_only=True, thin=3)
    assert not part["held_out"].any()
    assert len(part["beam"]) == pytest.approx((~everything["held_out"]).sum() / 3, rel=0.02)
    # Each beam has its turn; many shards give one beam in so many, and not each its first.
    assert set(part["beam"]) == set(everything["beam"])
    many = [replace(shard, run=f"{shard.run}{i}").read(["beam"], thin=20_000)["beam"] for i in range(100)]
    assert len(np.concatenate(many)) == pytest.approx(100 * shard.rows / 20_000, rel=0.5)
    assert len(set(np.concatenate(many))) > 10
    batches = list(shard.batches(["range"], rows=500))
    assert max(len(batch["range"]) for batch in batches) <= 500
    np.testing.assert_array_equal(np.concatenate([batch["range"] for batch in batches]), everything["range"])


def test_logs_that_are_there_are_not_read_again_and_a_changed_one_takes_its_place(own: Path, drive: SensorLog):
    before = contents(own / "catalogue")
    unchanged = again(own)
    assert (unchanged.scanned, contents(own / "catalogue")) == ((), before)
    write_log(own / "run1.log", part_of(drive, 300, NOON))
    changed = again(own)
    assert len(changed.scanned) == 1
    assert changed.records[1].run == changed.scanned[0] != unchanged.records[1].run
    assert changed.replaced == (unchanged.records[1].run,)
    after = contents(own / "catalogue")
    assert not any(unchanged.records[1].run in name for name in after)
    assert len(after) == len(before)
    # The log of another robot, as it turns out: its beams move.
    manifest = (own / "fleet.csv").read_text().replace("run1.log,office.yaml,ann", "run1.log,office.yaml,bob")
    (own / "fleet.csv").write_text(manifest)
    moved = again(own)
    assert [record.robot for record in moved.catalogue.used] == ["ann", "bob", "bob", "bob"]
    assert len(moved.catalogue.shards()) == 4


def test_a_log_that_was_renamed_is_kept_when_another_takes_its_name(own: Path, drive: SensorLog):
    before = again(own)
    (own / "run1.log").rename(own / "old.log")
    write_log(own / "run1.log", part_of(drive, 300, NOON + 1e5))
    manifest = (own / "fleet.csv").read_text()
    (own / "fleet.csv").write_text(manifest + "old.log,office.yaml,ann,hall\n")
    rotated = again(own)
    assert rotated.records[4] == replace(before.records[1], log="old.log")
    assert (rotated.replaced, len(rotated.scanned), len(rotated.catalogue.used)) == ((), 1, 5)
    # No longer listed, it stays, as others do, when the name is used once more.
    (own / "fleet.csv").write_text(manifest)
    write_log(own / "run1.log", part_of(drive, 360, NOON + 2e5))
    later = again(own)
    assert later.replaced == rotated.scanned
    assert rotated.records[4].run in {record.run for record in later.catalogue.used}


def test_a_copy_never_hides_its_log_and_is_scanned_once_it_is_the_only_one(own: Path):
    manifest = (own / "fleet.csv").read_text()
    shutil.copy(own / "run0.log", own / "a.log")
    shutil.copy(own / "run0.log", own / "b.log")
    (own / "fleet.csv").write_text(manifest + "a.log,office.yaml,ann,hall\nb.log,office.yaml,bob,hall\n")
    for done in (again(own), again(own)):
        assert [record.is_used for record in done.records] == [True] * 4 + [False] * 2
        assert done.records[0].log == "run0.log"
    # It was bob's: the rows that said ann go.
    (own / "fleet.csv").write_text(manifest.replace("run0.log,office.yaml,ann", "b.log,office.yaml,bob"))
    corrected = again(own)
    assert (corrected.records[0].is_used, corrected.records[0].log) == (True, "b.log")
    assert [record.robot for record in corrected.catalogue.used] == ["ann", "bob", "bob", "bob"]


def test_an_interrupted_scan_goes_on_and_gives_the_same_bytes(own: Path, tmp_path, monkeypatch):
    written = []

    class Killed(BaseException):
        pass

    def write(self: Folder, name: str, content: bytes) -> None:
        if name.startswith("runs/"):
            written.append(name)
            if len(written) == 3:
                raise Killed
        original(self, name, content)

    original = Folder.write
    monkeypatch.setattr(Folder, "write", write)
    with pytest.raises(Killed):
        scan(own / "fleet.csv", tmp_path / "catalogue")
    assert len(open_catalogue(str(tmp_path / "catalogue")).used) == 2
    monkeypatch.undo()
    done = scan(own / "fleet.csv", tmp_path / "catalogue")
    assert done.scanned == tuple(record.run for record in done.records[2:])
    assert contents(tmp_path / "catalogue") == contents(own / "catalogue")


@pytest.mark.skipif(sys.platform == "win32", reason="kills are POSIX's")
def test_what_killed_workers_leave_beside_files_that_are_not_written_again_is_removed(own: Path):
    before = contents(own / "catalogue")
    for name in before:
        if name.startswith(("maps/", "runs/")):
            subprocess.run([sys.executable, "-c", KILLED, str(own / "catalogue" / name)], check=False)
    assert len(contents(own / "catalogue")) > len(before)
    assert again(own).scanned == ()
    assert contents(own / "catalogue") == before


def test_what_cannot_be_used_is_left_out_with_the_reason_and_the_rest_goes_on(own: Path, drive: SensorLog):
    (own / "broken.log").write_text("FLASER 3 1.0 2.0\n")
    shutil.copy(own / "run0.log", own / "copy.log")
    near = part_of(drive, 0, NOON)
    write_log(own / "far.log", near.with_poses(near.poses + np.array([500.0, 0.0, 0.0])))
    more = ["missing.log,office.yaml,cid,hall", "broken.log,office.yaml,cid,hall", "copy.log,office.yaml,cid,hall",
            "far.log,office.yaml,cid,hall", "cut.log,nowhere.yaml,cid,hall"]  # fmt: skip
    (own / "cut.log").write_text((own / "run3.log").read_text() + "# a comment\n")
    (own / "fleet.csv").write_text((own / "fleet.csv").read_text() + "\n".join(more) + "\n")
    done = again(own)
    assert [record.status for record in done.records] == ["used"] * 4 + ["left out"] * 5
    reasons = [record.reason for record in done.records[4:]]
    assert reasons[0] == f"{own / 'missing.log'}: No such file or directory"
    assert "broken.log:1: FLASER" in reasons[1]
    assert reasons[2] == "the same log as run0.log of ann"
    assert "all 60 reference poses lie off the map" in reasons[3]
    assert "nowhere.yaml" in reasons[4]
    assert [done.rows[4].place, done.records[4].log] == [f"{own / 'fleet.csv'}:6", "missing.log"]
    # What was missing is tried again; what is broken stays so.
    write_log(own / "missing.log", part_of(drive, 360, NOON + 1e5))
    later = again(own)
    assert [run.partition("-")[0] for run in later.scanned] == ["missing", "cut"]
    assert later.records[4].is_used
    assert sum(record.robot == "cid" for record in later.catalogue.runs) == 5
    # A row with a wrong name and map is corrected: no robot of the wrong name stays. Copies that are listed do.
    text = (own / "fleet.csv").read_text().replace("cut.log,nowhere.yaml,cid", "cut.log,office.yaml,dan")
    (own / "fleet.csv").write_text(text)
    corrected = again(own)
    assert corrected.records[8].is_used
    assert [record.robot for record in corrected.catalogue.runs] == ["ann"] * 2 + ["bob"] * 2 + ["cid"] * 4 + ["dan"]


def test_a_package_that_is_missing_is_no_fault_of_the_log(own: Path, monkeypatch):
    def read(*_: object) -> None:
        raise MissingDependencyError("rosbags", "ros", "reading bags")

    monkeypatch.setattr(scanning, "read_run", read)
    (own / "run0.log").write_text((own / "run0.log").read_text() + "# changed\n")
    with pytest.raises(MissingDependencyError):
        again(own)
    assert len(open_catalogue(str(own / "catalogue")).used) == 4


def test_a_run_over_midnight_has_a_file_for_each_day(tmp_path: Path, drive: SensorLog, world: Path):
    write_log(tmp_path / "night.log", part_of(drive, 0, NOON + 12 * 3600.0 - 7.0))
    manifest = tmp_path / "fleet.yaml"
    manifest.write_text(f"runs:\n  - {{log: night.log, map: {world / 'office.yaml'}, robot: 'a/ü b', site: x=1}}\n")
    done = scan(manifest, tmp_path / "catalogue")
    first, second = done.catalogue.shards()
    assert [shard.day.isoformat() for shard in (first, second)] == ["2026-11-02", "2026-11-03"]
    assert first.read(["stamp"])["stamp"].max() < NOON + 12 * 3600.0 <= second.read(["stamp"])["stamp"].min()
    assert sum(shard.rows for shard in (first, second)) == done.records[0].beams
    table = done.catalogue.dataset().to_table(columns=["site", "robot", "day"]).to_pandas()
    assert set(table["site"]) == {"x=1"}
    assert set(table["robot"]) == {"a/ü b"}
    assert sorted(set(table["day"])) == [first.day, second.day]


def test_a_robot_without_poses_gets_them_and_no_beam_is_judged_at_its_own(
    tmp_path: Path, drive: SensorLog, world: Path
):
    lone = part_of(drive, 0, NOON)
    path = tmp_path / "lone.log"
    write_log(path, lone)
    x, y, heading = drive.poses[0]
    (tmp_path / "fleet.csv").write_text(
        "log,map,robot,site,start\n"
        f"lone.log,{world / 'office.yaml'},ann,hall,{x:.2f} {y:.2f} {np.degrees(heading):.0f}\n"
    )
    # FLASER lines always have poses; RAWLASER lines with ODOM lines have none.
    raw = []
    step = float(np.diff(lone.finder.bearings)[0])
    for stamp, z, pose in zip(lone.stamps, np.minimum(lone.ranges, 10.0), lone.odometry, strict=True):
        raw.append(f"ODOM {' '.join(f'{value:.6f}' for value in pose)} 0 0 0 {stamp:.6f} host {stamp:.6f}")
        laser = f"RAWLASER1 0 {-np.pi / 2} {np.pi} {step} 10 0.01 0 61"
        raw.append(f"{laser} {' '.join(f'{value:.3f}' for value in z)} 0 {stamp:.6f} host {stamp:.6f}")
    path.write_text("\n".join(raw) + "\n")
    (record,) = scan(tmp_path / "fleet.csv", tmp_path / "catalogue").records
    assert (record.status, record.pose_source) == ("used", "fitted"), record.reason
    assert record.share_trusted > 0.8
    (shard,) = Catalogue(Folder(str(tmp_path / "catalogue"))).shards()
    rows = shard.read(["scan", "beam", "x", "y", "var_x"])
    assert (np.diff(rows["scan"]) >= 0).all()
    assert set(rows["beam"].tolist()) == set(range(61))
    assert 1e-4 < np.sqrt(rows["var_x"]).mean() < 0.05
    scan_of_both = rows["scan"] == rows["scan"][len(rows["scan"]) // 2]
    even, odd = (scan_of_both & (rows["beam"] % 2 == half) for half in (0, 1))
    assert len(set(rows["x"][even])) == len(set(rows["x"][odd])) == 1
    assert rows["x"][even][0] != rows["x"][odd][0]
    error = np.hypot(rows["x"] - drive.poses[rows["scan"], 0], rows["y"] - drive.poses[rows["scan"], 1])
    assert error.max() < 0.1


def test_odometry_of_a_run_is_in_its_record(scanned: FleetScan):
    record = json.loads((Path(scanned.catalogue.folder.path("runs")) / f"{scanned.records[0].run}.json").read_text())
    # A quarter of a minute is too short a drive for errors, and the record says so.
    assert record["odometry"] is None
    assert record["odometry_reason"]


@pytest.mark.parametrize("stamp", [-1.0, 1e18, np.nan])
def test_stamps_that_are_in_no_calendar_have_no_day(stamp: float):
    assert days_of(np.array([NOON, stamp])) is None
    assert days_of(np.array([NOON, 86_399.9])).tolist() == [20759, 0]


def test_a_log_of_no_day_is_left_out(tmp_path: Path, drive: SensorLog, world: Path):
    write_log(tmp_path / "a.log", part_of(drive, 0, -86_400.0))
    (tmp_path / "fleet.csv").write_text(f"log,map,robot,site\na.log,{world / 'office.yaml'},ann,hall\n")
    (record,) = scan(tmp_path / "fleet.csv", tmp_path / "catalogue").records
    assert "in no year from 1970 to 9999" in record.reason


def test_a_bag_that_lacks_the_mount_is_read_with_that_of_the_manifest(tmp_path: Path, drive: SensorLog, world: Path):
    pytest.importorskip("rosbags")
    from tests.io.mini_bag import MiniBag, quaternion

    run, bag = part_of(drive, 0, NOON), MiniBag()
    bearings = run.finder.bearings
    for stamp, (x, y, heading), ranges in zip(run.stamps, run.poses, run.ranges, strict=True):
        bag.scan(stamp, ranges, angle_min=bearings[0], increment=bearings[1] - bearings[0], range_max=2.0)
        bag.tf("map", "base_link", stamp, (x, y, 0.0), quaternion(yaw=heading))
    bag.write(tmp_path, "run")
    row = f"{world / 'office.yaml'},ann,hall"
    (tmp_path / "bare.csv").write_text(f"log,map,robot,site\nrun,{row}\n")
    (record,) = scan(tmp_path / "bare.csv", tmp_path / "catalogue").records
    assert "give mount" in record.reason
    (tmp_path / "fleet.csv").write_text(f"log,map,robot,site,mount\nrun,{row},0.2 0.1 5\n")
    (record,) = scan(tmp_path / "fleet.csv", tmp_path / "catalogue").records
    assert record.is_used
    np.testing.assert_allclose(record.mounts[0], [0.2, 0.1, np.radians(5.0) + bearings[0]], atol=1e-6)
    (note,) = (note for note in record.notes if "range_max" in note)
    assert "of the readings are beyond the declared range_max of 2 m" in note
