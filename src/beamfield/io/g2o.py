"""Pose graphs (.g2o) whose vertices carry laser scans: VERTEX_SE2 with ROBOTLASER1."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray, between, compose
from beamfield.io.text_lines import parse_count, parse_numbers, read_lines
from beamfield.io.text_scans import TextOptions, TextScans, finite_pose
from beamfield.sensors import ScanLog

MOUNT_TOLERANCE = 2e-3
ANGLE_LIMIT = 1e3


def read_g2o(path: str | Path, options: TextOptions | None = None) -> ScanLog:
    """Read a pose graph with scans.

    ``VERTEX_SE2 id x y theta`` is followed by the CARMEN message ``ROBOTLASER1`` of the scan taken there. The vertex is
    the reference pose, the laser's pose seen from the robot's is the mount. Edges and other vertices are not read.
    There is no odometry: the robot's pose of the message is that of the optimised graph in the graphs known to us.

    Parameters
    ----------
    path
        Plain or gzip.
    options
        What the user says about it; the sensor's name is ``ROBOTLASER1``.

    Raises
    ------
    FormatError
        If a line is cut off or has something else than numbers, a scan has no vertex, or the mount is not constant.
    """
    source = Path(path)
    scans = TextScans(source, "ROBOTLASER1")
    vertex: FloatArray | None = None
    mounts: list[FloatArray] = []
    head: FloatArray | None = None
    for line, text in read_lines(source):
        words = text.split()
        kind = words[0] if words else "#"
        if kind == "VERTEX_SE2":
            _expect(source, line, words, 5)
            vertex = finite_pose(source, line, parse_numbers(source, line, words[2:], kind), kind)
        elif kind == "ROBOTLASER1":
            if vertex is None:
                raise FormatError(source, "the scan has no line VERTEX_SE2 before it", line=line, field=kind)
            found, ranges, poses, stamps = _parse_scan(source, line, words)
            if head is not None and not np.array_equal(head[:3], found[:3]):
                raise scans.error(
                    line,
                    f"start angle, field of view and resolution {found[:3].tolist()} differ from those of the first "
                    f"scan, {head[:3].tolist()}",
                )
            head = found if head is None else head
            mounts.append(between(poses[3:], poses[:3]))
            scans.add(line, ranges, stamps, vertex)
            vertex = None
    if head is None:
        raise FormatError(source, "no scans: no line ROBOTLASER1 after a line VERTEX_SE2")
    mount = np.median(mounts, axis=0)
    off = np.abs(between(mount, np.stack(mounts))).max(axis=1)
    if off.max() > MOUNT_TOLERANCE:
        worst = int(np.argmax(off))
        raise scans.error(scans.lines[worst], f"the laser moves on the robot: {mounts[worst].round(4).tolist()}")
    n_beams = len(scans.ranges[0])
    beams = np.column_stack([np.zeros((n_beams, 2)), head[0] + head[2] * np.arange(n_beams)])
    declared = float(head[3]) if 0.0 < head[3] < np.inf else None
    sensor, notes = scans.finish(compose(mount.round(6), beams), options or TextOptions(), declared_max=declared)
    notes.append("ROBOTLASER1: reference poses are the vertices of the graph; there is no odometry")
    return ScanLog({"ROBOTLASER1": sensor}, None, str(source), tuple(notes))


def _parse_scan(
    path: Path, line: int, words: list[str]
) -> tuple[FloatArray, FloatArray, FloatArray, tuple[float, float]]:
    """Return (start, field of view, resolution, limit), ranges, the laser's and the robot's pose (6,), and stamps."""
    kind = "ROBOTLASER1"
    n = parse_count(path, line, words[8] if len(words) > 8 else "", kind)
    m = parse_count(path, line, words[9 + n] if len(words) > 9 + n else "", kind)
    _expect(path, line, words, 10 + n + m + 14)
    head = parse_numbers(path, line, words[2:6], kind)
    if not (np.abs(head[:3]) < ANGLE_LIMIT).all():
        raise FormatError(path, f"expected angles in radians, got {head[:3].tolist()}", line=line, field=kind)
    ranges = parse_numbers(path, line, words[9 : 9 + n], kind)
    poses = parse_numbers(path, line, words[10 + n + m : 16 + n + m], kind)
    poses = np.concatenate([finite_pose(path, line, poses[:3], kind), finite_pose(path, line, poses[3:], kind)])
    stamps = parse_numbers(path, line, (words[-3], words[-1]), kind)
    return head, ranges, poses, (float(stamps[0]), float(stamps[1]))


def _expect(path: Path, line: int, words: list[str], expected: int) -> None:
    if len(words) != expected:
        raise FormatError(
            path, f"expected {expected} words, got {len(words)}: the line is cut off, or its count is wrong",
            line=line, field=words[0],
        )  # fmt: skip
