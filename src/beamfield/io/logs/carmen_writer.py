"""Write CARMEN logs."""

from __future__ import annotations

import gzip
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, compose, wrap_angle
from beamfield.io.files.atomic import write_file
from beamfield.sensors import ScanLog, SensorLog

# What FLASER can express: one origin on the robot's axis, and equal steps.
TOLERANCE = 1e-9
# Parameters of our own, for what CARMEN's have no name: how far from that origin every beam starts (a ring of sonars on
# the robot's rim), metres, and the full width of its cone, radians. Other readers pass over them.
RING_RADIUS, OPENING_ANGLE = "beamfield_ring_radius", "beamfield_opening_angle"


def write_carmen(path: str | Path, log: ScanLog) -> None:
    """Write the scans of a log of one sensor as FLASER lines, with PARAM lines about the sensor, and ODOM lines.

    Each FLASER line has the ranges, the laser's reference pose, the robot's odometry, and the stamp; reading it with
    `beamfield.io.logs.carmen.read_carmen` gives the same log: ranges and stamps to a micrometre and a microsecond. "No
    return" is written as max_range, "too close" as 0, NaN as nan. Two PARAM lines of our own, beamfield_ring_radius and
    beamfield_opening_angle, hold what a ring of sonars has and a laser has not; other readers pass over them.

    Parameters
    ----------
    path
        The file to write, whole or not at all; compressed if its name ends with ``.gz``.
    log
        The log. Each scan has a reference pose, or odometry. Without odometry the reference pose is written twice, as
        SLAM programs do. Without reference poses the odometry is, as robots do: read such a log with
        ``lone_poses="odometry"``.

    Raises
    ------
    InvalidInputError
        If there is not one sensor, only some scans have a reference pose, or odometry, or none has either, or the beams
        do not start at one point (x, 0) of the robot, or on a ring around it, in equal steps counter-clockwise: a
        FLASER line cannot say that.
    """
    scans = log.only_sensor()
    offset, start, step, radius = _geometry(scans)
    poses, odometry = _poses(scans)
    in_time = sorted(chain(_scan_lines(scans, offset, poses, odometry), _odometry_lines(log)), key=lambda item: item[0])
    lines = chain(_head(scans, offset, start, step, radius), (line for _, line in in_time))
    text = "".join(line + "\n" for line in lines).encode("ascii")
    if str(path).endswith(".gz"):
        text = gzip.compress(text, mtime=0)  # no time inside, so that the same log gives the same bytes
    write_file(path, text)


def _geometry(scans: SensorLog) -> tuple[float, float, float, float]:
    """Return the origin's place in front of the robot, the first bearing, the step, and the radius of the ring."""
    mounts = scans.finder.mounts
    step = float(wrap_angle(mounts[1, 2] - mounts[0, 2])) if len(mounts) > 1 else np.radians(1.0)
    start = float(mounts[0, 2])
    uniform = wrap_angle(mounts[:, 2] - (start + step * np.arange(len(mounts))))
    offset, radius = float(mounts[0, 0]), 0.0
    if np.ptp(mounts[:, 0]) >= TOLERANCE or np.abs(mounts[:, 1]).max() >= TOLERANCE:
        offset, radius = _ring(mounts)
    misplaced = mounts[:, :2] - [offset, 0.0] - radius * np.column_stack([np.cos(mounts[:, 2]), np.sin(mounts[:, 2])])
    if np.abs(misplaced).max() > TOLERANCE or np.abs(uniform).max() > TOLERANCE or step <= 0.0:
        raise InvalidInputError(
            "a CARMEN FLASER line needs beams that start at one point (x, 0) of the robot, or on a ring around it, in "
            f"equal steps counter-clockwise; got mounts {mounts[0].round(4).tolist()} ... "
            f"{mounts[-1].round(4).tolist()}"
        )
    return offset, start, step, radius


def _ring(mounts: FloatArray) -> tuple[float, float]:
    """Return the centre's x and the radius of the ring that fits the mounts best."""
    cos, sin = np.cos(mounts[:, 2]), np.sin(mounts[:, 2])
    along = np.concatenate([np.column_stack([np.ones_like(cos), cos]), np.column_stack([np.zeros_like(sin), sin])])
    (offset, radius), *_ = np.linalg.lstsq(along, np.concatenate([mounts[:, 0], mounts[:, 1]]))
    # Without rounding noise, which would be read as a mount.
    return round(float(offset), 12), round(float(radius), 12)


def _poses(scans: SensorLog) -> tuple[FloatArray, FloatArray | None]:
    known, driven = (np.isfinite(poses).all(axis=1) for poses in (scans.poses, scans.odometry))
    if driven.any() and not driven.all():
        raise InvalidInputError(f"odometry: {np.count_nonzero(~driven)} of {len(scans)} scans have none")
    if driven.any() and not known.any():
        return scans.odometry, scans.odometry
    if not known.all():
        raise InvalidInputError(f"a CARMEN log needs a reference pose per scan; {np.count_nonzero(~known)} have none")
    return scans.poses, scans.odometry if driven.any() else None


def _head(scans: SensorLog, offset: float, start: float, step: float, radius: float) -> Iterator[str]:
    yield "# CARMEN log: FLASER n ranges, laser pose, odometry pose, stamp host stamp; metres, radians, seconds"
    for name, value in (
        ("robot_frontlaser_offset", offset),
        ("robot_front_laser_max", scans.finder.max_range),
        ("laser_front_laser_start_angle", start),
        ("laser_front_laser_resolution", np.degrees(step)),
        ("laser_front_laser_fov", step * (scans.finder.n_beams - 1)),
    ):
        yield f"PARAM {name} {float(value)!r}"
    for name, value in ((RING_RADIUS, radius), (OPENING_ANGLE, scans.finder.opening_angle)):
        if value != 0.0:
            yield f"PARAM {name} {float(value)!r}"


def _scan_lines(
    scans: SensorLog, offset: float, poses: FloatArray, odometry: FloatArray | None
) -> Iterator[tuple[float, str]]:
    lasers = compose(poses, [offset, 0.0, 0.0])
    z = np.array(scans.ranges)
    # Rounded up, so that six decimals still reach the limit.
    z[z >= scans.finder.max_range] = np.ceil(scans.finder.max_range * 1e6) / 1e6
    z[z == -np.inf] = 0.0
    for i in range(len(scans)):
        ranges = " ".join(_shortest(value) for value in z[i].tolist())
        second = lasers[i] if odometry is None else odometry[i]
        stamp = f"{scans.stamps[i]:.6f}"
        yield (
            float(scans.stamps[i]),
            f"FLASER {z.shape[1]} {ranges} {_pose(lasers[i])} {_pose(second)} {stamp} beamfield {stamp}",
        )


def _odometry_lines(log: ScanLog) -> Iterator[tuple[float, str]]:
    if log.odometry is None:
        return
    for stamp, pose in zip(log.odometry.stamps.tolist(), log.odometry.poses, strict=True):
        yield stamp, f"ODOM {_pose(pose)} 0 0 0 {stamp:.6f} beamfield {stamp:.6f}"


def _pose(pose: FloatArray) -> str:
    return " ".join(f"{value:.9f}" for value in pose.tolist())


def _shortest(value: float) -> str:
    """Return a number with at most six decimals and no zeros that say nothing."""
    text = f"{value:.6f}"
    return text.rstrip("0").rstrip(".") if "." in text else text
