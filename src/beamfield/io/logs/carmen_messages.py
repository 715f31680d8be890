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
from beamfield.io.files.text_lines import Line, word_lines
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
        stamps = np.stack(self.stamps)[:, column or 0]
        return sorted_track(stamps, np.stack(self.poses), name, notes, numbered=column is None)


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

    def scans_of(self, name: str) -> TextScans:
        """Return the scans of one message, which may be the first one."""
        return self.scans.setdefault(name, TextScans(self.path, name))

    def number(self, parameter: str) -> float | None:
        """Return a parameter of the log as a finite number, None if it is not there or something else."""
        try:
            value = float(self.parameters[parameter])
        except (KeyError, ValueError):
            return None
        return value if np.isfinite(value) else None


def read_carmen_messages(path: Path) -> CarmenMessages:
    """Read all messages of a log.

    FormatError names the line if it is cut off, a count disagrees with its words, a word is no number, a pose is not
    finite, the number of beams changes, or there are no scans.
    """
    content = CarmenMessages(path)
    for line in word_lines(path):
        kind = line.words[0]
        if kind in OLD_STYLE:
            _parse_old_laser(content, line)
        elif CARMEN_SCANS.match(kind):
            _parse_laser(content, line)
        elif kind in ("ODOM", "TRUEPOS"):
            _parse_pose(content, line)
        elif kind == "PARAM":
            # name and value, with or without words of time
            if len(line.words) >= 3:
                content.parameters[line.words[1]] = line.words[2]
        elif kind.isascii() and kind[:1].isalpha():
            content.others[kind] += 1
        else:
            raise line.error(f"expected the name of a CARMEN message, got {kind[:40]!r}")
    if not content.scans:
        raise FormatError(path, "no scans: none of the messages FLASER, RLASER, ROBOTLASERn, RAWLASERn")
    if content.others:
        listed = ", ".join(f"{n} {kind[:40]}" for kind, n in content.others.most_common(10))
        content.notes.append(f"messages of other kinds, ignored: {listed}")
    return content


def _parse_old_laser(content: CarmenMessages, line: Line) -> None:
    """FLASER n ranges, x y theta, odom_x odom_y odom_theta, ipc_timestamp ipc_hostname logger_timestamp."""
    n = line.count(1)
    line.expect_words(2 + n + 9, f"{n} readings, two poses and 3 words of time")
    numbers = line.numbers(2, 8 + n)
    laser, robot = finite_pose(line, numbers[n : n + 3]), finite_pose(line, numbers[n + 3 :])
    content.scans_of(line.words[0]).add(line.number, numbers[:n], _stamps(line), laser, robot)


def _parse_laser(content: CarmenMessages, line: Line) -> None:
    """Add a ROBOTLASERn or RAWLASERn message, whose geometry may not change."""
    kind, message = line.words[0], parse_laser_message(line)
    require_same_geometry(line, message.geometry, content.geometry.setdefault(kind, message.geometry))
    if np.isfinite(message.max_range) and message.max_range > 0.0:
        content.limits.setdefault(kind, message.max_range)
    content.scans_of(kind).add(line.number, message.ranges, message.stamps, message.laser, message.robot)


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


def parse_laser_message(line: Line) -> LaserMessage:
    """Parse ROBOTLASERn and RAWLASERn, which differ in what follows the remission values.

    ``type start_angle field_of_view angular_resolution maximum_range accuracy remission_mode n ranges m remissions``;
    ROBOTLASERn then has ``laser_x y theta robot_x y theta laser_tv laser_rv forward_safety side_safety turn_axis``;
    both end with the three words of time.

    FormatError names line and value if the line is cut off, a count disagrees with its words, a word is no number, an
    angle is no angle, or a pose is not finite.
    """
    n = line.count(8)
    m = line.count(9 + n)
    own = 11 if line.words[0].startswith("ROBOT") else 0
    line.expect_words(10 + n + m + own + 3, f"{n} readings, {m} remission values and {own + 3} more")
    *angles, max_range = line.numbers(2, 6).tolist()
    if not all(abs(angle) < ANGLE_LIMIT for angle in angles):
        raise line.error(f"expected angles in radians, got {angles}", line.words[0])
    message = LaserMessage(LaserGeometry(*angles), max_range, line.numbers(9, 9 + n), _stamps(line))
    if not own:
        return message
    poses = line.numbers(10 + n + m, 16 + n + m)
    return message._replace(laser=finite_pose(line, poses[:3]), robot=finite_pose(line, poses[3:]))


def require_same_geometry(line: Line, geometry: LaserGeometry, first: LaserGeometry) -> None:
    """Raise the FormatError of a scan whose beams do not point where those of the first one do."""
    if geometry != first:
        text = "start angle, field of view and resolution {} differ from those of the first scan, {}"
        raise line.error(text.format(list(geometry), list(first)), line.words[0])


def _parse_pose(content: CarmenMessages, line: Line) -> None:
    """ODOM x y theta tv rv accel, or TRUEPOS true_x y theta odom_x y theta, and the three words of time."""
    is_odometry = line.words[0] == "ODOM"
    what = "a pose, two velocities, an acceleration" if is_odometry else "two poses"
    line.expect_words(10, f"{what} and 3 words of time")
    lines = content.odometry if is_odometry else content.truth
    lines.poses.append(finite_pose(line, line.numbers(1, 4)))
    lines.stamps.append(np.array(_stamps(line)))


def _stamps(line: Line) -> tuple[float, float]:
    """Return the timestamps of the message and of the logger, the third and the first word from the end."""
    field, n = f"{line.words[0]} timestamp", len(line.words)
    return float(line.numbers(n - 3, n - 2, field)[0]), float(line.numbers(n - 1, n, field)[0])
