"""Readings of people and other things that move, told by the scans alone: others of the drive see through them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beamfield.finding import Finding
from beamfield.geometry import FloatArray, chained, compose
from beamfield.kernels.jit import integer
from beamfield.kernels.seen_through import mark_seen_through
from beamfield.localization.drive import Drive
from beamfield.sensors import SensorLog, usable_ranges

# Each scan is compared with so many before and after it, up to so much motion away, metres and radians: so far odometry
# holds. So many beams of each tell enough.
REACH, WAY, TURN = 15, 2.0, 0.6
BEAMS = 180
# Ranges are the same up to this, metres and share.
TOLERANCE, TOLERANCE_SHARE = 0.25, 0.03
# Metres between two beams that do not miss what is between them.
WIDTH = 0.3
# What moves hides what others see, or do not: without the first that are found, more are.
TIMES = 2
# From this share on they are left out of a fit; of six real logs without a crowd at most 0.07 seem to move.
MANY = 0.15


def without_moving_objects(log: SensorLog, drive: Drive) -> SensorLog:
    """Return the log without the readings of what moves, NaN, in the scans of the drive that are held to the map.

    A reading is one if of the scans shortly before and after that look there more see through its end point than see
    something there, by the odometry. Readings without return do not count: dark and shiny things give none.
    """
    return _without(log, drive, moving_readings(log, drive, chained(np.zeros(3), drive.steps)[drive.scans]))


def without_crowd(log: SensorLog, drive: Drive, poses: FloatArray) -> tuple[SensorLog, list[Finding]]:
    """Do so by poses (n, 3) of the scans that are held to the map, if many of their readings are of what moves.

    Also return what to say about it. The few that are wrongly left out where nothing moves are missed in a fit.
    """
    marks = moving_readings(log, drive, poses)
    share = float(
        marks.sum()
        / max(np.count_nonzero(usable_ranges(log.ranges[drive.scans], log.finder) < log.finder.max_range), 1)
    )
    if share < MANY:
        return log, []
    return _without(log, drive, marks), [Finding(
        "moving-objects", "info",
        f"{share:.0%} of the readings are of what moves, such as people: other scans see through where they end. The "
        "poses were fitted without them.",
        {"share": share},
    )]  # fmt: skip


def moving_readings(log: SensorLog, drive: Drive, poses: FloatArray) -> NDArray[np.bool_]:
    """Return which readings of the scans that are held to the map, at poses (n, 3), are of what moves, (n, k)."""
    finder = log.finder
    ranges = usable_ranges(log.ranges[drive.scans], finder)
    marks = np.zeros(ranges.shape, np.bool_)
    if finder.opening_angle > 0.0:
        return marks
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*drive.steps[:, :2].T))])[drive.scans]
    turn = np.concatenate([[0.0], np.cumsum(drive.steps[:, 2])])[drive.scans]
    step = -(-finder.n_beams // BEAMS)
    origins, which = np.unique(finder.mounts[:, :2].round(3), axis=0, return_inverse=True)
    for _ in range(TIMES):
        for number, origin in enumerate(origins):
            beams = np.flatnonzero(which.ravel() == number)
            beams = beams[np.argsort(finder.mounts[beams, 2], kind="stable")]
            bearings = finder.mounts[beams, 2]
            if bearings[0] + 2.0 * np.pi > bearings[-1]:
                bearings, beams = np.append(bearings, bearings[0] + 2.0 * np.pi), np.append(beams, beams[0])
            lasers = compose(poses, np.array([*origin, 0.0]))
            mark_seen_through(ranges, finder.max_range, bearings, beams, lasers, way, turn, integer(REACH), WAY, TURN,
                              integer(step), TOLERANCE, TOLERANCE_SHARE, WIDTH, marks)  # fmt: skip
        ranges[marks] = np.nan
    return marks


def _without(log: SensorLog, drive: Drive, marks: NDArray[np.bool_]) -> SensorLog:
    ranges = log.ranges.copy()
    ranges[drive.scans] = np.where(marks, np.nan, ranges[drive.scans])
    return replace(log, ranges=ranges)
