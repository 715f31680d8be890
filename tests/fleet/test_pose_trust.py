"""Runs whose poses are wrong: fitted anew or left out, and the robot is named."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest

from beamfield.calibration.reference_checks import pose_findings
from beamfield.errors import TrajectoryNotFoundError
from beamfield.finding import Finding
from beamfield.fleet.catalogue import open_catalogue
from beamfield.fleet.engine import Engine
from beamfield.fleet.pose_trust import DOUBTS, lost_finding, warnings_in
from beamfield.fleet.robot_state import robot_states
from beamfield.fleet.run_record import RunRecord, record_from_json
from beamfield.fleet.run_warnings import run_warnings
from beamfield.fleet.scan import scan_fleet
from beamfield.geometry import between
from beamfield.io.maps.ros_map_writer import write_map
from beamfield.io.trajectory import Track, write_tum
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.report import verdict
from beamfield.sensors import SensorLog
from beamfield.simulation.floor_plan import draw_floor_plan
from tests.fleet.small_fleet import NOON, part_of, write_log


@pytest.fixture(scope="module")
def run(drive: SensorLog) -> SensorLog:
    return part_of(drive, 0, NOON, 200)


@pytest.fixture(scope="module")
def lost_scan(run, office, tmp_path_factory) -> tuple[RunRecord, Path]:
    """The record of a robot that got lost, and the folder of its catalogue."""
    folder = tmp_path_factory.mktemp("lost")
    return scanned(folder, lost(run), office), folder


def scanned(folder: Path, log: SensorLog, grid: OccupancyGrid, **row: str) -> RunRecord:
    """The record of a run, scanned into a catalogue of its own."""
    write_map(grid, folder / "map.yaml")
    write_log(folder / "run.log", log)
    named = {"log": "run.log", "map": "map.yaml", "robot": "ann", "site": "hall", **row}
    (folder / "fleet.csv").write_text(f"{','.join(named)}\n{','.join(named.values())}\n")
    with Engine("serial") as engine:
        (record,) = scan_fleet(folder / "fleet.csv", str(folder / "catalogue"), engine).catalogue.runs
    return record


def around(log: SensorLog, grid: OccupancyGrid, margin: float = 2.0) -> OccupancyGrid:
    """The part of the map about the drive: a search that finds no start is costly by the area."""
    corner = np.asarray(grid.origin[:2])
    places = log.poses[:, :2]
    low = np.floor((places.min(axis=0) - margin - corner) / grid.resolution).astype(int).clip(0)
    high = np.ceil((places.max(axis=0) + margin - corner) / grid.resolution).astype(int)
    part = grid.probability[low[1] : high[1], low[0] : high[0]]
    return OccupancyGrid(part, grid.resolution, [*(corner + low * grid.resolution), 0.0])


def lost(log: SensorLog) -> SensorLog:
    """The robot's own poses drift 6 m away after two fifths of the run."""
    poses = log.poses.copy()
    poses[:, 0] += np.interp(np.arange(len(log)) / len(log), [0.4, 0.5], [0.0, 6.0])
    return replace(log, poses=poses)


def test_a_lost_robots_poses_are_fitted_and_it_is_said_how_far_off_it_was(lost_scan):
    record, _ = lost_scan
    assert (record.status, record.pose_source) == ("used", "fitted")
    (finding,) = (one for one in record.findings if one.name == "robot-lost")
    assert finding.values["largest_m"] == pytest.approx(6.0, abs=0.1)
    assert finding.values["share"] == pytest.approx(0.6, abs=0.15)
    assert record_from_json(record.to_json(), "runs/x.json").findings == record.findings
    (state,) = robot_states([record], ())
    assert (state.light, state.urgency) == ("red", finding.values["largest_m"])
    assert state.findings[0].text.startswith(f"In run {record.run}: The robot was lost: its own poses are up to 6.0 m")


def test_a_robot_that_is_lost_after_a_restart_is_found_by_its_scans(run, office, tmp_path):
    # The odometry begins anew, too, so that nothing but the scans tells of the jump.
    poses, odometry = run.poses.copy(), run.odometry.copy()
    poses[120:, 0] += 6.0
    odometry[120:] = between(odometry[120], odometry[120:])
    restarted = replace(run, poses=poses, odometry=odometry)
    found = {one.name for one in pose_findings(restarted, office)}
    assert "map-disagrees-in-part" in found
    assert not found & set(DOUBTS)
    record = scanned(tmp_path, restarted, office)
    assert record.pose_source == "fitted"
    assert record.findings[0].name == "robot-lost"
    assert record.findings[0].values["share"] == pytest.approx(0.4, abs=0.05)


def test_a_map_that_is_out_of_date_in_part_loses_no_robot(run, tmp_path):
    # An office of nearly the same plan: the poses are those of the drive.
    record = scanned(tmp_path, run[::3], around(run, draw_floor_plan(seed=11)))
    assert [one.name for one in record.findings] == ["map-disagrees-in-part", "pose-in-wall"]
    assert (record.status, record.pose_source) == ("used", "log")


def test_beams_of_a_lost_robot_are_cast_where_it_was(run, lost_scan):
    _, folder = lost_scan
    (shard,) = open_catalogue(str(folder / "catalogue")).shards()
    rows = shard.read(["scan", "x", "y"])
    off = np.hypot(*(np.column_stack([rows["x"], rows["y"]]) - run.poses[rows["scan"], :2]).T)
    assert off.max() < 0.2


def test_a_run_in_a_wrong_map_is_left_out_and_the_robot_is_amber(run, tmp_path, monkeypatch):
    refused = Mock(side_effect=TrajectoryNotFoundError("no trajectory fits"))
    monkeypatch.setattr("beamfield.fleet.posed_run.cross_fit_poses", refused)
    record = scanned(tmp_path, run[::3], draw_floor_plan(seed=12))
    refused.assert_called_once()
    assert (record.status, record.files) == ("left out", ())
    assert record.reason.startswith("the robot was lost, or this is not the map: At the reference poses, ")
    assert "map-disagrees" in [finding.name for finding in record.findings]
    (state,) = robot_states([record], ())
    assert (state.light, [one.name for one in state.findings]) == ("amber", ["poses-doubted"])
    assert f"Run {record.run} cannot be used: the robot was lost, or" in state.findings[0].text


def test_poses_that_were_given_are_not_replaced(run, office, tmp_path):
    wrong = lost(run)
    write_tum(tmp_path / "run.tum", Track(wrong.stamps, wrong.poses))
    record = scanned(tmp_path, run, office, poses="run.tum")
    assert record.status == "left out"
    assert record.reason.startswith("the given poses are wrong, or this is not the map: ")
    assert record.reason.endswith("They are up to 6.0 m from those that fit.")


def test_odometry_of_the_wrong_sign_reaches_the_robots_state(run, office, tmp_path):
    # The log's lone poses are its odometry, which says that the robot drives backwards.
    backwards = run.poses * np.array([-1.0, -1.0, 1.0])
    log, grid = replace(run, poses=backwards, odometry=backwards), around(run, office)
    record = scanned(tmp_path, log, grid, **{"lone-poses": "odometry"})
    assert (record.status, record.pose_source) == ("used", "fitted")
    (state,) = robot_states([record], ())
    assert (state.light, [one.name for one in state.findings if one.name != "untested"]) == ("red", ["odometry-sign"])


def test_a_wrong_mount_is_named_and_not_the_odometry_that_disagrees_with_it():
    mount, odometry = (Finding(name, "warning", name) for name in ("laser-mount", "odometry-disagrees"))
    one = SimpleNamespace(run="a", is_used=True, findings=(mount, odometry))
    other = SimpleNamespace(run="b", is_used=True, findings=(odometry,))
    assert [(urgency, said.name) for urgency, said in run_warnings([one])] == [(1.0, "laser-mount")]
    assert [said.text for _, said in run_warnings([one, other])] == [
        "In 1 of 2 runs, as in a: laser-mount", "In 1 of 2 runs, as in b: odometry-disagrees"
    ]  # fmt: skip


def test_wrong_odometry_does_not_take_a_run_its_good_poses(run, office, tmp_path):
    backwards = replace(run, odometry=run.odometry * np.array([-1.0, -1.0, 1.0]))
    record = scanned(tmp_path, backwards, office)
    assert (record.status, record.pose_source) == ("used", "log")
    assert "odometry-disagrees" in {one.name for one in record.findings}
    (state,) = robot_states([record], ())
    assert state.light in ("red", "amber")


def test_a_run_that_slides_a_little_for_a_moment_keeps_its_poses(run, office, tmp_path):
    poses = run.poses.copy()
    poses[60:80, :2] += [-0.33, 0.33]
    record = scanned(tmp_path, replace(run, poses=poses), office)
    assert "reference-slides" in {one.name for one in record.findings}
    assert (record.status, record.pose_source) == ("used", "log")


def test_a_good_run_has_no_warnings_and_keeps_its_poses(world: Path):
    runs = open_catalogue(str(world / "catalogue")).runs
    assert [(record.pose_source, record.findings) for record in runs] == [("log", ())] * 4


def test_poses_that_differ_a_little_are_not_called_lost(run):
    near = replace(run, poses=run.poses + np.array([0.3, 0.0, 0.0]))
    assert lost_finding(near, run, ()) is None
    nowhere = replace(run, poses=np.full_like(run.poses, np.nan))
    assert lost_finding(nowhere, run, ()) is None


def test_of_many_runs_the_worst_speaks_for_the_robot(run, world: Path):
    good, *_ = open_catalogue(str(world / "catalogue")).used
    away = [replace(run, poses=run.poses + np.array([by, 0.0, 0.0])) for by in (0.8, 3.0)]
    doubt = Finding("map-disagrees", "warning", "Few readings agree.")
    found = [lost_finding(one, run, [doubt]) for one in away]
    assert None not in found
    runs = [
        good,
        *(replace(good, run=f"lost-{i}", findings=(one,)) for i, one in enumerate(found)),
        replace(left_out_of(good), findings=(doubt,), reason="lost, or not the map: Few readings agree."),
    ]
    (state,) = robot_states(runs, ())
    assert state.light == "red"
    assert state.urgency == pytest.approx(3.0)
    texts = [one.text for one in state.findings if one.name != "untested"]
    assert texts[0].startswith("In 2 of 4 runs, as in lost-1: The robot was lost: its own poses are up to 3.0 m")
    assert texts[0].endswith("Few readings agree.")
    assert texts[1:] == ["1 of 4 runs, as none, cannot be used: lost, or not the map: Few readings agree."]
    (near,) = robot_states(runs[:2], ())
    assert near.light == "amber"


def left_out_of(record: RunRecord) -> RunRecord:
    return replace(record, run="none", status="left out", sensor={}, map_info=None, files=())


def test_warnings_have_numbers_that_a_record_can_hold():
    given = [Finding("a", "warning", "b", {"x": np.float64(1.0), "y": np.inf, "n": 2}), Finding("c", "info", "d")]
    (kept,) = warnings_in(given)
    assert kept.values == {"x": 1.0, "n": 2.0}
    assert {type(value) for value in kept.values.values()} == {float}


def test_calibrate_doubts_the_same():
    # In a map that is out of date one robot learns what its filter meets there; a fleet learns the sensor, elsewhere.
    assert set(DOUBTS) - {"map-out-of-date"} <= set(verdict.DOUBTS)
