"""When a robot counts as found, and what a kidnapped log is."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import TooLittleDataError
from beamfield.geometry import between
from beamfield.localization.found import kidnapped, time_to_find
from beamfield.localization.replay import Replay
from beamfield.sensors import RangeFinder, SensorLog

N = 30


@pytest.fixture
def log() -> SensorLog:
    poses = np.column_stack([0.2 * np.arange(N), np.zeros(N), 0.05 * np.arange(N)])
    return SensorLog(RangeFinder.from_bearings([0.0], 5.0), 2.0 * np.arange(N), np.ones((N, 1)), poses, poses)


def replay(log: SensorLog, off: np.ndarray) -> Replay:
    poses = log.poses + np.column_stack([off, np.zeros((len(log), 2))])
    return Replay(poses, np.array([0]), np.zeros((1, 3)), np.zeros((1, 3, 3)), np.array([1]))


def test_found_from_the_first_scan_on_after_which_nearly_all_are_close(log):
    off = np.where(np.arange(N) < 12, 3.0, 0.1)
    assert time_to_find(replay(log, off), log) == 24.0
    off[20] = 3.0  # more than 5% of those that follow
    assert time_to_find(replay(log, off), log) == 42.0
    assert time_to_find(replay(log, off), log, 15) == 12.0


def test_not_found_far_off_or_too_late(log):
    assert time_to_find(replay(log, np.full(N, 3.0)), log) is None
    assert time_to_find(replay(log, np.where(np.arange(N) < 27, 3.0, 0.1)), log) is None
    silent = replay(log, np.where(np.arange(N) < 3, np.nan, 0.0))
    assert time_to_find(silent, log) == 6.0
    with pytest.raises(TooLittleDataError, match="number 5"):
        time_to_find(silent, log.with_poses(np.full((N, 3), np.nan)), 5)


def test_a_kidnapped_robot_is_elsewhere_without_a_step_of_odometry(log):
    cut, first = kidnapped(log)
    assert (len(cut), first) == (20, 10)
    np.testing.assert_array_equal(cut.poses, log.poses[np.r_[:10, 20:30]])
    np.testing.assert_allclose(cut.odometry[10], cut.odometry[9])
    np.testing.assert_allclose(
        between(cut.odometry[10:-1], cut.odometry[11:]), between(log.odometry[20:-1], log.odometry[21:]), atol=1e-12
    )
    assert (np.diff(cut.stamps) >= 0.0).all()
    with pytest.raises(TooLittleDataError, match="3 scans"):
        kidnapped(log.select([0, 1, 2]))
