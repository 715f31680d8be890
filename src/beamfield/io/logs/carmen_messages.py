"""The messages of a CARMEN log, line by line: what each says, unchecked against the others."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray
from beamfield.io.files.text_lines import expect_words, parse_count, parse_numbers, read_lines
from beamfield.io.logs.text_scans import TextScans, finite_pose, sorted_track
from beamfield.sensors import NO_POSE, Track

CARMEN_SCANS = re.compile(r"(FLASER|RLASER|LASER[345]|ROBOTLASER\d|RAWLASER\d)$")
OLD_STYLE = ("FLASER", "RLASER", "LASER3", "LASER4", "LASER5")
ANGLE_LIMIT = 1e3  # radians, or degrees by mistake: anything beyond is not an angle


@dataclass(eq=False)
class PoseLines:
    """Poses of ODOM or TRUEPOS lines with both their stamps."""

    poses: list[FloatArray] = field(default_factory=list)
    stamps: list[FloatArray] = field(default_factory=list)

    def track(self, name: str, column: int | None, notes: list[str]) -> Track | None:
        """Return the track with the stamps of the column that scans have; None if there is none, noting why."""
        if not self.poses:
            return None
        if column is None:
            notes.append(f"{name}: left out: scans are numbered, and these times cannot be matched to them")
            return None
        return sorted_track(np.stack(self.stamps)[:, column], np.stack(self.poses), name, notes)


@dataclass(eq=False)
class CarmenMessages:
    """What the lines of a file say.

    Parameters
    ----------
    path
        The file.
    scans
        Scans by the name of the message, in the order of the file.
    geometry
        Where the beams of ROBOTLASERn and RAWLASERn point.
    limits
        Their longest ranges, metres.
    odometry, truth
        ODOM and TRUEPOS lines.
    parameters
        PARAM lines.
    others
        How many messages of other kinds there are.
    notes
        What was not read.
    """

    path: Path
    scans: dict[str, TextScans] = field(default_factory=dict)
    geometry: dict[str, LaserGeometry] = field(default_factory=dict)
    limits: dict[str, float] = field(default_factory=dict)
    odometry: PoseLines = field(default_factory=PoseLines)
    truth: PoseLines = field(default_factory=PoseLines)
    parameters: dict[str, str] = field(default_factory=dict)
    others: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)

    def number(self, parameter: str) -> float | None:
        """Return a parameter of the log as a finite number, None if it is not there or something else."""
        try:
            value = float(self.parameters[parameter])
        except (KeyError, ValueError):
            return None
        return value if np.isfinite(value) else None


def read_carmen_messages(path: Path) -> CarmenMessages:
    """Read all messages of a log.

    Raises
    ------
    FormatError
        If a line is cut off, a count disagrees with its words, a word is no number, a pose is not finite, the number of
        beams changes, or there are no scans; the line is named.
    """
    content = CarmenMessages(path)
    for line, text in read_lines(path):
        words = text.split()
        if not words or words[0].startswith("#"):
            continue
        kind = words[0]
        if kind in OLD_STYLE:
            _parse_old_laser(content, line, words)
        elif CARMEN_SCANS.match(kind):
            _parse_laser(content, line, words)
        elif kind in ("ODOM", "TRUEPOS"):
            _parse_pose(content, line, words)
        elif kind == "PARAM":
            # name and value, with or without words of time
            if len(words) >= 3:
                content.parameters[words[1]] = words[2]
        elif kind.isascii() and kind[:1].isalpha():
            content.others[kind] += 1
        else:
            raise FormatError(path, f"expected the name of a CARMEN message, got {kind[:40]!r}", line=line)
    if not content.scans:
        raise FormatError(path, "no scans: none of the messages FLASER, RLASER, ROBOTLASERn, RAWLASERn")
    if content.others:
        listed = ", ".join(f"{n} {kind[:40]}" for kind, n in content.others.most_common(10))
        content.notes.append(f"messages of other kinds, ignored: {listed}")
    return content


def _parse_old_laser(content: CarmenMessages, line: int, words: list[str]) -> None:
    """FLASER n ranges, x y theta, odom_x odom_y odom_theta, ipc_timestamp ipc_hostname logger_timestamp."""
    path, kind = content.path, words[0]
    n = parse_count(path, line, _word(path, line, words, 1), kind)
    expect_words(path, line, words, 2 + n + 9, f"{n} readings, two poses and 3 words of time")
    ranges = parse_numbers(path, line, words[2 : 2 + n], kind)
    laser = finite_pose(path, line, parse_numbers(path, line, words[2 + n : 5 + n], kind), kind)
    robot = finite_pose(path, line, parse_numbers(path, line, words[5 + n : 8 + n], kind), kind)
    scans = content.scans.setdefault(kind, TextScans(path, kind))
    scans.add(line, ranges, _stamps(path, line, words), laser, robot)


def _parse_laser(content: CarmenMessages, line: int, words: list[str]) -> None:
    """Add a ROBOTLASERn or RAWLASERn message, whose geometry may not change."""
    kind = words[0]
    message = parse_laser_message(content.path, line, words)
    scans = content.scans.setdefault(kind, TextScans(content.path, kind))
    require_same_geometry(scans, line, message.geometry, content.geometry.setdefault(kind, message.geometry))
    if np.isfinite(message.max_range) and message.max_range > 0.0:
        content.limits.setdefault(kind, message.max_range)
    scans.add(line, message.ranges, message.stamps, message.laser, message.robot)


class LaserGeometry(NamedTuple):
    """Start angle, field of view and resolution of a ROBOTLASERn or RAWLASERn message, radians."""

    start: float
    field_of_view: float
    resolution: float


class LaserMessage(NamedTuple):
    """What a ROBOTLASERn or RAWLASERn message says; poses (3,) are NaN in the latter."""

    geometry: LaserGeometry
    max_range: float
    ranges: FloatArray
    stamps: tuple[float, float]
    laser: FloatArray = NO_POSE
    robot: FloatArray = NO_POSE


def parse_laser_message(path: Path, line: int, words: list[str]) -> LaserMessage:
    """Parse ROBOTLASERn and RAWLASERn, which differ in what follows the remission values.

    ``type start_angle field_of_view angular_resolution maximum_range accuracy remission_mode n ranges m remissions``;
    ROBOTLASERn then has ``laser_x y theta robot_x y theta laser_tv laser_rv forward_safety side_safety turn_axis``;
    both end with the three words of time.

    Raises
    ------
    FormatError
        If the line is cut off, a count disagrees with its words, a word is no number, an angle is no angle, or a pose
        is not finite; line and value are named.
    """
    kind = words[0]
    n = parse_count(path, line, _word(path, line, words, 8), kind)
    m = parse_count(path, line, _word(path, line, words, 9 + n), kind)
    own = 11 if kind.startswith("ROBOT") else 0
    expect_words(path, line, words, 10 + n + m + own + 3, f"{n} readings, {m} remission values and {own + 3} more")
    *angles, max_range = parse_numbers(path, line, words[2:6], kind).tolist()
    if not all(abs(angle) < ANGLE_LIMIT for angle in angles):
        raise FormatError(path, f"expected angles in radians, got {angles}", line=line, field=kind)
    ranges = parse_numbers(path, line, words[9 : 9 + n], kind)
    message = LaserMessage(LaserGeometry(*angles), max_range, ranges, _stamps(path, line, words))
    if not own:
        return message
    poses = parse_numbers(path, line, words[10 + n + m : 16 + n + m], kind)
    laser, robot = finite_pose(path, line, poses[:3], kind), finite_pose(path, line, poses[3:], kind)
    return message._replace(laser=laser, robot=robot)


def require_same_geometry(scans: TextScans, line: int, geometry: LaserGeometry, first: LaserGeometry) -> None:
    """Raise the FormatError of a scan whose beams do not point where those of the first one do."""
    if geometry != first:
        raise scans.error(
            line,
            f"start angle, field of view and resolution {list(geometry)} differ from those of the first scan, "
            f"{list(first)}",
        )


def _parse_pose(content: CarmenMessages, line: int, words: list[str]) -> None:
    """ODOM x y theta tv rv accel, or TRUEPOS true_x y theta odom_x y theta, and the three words of time."""
    path, kind = content.path, words[0]
    what = "a pose, two velocities, an acceleration" if kind == "ODOM" else "two poses"
    expect_words(path, line, words, 10, f"{what} and 3 words of time")
    lines = content.odometry if kind == "ODOM" else content.truth
    lines.poses.append(finite_pose(path, line, parse_numbers(path, line, words[1:4], kind), kind))
    lines.stamps.append(np.array(_stamps(path, line, words)))


def _word(path: Path, line: int, words: list[str], index: int) -> str:
    if index >= len(words):
        raise FormatError(path, f"the line is truncated after {len(words)} words", line=line, field=words[0])
    return words[index]


def _stamps(path: Path, line: int, words: list[str]) -> tuple[float, float]:
    """Return the timestamps of the message and of the logger, the third and the first word from the end."""
    pair = parse_numbers(path, line, (words[-3], words[-1]), f"{words[0]} timestamp")
    return float(pair[0]), float(pair[1])
