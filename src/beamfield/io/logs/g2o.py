"""Pose graphs (.g2o) whose vertices carry laser scans: VERTEX_SE2 with ROBOTLASER1."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray, between, compose
from beamfield.io.files.text_lines import word_lines
from beamfield.io.logs.carmen_messages import LaserMessage, parse_laser_message, require_same_geometry
from beamfield.io.logs.text_scans import DEFAULTS, TextOptions, TextScans, finite_pose
from beamfield.sensors import ScanLog

MOUNT_TOLERANCE = 2e-3


def read_g2o(path: str | Path, options: TextOptions = DEFAULTS) -> ScanLog:
    """Read a pose graph with scans, plain or gzip; its sensor is called ``ROBOTLASER1``.

    ``VERTEX_SE2 id x y theta`` is followed by the CARMEN message ``ROBOTLASER1`` of the scan taken there. The vertex is
    the reference pose, the laser's pose seen from the robot's is the mount. Edges and other vertices are not read.
    There is no odometry: the robot's pose of the message is that of the optimised graph in the graphs known to us.

    FormatError if a line is cut off or has something else than numbers, a scan has no vertex, or the mount is not
    constant.
    """
    source = Path(path)
    scans = TextScans(source, "ROBOTLASER1")
    vertex: FloatArray | None = None
    mounts: list[FloatArray] = []
    first: LaserMessage | None = None
    for line in word_lines(source):
        kind = line.words[0]
        if kind == "VERTEX_SE2":
            line.expect_words(5)
            vertex = finite_pose(line, line.numbers(2))
        elif kind == "ROBOTLASER1":
            if vertex is None:
                raise line.error("the scan has no line VERTEX_SE2 before it", kind)
            message = parse_laser_message(line)
            first = first or message
            require_same_geometry(line, message.geometry, first.geometry)
            mounts.append(between(message.robot, message.laser))
            scans.add(line.number, message.ranges, message.stamps, vertex)
            vertex = None
    if first is None:
        raise FormatError(source, "no scans: no line ROBOTLASER1 after a line VERTEX_SE2")
    mount = scans.constant_mount(np.stack(mounts), MOUNT_TOLERANCE)
    n_beams = len(scans.ranges[0])
    bearings = first.geometry.start + first.geometry.resolution * np.arange(n_beams)
    beams = np.column_stack([np.zeros((n_beams, 2)), bearings])
    declared = first.max_range if 0.0 < first.max_range < np.inf else None
    sensor, notes = scans.finish(compose(mount.round(6), beams), options, declared_max=declared)
    notes.append("ROBOTLASER1: reference poses are the vertices of the graph; there is no odometry")
    return ScanLog({"ROBOTLASER1": sensor}, None, str(source), tuple(notes))
