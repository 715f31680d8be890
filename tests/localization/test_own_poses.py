"""Where poses of a log leave the fitted ones."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from beamfield.localization.own_poses import compare_own_poses
from beamfield.sensors import RangeFinder, SensorLog

STAMPS = 100.0 + 0.5 * np.arange(10)
POSES = np.column_stack([np.arange(10.0), np.full(10, 2.0), np.full(10, 3.1)])


def compared(shift: np.ndarray, trusted: np.ndarray | None = None):
    """Compare poses that are shifted so, (10, 3), with fitted ones."""
    finder = RangeFinder.from_bearings([0.0], 8.0)
    log = SensorLog(finder, STAMPS, np.ones((10, 1)), POSES + shift, POSES)
    fit = SimpleNamespace(poses=POSES, trusted=np.ones(10, bool) if trusted is None else trusted)
    return compare_own_poses(log, fit)


def test_poses_that_are_near_agree():
    shift = np.zeros((10, 3))
    # Headings on both sides of pi are near each other.
    shift[:, 0], shift[4, 1], shift[:, 2] = 0.1, 0.4, 0.3
    found = compared(shift)
    assert (found.name, found.severity) == ("own-poses-agree", "info")
    assert found.values["largest_m"] == pytest.approx(np.hypot(0.1, 0.4))
    assert "0.10 m (median)" in found.text


def test_poses_that_are_lost_are_named_from_when_and_where_on():
    shift = np.zeros((10, 3))
    shift[6:, 1] = [0.6, 2.0, 4.0, 3.0]
    found = compared(shift)
    assert (found.name, found.severity) == ("own-poses-lost", "warning")
    assert "3.0 s after the first scan, with the robot at (6.00 m, 2.00 m)" in found.text
    assert "in 40% of the scans, up to 4.00 m, and 3.00 m at the end" in found.text
    assert (found.values["first_s"], found.values["share_lost"]) == (3.0, pytest.approx(0.4))


def test_a_heading_is_lost_too():
    shift = np.zeros((10, 3))
    shift[2, 2] = np.radians(21.0)
    assert compared(shift).name == "own-poses-lost"


def test_only_scans_with_both_poses_count():
    shift, trusted = np.zeros((10, 3)), np.ones(10, bool)
    shift[0, 0], shift[1], trusted[0] = 9.0, np.nan, False
    assert compared(shift, trusted).name == "own-poses-agree"
    assert compared(np.full((10, 3), np.nan)) is None


def test_poses_that_are_wrong_from_the_first_one_on_tell_of_the_initial_pose():
    shift = np.zeros((10, 3))
    shift[0], shift[1:, 0], shift[1:, 2] = np.nan, 1.0, np.pi
    found = compared(shift)
    assert found.name == "own-poses-lost"
    assert "wrong from their first one on, 0.5 s after the first scan, by 1.00 m and 180 degrees" in found.text
    assert "initial pose" in found.why
    assert "in 100% of the scans, up to 1.00 m" in found.text


def test_a_rough_initial_pose_is_not_blamed():
    shift = np.zeros((10, 3))
    shift[:, 0], shift[:, 2] = 0.6, np.radians(25.0)
    found = compared(shift)
    assert "wrong from their first one on, 0.0 s after the first scan, by" in found.text
    assert "initial pose" not in found.why
