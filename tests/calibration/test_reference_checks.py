from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import ArrayLike

from beamfield.calibration.beam_table import BeamTable
from beamfield.calibration.opposite_beams import OppositeBeams, map_findings, opposite_beams
from beamfield.calibration.reference_checks import pose_findings
from beamfield.calibration.selection import select_scans
from beamfield.geometry import between, chained, compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder, SensorLog

FINDER = RangeFinder.from_bearings(np.deg2rad(np.arange(-90.0, 91.0, 30.0)), 20.0)


def corridor_table(
    rng: np.random.Generator, *, scale: float = 1.0, thick: float = 0.0, pose_error: float = 0.0, n_scans: int = 400
):
    """Widths between 2 and 10 m seen by the beams to the left and right; the mapped ones differ as asked."""
    width = rng.uniform(2.0, 10.0, n_scans)
    left = width * rng.uniform(0.2, 0.8, n_scans)
    measured = np.column_stack([width - left, left]) + rng.normal(0, 0.02, (n_scans, 2))
    off = rng.normal(0, pose_error, n_scans)
    mapped = np.column_stack([width - left + off, left - off]) / scale - thick
    scan = np.repeat(np.arange(n_scans), 2)
    beam = np.tile([0, 6], n_scans)
    table = BeamTable(
        measured.ravel(), mapped.ravel(), scan.astype(np.int32), beam.astype(np.int32), scan * 0.1, FINDER.max_range
    )
    log = SensorLog(
        FINDER, 0.1 * np.arange(n_scans), np.ones((n_scans, 7)), np.zeros((n_scans, 3)), np.zeros((n_scans, 3))
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
    assert re.search(r"the ranges are [23]\.\d% too long", finding.do)
    # Cells of a map that was drawn from the log are as large as they are said to be.
    (finding,) = map_findings(pairs, 0.05, drawn=True)
    assert "0.051" not in finding.do
    assert "the poses drift" in finding.do


def test_a_scale_must_surely_be_wrong_by_more_than_a_percent():
    measured = OppositeBeams(35_000, 0.09, 1.0135, 0.0027, 0.03, 0.01)
    assert [one.name for one in map_findings(measured, 0.03)] == ["walls-too-thick"]
    assert [one.name for one in map_findings(replace(measured, scale_se=0.001), 0.03)] == ["map-scale"]
    # And by four standard errors.
    for scale_se, found in ((0.0085, ["map-scale"]), (0.0095, [])):
        unsure = replace(measured, scale=1.035, scale_se=scale_se, median_difference=0.0)
        assert [one.name for one in map_findings(unsure, 0.03)] == found


@pytest.mark.parametrize(("resolution", "least"), [(0.1, 0.15), (0.03, 0.06)])
def test_walls_are_too_thick_or_too_thin_by_more_than_cells_and_noise_make(resolution, least):
    measured = OppositeBeams(35_000, 0.0, 1.0, 0.001, 0.03, 0.01)
    for difference, name in ((least + 0.001, "walls-too-thick"), (-least - 0.001, "walls-too-thin")):
        (finding,) = map_findings(replace(measured, median_difference=difference), resolution)
        assert finding.name == name
        assert ("less between" in finding.text) is (difference < 0.0)
    for difference in (least - 0.001, 0.001 - least):
        assert not list(map_findings(replace(measured, median_difference=difference), resolution))


def test_people_beside_the_robot_do_not_move_the_estimate(rng):
    log, table, blocks = corridor_table(rng)
    short = rng.random(len(table)) < 0.2
    ranges = np.where(short, table.ranges * rng.random(len(table)), table.ranges)
    crowded = BeamTable(ranges, table.expected_ranges, table.scan, table.beam, table.stamps, table.max_range)
    pairs = opposite_beams(log, crowded, blocks)
    assert pairs.scale == pytest.approx(1.0, abs=0.01)
    assert not list(map_findings(pairs, 0.05))


def test_a_crowd_near_the_robot_is_neither_a_scale_nor_thin_walls(rng):
    log, table, blocks = corridor_table(rng, n_scans=6000)
    before = -np.log(1.0 - rng.random(len(table)) * (1.0 - np.exp(-0.6 * table.ranges))) / 0.6
    ranges = np.where(rng.random(len(table)) < 0.7, before, table.ranges)
    crowded = BeamTable(ranges, table.expected_ranges, table.scan, table.beam, table.stamps, table.max_range)
    pairs = opposite_beams(log, crowded, blocks)
    assert pairs.scale == pytest.approx(1.0, abs=0.003)
    assert pairs.median_difference == pytest.approx(0.0, abs=0.01)
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
    return SensorLog(FINDER, 1000.0 + t, ranges, poses if reference is None else reference, odometry)


def windows(driven: ArrayLike, shown: ArrayLike, *, n: int = 40, period: float = 5.1) -> SensorLog:
    """Return a log without readings whose odometry and reference move so, (3,) or (n, 3), in each of n windows."""
    driven, shown = (chained(np.zeros(3), np.broadcast_to(steps, (n, 3))) for steps in (driven, shown))
    # Scans without one of the two, when a window is due, begin and end none.
    stamps = np.repeat(period * np.arange(n + 1), 3) + np.tile([-0.1, -0.05, 0.0], n + 1)
    poses, odometry = np.repeat(shown, 3, axis=0), np.repeat(driven, 3, axis=0)
    poses[::3] = odometry[1::3] = np.nan
    return SensorLog(FINDER, stamps, np.full((len(stamps), 7), np.nan), poses, odometry)


EMPTY = OccupancyGrid(np.zeros((10, 10)), 0.1)


def test_a_reference_that_follows_the_odometry_gives_no_finding_unless_the_scans_are_of_elsewhere():
    assert not list(pose_findings(drive(), room()))
    (finding,) = pose_findings(replace(drive(), ranges=np.ones((300, 7))), room())
    assert (finding.name, finding.values["median_agreement"]) == ("map-disagrees", 0.0)


@pytest.mark.parametrize(("share", "found"), [(0.24, []), (0.26, ["map-disagrees-in-part"])])
def test_scans_of_elsewhere_are_found_where_they_are_many(share, found):
    ranges = drive().ranges.copy()
    ranges[: round(300 * share)] = 1.0
    findings = list(pose_findings(replace(drive(), ranges=ranges), room()))
    assert names(findings) == found
    assert all(finding.values["share"] == pytest.approx(share, abs=0.01) for finding in findings)


def test_scans_of_cones_agree_with_no_ray_and_decide_nothing():
    cones = replace(drive(), finder=replace(FINDER, opening_angle=0.4))
    assert not list(pose_findings(replace(cones, ranges=np.ones((300, 7))), room()))
    slid = cones.poses.copy()
    slid[:, 1] += np.linspace(0.0, 6.0, 300) - 3.0
    assert names(pose_findings(replace(cones, odometry=slid), room())) == ["reference-slides"]


CORRIDOR = np.zeros((100, 400))
CORRIDOR[0] = CORRIDOR[-1] = 1.0
FURNISHED = CORRIDOR.copy()
FURNISHED[40:45, ::17] = FURNISHED[57:60, ::23] = 1.0

SLIDES, STANDS = "reference-slides", "reference-stands-still"


@pytest.mark.parametrize(
    ("driven", "shown", "found"),
    [
        ([1.4, 1.4, 0.0], [1.4, 1.4, 0.0], []),
        # Along the way: by more than 0.3 m and a quarter of the longer way of the two.
        ([1.0, 0.0, 0.0], [0.71, 0.0, 0.0], []),
        ([1.0, 0.0, 0.0], [0.69, 0.0, 0.0], [SLIDES]),
        ([2.0, 0.0, 0.0], [1.51, 0.0, 0.0], []),
        ([2.0, 0.0, 0.0], [1.49, 0.0, 0.0], [SLIDES]),
        ([2.0, 0.0, 0.0], [2.66, 0.0, 0.0], []),
        ([2.0, 0.0, 0.0], [2.67, 0.0, 0.0], [SLIDES]),
        # Across it: by more than 0.25 m and 12% of the way.
        ([0.0, 1.0, 0.0], [0.24, 1.0, 0.0], []),
        ([0.0, 1.0, 0.0], [0.26, 1.0, 0.0], [SLIDES]),
        ([0.49, 0.0, 0.0], [0.49, 0.29, 0.0], []),
        ([4.0, 0.0, 0.0], [4.0, 0.47, 0.0], []),
        ([4.0, 0.0, 0.0], [4.0, 0.49, 0.0], [SLIDES]),
        # A quarter of more than half a metre.
        ([0.52, 0.0, 0.0], [0.12, 0.0, 0.0], [STANDS]),
        ([0.52, 0.0, 0.0], [0.14, 0.0, 0.0], [SLIDES]),
        ([0.48, 0.0, 0.0], [0.1, 0.0, 0.0], [SLIDES]),
        ([1.0, 0.0, 0.1], [1.0, 0.0, 0.29], []),
        ([1.0, 0.0, 0.1], [1.0, 0.0, 0.31], ["reference-turns"]),
    ],
)
def test_how_far_reference_and_odometry_may_differ_in_a_window(driven, shown, found):
    findings = list(pose_findings(windows(driven, shown), EMPTY))
    assert names(findings) == found
    assert all("in 40 of 40 windows" in one.text or "in 100% of the windows" in one.text for one in findings)


@pytest.mark.parametrize(
    ("n", "n_slid", "n_turned", "found"),
    [(200, 2, 20, []), (200, 3, 21, [SLIDES, "reference-turns"]), (40, 1, 0, [SLIDES]), (60, 1, 0, [])],
)
def test_a_few_windows_may_differ(n, n_slid, n_turned, found):
    shown = np.tile([1.0, 0.0, 0.0], (n, 1))
    shown[:n_slid, 0], shown[n - n_turned :, 2] = 0.5, 0.3
    findings = list(pose_findings(windows([1.0, 0.0, 0.0], shown, n=n), EMPTY))
    assert names(findings) == found
    assert [one.values["n_windows"] for one in findings if one.name == SLIDES] == [n_slid] * (SLIDES in found)
    assert all("in 10% of the windows" in one.text for one in findings if one.name == "reference-turns")


def test_a_log_shorter_than_a_window_is_one():
    assert names(pose_findings(windows([0.5, 0.0, 0.0], [0.3, 0.0, 0.0], n=2, period=2.0), EMPTY)) == [SLIDES]


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


def test_scans_tell_where_most_of_the_map_is_out_of_date_whether_the_odometry_slides():
    log, slid = drive(), drive().poses.copy()
    slid[:, 1] += np.linspace(0.0, 6.0, 300) - 3.0
    ranges = log.ranges.copy()
    ranges[:, :2], ranges[::25, :4] = 1.0, 1.0  # five of seven beams agree, three where windows begin and end
    assert names(pose_findings(replace(log, ranges=ranges, odometry=slid), room())) == ["odometry-disagrees"]
    assert names(pose_findings(replace(log, ranges=ranges, poses=slid), room()))[-1] == SLIDES


def test_a_reference_that_was_lost_for_a_while_is_not_taken_for_wheels_that_slip():
    log = drive()
    poses, odometry = log.poses.copy(), log.odometry.copy()
    poses[70:110, 1] += 1.5  # it goes within one window, and comes back within another
    odometry[:13] = np.nan
    furnished = OccupancyGrid(FURNISHED, 0.1)
    ranges = RayCaster(furnished).expected_ranges(log.poses, FINDER)
    (finding,) = pose_findings(replace(log, ranges=ranges, poses=poses, odometry=odometry), furnished)
    assert (finding.name, finding.values["n_windows"]) == (SLIDES, 2.0)


def test_wheels_that_spin_are_not_taken_for_a_reference_that_stands_still():
    poses, spun = drive().poses.copy(), drive().poses.copy()
    poses[100:] = poses[100]
    ended = CORRIDOR.copy()
    ended[:, 300] = 1.0
    # A corridor is alike all along; its end is seen by one beam of seven.
    for walls, found in ((FURNISHED, "odometry-disagrees"), (CORRIDOR, STANDS), (ended, STANDS)):
        grid = OccupancyGrid(walls, 0.1)
        log = replace(drive(poses), ranges=RayCaster(grid).expected_ranges(poses, FINDER), odometry=spun)
        assert names(pose_findings(log, grid)) == [found]


def test_a_heading_that_turns_otherwise_is_found():
    poses = drive().poses.copy()
    poses[:, 2] = 0.05 * np.arange(300)
    assert "reference-turns" in names(pose_findings(drive(poses), room()))


def test_poses_inside_walls_are_counted():
    poses = drive().poses.copy()
    poses[50:60, 1], poses[7] = 0.05, np.nan
    finding = next(f for f in pose_findings(drive(poses), room()) if f.name == "pose-in-wall")
    assert finding.values["n"] == 10
    assert finding.values["first_s"] == pytest.approx(10.0)


def test_a_log_without_odometry_is_not_judged_by_it():
    log = drive()
    blind = SensorLog(FINDER, log.stamps, log.ranges, log.poses, np.full((300, 3), np.nan))
    assert not list(pose_findings(blind, room()))
