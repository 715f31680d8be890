"""Scans whose stamps are off: the delay is named with its sign; drives with good stamps are left alone."""

from __future__ import annotations

from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from beamfield.errors import TrajectoryNotFoundError
from beamfield.geometry import FloatArray, compose, interpolate_poses
from beamfield.localization.course_choice import FoundCourse
from beamfield.localization.scan_delay import EXPLAINED_BY_SMALL, _best_shift, scan_delay
from beamfield.localization.trajectory import find_course, fit_course, fit_trajectory
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.log import simulate_log
from tests.conftest import TRUTH


@pytest.fixture(scope="module")
def tour(office: OccupancyGrid) -> SensorLog:
    """A minute with eight scans per second and odometry that drifts."""
    finder = RangeFinder.from_bearings(np.linspace(-2.2, 2.2, 121), 12.0, min_range=0.1)
    return simulate_log(office, finder, TRUTH, duration=60.0, scan_rate=8.0, seed=5).only_sensor()


@pytest.fixture(autouse=True)
def less_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """A third of the pairs of scans that are aligned, which tell as much of a simulated drive; starts are given."""
    monkeypatch.setattr("beamfield.localization.trajectory_start.PLACES", 2)
    monkeypatch.setattr("beamfield.localization.scan_delay.MOST_PAIRS", 100)
    monkeypatch.setattr("beamfield.localization.laser_mount.MOST_PAIRS", 66)


def stamped_late(log: SensorLog, seconds: float | FloatArray) -> SensorLog:
    """Return a log whose scans bear later stamps: beside each is then the odometry of a later time."""
    stamps = log.stamps + seconds
    odometry = interpolate_poses(log.stamps, log.odometry, stamps.clip(log.stamps[0], log.stamps[-1]))
    odometry[(stamps < log.stamps[0]) | (stamps > log.stamps[-1])] = np.nan
    return replace(log, stamps=stamps, odometry=odometry, poses=np.full_like(log.poses, np.nan))


def jumping(log: SensorLog, seconds: float) -> SensorLog:
    """Return a log whose scans bear later stamps in its second half."""
    late = stamped_late(log, np.where(np.arange(len(log)) < len(log) // 2, 0.0, seconds))
    return late.select(np.flatnonzero(np.isfinite(late.odometry).all(axis=1)))


@pytest.mark.parametrize("seconds", [0.15, -0.4])
def test_a_delay_is_measured_and_has_a_sign(tour: SensorLog, seconds: float):
    found = scan_delay(stamped_late(tour, seconds))
    assert found is not None
    assert found.values["delay_s"] == pytest.approx(seconds, abs=0.03)
    side, sign = ("later", "-") if seconds > 0 else ("earlier", "+")
    assert f"s {side} than the odometry" in found.text
    assert f"shifted by {sign}{abs(found.values['delay_s']):.2f} s" in found.text


def test_good_stamps_are_not_named(tour: SensorLog):
    assert scan_delay(tour) is None


@pytest.mark.parametrize("reset", [150, 350])
def test_a_reset_of_the_odometry_is_no_delay(tour: SensorLog, reset: int):
    odometry = np.concatenate([tour.odometry[:reset], compose((5.0, 5.0, 1.5), tour.odometry[reset:])])
    assert scan_delay(replace(tour, odometry=odometry)) is None


def test_a_small_delay_is_named_with_what_it_costs(tour: SensorLog, office: OccupancyGrid):
    late = stamped_late(tour, -0.1)
    fit = fit_trajectory(late, office, start=tour.poses[0])
    (found,) = (one for one in fit.findings if one.name == "small-scan-delay")
    assert found.severity == "info"
    assert found.values["delay_s"] == pytest.approx(-0.1, abs=0.03)
    size = abs(found.values["delay_s"])
    assert "At this drive's 0.99 m/s" in found.text
    assert f"poses are {0.99 * size:.2f} m and " in found.text
    assert f"move the stamps by {size:+.2f} s" in found.do


@pytest.mark.parametrize("seconds", [0.1, -0.1])
def test_a_trajectory_that_is_not_found_is_not_blamed_on_a_small_delay(
    tour: SensorLog, office: OccupancyGrid, monkeypatch: pytest.MonkeyPatch, seconds: float
):
    refused = Mock(side_effect=TrajectoryNotFoundError("no trajectory through this map fits the log"))
    monkeypatch.setattr("beamfield.localization.trajectory.choose_course", refused)
    with pytest.raises(TrajectoryNotFoundError, match=r"fits the log$"):
        fit_trajectory(stamped_late(tour, seconds), office)


def test_a_wrong_sign_of_the_turns_is_no_delay(tour: SensorLog):
    assert scan_delay(replace(tour, odometry=tour.odometry * [1.0, -1.0, -1.0])) is None


@pytest.mark.parametrize("seed", range(3))
def test_a_robot_that_turns_evenly_says_nothing_of_a_delay(seed: int):
    rng, stamps = np.random.default_rng(seed), 0.2 * np.arange(200)
    driven = np.cumsum(0.02 + 0.008 * rng.normal(size=200))
    begin = stamps[40:160]
    found = _best_shift(0.02 + 0.002 * rng.normal(size=120), begin, begin + 0.2, stamps, driven)
    assert abs(found.delay) > 0.2  # by chance
    assert not found.fits


def test_a_delay_that_moves_bumps_between_two_pairs_explains_nothing_by_that():
    rng, stamps = np.random.default_rng(0), 0.05 * np.arange(4000)
    headings = np.cumsum(rng.normal(0.0, 0.01, len(stamps)))
    begin = np.arange(100, 3900, 12)  # a tenth of a second, every 0.6 s
    turns = headings[begin + 2] - headings[begin] + rng.normal(0.0, 0.005, len(begin))
    bumps = np.zeros(len(stamps))
    bumps[begin[::60] + 1] = np.radians(6.0)  # the odometry turns in the first half of a pair, and the robot does not
    found = _best_shift(turns, stamps[begin], stamps[begin + 2], stamps, headings + np.cumsum(bumps))
    assert found.explained < EXPLAINED_BY_SMALL / 2


def test_scans_that_are_rare_say_nothing_of_a_delay(tour: SensorLog):
    assert scan_delay(stamped_late(tour.select(np.arange(0, len(tour), 4)), 0.4)) is None


@pytest.fixture(scope="module")
def course(tour: SensorLog, office: OccupancyGrid) -> FoundCourse:
    """Where the robot drove, found from scans that are stamped late."""
    return find_course(stamped_late(tour, 0.4), office, start=tour.poses[0])


def test_a_trajectory_names_the_delay_in_place_of_slips(tour: SensorLog, office: OccupancyGrid, course: FoundCourse):
    fit = fit_course(stamped_late(tour, 0.4), office, course)
    names = [one.name for one in fit.findings]
    assert names[0] == "scan-delay"
    assert "wheel-slip" not in names


def test_no_scan_is_aligned_where_the_fitted_poses_show_no_delay(tour: SensorLog, monkeypatch: pytest.MonkeyPatch):
    align = Mock(side_effect=AssertionError("aligned"))
    monkeypatch.setattr("beamfield.localization.scan_delay.align", align)
    assert scan_delay(replace(tour, odometry=tour.poses), tour.poses) is None


def test_a_drive_that_is_not_found_for_its_stamps_is_said_to_have_them(
    tour: SensorLog, office: OccupancyGrid, monkeypatch: pytest.MonkeyPatch
):
    refused = Mock(side_effect=TrajectoryNotFoundError("no trajectory through this map fits the log"))
    monkeypatch.setattr("beamfield.localization.trajectory.choose_course", refused)
    with pytest.raises(TrajectoryNotFoundError, match=r"fits the log\. The scans are stamped 0\.[34]\d s later than"):
        fit_trajectory(stamped_late(tour, 0.4), office)
    with pytest.raises(TrajectoryNotFoundError, match=r"fits the log$"):
        fit_trajectory(tour, office)


@pytest.mark.parametrize("seconds", [1.5, 0.5])
def test_a_clock_that_jumps_is_named_with_when_and_by_how_much(tour: SensorLog, seconds: float):
    found = scan_delay(jumping(tour, seconds))
    assert found is not None
    assert found.values["delay_s"] == pytest.approx(seconds, abs=0.05)
    assert abs(found.values["before_s"]) < 0.05
    assert found.values["time_s"] == pytest.approx(30.0, abs=5.0)
    assert found.text.startswith("A clock jumped, about ")


def test_a_clock_that_jumps_while_the_robot_stands_jumped_about_the_middle_of_that(tour: SensorLog):
    half, stay = len(tour) // 2, 160
    scans = np.concatenate([np.arange(half), np.full(stay, half), np.arange(half, len(tour))])
    standing = SensorLog(
        tour.finder, tour.stamps[0] + np.arange(len(scans)) / 8.0, tour.ranges[scans], tour.poses[scans],
        tour.odometry[scans],
    )  # fmt: skip
    late = stamped_late(standing, np.where(np.arange(len(scans)) < half + 10, 0.0, 0.5))
    found = scan_delay(late.select(np.flatnonzero(np.isfinite(late.odometry).all(axis=1))))
    assert found is not None
    assert found.values["time_s"] == pytest.approx(40.0, abs=5.0)


def test_where_poses_seem_to_slip_scans_are_aligned_though_the_poses_show_no_delay(
    tour: SensorLog, office: OccupancyGrid, course: FoundCourse, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr("beamfield.localization.scan_delay._is_hinted", Mock(return_value=False))
    fit = fit_course(stamped_late(tour, 0.4), office, course)
    assert fit.findings[0].name == "scan-delay"
