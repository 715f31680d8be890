"""Trajectories fitted to simulated logs, whose truth is known, and to logs with something wrong."""

from __future__ import annotations

import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from beamfield.errors import InvalidInputError, TooLittleDataError, TrajectoryNotFoundError
from beamfield.geometry import between, chained, compose, wrap_angle
from beamfield.localization.course_choice import MOST_COST, MirroredError, without_false_jumps
from beamfield.localization.drive import prepare
from beamfield.localization.trajectory import TrajectoryFit, find_course, fit_course, fit_trajectory
from beamfield.localization.trajectory_start import Followed, cheapest_course
from beamfield.localization.trajectory_trust import _carried, time_gaps
from beamfield.localization.wall_distance import walls_of
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.outdated_map import find_outdated_map
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import drawn_readings, simulate_log
from beamfield.simulation.odometry import OdometryNoise, noisy_odometry
from beamfield.simulation.trajectory import drive_through
from tests.conftest import TRUTH


def distances(fit: TrajectoryFit, log: SensorLog) -> np.ndarray:
    return np.hypot(*(fit.poses - log.poses)[:, :2].T)


def names(fit: TrajectoryFit) -> set[str]:
    return {finding.name for finding in fit.findings}


@pytest.fixture(scope="module")
def fit(drive: SensorLog, office: OccupancyGrid) -> TrajectoryFit:
    # Its reference poses are the truth, and not to be used.
    return fit_trajectory(drive.with_poses(np.full((len(drive), 3), np.nan)), office)


@pytest.fixture(autouse=True)
def few_places(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three places to search from, for all but `fit`: each is searched and followed like the others."""
    monkeypatch.setattr("beamfield.localization.trajectory_start.PLACES", 3)


def test_a_drive_with_drifting_odometry_is_found_without_a_start(fit: TrajectoryFit, drive: SensorLog):
    assert np.hypot(*(compose(drive.poses[0], drive.odometry) - drive.poses)[-1, :2]) > 0.3
    assert distances(fit, drive).mean() < 0.02
    assert distances(fit, drive).max() < 0.08
    assert np.abs(wrap_angle(fit.poses - drive.poses)[:, 2]).max() < np.radians(1.5)
    assert fit.trusted.all()
    assert fit.findings == ()
    assert fit.converged
    assert np.isfinite(fit.covariances).all()


@pytest.mark.parametrize(
    ("shares", "said"),
    [
        ([1.0, 1.0, 1.0], r"distances off by \S+, turns by "),
        ([1.0, 1.0, 0.0], r"distances off by \S+; the robot hardly turned"),
        ([0.0, 0.0, 1.0], r"the robot hardly drove; turns off by "),
    ],
)
def test_errors_are_told_only_of_what_the_robot_did(fit: TrajectoryFit, shares, said):
    fit = replace(fit, poses=fit.poses * shares)
    assert re.search(said, fit.summary().splitlines()[-1])


def test_a_robot_is_found_where_all_that_is_not_free_is_painted_black(drive: SensorLog, black_office: OccupancyGrid):
    log = drive.select(np.arange(160))
    assert distances(fit_trajectory(log, black_office), log).max() < 0.1


def test_a_sensor_that_looks_ahead_only_does_not_put_the_robot_into_the_walls(office: OccupancyGrid):
    camera = RangeFinder.from_bearings(np.radians(np.linspace(-28.5, 28.5, 40)), 6.0)
    sensor = BeamParameters(0.90, 0.03, 0.03, 0.04, sigma_hit=0.04, lambda_short=0.5)
    log = simulate_log(office, camera, sensor, duration=40.0, scan_rate=4.0, seed=3).only_sensor()
    fit = fit_trajectory(log, office, start=log.poses[0])
    ahead = between(log.poses, fit.poses)[:, 0]
    # As hits anywhere in the walls they put it 0.05 m too far ahead.
    assert abs(ahead.mean()) < 0.01
    assert distances(fit, log).mean() < 0.02


def test_hits_lie_less_deep_in_what_is_filled_than_in_walls_painted_thick(
    office: OccupancyGrid, black_office: OccupancyGrid
):
    assert walls_of(black_office).deepest < walls_of(office).deepest


def test_a_course_that_stands_out_is_taken_though_half_of_the_readings_are_no_hits(office: OccupancyGrid):
    finder = RangeFinder.from_bearings(np.radians(np.linspace(-90.0, 90.0, 60)), max_range=8.0)
    poor = BeamParameters(0.50, 0.25, 0.05, 0.20, sigma_hit=0.05, lambda_short=0.5)
    log = simulate_log(office, finder, poor, duration=60.0, scan_rate=4.0, seed=3).only_sensor()
    found = find_course(log, office)
    assert found.hypotheses[0].misfit > MOST_COST
    assert distances(fit_course(log, office, found), log).mean() < 0.05


def test_a_refusal_names_beams_that_see_the_robot(drive: SensorLog):
    ranges = drive.ranges.copy()
    ranges[:, :20] = 0.4
    with pytest.raises(TrajectoryNotFoundError, match=r"At .* the readings are 0\.40 m wherever .*--mask"):
        fit_trajectory(replace(drive, ranges=ranges), draw_floor_plan(seed=9))


def test_a_map_is_out_of_date_where_most_readings_disagree_with_it_at_poses_that_fit_the_whole_drive(
    drive: SensorLog, office: OccupancyGrid
):
    found, ranges = find_course(drive, office), drive.ranges.copy()
    behind = np.random.default_rng(4).random(ranges.shape) < 0.6
    ranges[behind] *= 0.6  # what the map does not show
    log = replace(drive, ranges=ranges)
    fit = fit_course(log, office, found)
    assert distances(fit, drive).max() < 0.1
    (outdated,) = [one for one in fit.findings if one.name == "map-out-of-date"]
    assert 0.3 < outdated.values["median_agreement"] < 0.45
    # The poses alone do not show it, nor does a course on which the robot was carried.
    assert find_outdated_map(log, office, fit.poses) is None
    carried = found._replace(course=replace(found.course, jumps=np.array([9])))
    assert "map-out-of-date" not in names(fit_course(log, office, carried))


def hall_log(side: float, n_racks: int, seed: int) -> tuple[SensorLog, OccupancyGrid]:
    """Return a drive between thin racks, most readings short or random, and the map."""
    rng, rows = np.random.default_rng(seed), int(side / 0.05)
    cells = np.pad(np.zeros((rows - 4, rows - 4), np.float32), 2, constant_values=1.0)
    for x, y in rng.uniform(1.0, side - 1.0, (n_racks, 2)):
        row, col, half = int(y / 0.05), int(x / 0.05), int(rng.integers(2, 6))
        cells[row - half : row + half, col - 1 : col + 1] = 1.0
    grid = OccupancyGrid(cells, 0.05, (0.0, 0.0, 0.0))
    finder = RangeFinder.from_bearings(np.radians(np.linspace(-90.0, 90.0, 60)), max_range=6.0)
    crowd = BeamParameters(0.62, 0.25, 0.05, 0.08, sigma_hit=0.04, lambda_short=0.5)
    return simulate_log(grid, finder, crowd, duration=60.0, scan_rate=4.0, seed=seed).only_sensor(), grid


def test_many_small_things_do_not_draw_the_poses_from_one_to_the_next():
    log, grid = hall_log(16.0, 60, seed=2)
    assert distances(fit_trajectory(log, grid), log).max() < 0.1


def test_a_start_that_is_given_is_believed_though_readings_fit_poorly():
    log, grid = hall_log(20.0, 120, seed=1)
    assert distances(fit_trajectory(log, grid, start=log.poses[0] + [0.5, -0.4, 0.1]), log).max() < 0.1


def test_end_points_alone_carry_a_robot_nowhere(drive: SensorLog, office: OccupancyGrid):
    kept = prepare(drive, drive.odometry)
    truth, n = drive.poses[kept.scans], len(kept.scans)
    late = np.arange(n) >= n - 60
    there = Followed(truth, np.where(late, 9.0, 2.0))
    elsewhere = Followed(truth + np.array([8.0, 0.0, 0.0]), np.where(late, 1.0, 20.0))
    course = cheapest_course(kept, [there, elsewhere], None)
    assert len(course.jumps) == 1
    assert not len(without_false_jumps(drive, office, kept, [there, elsewhere], course, None).jumps)


def test_a_robot_that_was_carried_is_found_again_and_the_time_named(drive: SensorLog, office: OccupancyGrid):
    kept = np.r_[0:160, 300 : len(drive)]
    log = drive.select(kept)
    step = between(log.odometry[159], log.odometry[160])
    moved = log.odometry.copy()
    # The odometry knows nothing of the way between.
    moved[160:] = compose(log.odometry[159], between(log.odometry[160], log.odometry[160:]))
    assert np.hypot(*step[:2]) > 1.5
    fit = fit_trajectory(replace(log, odometry=moved), office)
    assert "kidnapped" in names(fit)
    (carried,) = [one for one in fit.findings if one.name == "kidnapped"]
    assert carried.values["time_s"] == pytest.approx(log.stamps[160] - log.stamps[0], abs=1.5)
    assert distances(fit, log)[fit.trusted].max() < 0.1
    driven = np.delete(np.hypot(*np.diff(log.poses[:, :2], axis=0).T), 159).sum()
    said = re.search(r"scans, ([\d.]+) m", fit.summary())
    assert float(said.group(1)) == pytest.approx(driven, rel=0.01)


def test_a_jump_is_as_long_as_odometry_and_scans_differ():
    course = SimpleNamespace(jumps=[1], poses=np.array([[2.0, 1.0, np.pi / 2], [2.0, 1.5, np.pi / 2]]))
    drive = SimpleNamespace(steps_between_scans=np.array([[0.1, 0.3, 0.2]]), scans=[0, 4])
    (found,) = _carried(drive, course, np.arange(5.0))
    assert found.text.startswith("4.0 s after the first scan the robot is 0.5 m and 11 degrees from where its odometry")


def test_scans_of_a_robot_in_somebodys_hands_are_not_trusted(drive: SensorLog, office: OccupancyGrid):
    # It is carried while the odometry stands still; the scans see the way.
    moved = drive.odometry.copy()
    moved[160:300] = moved[159]
    moved[300:] = compose(moved[159], between(drive.odometry[300], drive.odometry[300:]))
    fit = fit_trajectory(replace(drive, odometry=moved), office)
    assert "kidnapped" in names(fit)
    assert distances(fit, drive).max() > 1.5
    assert distances(fit, drive)[fit.trusted].max() < 0.1
    assert fit.trusted[:150].all()
    assert fit.trusted[310:].all()


def test_a_stamp_that_is_no_number_is_named_as_such(drive: SensorLog):
    cells, log = room(drive)
    stamps = np.array(log.stamps)
    stamps[7] = np.nan
    with pytest.raises(InvalidInputError, match="log: expected finite stamps, got nan at scan 7"):
        fit_trajectory(replace(log, stamps=stamps), OccupancyGrid.from_ros(cells, 0.05))


def test_odometry_of_the_wrong_sign_is_put_right_and_mirrored_scans_are_refused(drive: SensorLog):
    cells, log = room(drive)
    grid = OccupancyGrid.from_ros(cells, 0.05)
    steps = between(log.odometry[:-1], log.odometry[1:])
    fit = fit_trajectory(replace(log, odometry=chained(np.zeros(3), steps * [1.0, -1.0, -1.0])), grid)
    (finding,) = [one for one in fit.findings if one.name == "odometry-sign"]
    assert "with its turns reversed" in finding.text
    assert distances(fit, log).max() < 0.1
    # They turn against the odometry too, and it is not the odometry that is wrong.
    with pytest.raises(TrajectoryNotFoundError, match=r"only if its scans are mirrored .*; best start"):
        fit_trajectory(replace(log, ranges=log.ranges[:, ::-1]), grid)


def test_a_map_whose_picture_is_upside_down_is_named(drive: SensorLog):
    cells, log = room(drive)
    with pytest.raises(TrajectoryNotFoundError, match=r"only if the map is mirrored .*; best start"):
        fit_trajectory(log, OccupancyGrid.from_ros(cells[::-1], 0.05))


def room(drive: SensorLog) -> tuple[np.ndarray, SensorLog]:
    """Return a furnished room, cells of 0.05 m, and a short drive through it."""
    cells = np.zeros((80, 120))
    cells[[0, 1, -1, -2]] = cells[:, [0, 1, -1, -2]] = 100
    cells[20:30, 20:40] = cells[45:78, 95:100] = 100
    angle = np.linspace(0.0, 3.0, 60)
    poses = np.column_stack([3.0 + 1.0 * np.sin(angle), 2.0 + 0.2 * np.cos(angle), -0.5 * angle])
    expected = RayCaster(OccupancyGrid.from_ros(cells, 0.05)).expected_ranges(poses, drive.finder)
    ranges = expected + np.random.default_rng(1).normal(0, 0.02, (60, 61))
    return cells, SensorLog(drive.finder, 0.2 * np.arange(60), ranges, poses, poses)


def test_slips_are_named_and_do_not_move_the_trajectory(drive: SensorLog, office: OccupancyGrid):
    log = drive.select(np.arange(160))
    steps = between(log.odometry[:-1], log.odometry[1:])
    steps[70] += [0.4, 0.0, 0.0]
    steps[120] += [0.0, 0.0, np.radians(20.0)]
    odometry = chained(np.zeros(3), steps)
    odometry[-1] = np.nan  # wheels stop reporting a little before the scanner does: nothing to worry about
    fit = fit_trajectory(replace(log, odometry=odometry), office)
    assert [one.severity for one in fit.findings if one.name == "odometry-missing"] == ["info"]
    times = sorted(one.values["time_s"] for one in fit.findings if one.name == "wheel-slip")
    assert times == pytest.approx([log.stamps[70] - log.stamps[0], log.stamps[120] - log.stamps[0]], abs=1.1)
    assert distances(fit, log).mean() < 0.04


def test_where_odometry_is_missing_at_an_end_the_robot_moves_on_along_its_arc(drive: SensorLog):
    stamps, turn = 0.1 * np.arange(60), 0.05 * np.arange(60)
    arc = np.column_stack([2.0 * np.sin(turn), 2.0 * (1.0 - np.cos(turn)), turn])
    log = replace(drive.select(np.arange(60)), stamps=stamps)
    for missing in (slice(None, 15), slice(-15, None)):
        odometry = arc.copy()
        odometry[missing] = np.nan
        np.testing.assert_allclose(prepare(log, odometry).steps, between(arc[:-1], arc[1:]), atol=1e-3)


def test_a_reset_and_missing_odometry_are_bridged_and_said(drive: SensorLog, office: OccupancyGrid):
    log = drive.select(np.arange(100))
    odometry = log.odometry.copy()
    odometry[50:] = between(odometry[50] - [9.0, 0.0, 0.0], odometry[50:])
    odometry[:3] = odometry[80:] = np.nan
    fit = fit_trajectory(replace(log, odometry=odometry, stamps=np.repeat(log.stamps[::2], 2)), office)
    assert {"odometry-reset", "odometry-missing", "odometry-gap"} <= names(fit)
    assert [one.severity for one in fit.findings if one.name == "odometry-missing"] == ["warning"]
    assert distances(fit, log)[:80].mean() < 0.04
    # Where odometry has ended, the robot may drive on.
    assert fit.trusted[3:48].all()
    assert not fit.trusted[90:].any()


def test_interpolated_odometry_is_no_slip_and_explains_scans_that_do_not_fit(drive: SensorLog, office: OccupancyGrid):
    log = drive.select(np.arange(100, 200))
    odometry = log.odometry.copy()
    odometry[40:60] = np.nan  # it turns meanwhile
    fit = fit_trajectory(replace(log, odometry=odometry), office, start=log.poses[0])
    # From interpolated poses walls seem to move, too.
    assert names(fit) - {"moving-objects"} == {"odometry-missing", "odometry-gap", "poor-fit-stretch"}
    (poor,) = [one for one in fit.findings if one.name == "poor-fit-stretch"]
    assert ("no odometry" in poor.why, poor.do) == (True, "Record the odometry throughout.")


@pytest.mark.parametrize(
    ("distance", "turn", "degrees_per_metre", "named"),
    [
        (1.25, 1.0, 0.0, {"odometry-scale"}),
        (0.85, 1.15, 6.0, {"odometry-scale", "odometry-turn-scale", "odometry-drift"}),
    ],
)
def test_odometry_that_is_wrong_throughout_is_followed_and_named(
    drive: SensorLog, office: OccupancyGrid, distance, turn, degrees_per_metre, named
):
    log = drive.select(np.arange(240))
    steps = between(log.odometry[:-1], log.odometry[1:])
    turns = turn * steps[:, 2] + np.radians(degrees_per_metre) * steps[:, 0]
    wrong = chained(np.zeros(3), np.column_stack([distance * steps[:, :2], turns]))
    fit = fit_trajectory(replace(log, odometry=wrong), office)
    (finding,) = [one for one in fit.findings if one.name == "odometry-scale"]
    assert finding.values["scale"] == pytest.approx(1.0 / distance - 1.0, abs=0.03)
    assert {one.name for one in fit.findings if one.severity == "warning"} == named
    assert distances(fit, log).max() < 0.1


def test_of_wheels_that_slip_sideways_neither_map_nor_ranges_are_blamed(office: OccupancyGrid):
    finder = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 60, endpoint=False), 12.0)
    stamps = 0.25 * np.arange(200)
    along = drive_through(office, stamps, seed=3).poses
    poses = np.column_stack([along[:, :2], wrap_angle(0.03 * stamps)])  # whatever the way, it turns slowly
    ranges = drawn_readings(RayCaster(office).expected_ranges(poses, finder), finder, TRUTH, np.random.default_rng(0))
    odometry = chained(np.zeros(3), between(poses[:-1], poses[1:]) * [1.01, 1.10, 1.0])
    fit = fit_trajectory(SensorLog(finder, stamps, ranges, poses, odometry), office, start=poses[0])
    (finding,) = [one for one in fit.findings if one.severity == "warning"]
    assert (finding.name, "slip sideways" in finding.why) == ("odometry-scale", True)
    assert finding.values["ahead"] == pytest.approx(1.0 / 1.01 - 1.0, abs=0.015)
    assert finding.values["sideways"] == pytest.approx(1.0 / 1.10 - 1.0, abs=0.015)


@pytest.mark.parametrize(
    ("step", "gap", "is_named"), [(0.1, 4.9, False), (0.1, 5.1, True), (0.5, 9.9, False), (0.5, 10.1, True)]
)
def test_a_gap_in_time_is_longer_than_five_seconds_and_twenty_steps(step, gap, is_named):
    since = np.r_[0.0, np.cumsum([step] * 10 + [gap] + [step] * 10)]
    found = list(time_gaps(1.7e9 + since))
    assert len(found) == is_named
    said = f"There is no scan for up to {gap:.1f} s, {10 * step:.1f} s after the first scan; odometry bridges it."
    assert all((one.name, one.text) == ("time-gap", said) for one in found)


def test_without_odometry_scans_are_aligned_in_its_place(drive: SensorLog, office: OccupancyGrid):
    log = drive.select(np.arange(30))
    fit = fit_trajectory(replace(log, odometry=np.full((30, 3), np.nan)), office, start=log.poses[0])
    (finding,) = [one for one in fit.findings if one.name == "no-odometry"]
    assert finding.do.endswith("read them as such (--lone-poses odometry).")
    assert "odometry   none; those of aligned scans: distances off by " in fit.summary()
    assert np.median(distances(fit, log)) < 0.1


def test_a_corridor_without_ends_in_sight_is_not_sure(drive: SensorLog):
    cells = np.zeros((48, 1000))
    cells[[0, 1, -1, -2]] = cells[:, [0, 1, -1, -2]] = 100
    grid = OccupancyGrid.from_ros(cells, 0.05)
    poses = np.column_stack([np.linspace(2.0, 46.0, 150), np.full(150, 1.2), np.zeros(150)])
    finder = replace(drive.finder, max_range=5.0)
    rng = np.random.default_rng(3)
    ranges = drawn_readings(RayCaster(grid).expected_ranges(poses, finder), finder, TRUTH, rng)
    noise = OdometryNoise(0.05, 0.008, 0.015, 0.02, 0.0)
    log = SensorLog(finder, 0.3 * np.arange(150), ranges, poses, noisy_odometry(poses, rng, noise))
    fit = fit_trajectory(log, grid, start=poses[0])
    assert "weak-stretch" in names(fit)
    assert not fit.trusted[66:84].any()
    deviation = np.sqrt(fit.covariances[:, 0, 0])
    assert (np.abs(fit.poses - poses)[:, 0] < 4.0 * deviation + 0.02).all()


def test_two_equal_rooms_are_refused_until_a_start_is_given(drive: SensorLog):
    cells, log = room(drive)
    grid, poses = OccupancyGrid.from_ros(np.hstack([cells, cells]), 0.05), log.poses
    with pytest.raises(TrajectoryNotFoundError, match=r"equally well, give the start of one; best starts: .*; "):
        fit_trajectory(log, grid)
    fit = fit_trajectory(log, grid, start=poses[0] + [6.3, 0.3, 0.1])
    np.testing.assert_allclose(fit.poses[:, :2], poses[:, :2] + [6.0, 0.0], atol=0.05)


def test_impossible_input_is_refused(drive: SensorLog, office: OccupancyGrid):
    some = drive.select(np.arange(20))
    with pytest.raises(InvalidInputError, match="lies off the map"):
        fit_trajectory(some, office, start=(500.0, 0.0, 0.0))
    with pytest.raises(InvalidInputError, match="no free cell"):
        fit_trajectory(some, OccupancyGrid(np.ones((10, 10), np.float32), 0.1))
    with pytest.raises(InvalidInputError, match="no occupied cell"):
        fit_trajectory(some, OccupancyGrid(np.zeros((10, 10), np.float32), 0.1))
    with pytest.raises(InvalidInputError, match="backwards at scan 10"):
        fit_trajectory(some.select(np.r_[0:10, 5:10]), office)
    with pytest.raises(InvalidInputError, match=r"shorter than .* in metres"):
        fit_trajectory(replace(some, ranges=some.ranges / 1000.0), office)
    with pytest.raises(TooLittleDataError, match=r"moves 0\.00 m and turns 0 degrees"):
        fit_trajectory(replace(some, odometry=np.zeros((20, 3))), office)
    standing = replace(some, odometry=np.full((20, 3), np.nan), ranges=np.tile(some.ranges[0], (20, 1)))
    said = r"by its scans \(the log has no odometry\), the robot moves 0.* such a log needs odometry"
    with pytest.raises(TooLittleDataError, match=f"{said}; if its poses are the odometry, read it with lone_poses="):
        fit_trajectory(standing.with_poses(np.zeros((20, 3))), office)
    with pytest.raises(TooLittleDataError, match=f"{said}$"):
        fit_trajectory(standing.with_poses(np.full((20, 3), np.nan)), office)
    with pytest.raises(TooLittleDataError, match="too few scans: 2;"):
        fit_trajectory(some.select([0, 1]), office)
    with pytest.raises(TooLittleDataError, match="readings"):
        fit_trajectory(replace(some, ranges=np.full_like(some.ranges, np.inf)), office)
    with pytest.raises(InvalidInputError, match="max_deviation"):
        fit_trajectory(some, office, max_deviation=0.0)


def test_odometry_that_stands_still_while_the_scans_turn_is_named(drive: SensorLog, office: OccupancyGrid, monkeypatch):
    log = replace(drive.select(np.arange(120)), odometry=np.zeros((120, 3)))
    with pytest.raises(TooLittleDataError, match=r"needs a drive\. Where the scans turn .* the odometry hardly turns"):
        fit_trajectory(log, office)
    log = replace(log, odometry=np.outer(np.linspace(0.0, 5.0, 120), [1.0, 0.0, 0.0]))

    def none(*_: object) -> None:
        raise TrajectoryNotFoundError("none fits")

    monkeypatch.setattr("beamfield.localization.trajectory.choose_course", none)
    with pytest.raises(TrajectoryNotFoundError, match=r"none fits\. Where the scans turn .* the odometry hardly turns"):
        fit_trajectory(log, office)


def test_of_mirrored_scans_the_odometry_is_not_blamed(drive: SensorLog, office: OccupancyGrid, monkeypatch):
    log = drive.select(np.arange(120))
    steps = between(log.odometry[:-1], log.odometry[1:])

    def refuse(*_: object) -> None:
        raise MirroredError("only if its scans are mirrored")

    monkeypatch.setattr("beamfield.localization.trajectory.choose_course", refuse)
    with pytest.raises(TrajectoryNotFoundError, match=r"mirrored$"):
        fit_trajectory(replace(log, odometry=chained(np.zeros(3), steps * [1.0, 1.0, -1.0])), office)
