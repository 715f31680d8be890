"""Whether scans agree with the map where a filter believes the robot to be; if not, it is elsewhere."""

from __future__ import annotations

import numpy as np

from beamfield.finding import Finding
from beamfield.geometry import FloatArray, between
from beamfield.localization.mapped_area import MappedArea
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.outdated_map import find_outdated_map
from beamfield.maps.ray_agreement import LEAST_AGREEMENT, scan_agreement
from beamfield.models.motion import odometry_jumps
from beamfield.sensors import SensorLog

# Odometry with more jumps than this share of its steps is no robot's.
MOST_JUMPS = 0.1
# Scans that are compared at most. At the end a robot is lost where so many of them or more, over a metre or more of
# way, agree so little, as the last ones do alone; they begin where the sum of what is missing to AGREES is largest.
SCANS, FEWEST, LEAST_WAY = 1000, 20, 1.0
AGREES, LEAST_AT_END = 0.3, 0.25
# Share of the scans within the map by which alone a robot is judged.
LEAST_WITHIN = 0.2


def find_lost_robot(log: SensorLog, grid: OccupancyGrid, poses: FloatArray) -> Finding | None:
    """Return a warning if the robot is elsewhere, the map is out of date, or the odometry cannot be followed.

    Poses (t, 3) are where a filter took the robot to be; NaN where it said nothing. The warning is "robot-lost" or
    "map-out-of-date", or "lost-at-end" if most scans agree but the last ones do not; None if scans agree, or if there
    is nothing to tell by: no reading, or cones of a sonar.
    """
    known = np.isfinite(log.odometry).all(axis=1)
    odometry, stamps = log.odometry[known], log.stamps[known]
    steps = between(odometry[:-1], odometry[1:])
    n_jumps = int(odometry_jumps(steps, np.abs(np.diff(stamps))).sum())
    if n_jumps > MOST_JUMPS * len(steps):
        return _jumping(n_jumps, len(steps))
    if log.finder.opening_angle > 0.0:
        return None
    shares = scan_agreement(log, grid, poses, most=SCANS)
    seen = np.flatnonzero(np.isfinite(shares))
    if not len(seen):
        return None
    # Beyond the map scans agree with nothing; a robot that is there nearly all the time is lost all the same.
    within = ~MappedArea(grid).is_beyond(poses[seen])
    if within.mean() >= LEAST_WITHIN:
        seen = seen[within]
    shares, median = shares[seen], float(np.median(shares[seen]))
    parted, end = "", _end(shares, log.odometry[seen])
    if end is not None:
        seconds = float(log.stamps[seen[end]] - log.stamps[0])
        before, after = float(np.median(shares[:end])), float(np.median(shares[end:]))
        if median >= LEAST_AGREEMENT:
            return _lost_at_end(before, after, seconds)
        parted = f" (until {seconds:.0f} s after the first scan {before:.0%}, from then on {after:.0%})"
    elif median >= LEAST_AGREEMENT:
        return None
    if end is None and (outdated := find_outdated_map(log, grid, poses)) is not None:
        return outdated
    way, turn = float(np.hypot(*steps[:, :2].T).sum()), float(np.abs(steps[:, 2]).sum())
    return Finding(
        "robot-lost",
        "warning",
        f"Where the filter takes the robot to be, {int(100.0 * median)}% of a scan's readings agree with the map "
        f"(median; expected {LEAST_AGREEMENT:.0%} or more){parted}. By its odometry it drove {way:.1f} m and "
        f"turned {np.degrees(turn):.0f} degrees.",
        {"median_agreement": median, "path_length_m": way, "turn_rad": turn},
        why="The robot was most likely elsewhere: the start, the map or the odometry (its signs, or it stands still) "
        "is wrong; or most readings are of people.",
        do="Run beamfield trajectory on this log and map: it searches all starts, and odometry of the wrong sign.",
    )


def lost_not_judged() -> Finding:
    """Return what to say of a sonar's log instead, whose cones agree with no single ray."""
    return Finding(
        "lost-not-judged",
        "info",
        "Whether the robot is lost is not judged from the cones of a sonar.",
        why="The filter can be sure of a wrong place.",
        do="See in localization.png whether the path keeps to free space.",
    )


def _end(shares: FloatArray, odometry: FloatArray) -> int | None:
    """Return from which share (t,) on they disagree, to the end, after most agreed; None if they do not."""
    missing = np.cumsum((AGREES - shares)[::-1])[::-1]
    begin = int(missing.argmax())
    if not FEWEST <= begin <= len(shares) - FEWEST or np.median(shares[:begin]) < LEAST_AGREEMENT:
        return None
    if max(shares[begin:].mean(), shares[-FEWEST:].mean()) >= LEAST_AT_END:
        return None
    way = np.nansum(np.hypot(*np.diff(odometry[begin:, :2], axis=0).T))
    return begin if way >= LEAST_WAY else None


def _lost_at_end(before: float, after: float, seconds: float) -> Finding:
    return Finding(
        "lost-at-end",
        "warning",
        f"From {seconds:.0f} s after the first scan on, {after:.0%} of a scan's readings agree with the map where the "
        f"filter takes the robot to be (median; before: {before:.0%}).",
        {"time_s": seconds, "median_agreement": after, "median_agreement_before": before},
        why="The robot is most likely elsewhere since then: carried, slipped or lost; or the map is wrong there.",
        do="Run beamfield trajectory on this log and map: it fits the whole drive, and says when the robot was carried "
        "or slipped.",
    )


def _jumping(n_jumps: int, n_steps: int) -> Finding:
    return Finding(
        "robot-lost",
        "warning",
        f"{n_jumps} of {n_steps} steps of the odometry are longer than a robot drives or turns.",
        {"jumps": float(n_jumps), "steps": float(n_steps)},
        why="It is not in metres and radians, or not this robot's; no filter can follow the robot by it.",
        do="Correct the units where the odometry is made.",
    )
