"""A laser that sits elsewhere on the robot than its transform says: the place at which scans move as odometry does."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.finding import Finding
from beamfield.geometry import FloatArray, Pose, after_step, between, compose, wrap_angle
from beamfield.localization.alignment import align
from beamfield.models.motion import odometry_jumps
from beamfield.sensors import SensorLog

# Motions that are compared: metres of way, a radian turned counting as a tenth of a metre. Alignments reach less far.
WAY, ALIGNED_WAY = 1.0, 0.15
# Beams of each scan that are aligned, pairs of scans at most, and their longest time in seconds.
BEAMS, MOST_PAIRS, LONGEST_STEP = 180, 200, 1.0
# Fewer motions say nothing. So many parts are left out in turn for the standard errors.
FEWEST, PARTS = 20, 10
# From here on a mount is named: radians, metres, and seconds times the usual speed along that axis, as stamps that are
# late by so much put the laser back by that; and standard errors. To the left it is off by 0.025 m at most on four real
# logs and eight simulated ones of very worn wheels.
LEAST_TURN, LEAST_OFFSET, UNNAMED_DELAY, SIGMAS = math.radians(3.0), 0.1, 0.15, 4.0
# Alignments are less exact, above all of scans that see little to the sides; a smaller error hides no trajectory.
ALIGNED_TURN, ALIGNED_OFFSET = math.radians(15.0), 0.3
# Beside a turn the position is named from here on, metres.
KNOWN = 0.05
# Share of the squared differences between scans and odometry that may be left, and of those in turning, where mirrored
# scans differ. Turned by 180 degrees about the robot's centre, a laser is as odometry whose direction is reversed.
LEFT, REVERSED = 0.5, math.radians(177.0)
ROUNDS = 10


class _Motions(NamedTuple):
    """(n, 3) motions from one scan to another, by the odometry and by the scans; the usual speed (2,) along x and y."""

    odometry: FloatArray
    scans: FloatArray
    speed: FloatArray


def mount_of_fit(log: SensorLog, fitted: FloatArray) -> Finding | None:
    """Compare the odometry with poses (t, 3) that were fitted to the map; return a finding if the mount is wrong.

    The finding, "laser-mount", is a warning that says where the laser seems to be. None if its mount is right, turned
    by 180 degrees about the robot's centre (which looks like odometry whose direction is reversed), or cannot be told
    from this log.

    Let E be the pose of the laser's true mount against the one assumed. Poses fitted to the scans are the robot's times
    E, so that a motion O of the robot appears as E^-1 O E. This is linear in four numbers, as plane rotations commute.
    """
    begin, end = _motions(log, WAY, np.inf)
    if len(begin) < FEWEST:
        return None
    motions = _compared(log, begin, end, between(fitted[begin], fitted[end]))
    return _finding(log, motions, LEAST_TURN, LEAST_OFFSET, or_reversed=False)


def mount_of_scans(log: SensorLog) -> Finding | None:
    """Do what `mount_of_fit` does without poses, for large errors: neighbouring scans are aligned, 8 ms each.

    A laser turned by 180 degrees is named, too: a trajectory with the odometry's direction reversed was looked for.
    """
    begin, end = _motions(log, ALIGNED_WAY, LONGEST_STEP)
    chosen = np.unique(np.linspace(0, len(begin) - 1, min(MOST_PAIRS, len(begin))).round().astype(np.int64))
    begin, end = begin[chosen], end[chosen]
    if len(begin) < FEWEST:
        return None
    steps = np.array([_step(log, int(a), int(b)) for a, b in zip(begin, end, strict=True)])
    good = np.isfinite(steps).all(axis=1)
    if good.sum() < FEWEST:
        return None
    motions = _compared(log, begin[good], end[good], steps[good])
    return _finding(log, motions, ALIGNED_TURN, ALIGNED_OFFSET, or_reversed=True)


def _motions(log: SensorLog, way: float, longest: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return first and last scans of motions of that way that follow each other, without jumps of the odometry."""
    steps = between(log.odometry[:-1], log.odometry[1:])
    bad = ~np.isfinite(steps).all(axis=1)
    bad |= odometry_jumps(steps, np.maximum(np.diff(log.stamps), 0.0))
    length = np.where(bad, 0.0, np.hypot(steps[:, 0], steps[:, 1]) + 0.1 * np.abs(steps[:, 2]))
    sums = np.concatenate([[0.0], np.cumsum(length)])
    places = np.unique(np.searchsorted(sums, np.arange(0.0, sums[-1], way)).clip(max=len(sums) - 1))
    begin, end = places[:-1], places[1:]
    broken = np.concatenate([[0], np.cumsum(bad)])
    good = (broken[begin] == broken[end]) & (log.stamps[end] - log.stamps[begin] <= longest)
    return begin[good], end[good]


def _step(log: SensorLog, i: int, j: int) -> FloatArray:
    """Return the pose of scan j in scan i; NaN if they cannot be aligned."""
    # The turn is the same wherever the laser sits.
    guess = np.array([0.0, 0.0, between(log.odometry[i], log.odometry[j])[2]])
    found = align(log.scan(j).every(BEAMS), log.scan(i).every(BEAMS), guess)
    return found.pose if not found.problem else np.full(3, np.nan)


def _compared(log: SensorLog, begin: NDArray[np.int64], end: NDArray[np.int64], scans: FloatArray) -> _Motions:
    driven = between(log.odometry[begin], log.odometry[end])
    seconds = np.maximum(log.stamps[end] - log.stamps[begin], 1e-9)
    return _Motions(driven, scans, np.median(np.abs(driven[:, :2]) / seconds[:, None], axis=0))


def _solve(motions: _Motions) -> tuple[Pose, float]:
    """Return E (see `mount_of_fit`), and the share of the differences between the motions that it leaves.

    Scans turn as the robot does, wherever the laser sits. Where odometry turns otherwise (drift, a wrong track width),
    its error is taken to grow evenly along the way, which turns the chord by half of it: not the laser.
    """
    turn = motions.scans[:, 2]
    half = 0.5 * wrap_angle(turn - motions.odometry[:, 2])
    corrections = np.column_stack([np.zeros((len(half), 2)), half])
    x, y, _ = compose(corrections, motions.odometry).T
    cos, sin = np.cos(turn), np.sin(turn)
    rows = np.stack([
        np.stack([x, -y, cos - 1.0, -sin], axis=1),
        np.stack([y, x, sin, cos - 1.0], axis=1),
    ], axis=1)  # fmt: skip
    seen = motions.scans[:, :2]
    weights = np.ones(len(rows))
    for _ in range(ROUNDS):
        root = np.sqrt(weights)
        found = np.linalg.lstsq((rows * root[:, None, None]).reshape(-1, 4), (seen * root[:, None]).ravel())[0]
        error = np.linalg.norm(seen - rows @ found, axis=1)
        usual = 1.5 * float(np.median(error)) + 1e-9
        weights = np.minimum(1.0, usual / np.maximum(error, 1e-12))
    turned = -math.atan2(found[1], found[0])
    ahead, aside, _ = after_step((0.0, 0.0, turned), (float(found[2]), float(found[3]), 0.0))
    before = np.linalg.norm(seen - np.column_stack([x, y]), axis=1)
    left = float(np.minimum(error, usual) @ np.minimum(error, usual) / max(before @ before, 1e-12))
    return (ahead, aside, turned), left


def _finding(
    log: SensorLog, motions: _Motions, least_turn: float, least_offset: float, *, or_reversed: bool
) -> Finding | None:
    (ahead, aside, turned), left = _solve(motions)
    part = np.arange(len(motions.scans)) * PARTS // len(motions.scans)
    others = [
        _solve(_Motions(motions.odometry[part != k], motions.scans[part != k], motions.speed))[0] for k in range(PARTS)
    ]
    away = np.array(others) - [ahead, aside, turned]
    away[:, 2] = wrap_angle(away[:, 2])
    deviation = np.sqrt((PARTS - 1) * away.var(axis=0))
    doubt = SIGMAS * float(np.hypot(*deviation[:2]))
    is_turned = abs(turned) > max(least_turn, SIGMAS * float(deviation[2]))
    least = np.maximum(least_offset + UNNAMED_DELAY * motions.speed, doubt)
    is_moved = bool((np.abs([ahead, aside]) > least).any())
    is_either = abs(turned) > REVERSED and not is_moved
    if not (is_turned or is_moved) or left > LEFT or (is_either and not or_reversed) or not _turn_alike(motions):
        return None
    said = _place(log, ahead, aside, turned, max(KNOWN, doubt) if is_turned else 0.0)
    if is_turned:
        side = "left" if turned > 0.0 else "right"
        said.append(f"is turned by {abs(math.degrees(turned)):.1f} degrees to the {side} of what its mount says")
    or_odometry = ", or the direction of the odometry" if is_either else ""
    return Finding(
        "laser-mount", "warning", f"Scans and odometry agree if the laser {', and '.join(said)}.",
        {"ahead_m": ahead, "left_m": aside, "turn_rad": turned},
        why="With a wrong mount poses are off by as much, and the odometry pulls any filter off the scans.",
        do=f"Correct the laser's transform (URDF, /tf_static){or_odometry}; for bags that have it, "
        "give the mount with --mount X Y YAW.",
    )  # fmt: skip


def _turn_alike(motions: _Motions) -> bool:
    turns = motions.odometry[:, 2]
    return bool(np.sum(wrap_angle(motions.scans[:, 2] - turns) ** 2) <= LEFT * np.sum(turns**2))


def _place(log: SensorLog, ahead: float, aside: float, turned: float, least: float) -> list[str]:
    """Say where the laser sits, if that is further than `least` from where its mount puts it."""
    mounts = log.finder.mounts[:, :2]
    if np.ptp(mounts, axis=0).any():  # scans merged of several lasers
        away = math.hypot(ahead, aside)
        text = f"sits {ahead:+.2f} m ahead and {aside:+.2f} m to the left of where its mount puts it"
    else:
        at_x, at_y = float(mounts[0, 0]), float(mounts[0, 1])
        x, y, _ = after_step((ahead, aside, turned), (at_x, at_y, 0.0))
        away = math.hypot(x - at_x, y - at_y)
        text = f"sits at ({x:.2f} m, {y:.2f} m) on the robot, not at ({at_x:.2f} m, {at_y:.2f} m)"
    return [text] if away > least else []
