"""Logs of GMapping (.gfs): scans with raw odometry, and the particles' poses after each scan."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.io.files.text_lines import Line, word_lines
from beamfield.io.logs.carmen_laser import SICK_BEARINGS
from beamfield.io.logs.text_scans import ABSURD, DEFAULTS, TextOptions, TextScans, finite_pose, sorted_track
from beamfield.sensors import ScanLog

IGNORED = ("ODO_UPDATE", "FRAME", "NEFF")


def read_gfs(path: str | Path, options: TextOptions = DEFAULTS) -> ScanLog:
    """Read a log of GMapping, plain or gzip; its sensor is called ``LASER_READING``.

    ``LASER_READING n ranges x y theta ts`` has raw odometry. ``SM_UPDATE p`` and p times ``x y theta log_weight``
    are the particles after that scan, ``RESAMPLE p`` and p indices say which of them go on. The reference poses are the
    path of the particle with the greatest weight over its whole path, traced back through the resampling: the path that
    GMapping's corrected log and final map are made of.

    Raises
    ------
    FormatError
        If a line is cut off, has something else than numbers, or counts disagree; the line is named.

    References
    ----------
    Grisetti, Stachniss and Burgard, "Improved techniques for grid mapping with Rao-Blackwellized particle filters",
    IEEE Transactions on Robotics 23(1), 2007.
    """
    source = Path(path)
    content = _parse(source)
    scans = content.scans
    n_beams = len(scans.ranges[0])
    if n_beams not in SICK_BEARINGS:
        raise FormatError(
            source,
            f"{n_beams} beams: the format does not give their bearings, known only for {sorted(SICK_BEARINGS)}",
            line=scans.lines[0], field="LASER_READING",
        )  # fmt: skip
    start, step = SICK_BEARINGS[n_beams]
    stamps = scans.resolve_stamps(options.stamps)
    beams = np.column_stack([np.zeros((n_beams, 2)), np.radians(start + step * np.arange(n_beams))])
    sensor, notes = scans.finish(
        beams,
        options,
        stamps=stamps,
        poses=_best_path(source, content.particles, content.parents),
        declared_max=_declared_max(content.parameters),
    )
    if sensor.has_poses:
        notes.append("LASER_READING: reference poses are the path of GMapping's best particle")
    track = sorted_track(content.odometry_stamps, content.odometry, "ODOM", notes, numbered=stamps.column is None)
    return ScanLog({"LASER_READING": sensor}, track, str(source), tuple(notes), content.parameters)


@dataclass(eq=False)
class _Content:
    """What the lines say; particles (p, 4) and parents (p,) scan by scan, None where a scan has none."""

    scans: TextScans
    particles: list[FloatArray | None] = field(default_factory=list)
    parents: list[NDArray[np.intp] | None] = field(default_factory=list)
    odometry: list[FloatArray] = field(default_factory=list)
    odometry_stamps: list[float] = field(default_factory=list)
    parameters: dict[str, str] = field(default_factory=dict)


def _parse(path: Path) -> _Content:
    content = _Content(TextScans(path, "LASER_READING"))
    for line in word_lines(path):
        kind = line.words[0]
        if kind in IGNORED:
            continue
        if kind == "PARAM":
            content.parameters[" ".join(line.words[1:2])] = " ".join(line.words[2:])
        elif kind == "ODOM":
            line.expect_words(5)
            numbers = line.numbers()
            content.odometry.append(finite_pose(line, numbers[:3]))
            content.odometry_stamps.append(float(numbers[3]))
        elif kind == "LASER_READING":
            n = line.count(1)
            line.expect_words(2 + n + 4)
            numbers = line.numbers(2)
            pose = finite_pose(line, numbers[n : n + 3])
            content.scans.add(line.number, numbers[:n], (float(numbers[-1]),), odometry=pose)
            content.particles.append(None)
            content.parents.append(None)
        elif kind == "SM_UPDATE" and content.particles:
            line.expect_words(2 + 4 * line.count(1))
            content.particles[-1] = _particles(line)
        elif kind == "RESAMPLE" and content.parents:
            n = line.count(1)
            line.expect_words(2 + n)
            content.parents[-1] = np.array([line.count(i) for i in range(2, 2 + n)], dtype=np.intp)
        elif kind not in ("SM_UPDATE", "RESAMPLE"):
            raise line.error(f"expected a line of a GMapping log, got {kind[:40]!r}")
    if not len(content.scans):
        raise FormatError(path, "no scans: no line LASER_READING")
    return content


def _particles(line: Line) -> FloatArray:
    """Return (p, 4) poses and logarithms of weights; a weight of 0 is not a mistake."""
    cloud = line.numbers(2).reshape(-1, 4)
    good = (np.abs(cloud[:, :3]) < ABSURD).all(axis=1) & (cloud[:, 3] < np.inf)
    if not good.all():
        found = " ".join(map(str, cloud[int(np.argmin(good))].tolist()))
        raise line.error(f"expected a finite pose and its weight, got {found}", line.words[0])
    return cloud


def _best_path(path: Path, particles: list[FloatArray | None], parents: list[NDArray[np.intp] | None]) -> FloatArray:
    """Return (t, 3) poses of the particle with the greatest weight over its whole path; NaN where a scan has none."""
    updates = enumerate(zip(particles, parents, strict=True))
    known = [(t, cloud, chosen) for t, (cloud, chosen) in updates if cloud is not None]
    poses = np.full((len(particles), 3), np.nan)
    earlier, weights = np.zeros(1), np.zeros(1)
    for t, cloud, chosen in known:
        if len(cloud) == 0 or len(earlier) not in (1, len(cloud)):
            raise FormatError(path, f"the number of particles changes at scan {t + 1} to {len(cloud)}")
        weights = earlier + cloud[:, 3]
        # Weights start again from 0 after resampling, so those before are carried along the ancestry.
        earlier = np.broadcast_to(earlier, weights.shape)
        if chosen is not None:
            if len(chosen) != len(cloud) or chosen.max() >= len(cloud):
                raise FormatError(path, f"scan {t + 1}: the resampled indices do not fit its {len(cloud)} particles")
            weights = earlier = weights[chosen]
    index = int(np.argmax(weights))
    for t, cloud, chosen in reversed(known):
        index = index if chosen is None else int(chosen[index])
        poses[t] = cloud[index, :3]
    poses[:, 2] = wrap_angle(poses[:, 2])
    return poses


def _declared_max(parameters: dict[str, str]) -> float | None:
    try:
        limit = float(parameters.get("maxrange", ""))
    except ValueError:
        return None
    return limit if 0.0 < limit < np.inf else None
