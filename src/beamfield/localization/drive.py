"""A log prepared for fitting a trajectory: odometry as steps, and end points of the scans that are held to the map."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, between, chained, compose, interpolate_poses
from beamfield.maps.end_points import end_points
from beamfield.models.motion import odometry_jumps
from beamfield.sensors import SensorLog

# Scans are held to the map after so much motion (metres, radians) or so many seconds at rest: what lies between them
# sees the same walls with the same errors.
SPACING, SPACING_TURN, SPACING_TIME = 0.1, 0.1, 2.0
# Where odometry ends while the robot moves, it goes on as in the last SPEED_TIME for CONTINUED, seconds.
SPEED_TIME, CONTINUED = 0.5, 2.0
MOST_SCANS = 5000
# End points of each.
BEAMS = 60


@dataclass(frozen=True, eq=False)
class Drive:
    """What a log says, as the smoother takes it.

    Parameters
    ----------
    stamps
        (t,) seconds.
    steps
        (t - 1, 3) odometry from each scan to the next, in the frame of the first of them.
    broken
        (t - 1,) steps that no robot makes; they are 0.
    scans
        (n,) indices of the scans that are held to the map.
    points, first
        End points (m, 4) of these, x, y and cos and sin of the beam, in the robot's frame; those of the i-th are
        points[first[i]:first[i + 1]].
    unknown
        (t,) scans whose odometry was interpolated.
    """

    stamps: FloatArray
    steps: FloatArray
    broken: NDArray[np.bool_]
    scans: NDArray[np.int64]
    points: FloatArray
    first: NDArray[np.int64]
    unknown: NDArray[np.bool_]

    @property
    def steps_between_scans(self) -> FloatArray:
        """(n - 1, 3) odometry from each scan that is held to the map to the next."""
        path = chained(np.zeros(3), self.steps)
        return between(path[self.scans[:-1]], path[self.scans[1:]])

    @property
    def way(self) -> FloatArray:
        """(t,) metres driven until each scan, a radian turned counting as a tenth of a metre."""
        length = np.hypot(self.steps[:, 0], self.steps[:, 1]) + 0.1 * np.abs(self.steps[:, 2])
        return np.concatenate([[0.0], np.cumsum(length)])


def prepare(log: SensorLog, odometry: FloatArray) -> Drive:
    """Prepare a log of at least one scan, with odometry (t, 3) that is finite somewhere."""
    known = np.isfinite(odometry).all(axis=1)
    # Time goes on where a recorder drops scans; where it runs backwards, the order of the log counts.
    when = np.maximum.accumulate(log.stamps)
    filled = _continued(when[known], odometry[known], when)
    filled[known] = odometry[known]
    steps = between(filled[:-1], filled[1:])
    broken = odometry_jumps(steps, np.maximum(np.diff(log.stamps), 0.0))
    steps[broken] = 0.0
    scans = _spread(steps, log.stamps)
    points, first = _points(log, scans)
    return Drive(log.stamps, steps, broken, scans, points, first, np.asarray(~known))


def _continued(stamps: FloatArray, poses: FloatArray, when: FloatArray) -> FloatArray:
    """Return poses (n, 3) at any times: between known ones, and beyond them as the robot moved there, for a while."""
    first, last = stamps[0], stamps[-1]
    filled = interpolate_poses(stamps, poses, np.clip(when, first, last))
    for end, inwards in ((first, min(first + SPEED_TIME, last)), (last, max(last - SPEED_TIME, first))):
        earlier, at_end = interpolate_poses(stamps, poses, [inwards, end])
        seconds, step = abs(end - inwards), between(earlier, at_end)
        beyond = when < first if end == first else when > last
        if not beyond.any() or seconds == 0.0 or odometry_jumps(step[None, :], np.array([seconds]))[0]:
            continue
        share = np.minimum(np.abs(when[beyond] - end), CONTINUED) / seconds
        # The chord of an arc has half its turn, and the sine of that is in its length.
        half, none = 0.5 * step[2], np.zeros(len(share))
        length = share * np.sinc(share * half / np.pi) / np.sinc(half / np.pi)
        chords = compose(np.column_stack([none, none, (share - 1.0) * half]), np.outer(length, [*step[:2], 0.0]))
        filled[beyond] = compose(at_end, np.column_stack([chords[:, :2], share * step[2]]))
    return filled


def with_points(drive: Drive, log: SensorLog) -> Drive:
    """Return the drive with the end points of some of its log's beams."""
    points, first = _points(log, drive.scans)
    return replace(drive, points=points, first=first)


def without_points(drive: Drive, blind: NDArray[np.bool_]) -> Drive:
    """Return the drive without the end points of some of its scans (n,)."""
    counts = np.diff(drive.first)
    first = np.concatenate([[0], np.cumsum(np.where(blind, 0, counts))])
    return replace(drive, points=drive.points[np.repeat(~blind, counts)], first=first)


def mirrored(drive: Drive) -> list[tuple[str, Drive]]:
    """Return the log with odometry in the senses that it may have been meant in, and what was changed."""
    return [
        (name, replace(drive, steps=drive.steps * np.array(signs)))
        for name, signs in (
            ("with its turns reversed", (1.0, -1.0, -1.0)),
            ("with its direction reversed", (-1.0, -1.0, 1.0)),
            ("with its turns and its direction reversed", (-1.0, 1.0, -1.0)),
        )
    ]


def _spread(steps: FloatArray, stamps: FloatArray) -> NDArray[np.int64]:
    """Return scans that motion, or time, sets apart."""
    progress = np.concatenate(
        [[0.0], np.cumsum(np.hypot(steps[:, 0], steps[:, 1]) / SPACING + np.abs(steps[:, 2]) / SPACING_TURN
                          + np.maximum(np.diff(stamps), 0.0) / SPACING_TIME)]
    )  # fmt: skip
    each = max(1.0, progress[-1] / MOST_SCANS)
    return np.unique(np.searchsorted(progress, np.arange(0.0, progress[-1] + each, each)).clip(max=len(stamps) - 1))


def _points(log: SensorLog, scans: NDArray[np.int64]) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return up to BEAMS end points of each scan, spread evenly over its hits."""
    kept, theta = [], log.finder.mounts[:, 2]
    directions = np.column_stack([np.cos(theta), np.sin(theta)])
    for scan in scans:
        ends = np.hstack([end_points(log.ranges[scan], log.finder), directions])
        ends = ends[np.isfinite(ends[:, 0])]
        if len(ends) > BEAMS:
            ends = ends[np.linspace(0, len(ends) - 1, BEAMS).round().astype(np.int64)]
        kept.append(ends)
    first = np.concatenate([[0], np.cumsum([len(ends) for ends in kept])])
    return np.ascontiguousarray(np.concatenate(kept)), first
