"""Trajectories of real logs, without a start, against references fitted to the same maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.io.trajectory import attach_poses, read_trajectory
from beamfield.localization.trajectory import fit_trajectory

pytestmark = pytest.mark.real


def distances(log_path: Path, poses: Path, grid: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return how far the fit is from the good poses of the reference, and which scans are trusted."""
    log = attach_poses(read_log(log_path), read_trajectory(poses)).only_sensor()
    fit = fit_trajectory(log, read_map(grid))
    far = np.hypot(*(fit.poses - log.poses)[:, :2].T)
    return far[np.isfinite(far)], fit.trusted


def test_wean_hall_is_found_within_what_the_reference_is_good_to(data: Path):
    folder = data / "wean_hall"
    far, trusted = distances(
        folder / "robotdata5.log.gz", folder / "reference_robotdata5.csv.gz", folder / "derived_wean.yaml"
    )
    assert np.quantile(far, 0.95) < 0.2
    assert far.mean() < 0.08
    assert trusted.mean() > 0.95


def test_the_turtlebot_is_found(data: Path):
    folder = data / "olin_mac_tb4"
    grid = next((folder / "map").glob("*.yaml"))
    far, trusted = distances(folder / "macfirst_floor_take_2", folder / "derived_ref_take_2.csv.gz", grid)
    assert np.median(far) < 0.03
    assert far.max() < 0.2
    assert trusted.all()
