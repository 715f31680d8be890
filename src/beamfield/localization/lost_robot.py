"""Whether scans agree with the map where a filter believes the robot to be; if not, it is elsewhere."""

from __future__ import annotations

import numpy as np

from beamfield.finding import Finding
from beamfield.geometry import FloatArray, between
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.outdated_map import find_outdated_map
from beamfield.maps.ray_agreement import LEAST_AGREEMENT, scan_agreement
from beamfield.models.motion import odometry_jumps
from beamfield.sensors import SensorLog

# Odometry with more jumps than this share of its steps is no robot's.
MOST_JUMPS = 0.1


def find_lost_robot(log: SensorLog, grid: OccupancyGrid, poses: FloatArray) -> Finding | None:
    """Return a warning if the robot is elsewhere, the map is out of date, or the odometry cannot be followed.

    Poses (t, 3) are where a filter took the robot to be; NaN where it said nothing. The warning is "robot-lost" or
    "map-out-of-date"; None if scans agree, or if there is nothing to tell by: no reading, or cones of a sonar.
    """
    known = np.isfinite(log.odometry).all(axis=1)
    odometry, stamps = log.odometry[known], log.stamps[known]
    steps = between(odometry[:-1], odometry[1:])
    n_jumps = int(odometry_jumps(steps, np.abs(np.diff(stamps))).sum())
    if n_jumps > MOST_JUMPS * len(steps):
        return _jumping(n_jumps, len(steps))
    if log.finder.opening_angle > 0.0:
        return None
    shares = scan_agreement(log, grid, poses)
    if np.isnan(shares).all() or float(np.nanmedian(shares)) >= LEAST_AGREEMENT:
        return None
    if (outdated := find_outdated_map(log, grid, poses)) is not None:
        return outdated
    median = float(np.nanmedian(shares))
    way, turn = float(np.hypot(*steps[:, :2].T).sum()), float(np.abs(steps[:, 2]).sum())
    return Finding(
        "robot-lost",
        "warning",
        f"Where the filter takes the robot to be, {int(100.0 * median)}% of a scan's readings agree with the map "
        f"(median; expected {LEAST_AGREEMENT:.0%} or more). By its odometry it drove {way:.1f} m and "
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


def _jumping(n_jumps: int, n_steps: int) -> Finding:
    return Finding(
        "robot-lost",
        "warning",
        f"{n_jumps} of {n_steps} steps of the odometry are longer than a robot drives or turns.",
        {"jumps": float(n_jumps), "steps": float(n_steps)},
        why="It is not in metres and radians, or not this robot's; no filter can follow the robot by it.",
        do="Correct the units where the odometry is made.",
    )
