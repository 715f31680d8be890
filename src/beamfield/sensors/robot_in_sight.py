"""Beams that read the same wherever the robot is: they see the robot itself, or the floor."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from beamfield.finding import Finding
from beamfield.geometry import wrap_angle
from beamfield.sensors.sectors import sectors
from beamfield.sensors.sensor_log import SensorLog

# Scans from this far or this many radians on see something else.
APART_M, APART_RAD = 0.3, 0.35
# Along a wall, beams across read the same until the robot turns: the scans must head for three quarters of the circle.
QUARTERS, SCANS_IN_QUARTER = 3, 5
# A beam's readings are the same within this much and this share of them: at most a third on 22 real logs.
SAME_M, SAME_SHARE = 0.02, 0.025
MOST = 0.8
# Scans that are looked at.
SCANS = 400


def robot_in_sight(log: SensorLog) -> Iterator[Finding]:
    """Find beams that see the robot itself: most of their readings are the same at all places and headings.

    Nothing is said of logs without poses or odometry, or of a robot that hardly turns.
    """
    scans = _scans_apart(log)
    if len(scans) == 0:
        return
    ranges = log.ranges[scans]
    ranges = np.where((ranges >= log.finder.min_range) & (ranges < log.finder.max_range), ranges, np.inf)
    usual = np.median(ranges, axis=0)
    seen = np.isfinite(usual)
    usual = np.where(seen, usual, 0.0)
    same = seen & (np.mean(np.abs(ranges - usual) <= SAME_M + SAME_SHARE * usual, axis=0) >= MOST)
    if not same.any():
        return
    shown, options = sectors(log.finder.bearings, same)
    low, high = float(usual[same].min()), float(usual[same].max())
    metres = f"{high:.2f} m" if high - low < SAME_M else f"{low:.2f} to {high:.2f} m"
    yield Finding(
        "robot-in-sight",
        "warning",
        f"At {shown} the readings are {metres} wherever the robot was: they are of the robot itself, or, if the laser "
        "is tilted, of the floor.",
        {"share_of_beams": float(same.mean()), "least_m": low, "most_m": high},
        why="To a filter these are walls or people.",
        do=f"Mask them here ({options}) and on the robot (ROS: LaserScanBoxFilter of laser_filters leaves out what is "
        "within the robot), or level the laser.",
    )


def _scans_apart(log: SensorLog) -> NDArray[np.intp]:
    """Return scans from different places or headings, in all of which the robot headed about; none if it did not."""
    poses = log.odometry if log.has_odometry else log.poses
    known = np.flatnonzero(np.isfinite(poses).all(axis=1))
    poses = poses[known]
    if len(known) == 0:
        return known
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T) / APART_M + np.abs(wrap_angle(np.diff(poses[:, 2]))) / APART_RAD
    _, first = np.unique(np.floor(np.concatenate([[0.0], np.cumsum(steps)])), return_index=True)
    quarter = np.floor(wrap_angle(poses[first, 2]) / (0.5 * np.pi)).astype(int)
    if np.count_nonzero(np.bincount(quarter + 2) >= SCANS_IN_QUARTER) < QUARTERS:
        return known[:0]
    few = np.linspace(0, len(first) - 1, min(len(first), SCANS)).astype(int)
    return np.asarray(known[first[few]])
