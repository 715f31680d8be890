"""A laser elsewhere on the robot than its transform says is named, with where it is; right mounts are left alone."""

from __future__ import annotations

import re
from dataclasses import replace
from unittest.mock import Mock

import numpy as np
import pytest

from beamfield.errors import TrajectoryNotFoundError
from beamfield.geometry import between, chained, compose, interpolate_poses, invert
from beamfield.localization.laser_mount import mount_of_fit, mount_of_scans
from beamfield.localization.trajectory import fit_trajectory
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.log import simulate_log
from tests.conftest import TRUTH

OF_THE_POSES = ("weak-stretch", "poor-fit-stretch")
TRUE_MOUNT = np.array([0.3, 0.1, np.radians(15.0)])


@pytest.fixture(scope="module")
def tour(office: OccupancyGrid) -> SensorLog:
    """A minute with eight scans per second, odometry that drifts, and the laser at `TRUE_MOUNT`."""
    finder = RangeFinder.from_bearings(np.linspace(-2.2, 2.2, 121), 12.0, mount=TRUE_MOUNT, min_range=0.1)
    return simulate_log(office, finder, TRUTH, duration=60.0, scan_rate=8.0, seed=5).only_sensor()


@pytest.fixture(autouse=True)
def less_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    """A third of the pairs of scans that are aligned, which tell as much of a simulated drive; starts are given."""
    monkeypatch.setattr("beamfield.localization.trajectory_start.PLACES", 2)
    monkeypatch.setattr("beamfield.localization.laser_mount.MOST_PAIRS", 66)
    monkeypatch.setattr("beamfield.localization.scan_delay.MOST_PAIRS", 100)


def mounted(log: SensorLog, mount: tuple[float, float, float]) -> SensorLog:
    """Return a log whose transform says another mount, metres and degrees; its poses are those that fit the scans."""
    said = np.array([mount[0], mount[1], np.radians(mount[2])])
    wrong = compose(TRUE_MOUNT, invert(said))
    finder = replace(log.finder, mounts=compose(invert(wrong), log.finder.mounts))
    return replace(log, finder=finder, poses=compose(log.poses, wrong))


@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (0.3, 0.1, 105.0), (0.6, -0.3, 15.0), (0.3, 0.1, -130.0)])
def test_a_wrong_mount_is_measured(tour: SensorLog, mount: tuple[float, float, float]):
    log = mounted(tour, mount)
    found = mount_of_fit(log, log.poses)
    assert found is not None
    wrong = compose(TRUE_MOUNT, invert([mount[0], mount[1], np.radians(mount[2])]))
    assert [found.values[name] for name in ("ahead_m", "left_m")] == pytest.approx(wrong[:2], abs=0.02)
    assert found.values["turn_rad"] == pytest.approx(wrong[2], abs=0.01)


def test_the_finding_says_where_the_laser_is(tour: SensorLog):
    log = mounted(tour, (0.0, 0.0, 0.0))
    found = mount_of_fit(log, log.poses)
    assert found is not None
    assert found.text == (
        "Scans and odometry agree if the laser sits at (0.30 m, 0.10 m) on the robot, not at (0.00 m, 0.00 m), and is "
        "turned by 15.0 degrees to the left of what its mount says."
    )


def test_a_laser_turned_where_it_sits_is_said_to_be_turned_only(tour: SensorLog):
    log = mounted(tour, (0.3, 0.1, -165.0))
    found = mount_of_fit(log, log.poses)
    assert found is not None
    assert re.match("Scans and odometry agree if the laser is turned by 1(79|80)[.]. degrees to the ", found.text)


@pytest.mark.parametrize("mount", [(0.3, 0.1, 15.0), (0.32, 0.08, 13.0), (-0.3, -0.1, -165.0)])
def test_a_right_mount_a_small_error_and_one_like_reversed_odometry_are_not_named(
    tour: SensorLog, mount: tuple[float, float, float]
):
    log = mounted(tour, mount)
    assert mount_of_fit(log, log.poses) is None


def test_to_the_side_a_smaller_error_is_named_than_ahead_where_late_stamps_look_alike(tour: SensorLog):
    beside, ahead = mounted(tour, (0.3, -0.05, 15.0)), mounted(tour, (0.15, 0.1, 15.0))
    found = mount_of_fit(beside, beside.poses)
    assert found is not None
    assert found.values["left_m"] == pytest.approx(0.15, abs=0.02)
    assert mount_of_fit(ahead, ahead.poses) is None


@pytest.mark.parametrize("drift", [-0.13, 0.13])
def test_odometry_that_drifts_does_not_turn_the_laser(tour: SensorLog, drift: float):
    # Radians per metre: wheels that differ by 2%, 0.16 m apart.
    steps = between(tour.odometry[:-1], tour.odometry[1:])
    steps[:, 2] += drift * np.hypot(steps[:, 0], steps[:, 1])
    drifting = replace(tour, odometry=chained(tour.odometry[0], steps))
    assert mount_of_fit(drifting, tour.poses) is None
    log = mounted(drifting, (0.3, 0.1, 11.0))
    found = mount_of_fit(log, log.poses)
    assert found is not None
    assert found.values["turn_rad"] == pytest.approx(np.radians(4.0), abs=0.01)


def test_a_scanner_stamped_late_is_not_taken_for_one_mounted_elsewhere(tour: SensorLog):
    odometry = interpolate_poses(tour.stamps, tour.odometry, (tour.stamps + 0.15).clip(max=tour.stamps[-1]))
    assert mount_of_fit(replace(tour, odometry=odometry), tour.poses) is None


@pytest.mark.parametrize(("mount", "degrees"), [((0.3, 0.1, 105.0), 90.0), ((0.0, -0.1, -165.0), 180.0)])
def test_aligned_scans_tell_a_mount_without_poses(tour: SensorLog, mount: tuple[float, float, float], degrees: float):
    found = mount_of_scans(mounted(tour, mount))
    assert found is not None
    assert abs(np.degrees(found.values["turn_rad"])) == pytest.approx(degrees, abs=1.2)
    assert ("or the direction of the odometry" in found.do) == (degrees == 180.0)


def test_aligned_scans_name_no_right_mount_and_no_small_error(tour: SensorLog):
    assert mount_of_scans(tour) is None
    assert mount_of_scans(mounted(tour, (0.3, 0.1, 10.0))) is None  # so little hides no trajectory


def test_mirrored_scans_are_not_taken_for_a_turned_laser(tour: SensorLog):
    mirrored = replace(tour.finder, mounts=tour.finder.mounts * [1.0, 1.0, -1.0])
    assert mount_of_scans(replace(tour, finder=mirrored)) is None


def test_too_short_a_drive_says_nothing(tour: SensorLog):
    log = mounted(tour, (0.0, 0.0, 0.0)).select(np.arange(40))
    assert mount_of_fit(log, log.poses) is None
    assert mount_of_scans(log.select(np.arange(10))) is None


@pytest.mark.parametrize(
    ("mount", "expected"),
    [((0.0, 0.0, 0.0), "laser-mount"), ((0.0, -0.1, -165.0), "laser-mount"), ((-0.15, -0.05, -165.0), "odometry-sign")],
)
def test_a_trajectory_names_the_mount_or_the_sign_alone(
    tour: SensorLog, office: OccupancyGrid, mount: tuple[float, float, float], expected: str
):
    log = mounted(tour, mount)
    fit = fit_trajectory(log, office, start=log.poses[0])
    assert [one.name for one in fit.findings if one.name not in OF_THE_POSES] == [expected]


def test_a_turned_laser_is_not_taken_for_distances_that_are_off(tour: SensorLog, office: OccupancyGrid):
    # At a heading 20 degrees off the robot seems to go ahead by 94% of the way.
    log = mounted(tour, (0.3, 0.1, 35.0))
    fit = fit_trajectory(log, office, start=log.poses[0])
    assert [one.name for one in fit.findings if one.name not in OF_THE_POSES] == ["laser-mount"]
    right = fit_trajectory(tour, office, start=tour.poses[0])
    assert fit.distance_scale == pytest.approx(right.distance_scale, abs=0.015)


def test_where_no_trajectory_is_found_the_error_names_the_mount(
    tour: SensorLog, office: OccupancyGrid, monkeypatch: pytest.MonkeyPatch
):
    log = mounted(tour, (0.3, 0.1, 105.0))
    not_found = Mock(side_effect=TrajectoryNotFoundError("no trajectory fits"))
    monkeypatch.setattr("beamfield.localization.trajectory.choose_course", not_found)
    with pytest.raises(
        TrajectoryNotFoundError,
        match=r"no trajectory fits\..* turned by (89|90)\.\d degrees to the right of what its mount",
    ):
        fit_trajectory(log, office, start=log.poses[0])
