"""A map that no longer shows the place: most readings disagree with it, though the poses are right."""

from __future__ import annotations

import numpy as np

from beamfield.finding import Finding
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.ray_agreement import LEAST_AGREEMENT, scan_agreement
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import SensorLog

# The map is out of date where at least this share of a scan's readings agrees, and so many times as many as beside the
# poses, up to 2 m away. At poses that are right, in maps that lack much of an office: 0.28 and 3.1 times or more. In
# maps of other buildings or with wrong odometry, of runs in which a quarter agrees: 1.8 times or less
# (benchmarks/other_maps.py and lost_robot.py).
LEAST, TIMES = 0.25, 2.5
# In the lower quartile of the scans, too, so many times as many agree: 2.1 or more in maps that are out of date, where
# the median passes. At poses that left the robot for good halfway it is 1.5 or less, and the median may pass.
LOWER, TIMES_OF_LOWER = 0.25, 1.75
BESIDE, DIRECTIONS = (0.5, 1.0, 2.0), 8
CAUSES = "The map is out of date, or most readings are of people or go through glass."


def find_outdated_map(
    log: SensorLog, grid: OccupancyGrid, poses: FloatArray, *, are_right: bool = False
) -> Finding | None:
    """Return a warning if most readings disagree with the map, but the poses (t, 3) are right all the same.

    None if most readings agree, or nothing shows that the poses are right. They are if somebody knows it, as of a
    course that fits the whole drive and no other (`are_right`), or where far fewer readings would agree a little way
    off, in any direction, also of the scans that agree least.
    """
    caster = RayCaster(grid)
    lower, agrees = _shares(log, grid, poses, caster)
    if not LEAST <= agrees < LEAST_AGREEMENT:
        return None
    if are_right:
        return outdated_at_right_poses(agrees)
    angles = 2.0 * np.pi / DIRECTIONS * np.arange(DIRECTIONS)
    steps = [r * np.array([np.cos(angle), np.sin(angle), 0.0]) for r in BESIDE for angle in angles]
    lower_beside, beside = np.max([_shares(log, grid, poses + step, caster) for step in steps], axis=0)
    if agrees < TIMES * beside or lower < TIMES_OF_LOWER * lower_beside:
        return None
    return _finding(
        f"{_share(agrees)}, and {int(100.0 * beside)}% at most would {BESIDE[0]:g} to {BESIDE[-1]:g} m away: the poses "
        f"are right. {CAUSES}",
        {"median_agreement": agrees, "agreement_beside": float(beside)},
    )


def outdated_at_right_poses(agrees: float) -> Finding | None:
    """Return the warning for the share of the median scan's readings that agree at poses that are known to be right."""
    if not LEAST <= agrees < LEAST_AGREEMENT:
        return None
    return _finding(
        f"{_share(agrees)} at the only poses that fit the whole drive. {CAUSES}",
        {"median_agreement": agrees},
    )


def _share(agrees: float) -> str:
    return (
        f"{int(100.0 * agrees)}% of a scan's readings agree with the map (median; expected {LEAST_AGREEMENT:.0%} or "
        "more)"
    )


def _finding(text: str, values: dict[str, float]) -> Finding:
    return Finding(
        "map-out-of-date",
        "warning",
        text,
        values,
        why="What was moved since misleads a robot sooner or later; a calibration takes it for noise of the sensor, as "
        "a filter in this map should.",
        do="Map the place anew, unless it is people or glass: beamfield check shows what is where.",
    )


def _shares(log: SensorLog, grid: OccupancyGrid, poses: FloatArray, caster: RayCaster) -> tuple[float, float]:
    """Return the agreement of the lower quartile and of the median of the scans; 0 if there is nothing to compare."""
    shares = scan_agreement(log, grid, poses, caster=caster)
    shares = shares[np.isfinite(shares)]
    lower, median = np.quantile(shares, [LOWER, 0.5]) if len(shares) else (0.0, 0.0)
    return float(lower), float(median)
