"""Trajectories fitted to simulated logs, whose truth is known, and to logs with something wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import InvalidInputError, TooLittleDataError, TrajectoryNotFoundError
from beamfield.geometry import between, compose, wrap_angle
from beamfield.localization.trajectory import TrajectoryFit, fit_trajectory
from beamfield.localization.trajectory_options import TrajectoryOptions
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog


def distances(fit: TrajectoryFit, log: SensorLog) -> np.ndarray:
    return np.hypot(*(fit.poses - log.poses)[:, :2].T)


def names(fit: TrajectoryFit) -> set[str]:
    return {finding.name for finding in fit.findings}


@pytest.fixture(scope="module")
def fit(drive: SensorLog, office: OccupancyGrid) -> TrajectoryFit:
    return fit_trajectory(drive, office)


def test_a_drive_with_drifting_odometry_is_found_without_a_start(fit: TrajectoryFit, drive: SensorLog):
    assert np.hypot(*(compose(drive.poses[0], drive.odometry) - drive.poses)[-1, :2]) > 0.3
    assert distances(fit, drive).mean() < 0.02
    assert distances(fit, drive).max() < 0.08
    assert np.abs(wrap_angle(fit.poses - drive.poses)[:, 2]).max() < np.radians(1.5)
    assert fit.trusted.all()
    assert fit.converged
    assert np.isfinite(fit.covariances).all()


def test_reference_poses_of_the_log_are_not_used(drive: SensorLog, office: OccupancyGrid, fit: TrajectoryFit):
    blind = fit_trajectory(drive.with_poses(np.full((len(drive), 3), np.nan)), office)
    np.testing.assert_array_equal(blind.poses, fit.poses)


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


@pytest.mark.parametrize(("signs", "said"), [((1, -1, -1), "turns"), ((-1, -1, 1), "direction")])
def test_odometry_of_the_wrong_sign_is_put_right_and_said(
    drive: SensorLog, office: OccupancyGrid, signs: tuple[int, int, int], said: str
):
    log = drive.select(np.arange(120))
    poses = [np.zeros(3)]
    for step in between(log.odometry[:-1], log.odometry[1:]):
        poses.append(compose(poses[-1], step * signs))
    fit = fit_trajectory(replace(log, odometry=np.array(poses)), office)
    (finding,) = [one for one in fit.findings if one.name == "odometry-sign"]
    assert said in finding.text
    assert distances(fit, log).max() < 0.1


def test_a_log_of_another_building_is_refused_with_the_best_starts(drive: SensorLog):
    rng = np.random.default_rng(4)
    cells = np.zeros((300, 300))
    cells[[0, -1]] = cells[:, [0, -1]] = 100
    for x, y in rng.integers(0, 290, (120, 2)):
        cells[y : y + 4, x : x + 4] = 100
    with pytest.raises(TrajectoryNotFoundError, match=r"another building.*best starts: \(.* m, .* m, .* deg\)"):
        fit_trajectory(drive.select(np.arange(80)), OccupancyGrid.from_ros(cells, 0.05))


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
    with pytest.raises(TooLittleDataError, match="2 scans"):
        fit_trajectory(some.select([0, 1]), office)
    with pytest.raises(TooLittleDataError, match="readings"):
        fit_trajectory(replace(some, ranges=np.full_like(some.ranges, np.inf)), office)
    with pytest.raises(InvalidInputError, match="max_deviation"):
        TrajectoryOptions(max_deviation=0.0)
