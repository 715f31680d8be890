"""CARMEN logs: FLASER, RLASER, ROBOTLASERn, RAWLASERn, ODOM, TRUEPOS and PARAM messages, one per line."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from beamfield.geometry import FloatArray, between, compose, interpolate_poses, invert
from beamfield.io.logs.carmen_laser import bearings, declared_max, declared_mount, ring_and_cone
from beamfield.io.logs.carmen_messages import CarmenMessages, read_carmen_messages
from beamfield.io.logs.carmen_writer import write_carmen
from beamfield.io.logs.text_scans import DEFAULTS, LonePoses, TextOptions, TextScans, middle_mount
from beamfield.sensors import MAX_GAP, ScanLog, SensorLog, Track

__all__ = ["read_carmen", "write_carmen"]

# The poses of public logs have six digits or more; a pose in the frame of the odometry follows it closer than this.
CONSTANT = 2e-3
SAME_FRAME = 0.1
# No laser is so far from its robot, metres: the second pose of a robot that stands is in the frame of the odometry.
FARTHEST_LASER = 5.0


def read_carmen(path: str | Path, options: TextOptions = DEFAULTS) -> ScanLog:
    """Read a log of the Carnegie Mellon robot navigation toolkit, plain or gzip; sensors are called as their messages.

    FLASER and RLASER have two poses: the laser's, and the robot's in the frame of the odometry.

    - If they differ by a transform that is not constant, or longer than 5 m, the first is the corrected pose: the
      reference; and the second is the odometry.
    - Otherwise the log has one trajectory only. SLAM programs write corrected logs that way, so it is the reference and
      there is no odometry (``lone_poses="odometry"``: the other way round, for logs that are raw). The ODOM lines are
      taken as odometry only where they do not follow those poses: SLAM programs correct them, too.

    The first pose is the laser's: with a mount of (robot_frontlaser_offset, 0, 0) from the PARAM lines the robot's pose
    is that far behind. In corrected logs with PARAM offsets of -0.04 m, maps are sharper so than with the mount added
    to the pose. Without the parameter the mount is 0, the robot's pose that of its laser.

    ROBOTLASERn has the laser's and the robot's pose of one trajectory, treated in the same way; its mount is the
    transform between them. RAWLASERn has no pose; it is read from the ODOM lines, and only if there is no ROBOTLASERn.

    TRUEPOS (the true pose in a simulator) is the reference of all sensors where it is there.

    A ring of sonars that `write_carmen` wrote as FLASER lines is told by its PARAM lines beamfield_ring_radius and
    beamfield_opening_angle.

    Returns
    -------
    The log; its stamps are the first of the two timestamps of a line, or the second if those are not usable (see
    `beamfield.io.logs.scan_stamps.resolve_stamps`). Messages of other kinds are counted in the notes.

    Raises
    ------
    FormatError
        If a line is cut off, a count disagrees with the words of the line, a word is no number, a pose is not finite,
        the number of beams changes, stamps run backwards, or there are no scans; the line is named.

    References
    ----------
    CARMEN manual, "logger and playback": the messages and their fields.
    """
    content = read_carmen_messages(Path(path))
    names = _sensors_to_read(content, options)
    notes = list(content.notes)
    resolved = {name: content.scans[name].resolve_stamps(options.stamps) for name in names}
    column = next((r.column for r in resolved.values()), 0)
    odometry_notes: list[str] = []
    odometry = content.odometry.track("ODOM", column, odometry_notes)
    truth = content.truth.track("TRUEPOS", column, notes)
    sensors: dict[str, SensorLog] = {}
    follows = False
    for name in names:
        scans, stamps = content.scans[name], resolved[name]
        directions = bearings(content, name, len(scans.ranges[0]), notes)
        placed = _place(content, scans, stamps.seconds, odometry, options.lone_poses, notes)
        follows |= placed.odometry_follows
        poses = placed.poses
        if truth is not None:
            poses = interpolate_poses(truth.stamps, truth.poses, stamps.seconds, max_gap=MAX_GAP)
            notes.append(f"{name}: reference poses are those of the TRUEPOS lines")
        radius, opening = ring_and_cone(content, name)
        sensors[name], found = scans.finish(
            _beam_mounts(placed.mount, directions, radius),
            options,
            stamps=stamps,
            poses=poses,
            odometry=placed.odometry,
            declared_max=declared_max(content, name),
            opening_angle=opening,
        )
        notes += found
    if follows and odometry is not None:
        odometry, odometry_notes = None, ["ODOM: the lines follow the corrected poses: they are not read as odometry"]
    return ScanLog(sensors, odometry, str(path), tuple(notes + odometry_notes), dict(content.parameters))


def _sensors_to_read(content: CarmenMessages, options: TextOptions) -> list[str]:
    asked = [name for name in content.scans if options.wants(name)]
    if options.sensors is None:
        raw = [n for n in asked if n.startswith("RAWLASER") and n.replace("RAW", "ROBOT") in asked]
        for name in raw:
            content.notes.append(
                f"{name}: not read, because {name.replace('RAW', 'ROBOT')} has the same scans with poses"
            )
        asked = [name for name in asked if name not in raw]
    return asked


class _Placed(NamedTuple):
    """A laser on the robot, and the robot in the world."""

    mount: FloatArray
    poses: FloatArray
    odometry: FloatArray
    odometry_follows: bool = False


def _place(
    content: CarmenMessages,
    scans: TextScans,
    stamps: FloatArray,
    odometry: Track | None,
    lone_poses: LonePoses,
    notes: list[str],
) -> _Placed:
    """Return the mount (3,), reference poses and odometry (t, 3), and whether the ODOM lines follow the reference."""
    name, mount = scans.name, declared_mount(content, scans.name)
    nothing = np.full((len(scans), 3), np.nan)
    driven = nothing
    if odometry is not None:
        driven = interpolate_poses(odometry.stamps, odometry.poses, stamps, max_gap=MAX_GAP)
    if name.startswith("RAWLASER"):
        notes.append(f"{name}: has no poses of its own; odometry is that of the ODOM lines")
        return _Placed(mount, nothing, driven)
    laser, robot = np.stack(scans.poses), np.stack(scans.odometry)
    seen = between(robot, laser)
    if name.startswith("ROBOTLASER"):
        scans.constant_mount(seen, CONSTANT)
    typical = middle_mount(seen)
    if np.abs(between(typical, seen)).max() > CONSTANT or np.hypot(typical[0], typical[1]) > FARTHEST_LASER:
        _note_mount(name, mount, notes)
        return _Placed(mount, compose(laser, invert(mount)), robot)
    # One trajectory. Equal poses are the laser's, as the mount says; else the second one is the robot's.
    if np.abs(typical).max() < 1e-9:
        poses = compose(laser, invert(mount))
    else:
        mount, poses = typical.round(6), robot
    _note_mount(name, mount, notes)
    if lone_poses == "odometry":
        return _Placed(mount, nothing, poses)
    notes.append(
        f"{name}: the log has one pose per scan, taken as the corrected (reference) pose; if the log is raw, it is "
        "odometry: read it with lone_poses='odometry'"
    )
    if odometry is None or _follows(driven, poses):
        return _Placed(mount, poses, nothing, odometry is not None)
    return _Placed(mount, poses, driven)


def _follows(odometry: FloatArray, poses: FloatArray) -> bool:
    """Whether odometry (t, 3) is in the frame of the poses; so it is if it is not known at any of them."""
    known = np.isfinite(odometry).all(axis=1)
    distance = np.hypot(*(odometry - poses)[known, :2].T)
    return not known.any() or bool(np.median(distance) < SAME_FRAME)


def _note_mount(name: str, mount: FloatArray, notes: list[str]) -> None:
    if np.abs(mount).max() > 0.0:
        x, y, theta = (mount + 0.0).tolist()  # 0, not -0
        notes.append(f"{name}: the laser is at ({x:.6g} m, {y:.6g} m, {np.degrees(theta):.6g} degrees) on the robot")


def _beam_mounts(mount: FloatArray, directions: FloatArray, radius: float) -> FloatArray:
    """Return where each beam starts on the robot, (k, 3): at the laser, or on a ring around it."""
    nothing = np.zeros_like(directions)
    mounts = compose(mount, np.column_stack([nothing, nothing, directions]))
    return mounts if radius == 0.0 else compose(mounts, [radius, 0.0, 0.0])
