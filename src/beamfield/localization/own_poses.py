"""Where the poses that a log brings, such as those of the robot's own filter, leave the ones fitted to a map."""

from __future__ import annotations

import numpy as np

from beamfield.finding import Finding
from beamfield.geometry import wrap_angle
from beamfield.localization.trajectory import TrajectoryFit
from beamfield.sensors import SensorLog

# A robot that is farther off than this is lost, metres and radians.
LOST, LOST_TURN = 0.5, float(np.radians(20.0))
# From a start nearer than this, two standard deviations of nav2's initial belief, a filter finds the robot.
FAR, FAR_TURN = 1.0, float(np.radians(30.0))


def compare_own_poses(log: SensorLog, fit: TrajectoryFit) -> Finding | None:
    """Compare the poses of a log with the trajectory that was fitted to its scans and odometry.

    "own-poses-lost", a warning, if they are more than 0.5 m or 20 degrees apart at some scan; else "own-poses-agree".
    None if no scan has both a pose and a fitted one that can be trusted.
    """
    both = np.flatnonzero(fit.trusted & np.isfinite(log.poses).all(axis=1))
    if not len(both):
        return None
    apart = log.poses[both] - fit.poses[both]
    off, turned = np.hypot(*apart[:, :2].T), np.abs(wrap_angle(apart[:, 2]))
    lost = (off > LOST) | (turned > LOST_TURN)
    values = {"share_lost": float(lost.mean()), "median_m": float(np.median(off)), "largest_m": float(off.max()),
              "end_m": float(off[-1])}  # fmt: skip
    if not lost.any():
        text = (
            f"The log's own poses lie {np.median(off):.2f} m (median) from the fitted ones, {off.max():.2f} m at most"
        )
        return Finding("own-poses-agree", "info", f"{text}.", values)
    first = int(np.argmax(lost))
    scan = both[first]
    since, (x, y, _) = float(log.stamps[scan] - log.stamps[0]), fit.poses[scan]
    where = f"with the robot at ({x:.2f} m, {y:.2f} m)"
    said = f"leave the fitted ones {since:.1f} s after the first scan, {where}"
    if first == 0:
        by = f"by {off[0]:.2f} m and {np.degrees(turned[0]):.0f} degrees"
        said = f"are wrong from their first one on, {since:.1f} s after the first scan, {by}, {where}"
    why = "What localised the robot was lost there, or its poses are of another map's frame."
    do = "Try the filter's parameters on this log: beamfield doctor, then beamfield calibrate --stack."
    if first == 0 and (off[0] > FAR or turned[0] > FAR_TURN):
        why = "The initial pose was wrong, the robot was lost before, or its poses are of another map's frame."
        do = "Look at where the initial pose comes from. beamfield evaluate runs the filter from a right one."
    return Finding(
        "own-poses-lost",
        "warning",
        f"The log's own poses {said}: they are more than {LOST:g} m or {np.degrees(LOST_TURN):.0f} degrees off in "
        f"{lost.mean():.0%} of the scans, up to {off.max():.2f} m, and {off[-1]:.2f} m at the end.",
        {**values, "first_s": since, "x_m": float(x), "y_m": float(y)},
        why=why,
        do=do,
    )
