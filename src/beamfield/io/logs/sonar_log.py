"""The eight-sonar log of the occupancy grid mapping exercise: measurement.txt beside poses.txt."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray
from beamfield.io.files.text_lines import parse_numbers, read_lines
from beamfield.io.logs.text_scans import TextOptions, TextScans, finite_pose
from beamfield.sensors import ScanLog

MEASUREMENTS, POSES = "measurement.txt", "poses.txt"
BEARINGS_DEG = (-90.0, -37.5, -22.5, -7.5, 7.5, 22.5, 37.5, 90.0)
OPENING_ANGLE_DEG = 20.0
# Millimetres, and tenths of a degree.
POSE_UNITS = np.array([1e-3, 1e-3, np.radians(0.1)])


def is_sonar_log(folder: Path) -> bool:
    """Whether a folder holds the two files of such a log."""
    return (folder / MEASUREMENTS).is_file() and (folder / POSES).is_file()


def read_sonar_log(folder: str | Path, options: TextOptions | None = None) -> ScanLog:
    """Read a folder with ``measurement.txt`` (t r1 ... r8) and ``poses.txt`` (t x y theta), line by line.

    Times in milliseconds, ranges and positions in millimetres, headings in tenths of a degree. The eight sonars look
    from the robot's centre to -90, -37.5, -22.5, -7.5, 7.5, 22.5, 37.5 and 90 degrees with cones of 20 degrees; their
    value for "no echo" is found in the data.

    Parameters
    ----------
    folder
        Where the two files are.
    options
        What the user says about it; the sensor's name is ``sonar``.

    Raises
    ------
    FormatError
        If a line has another number of words or something else than numbers, or the files' lines differ in number or
        time.
    """
    root = Path(folder)
    chosen = options or TextOptions()
    scans = TextScans(root / MEASUREMENTS, "sonar")
    poses = list(_rows(root / POSES, 4))
    for i, (line, row) in enumerate(_rows(root / MEASUREMENTS, 1 + len(BEARINGS_DEG))):
        if i >= len(poses) or poses[i][1][0] != row[0]:
            other = f"{poses[i][1][0]:.10g}" if i < len(poses) else "none"
            raise FormatError(
                root / MEASUREMENTS,
                f"the measurement at {row[0]:.10g} ms has no pose: {POSES} has {other} there",
                line=line,
            )
        pose_line, pose = poses[i]
        scans.add(
            line, row[1:] / 1000.0, (row[0] / 1000.0,),
            finite_pose(root / POSES, pose_line, pose[1:] * POSE_UNITS, "pose"),
        )  # fmt: skip
    if not len(scans):
        raise FormatError(root / MEASUREMENTS, "no scans: the file is empty")
    mounts = np.column_stack([np.zeros((len(BEARINGS_DEG), 2)), np.radians(BEARINGS_DEG)])
    nothing = np.full((len(scans), 3), np.nan)
    given = np.stack(scans.poses)
    reference = chosen.lone_poses == "reference"
    sensor, notes = scans.finish(
        mounts,
        chosen,
        poses=given if reference else nothing,
        odometry=nothing if reference else given,
        opening_angle=float(np.radians(OPENING_ANGLE_DEG)),
    )
    if reference:
        notes.append("sonar: the poses of the folder are read as reference; they may be odometry")
    return ScanLog({"sonar": sensor}, None, str(root), tuple(notes))


def _rows(path: Path, n_words: int) -> list[tuple[int, FloatArray]]:
    rows = []
    for line, text in read_lines(path):
        words = text.split()
        if not words:
            continue
        if len(words) != n_words:
            raise FormatError(path, f"expected {n_words} words, got {len(words)}", line=line)
        rows.append((line, parse_numbers(path, line, words, "number")))
    return rows
