"""What to know before odometry's noise is trusted."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from beamfield.calibration.odometry.held_out import FEWEST_BLOCKS
from beamfield.finding import Finding, worst_first
from beamfield.geometry import between, wrap_angle

if TYPE_CHECKING:
    from beamfield.calibration.odometry.result import OdometryCalibration
    from beamfield.sensors import SensorLog

# The common alpha of white noise is that of any window; an error that lasts makes it grow with the first power of the
# window's length. Beyond this power the noise is not white.
WHITE_POWER = 0.65
# Steps between scans that tell whether the robot drove forwards or backwards, metres; a few may be the reference's.
TELLING_STEP = 0.04
FEWEST_LOST_SIGNS, LEAST_LOST_SHARE = 5, 0.2
# Faults of this size are named for what they are, radians and share of the distance.
MISSED_TURN, SLIP = 0.3, 0.3
# Systematic errors worth putting right: of scales, rad/m and radians.
WORTH_CORRECTING = {"distance_scale": 0.01, "turn_scale": 0.01, "drift": 0.005, "yaw": 0.01}
CORRECTIONS = {
    "distance_scale": "the wheels' radius",
    "turn_scale": "the track width (divide it by 1 + the error)",
    "drift": "the ratio of the wheels' radii",
    "yaw": "the laser's yaw on the robot (fast round in one direction, a car slips outwards, which looks alike)",
}
# Residuals below this, metres and radians: the reference was made from the odometry.
SAME = 1e-3


def odometry_findings(result: OdometryCalibration, log: SensorLog) -> tuple[Finding, ...]:
    """Return findings, the worst first."""
    of_result = (_faults, _not_white, _systematic, _few_blocks, _floor)
    return worst_first([*_same(result), *_lost_signs(log), *(one for find in of_result for one in find(result))])


def _same(result: OdometryCalibration) -> Iterator[Finding]:
    off = np.abs(result.windows.residuals).max()
    if off < SAME:
        yield Finding(
            "odometry-is-reference",
            "warning",
            f"Reference poses and odometry never differ by more than {off:.1g} m or rad over "
            f"{result.windows.length} steps.",
            {"largest_difference": float(off)},
            why="The poses were made from the odometry, so its noise does not show.",
            do="Give poses that come from the scans.",
        )


def _lost_signs(log: SensorLog) -> Iterator[Finding]:
    both = np.isfinite(log.poses).all(axis=1) & np.isfinite(log.odometry).all(axis=1)
    shown = between(log.poses[both][:-1], log.poses[both][1:])[:, 0]
    driven = between(log.odometry[both][:-1], log.odometry[both][1:])[:, 0]
    telling = np.minimum(np.abs(shown), np.abs(driven)) > TELLING_STEP
    backwards = telling & (shown < 0.0)
    lost = backwards & (driven > 0.0)
    if lost.sum() >= FEWEST_LOST_SIGNS and lost.sum() >= LEAST_LOST_SHARE * backwards.sum():
        first = float(log.stamps[both][:-1][lost][0] - log.stamps[0])
        yield Finding(
            "odometry-sign",
            "warning",
            f"The odometry says forwards where the reference drives backwards, in {int(lost.sum())} of "
            f"{int(backwards.sum())} steps back between scans, first {first:.1f} s after the start.",
            {"n_lost": float(lost.sum()), "n_backwards": float(backwards.sum()), "first_s": first},
            why="A filter that follows it drives the wrong way; no noise makes up for that.",
            do="Put the sign of the odometry right.",
        )


def _faults(result: OdometryCalibration) -> Iterator[Finding]:
    faulty = ~result.is_noise
    if not faulty.any():
        return
    windows = result.windows
    residuals, motion = windows.residuals[faulty], windows.motion[faulty]
    turns = np.abs(wrap_angle(residuals[:, 2])) > MISSED_TURN
    slips = ~turns & (np.hypot(*residuals[:, :2].T) > SLIP * np.maximum(np.hypot(*motion[:, :2].T), 0.3))
    kinds = [
        f"{int(n.sum())} with {what}"
        for n, what in ((turns, "a turn missed or made up"), (slips, "a slip or a lost sign"))
        if n.any()
    ]
    first = float(result.fault_stamps[0])
    yield Finding(
        "odometry-faults",
        "warning",
        f"{int(faulty.sum())} of {len(windows)} overlapping windows of {windows.length} update steps fit no noise"
        + (f" ({', '.join(kinds)})" if kinds else "")
        + f", first from stamp {first:.1f} on.",
        {"n_windows": float(faulty.sum()), "first_stamp": first, "n_turns": float(turns.sum()),
         "n_slips": float(slips.sum())},
        why="They are left out of the fit: noise that covers them would be too wide for all the rest.",
        do="Look at the log there; keep the floor, which lets a filter survive small faults, and a recovery for large.",
    )  # fmt: skip


def _not_white(result: OdometryCalibration) -> Iterator[Finding]:
    known = [(length, alpha) for length, alpha in result.by_length if alpha > 0.0]
    if len(known) < 2:
        return
    (short, low), (long, high) = known[0], known[-1]
    allowed = (long / short) ** WHITE_POWER
    if 1.0 / allowed <= high / low <= allowed:
        return
    # What is advised is the floor then, whatever the noise below it is like.
    if max(low, high) < result.options.floor:
        return
    yield Finding(
        "odometry-not-white",
        "warning",
        f"The common alpha {'grows' if high > low else 'shrinks'} from {low:.2g} over {short} to {high:.2g} over "
        f"{long} update steps.",
        {"short": float(short), "long": float(long), "alpha_short": low, "alpha_long": high},
        why="Errors that last, such as a wrong scale, add up faster than noise."
        if high > low
        else "Errors that cancel, such as the reference's own or skewed stamps, look like noise of single steps.",
        do="Put the systematic errors right, and do not go below the floor."
        if high > low
        else "Check the stamps, and the error of the reference.",
    )


def _systematic(result: OdometryCalibration) -> Iterator[Finding]:
    for name, worth in WORTH_CORRECTING.items():
        error = result.systematic.get(name)
        if error is None or abs(error.value) < worth or error.low <= 0.0 <= error.high:
            continue
        yield Finding(
            f"odometry-{name.replace('_', '-')}",
            "warning",
            f"The odometry's {name.replace('_', ' ')} is off by {error.value:+.3g} "
            f"[{error.low:.3g}, {error.high:.3g}].",
            {"error": error.value, "low": error.low, "high": error.high},
            why="A filter takes it for noise, and needs more of that.",
            do=f"Correct {CORRECTIONS[name]}, record again, and calibrate again.",
        )


def _few_blocks(result: OdometryCalibration) -> Iterator[Finding]:
    if result.n_blocks < FEWEST_BLOCKS:
        yield Finding(
            "odometry-few-blocks",
            "warning",
            f"The {result.n_steps} update steps make {result.n_blocks} blocks of twice {result.windows.length} steps.",
            {"n_steps": float(result.n_steps), "n_blocks": float(result.n_blocks)},
            why="There are no intervals, and nothing tells whether one alpha is enough.",
            do="Record a longer drive.",
        )


def _floor(result: OdometryCalibration) -> Iterator[Finding]:
    floor = result.options.floor
    raised = [f"alpha{i}" for i in range(1, 5) if getattr(result.chosen.model, f"alpha{i}") < floor]
    if raised:
        yield Finding(
            "odometry-floor",
            "info",
            f"{', '.join(raised)} would be below {floor:g}, and are advised at that.",
            {"floor": floor, "n_raised": float(len(raised))},
            why="An alpha a few times too small loses the robot at the first fault; one too large costs little.",
        )
