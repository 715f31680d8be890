"""Logs of GMapping (.gfs): scans with raw odometry, and the particles' poses after each scan."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.io.carmen_laser import SICK_BEARINGS
from beamfield.io.text_lines import expect_words, parse_count, parse_numbers, read_lines
from beamfield.io.text_scans import TextOptions, TextScans, finite_pose, sorted_track
from beamfield.sensors import ScanLog

IGNORED = ("ODO_UPDATE", "FRAME", "NEFF")


def read_gfs(path: str | Path, options: TextOptions | None = None) -> ScanLog:
    """Read a log of GMapping.

    ``LASER_READING n ranges x y theta ts`` has raw odometry. ``SM_UPDATE p`` and p times ``x y theta log_weight``
    are the particles after that scan, ``RESAMPLE p`` and p indices say which of them go on. The reference poses are the
    path of the particle with the greatest weight over its whole path, traced back through the resampling: the path that
    GMapping's corrected log and final map are made of.

    Parameters
    ----------
    path
        Plain or gzip.
    options
        What the user says about it; the sensor's name is ``LASER_READING``.

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
    scans = TextScans(source, "LASER_READING")
    particles: list[FloatArray | None] = []
    parents: list[NDArray[np.intp] | None] = []
    odometry, odometry_stamps = [], []
    parameters: dict[str, str] = {}
    for line, text in read_lines(source):
        words = text.split()
        if not words or words[0].startswith("#") or words[0] in IGNORED:
            continue
        kind = words[0]
        if kind == "PARAM":
            parameters[words[1] if len(words) > 1 else ""] = " ".join(words[2:])
        elif kind == "ODOM":
            expect_words(source, line, words, 5)
            numbers = parse_numbers(source, line, words[1:], kind)
            odometry.append(finite_pose(source, line, numbers[:3], kind))
            odometry_stamps.append(numbers[3])
        elif kind == "LASER_READING":
            n = _counted(source, line, words, 1, 4)
            numbers = parse_numbers(source, line, words[2:], kind)
            pose = finite_pose(source, line, numbers[n : n + 3], kind)
            scans.add(line, numbers[:n], (float(numbers[-1]),), odometry=pose)
            particles.append(None)
            parents.append(None)
        elif kind == "SM_UPDATE" and particles:
            _counted(source, line, words, 4, 0)
            particles[-1] = parse_numbers(source, line, words[2:], kind).reshape(-1, 4)
        elif kind == "RESAMPLE" and parents:
            _counted(source, line, words, 1, 0)
            parents[-1] = np.array([parse_count(source, line, word, kind) for word in words[2:]], dtype=np.intp)
        elif kind not in ("SM_UPDATE", "RESAMPLE"):
            raise FormatError(source, f"expected a line of a GMapping log, got {kind[:40]!r}", line=line)
    if not len(scans):
        raise FormatError(source, "no scans: no line LASER_READING")
    n_beams = len(scans.ranges[0])
    if n_beams not in SICK_BEARINGS:
        raise FormatError(
            source, f"{n_beams} beams: the format does not say where they point, known are {sorted(SICK_BEARINGS)}",
            line=scans.lines[0], field="LASER_READING",
        )  # fmt: skip
    start, step = SICK_BEARINGS[n_beams]
    beams = np.column_stack([np.zeros((n_beams, 2)), np.radians(start + step * np.arange(n_beams))])
    chosen = options or TextOptions()
    sensor, notes = scans.finish(
        beams, chosen, poses=_best_path(source, particles, parents), declared_max=_declared_max(parameters)
    )
    if sensor.has_poses:
        notes.append("LASER_READING: reference poses are the path of GMapping's best particle")
    track = sorted_track(odometry_stamps, odometry, "ODOM", notes) if odometry else None
    return ScanLog({"LASER_READING": sensor}, track, str(source), tuple(notes), parameters)


def _counted(path: Path, line: int, words: list[str], words_each: int, words_more: int) -> int:
    """Return the count in the second word, after checking that the line has as many words as that makes."""
    n = parse_count(path, line, words[1] if len(words) > 1 else "", words[0])
    expect_words(path, line, words, 2 + n * words_each + words_more)
    return n


def _best_path(path: Path, particles: list[FloatArray | None], parents: list[NDArray[np.intp] | None]) -> FloatArray:
    """Return (t, 3) poses of the particle with the greatest weight over its whole path; NaN where a scan has none."""
    known = [t for t, cloud in enumerate(particles) if cloud is not None]
    poses = np.full((len(particles), 3), np.nan)
    earlier, weights = np.zeros(1), np.zeros(1)
    for t in known:
        cloud, chosen = particles[t], parents[t]
        if cloud is None or len(cloud) == 0 or (len(earlier) not in (1, len(cloud))):
            raise FormatError(
                path, f"the number of particles changes at scan {t + 1} to {0 if cloud is None else len(cloud)}"
            )
        weights = earlier + cloud[:, 3]
        # Weights start again from 0 after resampling, so those before are carried along the ancestry.
        earlier = np.broadcast_to(earlier, weights.shape)
        if chosen is not None:
            if len(chosen) != len(cloud) or chosen.max() >= len(cloud):
                raise FormatError(path, f"scan {t + 1}: the resampled indices do not fit its {len(cloud)} particles")
            weights = earlier = weights[chosen]
    index = int(np.argmax(weights))
    for t in reversed(known):
        cloud, chosen = particles[t], parents[t]
        if cloud is not None:
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
