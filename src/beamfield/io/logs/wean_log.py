"""Logs in the format of the Wean Hall data of Carnegie Mellon: O and L lines in centimetres."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beamfield.errors import FormatError
from beamfield.geometry import between, compose
from beamfield.io.files.text_lines import word_lines
from beamfield.io.logs.text_scans import DEFAULTS, TextOptions, TextScans, finite_pose, sorted_track
from beamfield.sensors import ScanLog

N_BEAMS = 180
CENTIMETRES = np.array([0.01, 0.01, 1.0])
# The laser's pose is printed with six digits; a mount that moves more than this is another format.
MOUNT_TOLERANCE = 1e-3


def read_wean_log(path: str | Path, options: TextOptions = DEFAULTS) -> ScanLog:
    """Read a log of O lines (odometry) and L lines (scans of the sensor ``L``), plain or gzip.

    ``O x y theta ts`` and ``L x y theta xl yl thetal r1 ... r180 ts``: the robot's and the laser's pose in the frame of
    the odometry, and 180 ranges counter-clockwise from -90 to +89 degrees; centimetres, radians, seconds. The laser's
    mount is its pose seen from the robot. There is no reference pose. FormatError if a line is neither, is cut off or
    has something else than numbers, or the mount is not constant.
    """
    source = Path(path)
    scans = TextScans(source, "L")
    lasers, odometry, odometry_stamps = [], [], []
    for line in word_lines(source):
        kind = line.words[0]
        if kind not in ("O", "L"):
            raise line.error(f"expected a line O or L, got {kind[:40]!r}")
        line.expect_words(5 if kind == "O" else 8 + N_BEAMS)
        numbers = line.numbers()
        pose = finite_pose(line, numbers[:3] * CENTIMETRES)
        if kind == "O":
            odometry.append(pose)
            odometry_stamps.append(numbers[3])
        else:
            lasers.append(finite_pose(line, numbers[3:6] * CENTIMETRES))
            scans.add(line.number, numbers[6:-1] / 100.0, (float(numbers[-1]),), odometry=pose)
    if not len(scans):
        raise FormatError(source, f"no scans: no line L among {len(odometry)} lines O")
    mount = scans.constant_mount(between(np.stack(scans.odometry), np.stack(lasers)), MOUNT_TOLERANCE)
    beams = np.column_stack([np.zeros((N_BEAMS, 2)), np.radians(-90.0 + np.arange(N_BEAMS))])
    stamps = scans.resolve_stamps(options.stamps)
    sensor, notes = scans.finish(compose(mount.round(4), beams), options, stamps=stamps)
    track = sorted_track(odometry_stamps, odometry, "O", notes, numbered=stamps.column is None)
    return ScanLog({"L": sensor}, track, str(source), tuple(notes))
