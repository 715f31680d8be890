from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.calibration.beam_table import BeamTable
from beamfield.calibration.opposite_beams import OppositeBeams, map_findings, opposite_beams
from beamfield.calibration.reference_checks import pose_findings
from beamfield.calibration.selection import select_scans
from beamfield.geometry import between, compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder, SensorLog

FINDER = RangeFinder.from_bearings(np.deg2rad(np.arange(-90.0, 91.0, 30.0)), 20.0)
N_SCANS = 400


def corridor_table(rng: np.random.Generator, *, scale: float = 1.0, thick: float = 0.0, pose_error: float = 0.0):
    """Widths between 2 and 10 m seen by the beams to the left and right; the mapped ones differ as asked."""
    width = rng.uniform(2.0, 10.0, N_SCANS)
    left = width * rng.uniform(0.2, 0.8, N_SCANS)
    measured = np.column_stack([width - left, left]) + rng.normal(0, 0.02, (N_SCANS, 2))
    off = rng.normal(0, pose_error, N_SCANS)
    mapped = np.column_stack([width - left + off, left - off]) / scale - thick
    scan = np.repeat(np.arange(N_SCANS), 2)
    beam = np.tile([0, 6], N_SCANS)
    table = BeamTable(
        measured.ravel(), mapped.ravel(), scan.astype(np.int32), beam.astype(np.int32), scan * 0.1, FINDER.max_range
    )
    log = SensorLog(
        FINDER, 0.1 * np.arange(N_SCANS), np.ones((N_SCANS, 7)), np.zeros((N_SCANS, 3)), np.zeros((N_SCANS, 3))
    )
    return log, table, scan // 40


def names(findings) -> list[str]:
    return [finding.name for finding in findings]


def test_a_true_map_gives_no_finding_even_with_poses_off_across_the_corridor(rng):
    pairs = opposite_beams(*corridor_table(rng, pose_error=0.1))
    assert pairs is not None
    assert pairs.n_pairs > 390
    assert pairs.scale == pytest.approx(1.0, abs=0.003)
    assert not list(map_findings(pairs, 0.05))


def test_walls_drawn_too_thick_are_found_and_measured(rng):
    pairs = opposite_beams(*corridor_table(rng, thick=0.17, pose_error=0.1))
    (finding,) = map_findings(pairs, 0.1)
    assert finding.name == "walls-too-thick"
    assert finding.values["median_difference"] == pytest.approx(0.34, abs=0.01)
    assert "0.17 m on each side" in finding.text


def test_a_map_at_the_wrong_scale_is_found_and_not_taken_for_thick_walls(rng):
    pairs = opposite_beams(*corridor_table(rng, scale=1.03))
    (finding,) = map_findings(pairs, 0.05)
    assert finding.name == "map-scale"
    assert finding.values["scale"] == pytest.approx(1.03, abs=0.004)
    assert "0.051" in finding.do
    # Cells of a map that was drawn from the log are as large as they are said to be.
    (finding,) = map_findings(pairs, 0.05, drawn=True)
    assert "0.051" not in finding.do
    assert "the poses drift" in finding.do


def test_a_scale_must_surely_be_wrong_by_more_than_a_percent():
    measured = OppositeBeams(35_000, 0.09, 1.0135, 0.0027, 0.03, 0.01)
    assert [one.name for one in map_findings(measured, 0.03)] == ["walls-too-thick"]
    assert [one.name for one in map_findings(replace(measured, scale_se=0.001), 0.03)] == ["map-scale"]


def test_people_beside_the_robot_do_not_move_the_estimate(rng):
    log, table, blocks = corridor_table(rng)
    short = rng.random(len(table)) < 0.2
    ranges = np.where(short, table.ranges * rng.random(len(table)), table.ranges)
    crowded = BeamTable(ranges, table.expected_ranges, table.scan, table.beam, table.stamps, table.max_range)
    pairs = opposite_beams(log, crowded, blocks)
    assert pairs.scale == pytest.approx(1.0, abs=0.01)
    assert not list(map_findings(pairs, 0.05))


def test_a_sensor_without_opposite_beams_cannot_tell(rng):
    log, table, blocks = corridor_table(rng)
    narrow = RangeFinder.from_bearings(np.deg2rad(np.arange(-45.0, 46.0, 15.0)), 20.0)
    log = SensorLog(narrow, log.stamps, log.ranges, log.poses, log.odometry)
    assert opposite_beams(log, table, blocks) is None
    assert not list(map_findings(None, 0.05))


def room() -> OccupancyGrid:
    cells = np.zeros((100, 400))
    cells[0] = cells[-1] = 1.0
    cells[:, 0] = cells[:, -1] = 1.0
    return OccupancyGrid(cells, 0.1)


def drive(reference: np.ndarray | None = None) -> SensorLog:
    """One minute at 0.5 m/s; odometry in a frame of its own, turned by 0.7 rad."""
    t = 0.2 * np.arange(300)
    poses = np.column_stack([2.0 + 0.5 * t, np.full(300, 5.0), np.zeros(300)])
    odometry = compose([3.0, -1.0, 0.7], poses)
    ranges = RayCaster(room()).expected_ranges(poses, FINDER)
    return SensorLog(FINDER, t, ranges, poses if reference is None else reference, odometry)


def test_a_reference_that_follows_the_odometry_gives_no_finding_unless_the_scans_are_of_elsewhere():
    assert not list(pose_findings(drive(), room()))
    (finding,) = pose_findings(replace(drive(), ranges=np.ones((300, 7))), room())
    assert (finding.name, finding.values["median_agreement"]) == ("map-disagrees", 0.0)


@pytest.mark.parametrize(("share", "found"), [(0.2, []), (0.3, ["map-disagrees-in-part"])])
def test_scans_of_elsewhere_are_found_where_they_are_many(share, found):
    ranges = drive().ranges.copy()
    ranges[: round(300 * share)] = 1.0
    findings = list(pose_findings(replace(drive(), ranges=ranges), room()))
    assert names(findings) == found
    assert all(finding.values["share"] == pytest.approx(share, abs=0.01) for finding in findings)


def test_a_reference_that_stands_still_while_the_odometry_moves_is_found():
    poses = drive().poses.copy()
    poses[100:200] = poses[100]
    findings = list(pose_findings(drive(poses), room()))
    assert "reference-stands-still" in names(findings)
    finding = next(f for f in findings if f.name == "reference-stands-still")
    assert finding.values["first_s"] == pytest.approx(20.0, abs=5.1)


def test_odometry_that_was_reset_takes_no_ground_from_the_reference():
    log = drive()
    odometry = log.odometry.copy()
    odometry[200:] = between(odometry[200], odometry[200:])
    reset = replace(log, odometry=odometry)
    (finding,) = pose_findings(reset, room())
    assert (finding.name, finding.values["count"]) == ("odometry-jumps", 1.0)
    assert finding.values["first_s"] == pytest.approx(40.0)
    assert "reference pose jumps" not in select_scans(reset, room()).dropped


def test_a_reference_that_slides_sideways_is_found():
    poses = drive().poses.copy()
    poses[:, 1] += np.linspace(0.0, 4.0, 300) - 2.0
    finding = next(f for f in pose_findings(drive(poses), room()) if f.name == "reference-slides")
    assert finding.values["median_difference"] == pytest.approx(4.0 * 25 / 299, rel=0.1)


def test_scans_tell_whether_the_reference_or_the_odometry_slides():
    log, slid = drive(), drive().poses.copy()
    slid[:, 1] += np.linspace(0.0, 6.0, 300) - 3.0
    assert names(pose_findings(replace(log, odometry=slid), room())) == ["odometry-disagrees"]
    (finding,) = pose_findings(replace(log, odometry=slid), room())
    assert finding.values["median_difference"] == pytest.approx(6.0 * 25 / 299, rel=0.1)
    # A map that these poses drew agrees with them, be they right or wrong.
    assert names(pose_findings(replace(log, odometry=slid), room(), drawn=True)) == ["reference-slides"]
    # Without readings none of the two is known to be wrong.
    blind = replace(log, odometry=slid, ranges=np.full(log.ranges.shape, np.nan))
    assert names(pose_findings(blind, room())) == ["reference-slides"]


def test_wheels_that_spin_are_not_taken_for_a_reference_that_stands_still():
    poses, spun = drive().poses.copy(), drive().poses.copy()
    poses[100:] = poses[100]
    cells = np.zeros((100, 400))
    cells[0] = cells[-1] = 1.0
    furnished = cells.copy()
    furnished[40:45, ::17] = furnished[57:60, ::23] = 1.0
    for walls, found in ((furnished, "odometry-disagrees"), (cells, "reference-stands-still")):  # a corridor is alike
        grid = OccupancyGrid(walls, 0.1)
        log = replace(drive(poses), ranges=RayCaster(grid).expected_ranges(poses, FINDER), odometry=spun)
        assert names(pose_findings(log, grid)) == [found]


def test_a_heading_that_turns_otherwise_is_found():
    poses = drive().poses.copy()
    poses[:, 2] = 0.05 * np.arange(300)
    assert "reference-turns" in names(pose_findings(drive(poses), room()))


def test_poses_inside_walls_are_counted():
    poses = drive().poses.copy()
    poses[50:60, 1] = 0.05
    finding = next(f for f in pose_findings(drive(poses), room()) if f.name == "pose-in-wall")
    assert finding.values["n"] == 10
    assert finding.values["first_s"] == pytest.approx(10.0)


def test_a_log_without_odometry_is_not_judged_by_it():
    log = drive()
    blind = SensorLog(FINDER, log.stamps, log.ranges, log.poses, np.full((300, 3), np.nan))
    assert not list(pose_findings(blind, room()))
