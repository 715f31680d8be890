"""By how much turns of the odometry differ from those of a fitted trajectory."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.finding import Finding
from beamfield.geometry import FloatArray
from beamfield.localization.drive import Drive

# Seconds over which turns are compared: from scan to scan, noise and skewed stamps make one's turns smaller by the
# other's.
WINDOW = 3.0
# Fewer windows or radians of turning tell nothing. So many parts are left out in turn for the standard errors.
FEWEST, LEAST_TURN, PARTS = 12, 3.0, 10
# Variances of a window's difference: per radian, per metre, and of any.
PER_TURN, PER_METRE, FLOOR = 1.0, 0.1, 0.01
ROUNDS = 5
# From here on an error is named: a share, radians per metre, and standard errors. Of five real logs the worst have 0.04
# and 0.0105.
SCALE, DRIFT, SIGMAS = 0.05, 0.03, 4.0


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
    since = drive.stamps - drive.stamps[0]
    edges = np.unique(np.searchsorted(since, np.arange(0.0, since[-1], WINDOW)).clip(max=len(since) - 1))
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
            why="The distance between the wheels or a gyro's scale is wrong, or the wheels skid: after each turn a "
            "filter has to find its heading anew.",
            do=f"Make the wheel separation {1.0 + scale:.3f} times as large, or divide the gyro's turns by that; for a "
            "robot that skids, take a gyro's turns.",
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
