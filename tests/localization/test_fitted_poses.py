"""Poses fitted by one half of the beams, so that the other can be judged at them."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from beamfield.errors import TrajectoryNotFoundError
from beamfield.localization import fitted_poses
from beamfield.localization.fitted_poses import CrossFittedPoses, cross_fit_poses, fit_poses
from beamfield.localization.trajectory import TrajectoryFit
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import NO_POSE, SensorLog


@pytest.fixture(scope="module")
def lone(drive: SensorLog) -> SensorLog:
    """The first quarter of a minute of a drive, without its poses."""
    part = drive.select(np.arange(60))
    return part.with_poses(np.tile(NO_POSE, (len(part), 1)))


@pytest.fixture(scope="module")
def crossed(lone: SensorLog, drive: SensorLog, office: OccupancyGrid) -> CrossFittedPoses:
    return cross_fit_poses(lone, office, start=drive.poses[0])


def test_no_beam_is_judged_at_a_pose_that_it_made(lone: SensorLog, office: OccupancyGrid, monkeypatch):
    fits, searched = {}, []

    def made_up_once(log: SensorLog, *_, **__) -> TrajectoryFit:
        fits[log.ranges.tobytes()] = fit = made_up(log, np.ones(len(log), bool), heading=0.01 * len(fits))
        return fit

    turned = np.tile([0.0, 0.0, 1.0], (len(lone), 1))
    course = SimpleNamespace(odometry=turned)
    monkeypatch.setattr(fitted_poses, "find_course", lambda log, *_, **__: searched.append(log) or course)
    monkeypatch.setattr(fitted_poses, "fit_course", made_up_once)
    crossed = cross_fit_poses(lone, office)
    assert searched == [lone], "half of the beams may not tell where the log begins"
    even, odd = (np.ascontiguousarray(lone.ranges[:, first::2]) for first in (0, 1))
    assert set(fits) == {even.tobytes(), odd.tobytes()}
    for log, seen, made in ((crossed.judged, even, odd), (crossed.swapped, odd, even), (crossed.same, odd, odd)):
        np.testing.assert_array_equal(log.ranges, seen)
        np.testing.assert_array_equal(log.poses, fits[made.tobytes()].poses)
        np.testing.assert_array_equal(log.odometry, turned, "what was found wrong with the odometry is put right")
    np.testing.assert_array_equal(crossed.log.poses, crossed.judged.poses)


def test_the_poses_are_near_the_truth_and_the_stated_error_is_about_right(crossed: CrossFittedPoses, drive: SensorLog):
    errors = (crossed.log.poses - drive.poses[: len(crossed.log)])[:, :2]
    assert np.isfinite(errors).all()
    assert np.abs(errors).max() < 0.06
    rms = float(np.sqrt(np.mean(errors**2)))
    assert crossed.deviation / 2.0 < rms < 2.0 * crossed.deviation
    assert crossed.reference_error == max(crossed.deviation, 0.025)


def made_up(log: SensorLog, trusted: np.ndarray, *, heading: float = 0.0) -> TrajectoryFit:
    return TrajectoryFit(
        log.stamps, np.tile([0.0, 0.0, heading], (len(log), 1)), np.tile(1e-4 * np.eye(3), (len(log), 1, 1)), trusted,
        (), (), 0.05, 0.0, 0.0, 0.0, True,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("share", "name", "severity"),
    [(1.0, "poses-fitted", "info"), (0.8, "poses-fitted", "warning"), (0.4, "few-poses-trusted", "warning")],
)
def test_the_less_is_trusted_the_louder_it_is_said(
    lone: SensorLog, office: OccupancyGrid, monkeypatch, share: float, name: str, severity: str
):
    fit = made_up(lone, np.arange(len(lone)) < share * len(lone))
    monkeypatch.setattr(fitted_poses, "fit_trajectory", lambda *_, **__: fit)
    fitted = fit_poses(lone, office)
    first = fitted.findings("Measured.")[0]
    assert (first.name, first.severity) == (name, severity)
    assert first.values["share_trusted"] == pytest.approx(share)
    assert f"{fitted.n_trusted} of 60 scans are trusted" in first.text
    assert first.text.endswith("Measured.")
    assert np.isnan(fitted.log.poses[fitted.n_trusted :]).all()
    assert fitted.deviation == pytest.approx(0.01)


def test_where_no_pose_is_trusted_none_is_returned(lone: SensorLog, office: OccupancyGrid, monkeypatch):
    for name in ("fit_trajectory", "fit_course"):
        monkeypatch.setattr(fitted_poses, name, lambda log, *_, **__: made_up(log, np.zeros(len(log), bool)))
    monkeypatch.setattr(fitted_poses, "find_course", lambda log, *_, **__: SimpleNamespace(odometry=log.odometry))
    for fit in (fit_poses, cross_fit_poses):
        with pytest.raises(TrajectoryNotFoundError, match="no pose of the fitted trajectory can be trusted"):
            fit(lone, office)


def test_few_beams_are_not_halved(lone: SensorLog, office: OccupancyGrid, monkeypatch):
    monkeypatch.setattr(fitted_poses, "fit_trajectory", lambda log, *_, **__: made_up(log, np.ones(len(log), bool)))
    few = replace(lone, finder=lone.finder.subset(np.arange(20)), ranges=lone.ranges[:, :20])
    crossed = cross_fit_poses(few, office)
    assert crossed.judged is crossed.log
    assert crossed.swapped is None
