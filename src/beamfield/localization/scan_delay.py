"""Scans stamped later or earlier than the odometry, throughout or since a clock jumped: when both turn alike."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.finding import Finding
from beamfield.geometry import FloatArray, between, wrap_angle
from beamfield.localization.alignment import align
from beamfield.models.motion import odometry_jumps
from beamfield.sensors import SensorLog

# Beams of each scan that are aligned, and pairs of neighbouring scans at most: 8 ms each.
BEAMS, MOST_PAIRS = 180, 300
# Windows of fitted poses that are compared at most.
MOST_WINDOWS = 2000
# Fewer pairs say nothing. Scans further apart than so many seconds are not aligned.
FEWEST_PAIRS, LONGEST_STEP = 60, 0.35
# Pairs count that lie within so many seconds of turning faster than this, radians per second.
TURNING, NEAR = 0.1, 0.5
# Delays that are tried, and their step, seconds.
REACH, STEP = 2.0, 0.02
# The robot stands still if it moves no further from scan to scan, metres.
LEAST_STEP = 0.001
# Radians by which an alignment that failed or a wheel that slipped counts at most.
OUTLIER = 0.1
# Differences in turning that are larger than so many times the median one are of bumps, not of the stamps.
UNUSUAL = 6.0
# From here on it is a fault, seconds: one of 0.15 s is mostly measured as 0.14 or 0.16 s. Half the time that a scanner
# takes for a scan is up to 0.1 s, which is named from the second number on.
LEAST_DELAY, SMALL_DELAY = 0.13, 0.05
# Squares of the differences in turning that either has to explain. In good simulated drives the best delay is up to
# 0.04 s, with bad wheels 0.08 s, and explains 0.2 at most; a delay of 0.1 s explains 0.3 to 0.5 there.
EXPLAINED, EXPLAINED_BY_SMALL = 0.35, 0.25
# What may be left of the squares of the turning, and of what the median delay leaves. Robots that turn evenly do so at
# any delay: 0.57 or more is left, elsewhere 0.44.
LEFT, SHARP = 0.25, 0.5
# A clock jumped if two delays, each of so many pairs or more, leave no more than this share of what one leaves: with
# jumps of 0.5 and 1.5 s in simulated drives it is 0.02 to 0.22, in good logs at least 0.94.
FEWEST_OF_EACH, TWO_DELAYS = 30, 0.5


class _Shift(NamedTuple):
    """The delay at which turns agree with the odometry's, and how well; up to turn `jump` it is another, `before`."""

    delay: float
    explained: float
    fits: bool
    jump: int
    before: float


def scan_delay(log: SensorLog, fitted: FloatArray | None = None) -> Finding | None:
    """Look for a delay between the stamps of scans and odometry, in how each of them turns.

    Return the warning "scan-delay" if one delay of 0.15 s or more makes the turns agree, or two that differ so much,
    before and after a jump; "small-scan-delay", which is no fault, if one of 0.05 s or more does, or one that is less
    sure; else None, also where the robot hardly turns, or evenly, scans are too rare, or odometry is missing.

    Neighbouring scans are aligned where the robot turns, which needs neither map nor poses. Poses (t, 3) that were
    fitted to scans and odometry tell less: they lie between both, and show half of the delay or less, but cost nothing.
    Where they are given and show no delay at all, no scans are aligned.
    """
    known = np.isfinite(log.odometry).all(axis=1)
    if known.sum() < FEWEST_PAIRS:
        return None
    stamps, odometry = log.stamps[known], log.odometry[known]
    steps = between(odometry[:-1], odometry[1:])
    steps[odometry_jumps(steps, np.maximum(np.diff(stamps), 0.0))] = 0.0
    headings = np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    pairs = _turning_pairs(log, stamps, headings)
    if len(pairs) < FEWEST_PAIRS or (fitted is not None and not _is_hinted(log.stamps, fitted, stamps, headings)):
        return None
    turns = np.array([_turn(log, int(i)) for i in pairs])
    pairs, turns = pairs[np.isfinite(turns)], turns[np.isfinite(turns)]
    if len(turns) < FEWEST_PAIRS:
        return None
    found = _best_shift(turns, log.stamps[pairs], log.stamps[pairs + 1], stamps, headings)
    if not found.fits:
        return None
    if found.explained >= EXPLAINED and max(abs(found.delay), abs(found.before)) >= LEAST_DELAY:
        if found.jump:
            # Only turns tell: the clock jumped anywhere between the last of the one delay and the first of the other.
            around = log.stamps[pairs[found.jump - 1 : found.jump + 1]] - log.stamps[0]
            return _jump_finding(found, float(around.mean()))
        return _finding(found, len(turns))
    if found.jump or abs(found.delay) < SMALL_DELAY or found.explained < EXPLAINED_BY_SMALL:
        return None
    rates = turns / (log.stamps[pairs + 1] - log.stamps[pairs])
    return _small_finding(found, len(turns), _usual_speed(stamps, odometry), float(np.sqrt((rates**2).mean())))


def _is_hinted(times: FloatArray, fitted: FloatArray, stamps: FloatArray, headings: FloatArray) -> bool:
    """Return whether fitted poses turn at another time than the odometry."""
    begin = np.arange(0, len(times), max(1, len(times) // MOST_WINDOWS))
    end = np.searchsorted(times, times[begin] + NEAR)
    inside = (times[begin] - REACH >= stamps[0]) & (times[end.clip(max=len(times) - 1)] + REACH <= stamps[-1])
    begin, end = begin[inside & (end < len(times))], end[inside & (end < len(times))]
    turned = np.unwrap(fitted[:, 2])
    found = _best_shift(turned[end] - turned[begin], times[begin], times[end], stamps, headings)
    return bool(found.jump) or abs(found.delay) > 0.5 * STEP


def _best_shift(
    turns: FloatArray, begin: FloatArray, end: FloatArray, stamps: FloatArray, headings: FloatArray
) -> _Shift:
    """Return the delay with the least squares of the differences between turns and those of the odometry."""

    def heading(times: FloatArray) -> FloatArray:
        # Amid two stamps half of their noise is gone, at stamps none: averaged over a step, all delays have as much.
        return np.asarray((np.interp(times - half, stamps, headings) + 2.0 * np.interp(times, stamps, headings)
                           + np.interp(times + half, stamps, headings)) / 4.0)  # fmt: skip

    n_steps, half = round(REACH / STEP), 0.5 * float(np.median(np.diff(stamps)))
    delays = STEP * np.arange(-n_steps, n_steps + 1)
    squares = np.array([(turns - heading(end - delay) + heading(begin - delay)) ** 2 for delay in delays])
    costs = np.zeros((len(delays), len(turns) + 1))
    costs[:, 1:] = np.minimum(squares, OUTLIER**2).cumsum(axis=1)
    total = costs[:, -1]
    best = before = int(total.argmin())
    left, jump = float(total[best]), 0
    two = costs.min(axis=0) + (total[:, None] - costs).min(axis=0)
    two[:FEWEST_OF_EACH] = two[-FEWEST_OF_EACH:] = np.inf
    split = int(two.argmin())
    after, until = int((total - costs[:, split]).argmin()), int(costs[:, split].argmin())
    if two[split] <= TWO_DELAYS * left and abs(delays[after] - delays[until]) >= LEAST_DELAY:
        best, before, left, jump = after, until, float(two[split]), split
    most = min(LEFT * float(np.minimum(turns**2, OUTLIER**2).sum()), SHARP * float(np.median(total)))
    fits = not {best, before} & {0, len(delays) - 1} and left <= most
    # Few pairs of all are aligned: a delay that moves some bumps of the robot out of them explains nothing by that.
    chosen = np.concatenate([squares[before, :jump], squares[best, jump:]])
    most_of_one = min(OUTLIER**2, UNUSUAL**2 * float(np.median(chosen)))
    without = max(float(np.minimum(squares[n_steps], most_of_one).sum()), 1e-12)
    explained = 1.0 - float(np.minimum(chosen, most_of_one).sum()) / without
    return _Shift(float(delays[best]), explained, fits, jump, float(delays[before]))


def _turning_pairs(log: SensorLog, stamps: FloatArray, headings: FloatArray) -> NDArray[np.int64]:
    """Return the first of each two neighbouring scans that are near a turn, and inside the odometry at all delays."""
    first = np.flatnonzero((np.diff(log.stamps) > 0.0) & (np.diff(log.stamps) <= LONGEST_STEP))
    begin, end = log.stamps[first], log.stamps[first + 1]
    turned = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(headings)))])
    near = np.interp(end + NEAR, stamps, turned) - np.interp(begin - NEAR, stamps, turned)
    inside = (begin - REACH >= stamps[0]) & (end + REACH <= stamps[-1])
    first = first[inside & (near > TURNING * (2.0 * NEAR))]
    spread = np.linspace(0, len(first) - 1, min(MOST_PAIRS, len(first))).round().astype(np.int64)
    return np.asarray(first[spread], dtype=np.int64)


def _turn(log: SensorLog, i: int) -> float:
    """Return by how much scan i + 1 is turned against scan i, radians; NaN if they cannot be aligned."""
    step = between(log.odometry[i], log.odometry[i + 1])
    guess = step if np.isfinite(step).all() else np.zeros(3)
    found = align(log.scan(i + 1).every(BEAMS), log.scan(i).every(BEAMS), guess)
    # Along a corridor the position is undetermined, and the heading is not.
    return float(wrap_angle(found.pose[2])) if found.problem in ("", "undetermined") else float("nan")


def _finding(found: _Shift, n_pairs: int) -> Finding:
    delay, explained = found.delay, found.explained
    side, sign = ("later", "-") if delay > 0.0 else ("earlier", "+")
    return Finding(
        "scan-delay",
        "warning",
        f"The scans are stamped {abs(delay):.2f} s {side} than the odometry: with their stamps shifted by "
        f"{sign}{abs(delay):.2f} s, both turn at the same time ({n_pairs} pairs of scans; that explains "
        f"{explained:.0%} of the differences).",
        {"delay_s": delay, "explained": explained, "pairs": float(n_pairs)},
        why="In turns each scan is put where the robot was not yet, or no longer: that looks like slipping wheels, and "
        "any filter on this robot suffers from it.",
        do="Compare the clocks of scanner and base (NTP, chrony), and what the scanner's driver stamps; set its time "
        "offset, and record again.",
    )


def _usual_speed(stamps: FloatArray, odometry: FloatArray) -> float:
    """Return the median speed of a robot while it moves, metres per second."""
    way = np.hypot(*np.diff(odometry[:, :2], axis=0).T)
    moves = (way > LEAST_STEP) & (np.diff(stamps) > 0.0)
    return float(np.median(way[moves] / np.diff(stamps)[moves])) if moves.any() else 0.0


def _small_finding(found: _Shift, n_pairs: int, speed: float, rate: float) -> Finding:
    size, turn = abs(found.delay), np.degrees(rate)
    return Finding(
        "small-scan-delay",
        "info",
        f"The scans are stamped {_beside(found.delay)} the odometry ({n_pairs} pairs of scans). At this drive's "
        f"{speed:.2f} m/s, and {turn:.0f} degrees/s in turns, poses are {speed * size:.2f} m and {turn * size:.1f} "
        "degrees off.",
        {"delay_s": found.delay, "explained": found.explained, "pairs": float(n_pairs)},
        why="A filter takes the odometry of the stamp. Half the time that a scanner takes for a scan is such a delay.",
        do=f"If that is too much, move the stamps by {-found.delay:+.2f} s: a time offset of the scanner's driver, or "
        "a node in between.",
    )


def _jump_finding(found: _Shift, since: float) -> Finding:
    return Finding(
        "scan-delay",
        "warning",
        f"A clock jumped, about {since:.0f} s after the first scan: until then the scans are stamped "
        f"{_beside(found.before)} the odometry, from then on {_beside(found.delay)} it.",
        {"delay_s": found.delay, "before_s": found.before, "time_s": since, "explained": found.explained},
        why="From then on each scan is put where the robot was not yet, or no longer, and any filter suffers from it.",
        do="Set the clocks of scanner and base before a drive (chrony: makestep at the start only), and record again.",
    )


def _beside(delay: float) -> str:
    return f"{abs(delay):.2f} s {'later' if delay > 0.0 else 'earlier'} than"
