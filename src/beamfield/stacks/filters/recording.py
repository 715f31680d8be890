"""Collects what a filter says while a log runs."""

from __future__ import annotations

import time

import numpy as np

from beamfield.geometry import FloatArray, compose, invert
from beamfield.localization.replay import Replay
from beamfield.sensors import SensorLog
from beamfield.stacks.filters.particles import particle_moments


class Recording:
    """A replay while it grows.

    Parameters
    ----------
    log
        The log that runs.
    """

    def __init__(self, log: SensorLog) -> None:
        self._odometry = log.odometry
        self._rows: list[tuple[int, FloatArray, FloatArray, int, float]] = []
        self._answers: list[tuple[int, FloatArray]] = []
        self._started = 0.0

    def start_update(self) -> None:
        """Take the time from here on."""
        self._started = time.thread_time()

    def updated(self, scan: int, poses: FloatArray, weights: FloatArray) -> None:
        """Note what the particles (n, 3) are after a scan, with weights (n,) that sum to 1."""
        seconds = time.thread_time() - self._started
        self._rows.append((scan, *particle_moments(poses, weights), len(poses), seconds))

    def published(self, scan: int, pose: FloatArray) -> None:
        """Note an answer, which odometry continues until the next one."""
        self._answers.append((scan, pose))

    def replay(self) -> Replay:
        """Return the whole."""
        scans, answers = (np.array(column) for column in zip(*self._answers, strict=True))
        # All at once: one by one takes a sixth of a replay's time.
        map_from_odom = compose(answers, invert(self._odometry[scans]))
        poses = np.full(self._odometry.shape, np.nan)
        held = np.repeat(map_from_odom, np.diff(scans, append=len(poses)), axis=0)
        poses[scans[0] :] = compose(held, self._odometry[scans[0] :])
        return Replay(poses, *(np.array(column) for column in zip(*self._rows, strict=True)))
