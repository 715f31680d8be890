"""CARMEN logs: FLASER, RLASER, ROBOTLASERn, RAWLASERn, ODOM, TRUEPOS and PARAM messages, one per line."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray, between, compose, interpolate_poses, invert
from beamfield.io.carmen_writer import OPENING_ANGLE, RING_RADIUS, write_carmen
from beamfield.io.scan_stamps import ScanStamps
from beamfield.io.text_lines import parse_count, parse_numbers, read_lines
from beamfield.io.text_scans import TextOptions, TextScans, finite_pose, sorted_track
from beamfield.sensors import ScanLog, SensorLog, Track

__all__ = ["CARMEN_SCANS", "read_carmen", "write_carmen"]

CARMEN_SCANS = re.compile(r"(FLASER|RLASER|LASER[345]|ROBOTLASER\d|RAWLASER\d)$")
OLD_STYLE = ("FLASER", "RLASER", "LASER3", "LASER4", "LASER5")
# First beam and step of a SICK LMS in degrees, by the number of beams. Checked on public logs: the right convention
# gives the sharpest map.
SICK_BEARINGS = {180: (-90.0, 1.0), 181: (-90.0, 1.0), 360: (-90.0, 0.5), 361: (-90.0, 0.5)}
# The poses of public logs have six digits or more; a pose in the frame of the odometry follows it closer than this.
CONSTANT = 2e-3
SAME_FRAME = 0.1
ANGLE_LIMIT = 1e3  # radians, or degrees by mistake: anything beyond is no angle
RING_LIMIT = 100.0  # metres: no robot is larger


def read_carmen(path: str | Path, options: TextOptions | None = None) -> ScanLog:
    """Read a log of the Carnegie Mellon robot navigation toolkit.

    FLASER and RLASER have two poses: the laser's, and the robot's in the frame of the odometry.

    - If they differ by a transform that is not constant, the first is the corrected pose: the reference; and the second
      is the odometry.
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

    Parameters
    ----------
    path
        Plain or gzip.
    options
        What the user says about it; sensors are called as their messages.

    Returns
    -------
    The log; its stamps are the first of the two timestamps of a line, or the second if those are not usable (see
    `beamfield.io.scan_stamps.resolve_stamps`). Messages of other kinds are counted in the notes.

    Raises
    ------
    FormatError
        If a line is cut off, a count disagrees with the words of the line, a word is no number, a pose is not finite,
        the number of beams changes, stamps run backwards, or there are no scans; the line is named.

    References
    ----------
    CARMEN manual, "logger and playback": the messages and their fields.
    """
    content = _parse(Path(path))
    chosen = options or TextOptions()
    names = _sensors_to_read(content, chosen)
    notes = list(content.notes)
    resolved = {name: content.scans[name].resolve_stamps(chosen.stamps) for name in names}
    column = next((r.column for r in resolved.values()), 0)
    odometry_notes: list[str] = []
    odometry = content.odometry.track("ODOM", column, odometry_notes)
    truth = content.truth.track("TRUEPOS", column, notes)
    sensors: dict[str, SensorLog] = {}
    follows = False
    for name in names:
        scans, stamps = content.scans[name], resolved[name]
        mounts, poses, driven, follows_odometry = _beams_and_poses(content, scans, stamps, chosen, odometry, notes)
        follows |= follows_odometry
        if truth is not None:
            poses = interpolate_poses(truth.stamps, truth.poses, stamps.seconds)
            notes.append(f"{name}: reference poses are those of the TRUEPOS lines")
        radius, opening = _ring_and_cone(content, name)
        sensors[name], found = scans.finish(
            compose(mounts, [radius, 0.0, 0.0]) if radius != 0.0 else mounts,
            chosen,
            stamps=stamps,
            poses=poses,
            odometry=driven,
            declared_max=_declared_max(content, name),
            opening_angle=opening,
        )
        notes += found
    if follows and odometry is not None:
        odometry, odometry_notes = None, ["ODOM: the lines follow the corrected poses: they are not read as odometry"]
    return ScanLog(sensors, odometry, str(path), tuple(notes + odometry_notes), dict(content.parameters))


@dataclass(eq=False)
class _Poses:
    """Poses of ODOM or TRUEPOS lines with both their stamps."""

    poses: list[FloatArray] = field(default_factory=list)
    stamps: list[FloatArray] = field(default_factory=list)

    def track(self, name: str, column: int | None, notes: list[str]) -> Track | None:
        if not self.poses:
            return None
        if column is None:
            notes.append(f"{name}: left out, because scans are numbered and its times do not fit that")
            return None
        return sorted_track(np.stack(self.stamps)[:, column], np.stack(self.poses), name, notes)


@dataclass(eq=False)
class _Content:
    """What the lines of a file say."""

    path: Path
    scans: dict[str, TextScans] = field(default_factory=dict)
    geometry: dict[str, tuple[float, ...]] = field(default_factory=dict)
    limits: dict[str, float] = field(default_factory=dict)
    odometry: _Poses = field(default_factory=_Poses)
    truth: _Poses = field(default_factory=_Poses)
    parameters: dict[str, str] = field(default_factory=dict)
    others: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)


def _parse(path: Path) -> _Content:
    content = _Content(path)
    for line, text in read_lines(path):
        words = text.split()
        if not words or words[0].startswith("#"):
            continue
        kind = words[0]
        if kind in OLD_STYLE:
            _parse_old_laser(content, line, words)
        elif CARMEN_SCANS.match(kind):
            _parse_laser(content, line, words)
        elif parser := _OTHER.get(kind):
            parser(content, line, words)
        elif kind.isascii() and kind[:1].isalpha():
            content.others[kind] += 1
        else:
            raise FormatError(path, f"expected the name of a CARMEN message, got {kind[:40]!r}", line=line)
    if not content.scans:
        raise FormatError(path, "no scans: none of the messages FLASER, RLASER, ROBOTLASERn, RAWLASERn")
    if content.others:
        listed = ", ".join(f"{n} {kind[:40]}" for kind, n in content.others.most_common(10))
        content.notes.append(f"messages of other kinds, not read: {listed}")
    return content


def _parse_old_laser(content: _Content, line: int, words: list[str]) -> None:
    """FLASER n ranges, x y theta, odom_x odom_y odom_theta, ipc_timestamp ipc_hostname logger_timestamp."""
    path, kind = content.path, words[0]
    n = parse_count(path, line, _word(content, line, words, 1), kind)
    _expect_words(content, line, words, 2 + n + 9, f"{n} readings, two poses and 3 words of time")
    ranges = parse_numbers(path, line, words[2 : 2 + n], kind)
    laser = finite_pose(path, line, parse_numbers(path, line, words[2 + n : 5 + n], kind), kind)
    robot = finite_pose(path, line, parse_numbers(path, line, words[5 + n : 8 + n], kind), kind)
    scans = content.scans.setdefault(kind, TextScans(path, kind))
    scans.add(line, ranges, _stamps(content, line, words), laser, robot)


def _parse_laser(content: _Content, line: int, words: list[str]) -> None:
    """Parse ROBOTLASERn and RAWLASERn, which differ in what follows the remission values.

    ``type start_angle field_of_view angular_resolution maximum_range accuracy remission_mode n ranges m remissions``;
    ROBOTLASERn then has ``laser_x y theta robot_x y theta laser_tv laser_rv forward_safety side_safety turn_axis``;
    both end with the three words of time.
    """
    path, kind = content.path, words[0]
    n = parse_count(path, line, _word(content, line, words, 8), kind)
    m = parse_count(path, line, _word(content, line, words, 9 + n), kind)
    own = 11 if kind.startswith("ROBOT") else 0
    _expect_words(content, line, words, 10 + n + m + own + 3, f"{n} readings, {m} remission values and {own + 3} more")
    head = parse_numbers(path, line, words[2:6], kind)
    geometry = (float(head[0]), float(head[2]), float(head[1]))
    if content.geometry.setdefault(kind, geometry) != geometry or not (np.abs(head[:3]) < ANGLE_LIMIT).all():
        raise FormatError(
            path, f"start angle, resolution and field of view {geometry} differ from those of the first scan, "
            f"{content.geometry[kind]}, or are no angles", line=line, field=kind,
        )  # fmt: skip
    if np.isfinite(head[3]) and head[3] > 0.0:
        content.limits.setdefault(kind, float(head[3]))
    ranges = parse_numbers(path, line, words[9 : 9 + n], kind)
    scans = content.scans.setdefault(kind, TextScans(path, kind))
    if not own:
        scans.add(line, ranges, _stamps(content, line, words))
        return
    poses = parse_numbers(path, line, words[10 + n + m : 16 + n + m], kind)
    laser, robot = finite_pose(path, line, poses[:3], kind), finite_pose(path, line, poses[3:], kind)
    scans.add(line, ranges, _stamps(content, line, words), laser, robot)


def _parse_odometry(content: _Content, line: int, words: list[str]) -> None:
    """ODOM x y theta tv rv accel, and the three words of time."""
    _expect_words(content, line, words, 10, "a pose, two velocities, an acceleration and 3 words of time")
    pose = parse_numbers(content.path, line, words[1:4], "ODOM")
    content.odometry.poses.append(finite_pose(content.path, line, pose, "ODOM"))
    content.odometry.stamps.append(np.array(_stamps(content, line, words)))


def _parse_truth(content: _Content, line: int, words: list[str]) -> None:
    """TRUEPOS true_x y theta odom_x y theta, and the three words of time."""
    _expect_words(content, line, words, 10, "two poses and 3 words of time")
    pose = parse_numbers(content.path, line, words[1:4], "TRUEPOS")
    content.truth.poses.append(finite_pose(content.path, line, pose, "TRUEPOS"))
    content.truth.stamps.append(np.array(_stamps(content, line, words)))


def _parse_parameter(content: _Content, line: int, words: list[str]) -> None:  # noqa: ARG001
    """PARAM name value, with or without words of time."""
    if len(words) >= 3:
        content.parameters[words[1]] = words[2]


_OTHER: dict[str, Callable[[_Content, int, list[str]], None]] = {
    "ODOM": _parse_odometry,
    "TRUEPOS": _parse_truth,
    "PARAM": _parse_parameter,
}


def _word(content: _Content, line: int, words: list[str], index: int) -> str:
    if index >= len(words):
        raise FormatError(content.path, f"the line is cut off after {len(words)} words", line=line, field=words[0])
    return words[index]


def _expect_words(content: _Content, line: int, words: list[str], expected: int, what: str) -> None:
    if len(words) != expected:
        raise FormatError(
            content.path,
            f"expected {expected} words ({what}), got {len(words)}: the line is cut off, or its count is wrong",
            line=line, field=words[0],
        )  # fmt: skip


def _stamps(content: _Content, line: int, words: list[str]) -> tuple[float, float]:
    """Return the timestamps of the message and of the logger, the third and the first word from the end."""
    pair = parse_numbers(content.path, line, (words[-3], words[-1]), f"{words[0]} timestamp")
    return float(pair[0]), float(pair[1])


def _sensors_to_read(content: _Content, options: TextOptions) -> list[str]:
    asked = [name for name in content.scans if options.wants(name)]
    if options.sensors is None:
        raw = [n for n in asked if n.startswith("RAWLASER") and n.replace("RAW", "ROBOT") in asked]
        for name in raw:
            content.notes.append(
                f"{name}: not read, because {name.replace('RAW', 'ROBOT')} has the same scans with poses"
            )
        asked = [name for name in asked if name not in raw]
    return asked


def _beams_and_poses(
    content: _Content,
    scans: TextScans,
    stamps: ScanStamps,
    options: TextOptions,
    odometry: Track | None,
    notes: list[str],
) -> tuple[FloatArray, FloatArray, FloatArray, bool]:
    """Return mounts (k, 3), reference poses and odometry (t, 3), and whether the ODOM lines follow the reference."""
    name = scans.name
    bearings = _bearings(content, name, len(scans.ranges[0]), notes)
    mount = _declared_mount(content, name)
    nothing = np.full((len(scans), 3), np.nan)
    at_scans = nothing if odometry is None else interpolate_poses(odometry.stamps, odometry.poses, stamps.seconds)
    if name.startswith("RAWLASER"):
        notes.append(f"{name}: has no poses of its own; odometry is that of the ODOM lines")
        return _mounted(mount, bearings), nothing, at_scans, False
    laser, robot = np.stack(scans.poses), np.stack(scans.odometry)
    seen = between(robot, laser)
    typical = np.median(seen, axis=0)
    if np.abs(between(typical, seen)).max() > CONSTANT:
        if name.startswith("ROBOTLASER"):
            worst = int(np.argmax(np.abs(between(typical, seen)).max(axis=1)))
            raise scans.error(
                scans.lines[worst], f"the laser moves on the robot: its mount is {seen[worst].round(4).tolist()}, "
                f"elsewhere {typical.round(4).tolist()}",
            )  # fmt: skip
        _note_mount(name, mount, notes)
        return _mounted(mount, bearings), compose(laser, invert(mount)), robot, False
    # One trajectory. Equal poses are the laser's, as the mount says; else the second one is the robot's.
    equal = bool(np.abs(typical).max() < 1e-9)
    if equal and not name.startswith("ROBOTLASER"):
        poses = compose(laser, invert(mount))
    else:
        mount, poses = typical.round(6), robot
    _note_mount(name, mount, notes)
    if options.lone_poses == "odometry":
        return _mounted(mount, bearings), nothing, poses, False
    notes.append(
        f"{name}: the log has one pose per scan, taken as the corrected (reference) pose; if the log is raw, it is "
        "odometry: read it with lone_poses='odometry' and bring reference poses"
    )
    known = np.isfinite(at_scans).all(axis=1)
    if not known.any():
        return _mounted(mount, bearings), poses, nothing, odometry is not None
    distance = np.hypot(*(at_scans - poses)[known, :2].T)
    follows = bool(np.median(distance) < SAME_FRAME)
    return _mounted(mount, bearings), poses, nothing if follows else at_scans, follows


def _note_mount(name: str, mount: FloatArray, notes: list[str]) -> None:
    if np.abs(mount).max() > 0.0:
        x, y, theta = mount.tolist()
        notes.append(f"{name}: the laser is at ({x:.6g} m, {y:.6g} m, {np.degrees(theta):.6g} degrees) on the robot")


def _bearings(content: _Content, name: str, n_beams: int, notes: list[str]) -> FloatArray:
    index = np.arange(n_beams, dtype=np.float64)
    if name in content.geometry:
        start, step, span = content.geometry[name]
        if n_beams > 1 and not 0.0 < abs(step) * (n_beams - 1) < 2.1 * np.pi:
            step = span / (n_beams - 1)
            notes.append(
                f"{name}: the resolution makes no sense, {np.degrees(step):.4g} degrees from the field of view"
            )
        return np.asarray(start + step * index)
    side = {"FLASER": "front", "RLASER": "rear"}.get(name, name.lower())
    start_angle = _number(content, f"laser_{side}_laser_start_angle")
    step_deg = _number(content, f"laser_{side}_laser_resolution")
    if start_angle is not None and step_deg is not None and step_deg > 0.0:
        return np.asarray(start_angle + np.radians(step_deg) * index)
    if n_beams in SICK_BEARINGS:
        start_deg, step_deg = SICK_BEARINGS[n_beams]
        return np.asarray(np.radians(start_deg + step_deg * index))
    span_or_none = _number(content, f"laser_{side}_laser_fov")
    span = np.pi if span_or_none is None or not 0.0 < span_or_none <= 2.0 * np.pi else span_or_none
    notes.append(
        f"{name}: {n_beams} beams are no usual number and the log does not say where they point: taken as spanning "
        f"{np.degrees(span):.4g} degrees, from right to left"
    )
    return np.linspace(-span / 2.0, span / 2.0, n_beams)


def _declared_mount(content: _Content, name: str) -> FloatArray:
    if name in ("RLASER", "RAWLASER2"):
        return np.array([_number(content, "robot_rearlaser_offset") or 0.0, 0.0, np.pi])
    front = name in ("FLASER", "RAWLASER1")
    return np.array([(_number(content, "robot_frontlaser_offset") or 0.0) if front else 0.0, 0.0, 0.0])


def _declared_max(content: _Content, name: str) -> float | None:
    if name in content.limits:
        return content.limits[name]
    side = {"FLASER": "front", "RLASER": "rear"}.get(name)
    limit = _number(content, f"robot_{side}_laser_max") if side else None
    return limit if limit is not None and limit > 0.0 else None


def _ring_and_cone(content: _Content, name: str) -> tuple[float, float]:
    """Return how far from the sensor's origin its beams start, and how wide they are; 0 and 0 if the log is silent."""
    if name != "FLASER":
        return 0.0, 0.0
    values = []
    for parameter, limit in ((RING_RADIUS, RING_LIMIT), (OPENING_ANGLE, np.pi)):
        value = 0.0
        if parameter in content.parameters:
            known = _number(content, parameter)
            value = np.nan if known is None else known
        # A negative radius is that of a ring of sensors that look inwards.
        if not (abs(value) < limit and (value >= 0.0 or parameter == RING_RADIUS)):
            raise FormatError(
                content.path,
                f"expected a number below {limit:.6g}, got {content.parameters[parameter][:40]!r}",
                field=parameter,
            )
        values.append(value)
    return values[0], values[1]


def _number(content: _Content, parameter: str) -> float | None:
    """Return a parameter of the log as a finite number, None if it is not there or something else."""
    try:
        value = float(content.parameters[parameter])
    except (KeyError, ValueError):
        return None
    return value if np.isfinite(value) else None


def _mounted(mount: FloatArray, bearings: FloatArray) -> FloatArray:
    beams = np.column_stack([np.zeros_like(bearings), np.zeros_like(bearings), bearings])
    return compose(mount, beams)
