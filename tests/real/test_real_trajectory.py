"""Trajectories of real logs, without a start, against references fitted to the same maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beamfield.io.read_map import read_map
from beamfield.localization.trajectory import fit_trajectory
from beamfield.sensors import SensorLog
from tests.real.posed_logs import turtlebot_log, wean_log

pytestmark = pytest.mark.real


def distances(log: SensorLog, grid: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return how far the fit is from the good poses of the reference, and which scans are trusted."""
    fit = fit_trajectory(log, read_map(grid))
    far = np.hypot(*(fit.poses - log.poses)[:, :2].T)
    return far[np.isfinite(far)], fit.trusted


def test_wean_hall_is_found_within_what_the_reference_is_good_to(data: Path):
    far, trusted = distances(wean_log(data, 5), data / "wean_hall/derived_wean.yaml")
    assert np.quantile(far, 0.95) < 0.2
    assert far.mean() < 0.08
    assert trusted.mean() > 0.95


def test_the_turtlebot_is_found(data: Path):
    far, trusted = distances(turtlebot_log(data), data / "olin_mac_tb4/map/mac_1st_floor_final.yaml")
    assert np.median(far) < 0.03
    assert far.max() < 0.2
    assert trusted.all()
