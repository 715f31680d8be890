"""By how much turns of the odometry differ from those of a fitted trajectory, or of scans that are aligned."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.finding import Finding
from beamfield.geometry import FloatArray, between, wrap_angle
from beamfield.localization.alignment import align
from beamfield.localization.drive import Drive
from beamfield.sensors import SensorLog

# Seconds over which turns are compared: from scan to scan, noise and skewed stamps make one's turns smaller by the
# other's.
WINDOW = 3.0
# Fewer windows or radians of turning tell nothing. So many parts are left out in turn for the standard errors.
FEWEST, LEAST_TURN, PARTS = 12, 3.0, 10
# Variances of a window's difference: per radian, per metre, and of any.
PER_TURN, PER_METRE, FLOOR = 1.0, 0.1, 0.01
# Weights settle within so many rounds, with slips in a fifth of the windows.
ROUNDS = 20
# From here on an error is named: a share, radians per metre, and standard errors. Of five real logs the worst have 0.04
# and 0.0105.
SCALE, DRIFT, SIGMAS = 0.05, 0.03, 4.0
# A robot that moves less in a window stands, metres and radians; from so many radians per second on, in so many
# windows, its odometry drifts.
STILL, STILL_TURN, REST_RATE, RESTS = 0.02, 0.02, 0.002, 4
# Without a trajectory: pairs of scans that are aligned at most, 8 ms each, their beams, and about how many seconds they
# are apart. Turns of more than a standing robot's noise, radians, have to sum up to so much.
MOST_PAIRS, FEWEST_PAIRS, BEAMS, APART, LONGEST = 300, 30, 180, 0.15, 0.35
NOISE, LEAST_ALIGNED = 0.03, 1.0
# Shares of the true turns that are right, or are named with a trajectory, and what else than a wrong share may be left
# of the squares of the turns. On six real logs the shares are 0.92 to 1.02; with half as many hits as short readings,
# with which alignments fall short, 1.2. Below the last share the odometry hardly turns, in either direction.
RIGHT, LEFT, HARDLY = (0.6, 1.6), 0.25, 0.2


class TurnErrors(NamedTuple):
    """Turns of the odometry over the true ones, minus 1; radians it turns per metre; and their standard errors."""

    scale: float
    drift: float
    scale_error: float
    drift_error: float


def turn_errors(drive: Drive, poses: FloatArray, cut: NDArray[np.bool_]) -> TurnErrors | None:
    """Compare the turns of odometry and fitted poses (t, 3); steps `cut` (t - 1,) say nothing.

    None if the robot turned too little.
    """
    _, edges = _windows(drive)
    begin, end = edges[:-1], edges[1:]
    broken = np.concatenate([[0], np.cumsum(cut)])
    whole = broken[begin] == broken[end]
    begin, end = begin[whole], end[whole]
    heading = np.unwrap(poses[:, 2])
    turned = heading[end] - heading[begin]
    if len(begin) < FEWEST or np.abs(turned).sum() < LEAST_TURN:
        return None
    sums = np.concatenate([np.zeros((1, 3)), np.cumsum(drive.steps, axis=0)])
    driven = sums[end] - sums[begin]
    rows, off = np.column_stack([turned, driven[:, 0]]), driven[:, 2] - turned
    part = np.arange(len(begin)) * PARTS // len(begin)
    others = np.array([_solved(rows[part != k], off[part != k]) for k in range(PARTS)])
    scale, drift = _solved(rows, off)
    scale_error, drift_error = np.sqrt((PARTS - 1) * others.var(axis=0))
    return TurnErrors(float(scale), float(drift), float(scale_error), float(drift_error))


def drift_at_rest(drive: Drive, poses: FloatArray) -> Iterator[Finding]:
    """Name odometry that turns to one side while the fitted poses (t, 3) stand still."""
    since, edges = _windows(drive)
    moved, sums = between(poses[edges[:-1]], poses[edges[1:]]), np.concatenate([[0.0], np.cumsum(drive.steps[:, 2])])
    stands = (np.hypot(moved[:, 0], moved[:, 1]) < STILL) & (np.abs(moved[:, 2]) < STILL_TURN)
    rates = (np.diff(sums[edges]) / np.diff(since[edges]))[stands]
    rate = float(np.median(rates)) if len(rates) else 0.0
    if len(rates) < RESTS or np.quantile(math.copysign(1.0, rate) * rates, 0.25) < REST_RATE:
        return
    yield Finding(
        "odometry-drift-at-rest", "warning",
        f"While the robot stands, its odometry turns by {abs(math.degrees(rate)):.1f} degrees a second to the "
        f"{'left' if rate > 0.0 else 'right'}.",
        {"radians_per_second": rate},
        why="A gyro drifts: the robot turns away in the map, and the longer it stands the more.",
        do="Calibrate the gyro's bias while the robot stands, or let the odometry take no turn while the wheels stand.",
    )  # fmt: skip


def _windows(drive: Drive) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the seconds of the scans (t,) since the first one, and the scans at which windows begin and end."""
    since = drive.stamps - drive.stamps[0]
    return since, np.unique(np.searchsorted(since, np.arange(0.0, since[-1], WINDOW)).clip(max=len(since) - 1))


def _solved(rows: FloatArray, off: FloatArray) -> FloatArray:
    """Return scale and drift by least squares in which slips count little."""
    variances = PER_TURN * np.abs(rows[:, 0]) + PER_METRE * np.abs(rows[:, 1]) + FLOOR
    weights = 1.0 / variances
    for _ in range(ROUNDS):
        root = np.sqrt(weights)
        found = np.linalg.lstsq(rows * root[:, None], off * root)[0]
        error = np.abs(off - rows @ found) / np.sqrt(variances)
        weights = np.minimum(1.0, 2.0 * float(np.median(error)) / np.maximum(error, 1e-12)) / variances
    return np.asarray(found)


def turn_findings(errors: TurnErrors | None) -> Iterator[Finding]:
    """Name turns that are wrong by a scale, and a drift."""
    if errors is None:
        return
    scale, drift = errors.scale, errors.drift
    if abs(scale) > max(SCALE, SIGMAS * errors.scale_error):
        yield Finding(
            "odometry-turn-scale", "warning",
            f"Turns of the odometry are {abs(scale):.1%} too {'large' if scale > 0.0 else 'small'}, by the scans.",
            {"scale": scale, "standard_error": errors.scale_error},
            why="The distance between the wheels, a gyro's scale or a car's steering angle is wrong, or the wheels "
            "skid: after each turn a filter has to find its heading anew.",
            do=f"Make the wheel separation {1.0 + scale:.3f} times as large, or divide the turns of the gyro, or of "
            "the steering, by that; for a robot that skids, and a car in fast curves, take a gyro's turns.",
        )  # fmt: skip
    if abs(drift) > max(DRIFT, SIGMAS * errors.drift_error):
        yield Finding(
            "odometry-drift", "warning",
            f"The odometry turns to the {'left' if drift > 0.0 else 'right'} by {abs(math.degrees(drift)):.1f} degrees "
            "per metre more than the scans.",
            {"radians_per_metre": drift, "standard_error": errors.drift_error},
            why="A gyro drifts, or one wheel is larger than the other: a filter's particles all go astray alike.",
            do="Calibrate the gyro's bias while the robot stands still, or compare the wheels and their tyres.",
        )  # fmt: skip


def turns_of_scans(log: SensorLog) -> Finding | None:
    """Compare the odometry's turns with those between scans that are aligned; this needs neither map nor poses.

    The finding is "odometry-turn-scale". None if they agree but for what a trajectory shows, the robot hardly turns, or
    it is more than a scale that is wrong.
    """
    end = np.searchsorted(log.stamps, log.stamps + APART).clip(max=len(log) - 1)
    known = np.asarray(np.isfinite(log.odometry).all(axis=1))
    time = log.stamps[end] - log.stamps
    pairs = np.flatnonzero((time > 0.0) & (time <= LONGEST) & known & known[end])
    pairs = pairs[np.unique(np.linspace(0, len(pairs) - 1, min(MOST_PAIRS, len(pairs))).round().astype(np.int64))]
    found = [align(log.scan(int(end[i])).every(BEAMS), log.scan(int(i)).every(BEAMS), np.zeros(3)) for i in pairs]
    good = np.array([one.problem in ("", "undetermined") for one in found], dtype=bool)
    pairs = pairs[good]
    turned = wrap_angle(np.array([one.pose[2] for one in found])[good])
    said = between(log.odometry[pairs], log.odometry[end[pairs]])[:, 2]
    if len(pairs) < FEWEST_PAIRS or np.abs(turned[np.abs(turned) > NOISE]).sum() < LEAST_ALIGNED:
        return None
    share = float(said @ turned / (turned @ turned))
    left = float(np.sum((said - share * turned) ** 2) / (turned @ turned))
    if RIGHT[0] <= share <= RIGHT[1] or left > LEFT * max(1.0, share**2):
        return None
    seen = f"turns {share:.1f} times as far" if share > 0.0 else "turns the other way, or the scans are mirrored"
    if share <= -HARDLY:
        do = (
            "Stand beside the robot and look at the scan in rviz: if left and right are swapped, the laser is upside "
            "down, and its transform lacks the roll of 180 degrees; if not, the odometry's turns have the wrong sign."
        )
    else:
        do = (
            "Turn the robot on the spot, and see whether /odom turns as far: if not, the distance between the wheels, "
            "the encoders, a gyro's scale, or what robot_localization takes of each (yaw, yaw rate) is wrong."
        )
    return Finding(
        "odometry-turn-scale", "warning",
        f"Where the scans turn against each other, the odometry {'hardly turns' if abs(share) < HARDLY else seen}.",
        {"scale": share - 1.0},
        why="In rviz the scans turn with the robot, where they should stand still, and any filter loses it in turns.",
        do=do,
    )  # fmt: skip
