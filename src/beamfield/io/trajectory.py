"""Trajectories: TUM and CSV files, and how they are attached to a log."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import checked, require
from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import FloatArray, interpolate_poses, wrap_angle, yaw_from_quaternion
from beamfield.io.files.atomic import write_file
from beamfield.io.files.text_lines import Line, is_number, read_lines
from beamfield.sensors import MAX_GAP, ScanLog, SensorLog, Track
from beamfield.short_repr import short_repr

TIME_NAMES = ("t", "time", "stamp", "timestamp", "sec", "seconds")
# More poses a stamp, on average, are no path: a filter's particles, or stamps rounded to whole seconds.
MOST_AT_ONCE = 5
# Files round their times; more than this is another log, or another scan of it.
SAME_TIME = 0.02
# A quaternion with a norm further from 1 is something else.
UNIT_TOLERANCE = 0.01
MAX_TILT_DEG = 20.0


@dataclass(frozen=True, eq=False)
class IndexedTrack(Track):
    """A trajectory whose poses say which scan they belong to.

    Parameters
    ----------
    scan_indices
        (t,) index of the scan, counted from 0 in the order of the log.
    """

    scan_indices: NDArray[np.int64]

    __repr__ = short_repr


def read_trajectory(path: str | Path) -> Track:
    """Read reference poses from a file, plain or gzip.

    Three kinds are recognised by their content:

    - TUM: ``t x y z qx qy qz qw``, separated by blanks, without a header. The heading is the yaw of the quaternion.
    - CSV with a header that names ``t`` (or time, stamp, timestamp), ``x``, ``y`` and ``theta`` (or yaw, or ``map_x``,
      ``map_y``, ``map_theta``), or ``qx qy qz qw`` instead of the heading. Only rows with ``good`` = 1 are used where
      there is such a column. With a column ``scan_index`` the result is an `IndexedTrack`.
    - A log that `beamfield.io.read_log.read_log` reads: the reference poses of its only sensor, or its odometry if
      there are none, as in the corrected logs that SLAM programs write.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    Poses in metres and radians with stamps in seconds that do not decrease.

    Raises
    ------
    FormatError
        If the text is none of these, a number is missing or not finite, stamps run backwards, or there is no pose; the
        line and the value are named. If the poses are a filter's particles.
    OSError
        As the file system says.
    """
    source = Path(path)
    track = read_poses(source)
    at_once = len(track) / len(np.unique(track.stamps))
    if at_once > MOST_AT_ONCE and not isinstance(track, IndexedTrack):
        raise FormatError(
            source,
            f"{at_once:.0f} poses at each time: a filter's particles, or rounded times; give the poses of one path "
            "(trajectory.tum, beside the particles that beamfield localize writes)",
        )
    return track


def read_poses(source: Path) -> Track:
    """Read what `read_trajectory` does, but any number of poses at a time."""
    rows = _rows(source)
    first = next(rows, None)
    if first is None:
        raise FormatError(source, "no poses: the file is empty")
    kind = _table_of(first)
    if kind == "csv":
        return _read_csv(first, rows)
    return _read_tum([first, *rows]) if kind == "tum" else _read_from_log(first)


def is_pose_table(path: str | Path) -> bool:
    """Return whether a file is a table of poses by its first row, TUM or CSV, and no log.

    FormatError if it is binary, or its gzip stream is damaged.
    """
    first = next(_rows(Path(path)), None)
    return first is not None and bool(_table_of(first))


def _table_of(first: Line) -> str:
    """Return "csv" or "tum", or "" for what is no table of poses."""
    names = [word.lower() for word in first.words]
    if any(name in TIME_NAMES for name in names) and any(name in ("x", "map_x", "tx") for name in names):
        return "csv"
    return "tum" if len(names) == 8 and is_number(names[0]) else ""


def write_tum(path: str | Path, track: Track) -> None:
    """Write a trajectory as TUM lines ``t x y z qx qy qz qw`` with nine decimals, whole or not at all.

    InvalidInputError if a pose or stamp is not finite.
    """
    poses = np.asarray(track.poses, dtype=np.float64)
    stamps = np.asarray(track.stamps, dtype=np.float64)
    if not (np.isfinite(poses).all() and np.isfinite(stamps).all()):
        raise InvalidInputError("track: expected finite poses and stamps; leave out the poses that are not known")
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    for stamp, (x, y, theta) in zip(stamps.tolist(), poses.tolist(), strict=True):
        lines.append(f"{stamp:.9f} {x:.9f} {y:.9f} 0 0 0 {np.sin(theta / 2.0):.12f} {np.cos(theta / 2.0):.12f}")
    write_file(path, "\n".join(lines) + "\n")


@checked
def attach_poses(log: ScanLog, track: Track, *, max_gap: float = MAX_GAP) -> ScanLog:
    """Return the log with the reference poses of a trajectory.

    An `IndexedTrack` belongs to one log: its poses go to the scans of those indices, if the log has one sensor. Its
    times must then differ from the stamps of those scans by a constant (the same run in another format may count from
    another zero), unless the log's stamps only number the scans. Scans without a pose in the file have none.

    Any other trajectory, and an `IndexedTrack` on a log with several sensors, is interpolated at the stamps of the
    scans.

    Parameters
    ----------
    log
        The log; its own reference poses are replaced.
    track
        Poses of the robot in the map's frame.
    max_gap
        Longest time in seconds between two poses that are interpolated.

    Returns
    -------
    The log, with a note. Scans outside the trajectory, or in gaps, have no reference pose (NaN).

    Raises
    ------
    InvalidInputError
        If no scan gets a pose, or indices or times show that the trajectory belongs to another log.
    """
    require(max_gap > 0.0, "max_gap", "seconds > 0", max_gap)
    sensors, notes = {}, list(log.notes)
    for name, sensor in log.sensors.items():
        if isinstance(track, IndexedTrack) and len(log.sensors) == 1:
            poses, how = _poses_by_index(log.source, sensor, track), "by scan index"
        else:
            poses = interpolate_poses(track.stamps, track.poses, sensor.stamps, max_gap=max_gap)
            how = "interpolated at their stamps"
        known = int(np.count_nonzero(np.isfinite(poses).all(axis=1)))
        if known == 0:
            raise InvalidInputError(_nothing_attached(log.source, name, sensor, track, max_gap))
        notes.append(f"{name}: {known} of {len(sensor)} scans have a reference pose from the given trajectory, {how}")
        sensors[name] = sensor.with_poses(poses)
    return replace(log, sensors=sensors, notes=tuple(notes))


def _rows(path: Path) -> Iterator[Line]:
    """Yield the header, if there is one, and the rows; of the comments only one before them may be the header."""
    started = False
    for number, text in read_lines(path):
        stripped = text.strip()
        content, is_csv, commented = stripped.lstrip("# "), "," in stripped, stripped.startswith("#")
        words = [w.strip() for w in content.split(",")] if is_csv else [w for w in re.split(r"[;\s]+", content) if w]
        # A comment counts only as the header of a CSV file; TUM files have one that names the same columns.
        is_header = is_csv and not started and any(word.lower() in TIME_NAMES for word in words)
        if stripped and (is_header or not commented):
            started = True
            yield Line(path, number, words)


def _read_tum(rows: list[Line]) -> Track:
    for row in rows:
        if len(row.words) != 8:
            raise row.error(f"expected 8 numbers (t x y z qx qy qz qw), got {len(row.words)}")
    numbers = np.array([row.finite(0, field="pose") for row in rows])
    return _checked(rows, numbers[:, 0], np.column_stack([numbers[:, 1:3], _yaw(rows, numbers[:, 4:])]))


def _read_csv(header: Line, rows: Iterator[Line]) -> Track:
    names = [word.lower() for word in header.words]
    columns = {name: i for i, name in reversed(list(enumerate(names)))}
    time = next(name for name in TIME_NAMES if name in columns)
    prefix = next(p for p in ("", "map_", "t") if p + "x" in columns)
    heading = next((n for n in (prefix + "theta", prefix + "yaw", "theta", "yaw") if n in columns), None)
    quaternion = [n for n in ("qx", "qy", "qz", "qw") if n in columns]
    if prefix + "y" not in columns or (heading is None and len(quaternion) != 4):
        found = ", ".join(names)[:80]
        raise header.error(f"expected columns for the time, x, y and theta (or qx qy qz qw), got {found!r}")
    needed = [columns[n] for n in (time, prefix + "x", prefix + "y", *([heading] if heading else quaternion))]
    kept, table, indices = [], [], []
    for row in rows:
        if len(row.words) != len(names):
            # A row is cut at its commas, and between them are what the header is cut at.
            commas = ": write a point for the decimal comma" if any(";" in word for word in row.words) else ""
            raise row.error(f"expected {len(names)} fields, got {len(row.words)}{commas}")
        if "good" in columns and row.pick([columns["good"]]).finite(0, field="good")[0] != 1.0:
            continue
        if "scan_index" in columns:
            indices.append(_index(row, row.words[columns["scan_index"]]))
        kept.append(row)
        table.append(row.pick(needed).finite(0, field="pose"))
    if not table:
        end = " with good = 1" if "good" in columns else ""
        raise FormatError(header.path, f"no poses: no row after the header{end}")
    numbers = np.array(table)
    theta = numbers[:, 3] if heading else _yaw(kept, numbers[:, 3:])
    track = _checked(kept, numbers[:, 0], np.column_stack([numbers[:, 1:3], theta]))
    if "scan_index" not in columns:
        return track
    falls = np.diff(indices) <= 0
    if falls.any():
        where = int(np.argmax(falls)) + 1
        raise kept[where].error(f"the indices do not increase: {indices[where]}", "scan_index")
    return IndexedTrack(track.stamps, track.poses, np.array(indices, dtype=np.int64))


def _index(row: Line, word: str) -> int:
    if not (word.isascii() and word.isdigit() and len(word) < 12):
        raise row.error(f"expected an index, got {word[:40]!r}", "scan_index")
    return int(word)


def _read_from_log(first: Line) -> Track:
    # Only files that are not tables of poses need the readers of logs.
    from beamfield.io.read_log import read_log

    try:
        sensor = read_log(first.path).only_sensor()
    except (FormatError, InvalidInputError) as error:
        start = " ".join(first.words[:4])[:60]
        expected = "expected poses (TUM lines, or CSV with a header t,x,y,theta) or a log"
        raise first.error(f"{expected}, got {start!r} ({error})") from error
    poses = sensor.poses if sensor.has_poses else sensor.odometry
    known = np.isfinite(poses).all(axis=1)
    if not known.any():
        raise FormatError(first.path, "the log has scans, but no poses")
    return Track(sensor.stamps[known], poses[known])


def _yaw(rows: list[Line], quaternions: FloatArray) -> FloatArray:
    norms = np.linalg.norm(quaternions, axis=1)
    worst = int(np.argmax(np.abs(norms - 1.0)))
    if abs(norms[worst] - 1.0) > UNIT_TOLERANCE:
        found = f"{quaternions[worst].tolist()} of norm {norms[worst]:.4g}"
        raise rows[worst].error(f"expected a unit quaternion, scalar last, got {found}")
    x, y, z, w = (quaternions / norms[:, None]).T
    # The cosine between the robot's upward axis and the map's.
    upright = 1.0 - 2.0 * (x * x + y * y)
    worst = int(np.argmin(upright))
    if upright[worst] < np.cos(np.radians(MAX_TILT_DEG)):
        tilt = np.degrees(np.arccos(np.clip(upright[worst], -1.0, 1.0)))
        raise rows[worst].error(f"the pose is tilted by {tilt:.3g} degrees; expected a robot on the floor, z upwards")
    return yaw_from_quaternion(x, y, z, w)


def _checked(rows: list[Line], stamps: FloatArray, poses: FloatArray) -> Track:
    steps = np.diff(stamps)
    if (steps < 0.0).any():
        where = int(np.argmax(steps < 0.0)) + 1
        raise rows[where].error(f"the stamps run backwards: {stamps[where]:.6f} s after {stamps[where - 1]:.6f} s")
    poses[:, 2] = wrap_angle(poses[:, 2])
    return Track(stamps, poses)


def _poses_by_index(source: str, sensor: SensorLog, track: IndexedTrack) -> FloatArray:
    last = int(track.scan_indices[-1])
    if last >= len(sensor):
        raise InvalidInputError(
            f"{source}: the trajectory has a pose for scan {last}, but the log has {len(sensor)} scans: another log?"
        )
    numbered = np.array_equal(sensor.stamps, np.arange(len(sensor)))
    offsets = track.stamps - sensor.stamps[track.scan_indices]
    apart = float(np.abs(offsets - np.median(offsets)).max())
    if apart > SAME_TIME and not numbered:
        raise InvalidInputError(
            f"{source}: the trajectory's times and scan indices do not match the stamps of the log (up to {apart:.3g} "
            "s apart after the best shift): another log?"
        )
    poses = np.full((len(sensor), 3), np.nan)
    poses[track.scan_indices] = track.poses
    return poses


def _nothing_attached(source: str, name: str, sensor: SensorLog, track: Track, max_gap: float) -> str:
    def span(stamps: Any) -> str:
        return f"{stamps[0]:.3f} to {stamps[-1]:.3f} s" if len(stamps) else "no time at all"

    return (
        f"{source}: no scan of {name!r} gets a pose: the scans are from {span(sensor.stamps)}, the trajectory from "
        f"{span(track.stamps)}; gaps up to {max_gap:g} s are bridged"
    )
