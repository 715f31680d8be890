"""Readings of people and other things that move, told by the scans alone: others of the drive see through them."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beamfield.finding import Finding
from beamfield.geometry import FloatArray, chained, compose
from beamfield.kernels.jit import integer
from beamfield.kernels.seen_through import mark_seen_through
from beamfield.localization.drive import Drive, prepare
from beamfield.sensors import SensorLog, usable_ranges

# Each scan is compared with so many before and after it, up to so much motion away, metres and radians: so far odometry
# holds. So many beams of each tell enough.
REACH, WAY, TURN = 15, 2.0, 0.6
BEAMS = 180
# Ranges are the same up to this, metres and share.
TOLERANCE, TOLERANCE_SHARE = 0.25, 0.03
# Metres between two beams that do not miss what is between them.
WIDTH = 0.3
# From this share on they are left out; of six real logs at most 0.07 seem to move, of offices with some people 0.11.
MANY = 0.12


def without_crowd(
    log: SensorLog, drive: Drive, poses: FloatArray | None = None
) -> tuple[SensorLog, tuple[Finding, ...]]:
    """Return the log without the readings of what moves, NaN, if these are many, and what to say of it.

    That is in the scans of the drive that are held to the map. A reading is one if of the scans shortly before and
    after that look there more see through its end point than see something there, by their poses (n, 3) or by odometry.
    Readings without return do not count: dark and shiny things give none. A few are always taken for such, and are
    missed where nothing moves.
    """
    if poses is None:
        poses = chained(np.zeros(3), drive.steps)[drive.scans]
    held = log[drive.scans]
    marks = _Neighbours(held, drive, drive.scans, poses).marked_before_and_after()
    said = _said(held, marks, "The poses were fitted without them.")
    return (_without(log, drive.scans, marks), said) if said else (log, ())


def without_crowd_so_far(log: SensorLog) -> tuple[SensorLog, tuple[Finding, ...]]:
    """Do so for all scans, by the odometry and the scans before each, for a filter."""
    drive = prepare(log, log.odometry)
    everything, held = np.arange(len(log)), drive.scans
    neighbours = _Neighbours(log, drive, everything, chained(np.zeros(3), drive.steps))
    marks = neighbours.marked(held, held, _before(held, held))
    said = _said(log[held], marks[held], "The filter did without them.")
    if not said:
        return log, ()
    marks |= neighbours.without(marks).marked(everything, held, _before(held, everything))
    return _without(log, everything, marks), said


class _Neighbours:
    """Scans of a drive (n,) at poses (n, 3) in a frame that holds over a short way."""

    def __init__(self, log: SensorLog, drive: Drive, scans: NDArray[np.int64], poses: FloatArray) -> None:
        self._finder, self._poses = log.finder, poses
        self._ranges = usable_ranges(log.ranges, log.finder)
        self._way = np.concatenate([[0.0], np.cumsum(np.hypot(*drive.steps[:, :2].T))])[scans]
        self._turn = np.concatenate([[0.0], np.cumsum(drive.steps[:, 2])])[scans]

    def marked_before_and_after(self) -> NDArray[np.bool_]:
        """Return which readings (n, k) are of what moves, by the scans before and after."""
        scans = np.arange(len(self._ranges))
        bounds = np.column_stack([scans - REACH, scans + REACH + 1]).clip(0, len(scans))
        marks = self.marked(scans, scans, bounds)
        return marks | self.without(marks).marked(scans, scans, bounds)

    def without(self, marks: NDArray[np.bool_]) -> _Neighbours:
        """Return the scans without some readings: what moves hides what others see, or do not."""
        left = copy(self)
        left._ranges = np.where(marks, np.nan, self._ranges)
        return left

    def marked(
        self, judged: NDArray[np.int64], others: NDArray[np.int64], bounds: NDArray[np.int64]
    ) -> NDArray[np.bool_]:
        """Return which readings (n, k) of the scans that are judged (q,) are of what moves, by others within bounds."""
        finder, marks = self._finder, np.zeros(self._ranges.shape, np.bool_)
        if finder.opening_angle > 0.0:
            return marks
        origins, which = np.unique(finder.mounts[:, :2].round(3), axis=0, return_inverse=True)
        for number, origin in enumerate(origins):
            beams = np.flatnonzero(which.ravel() == number)
            beams = beams[np.argsort(finder.mounts[beams, 2], kind="stable")]
            bearings = finder.mounts[beams, 2]
            if bearings[0] + 2.0 * np.pi > bearings[-1]:
                bearings, beams = np.append(bearings, bearings[0] + 2.0 * np.pi), np.append(beams, beams[0])
            lasers = compose(self._poses, np.array([*origin, 0.0]))
            mark_seen_through(self._ranges, finder.max_range, bearings, beams, lasers, self._way, self._turn, judged,
                              others, bounds, WAY, TURN, integer(-(-finder.n_beams // BEAMS)), TOLERANCE,
                              TOLERANCE_SHARE, WIDTH, marks)  # fmt: skip
        return marks


def _before(held: NDArray[np.int64], scans: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return from which to before which of the scans that are held each of some scans is compared: those before it."""
    end = np.searchsorted(held, scans)
    return np.column_stack([np.maximum(end - REACH, 0), end])


def _said(held: SensorLog, marks: NDArray[np.bool_], done: str) -> tuple[Finding, ...]:
    """Return what to say of scans in which some readings are marked (n, k): nothing if these are few."""
    share = float(
        marks.sum() / max(np.count_nonzero(usable_ranges(held.ranges, held.finder) < held.finder.max_range), 1)
    )
    if share < MANY:
        return ()
    text = f"{share:.0%} of the readings are of what moves, such as people: other scans see through where they end."
    return (Finding("moving-objects", "info", f"{text} {done}", {"share": share}),)


def _without(log: SensorLog, scans: NDArray[np.int64], marks: NDArray[np.bool_]) -> SensorLog:
    ranges = log.ranges.copy()
    ranges[scans] = np.where(marks, np.nan, ranges[scans])
    return replace(log, ranges=ranges)
