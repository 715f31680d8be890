"""Intervals that hold the error of the poses."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest

import beamfield as bf
from beamfield.calibration.intrinsic.block_intervals import IntervalResult
from beamfield.calibration.pose_error import with_error_again, with_pose_error
from beamfield.errors import InvalidInputError

TRUTH = bf.BeamParameters(0.82, 0.09, 0.03, 0.06, sigma_hit=0.03, lambda_short=0.5)
OPTIONS = bf.CalibrationOptions(refine=False, range_offset="off", sigma_slope="off")
# Of the poses, along x, y and the heading.
DEVIATIONS = np.array([0.01, 0.01, np.radians(0.25)])


@pytest.fixture(scope="module")
def grid() -> bf.OccupancyGrid:
    return bf.draw_floor_plan(seed=3)


@pytest.fixture(scope="module")
def exact(grid: bf.OccupancyGrid) -> bf.SensorLog:
    laser = bf.RangeFinder.from_bearings(np.radians(np.linspace(-135, 135, 60)), max_range=12.0)
    return bf.simulate_log(grid, laser, TRUTH, duration=60.0, scan_rate=5.0, seed=3).only_sensor()


@pytest.fixture(scope="module")
def log(exact: bf.SensorLog) -> bf.SensorLog:
    errors = DEVIATIONS * np.random.default_rng(1).standard_normal((len(exact), 3))
    return exact.with_poses(exact.poses + errors)


def test_intervals_hold_what_exact_poses_teach_only_with_the_error_of_the_poses(
    exact: bf.SensorLog, log: bf.SensorLog, grid: bf.OccupancyGrid
):
    at_exact = bf.calibrate(exact, grid, OPTIONS)
    covariances = np.broadcast_to(np.diag(DEVIATIONS**2), (len(log), 3, 3))
    as_if_exact = bf.calibrate(log, grid, OPTIONS)
    result = bf.calibrate(log, grid, OPTIONS, covariances=covariances)
    assert result.parameters == as_if_exact.parameters
    for name in ("z_hit", "z_rand", "sigma_hit"):
        value, error = getattr(at_exact.parameters, name), at_exact.intervals.standard_errors[name]
        (low, high), (lowest, highest) = (r.intervals.intervals[name] for r in (as_if_exact, result))
        assert not low <= value + error or not value - error <= high
        assert lowest <= value + error
        assert value - error <= highest


def test_poses_without_error_leave_intervals_as_they_are(log: bf.SensorLog, grid: bf.OccupancyGrid):
    stages: list[str] = []
    none = np.zeros((len(log), 3, 3))
    same = bf.calibrate(log, grid, OPTIONS, covariances=none, progress=lambda stage, *_: stages.append(stage))
    assert same.intervals.intervals == bf.calibrate(log, grid, OPTIONS).intervals.intervals
    assert len(list(groupby(stages))) == len(set(stages))  # no stage comes again


def test_the_second_error_has_the_covariance_of_the_first(log: bf.SensorLog):
    axes = np.array([[0.8, -0.6, 0.0], [0.6, 0.8, 0.0], [0.0, 0.0, 1.0]])
    covariance = axes @ np.diag([0.3, 0.02, 0.01]) ** 2 @ axes.T
    lone = replace(log, poses=np.where(np.arange(len(log))[:, None] == 5, np.nan, log.poses))
    covariances = np.broadcast_to(covariance, (len(log), 3, 3)).copy()
    covariances[5] = np.nan
    drawn = [with_error_again(lone, covariances, seed).poses - lone.poses for seed in range(20)]
    assert all(np.isnan(one[5]).all() for one in drawn)
    errors = np.concatenate(drawn)
    np.testing.assert_allclose(np.cov(errors[np.isfinite(errors[:, 0])].T), covariance, atol=0.03 * 0.3**2)


@pytest.mark.parametrize("name", ["sigma_hit", "sigma_slope"])
def test_an_error_that_adds_its_variance_to_a_deviation_is_taken_out_whole(name):
    truth, error = 0.01, 0.02
    fit, again = (replace(TRUTH, **{name: np.hypot(truth, np.sqrt(n) * error)}) for n in (1, 2))
    ends = 0.99 * getattr(fit, name), getattr(fit, name)
    result = with_pose_error(IntervalResult({name: ends}, {name: 0.001}, 0.95, 10, ()), fit, again)
    low, high = result.intervals[name]
    assert low == pytest.approx(np.sqrt(ends[0] ** 2 - error**2))
    assert low < truth < high


def test_widened_intervals_stay_where_parameters_can_be():
    found = {"z_hit": (0.9, 0.99), "sigma_hit": (0.01, 0.02), "range_offset": (-0.01, 0.01)}
    found["lambda_short"] = 0.0, np.inf
    intervals = IntervalResult(found, dict.fromkeys(found, 0.01), 0.95, 10, ())
    fit = bf.BeamParameters(0.95, 0.02, 0.01, 0.02, sigma_hit=0.015, lambda_short=0.5, range_offset=0.0)
    again = replace(fit, z_hit=0.92, z_rand=0.05, sigma_hit=0.03, range_offset=0.02)
    wide = with_pose_error(intervals, fit, again).intervals
    assert wide["z_hit"] == (0.9, 1.0)
    assert wide["sigma_hit"] == (0.0, 0.02)
    assert wide["range_offset"] == (-0.03, 0.01)
    assert wide["lambda_short"] == (0, np.inf)


@pytest.mark.parametrize(
    ("covariances", "message"),
    [
        (np.zeros((3, 3)), r"covariances: expected shape \(\d+, 3, 3\), got \(3, 3\)"),
        (np.nan, "covariances: expected finite numbers wherever there is a pose"),
        (-1.0, "covariances: expected positive semi-definite matrices"),
    ],
)
def test_wrong_covariances_are_refused(log: bf.SensorLog, grid: bf.OccupancyGrid, covariances: object, message: str):
    values = covariances * np.ones((len(log), 1, 1)) * np.eye(3) if isinstance(covariances, float) else covariances
    with pytest.raises(InvalidInputError, match=message):
        bf.calibrate(log, grid, OPTIONS, covariances=values)
