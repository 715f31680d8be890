"""The eight-sonar log of the occupancy grid mapping exercise: measurement.txt beside poses.txt."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray
from beamfield.io.files.text_lines import Line, word_lines
from beamfield.io.logs.text_scans import DEFAULTS, TextOptions, TextScans, finite_pose
from beamfield.sensors import ScanLog

MEASUREMENTS, POSES = "measurement.txt", "poses.txt"
BEARINGS_DEG = (-90.0, -37.5, -22.5, -7.5, 7.5, 22.5, 37.5, 90.0)
OPENING_ANGLE_DEG = 20.0
# Millimetres, and tenths of a degree.
POSE_UNITS = np.array([1e-3, 1e-3, np.radians(0.1)])


def is_sonar_log(folder: Path) -> bool:
    """Whether a folder holds the two files of such a log."""
    return (folder / MEASUREMENTS).is_file() and (folder / POSES).is_file()


def read_sonar_log(folder: str | Path, options: TextOptions = DEFAULTS) -> ScanLog:
    """Read a folder with ``measurement.txt`` (t r1 ... r8) and ``poses.txt`` (t x y theta), line by line.

    Times in milliseconds, ranges and positions in millimetres, headings in tenths of a degree. The eight sonars look
    from the robot's centre to -90, -37.5, -22.5, -7.5, 7.5, 22.5, 37.5 and 90 degrees with cones of 20 degrees; their
    value for "no echo" is found in the data. The sensor is called ``sonar``. FormatError if a line has another number
    of words or something else than numbers, or the files' lines differ in number or time.
    """
    root = Path(folder)
    scans = TextScans(root / MEASUREMENTS, "sonar")
    poses = word_lines(root / POSES)
    for line in word_lines(root / MEASUREMENTS):
        time, *ranges = _numbers(line, 1 + len(BEARINGS_DEG))
        other = next(poses, None)
        pose = None if other is None else _numbers(other, 4)
        if other is None or pose is None or pose[0] != time:
            found = "none" if pose is None else f"{pose[0]:.10g}"
            raise line.error(f"the measurement at {time:.10g} ms has no pose: {POSES} has {found} there")
        scans.add(
            line.number, np.array(ranges) / 1000.0, (time / 1000.0,), finite_pose(other, pose[1:] * POSE_UNITS, "pose")
        )
    if not len(scans):
        raise FormatError(root / MEASUREMENTS, "no scans: the file is empty")
    if (more := next(poses, None)) is not None:
        raise more.error(f"the pose has no measurement: {MEASUREMENTS} ends after {len(scans)} of them")
    mounts = np.column_stack([np.zeros((len(BEARINGS_DEG), 2)), np.radians(BEARINGS_DEG)])
    nothing = np.full((len(scans), 3), np.nan)
    given = np.stack(scans.poses)
    reference = options.lone_poses == "reference"
    sensor, notes = scans.finish(
        mounts,
        options,
        poses=given if reference else nothing,
        odometry=nothing if reference else given,
        opening_angle=float(np.radians(OPENING_ANGLE_DEG)),
    )
    if reference:
        notes.append("sonar: the poses of the folder are read as reference; they may be odometry")
    return ScanLog({"sonar": sensor}, None, str(root), tuple(notes))


def _numbers(line: Line, n_words: int) -> FloatArray:
    if len(line.words) != n_words:
        raise line.error(f"expected {n_words} words, got {len(line.words)}")
    return line.numbers(0, field="number")
