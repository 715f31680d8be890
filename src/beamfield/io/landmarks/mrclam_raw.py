"""The text files of the UTIAS MRCLAM sets: what one robot saw, by barcode, its odometry and its true poses."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beamfield.detection_log import DetectionLog, group_detections
from beamfield.detections import SPURIOUS, UNKNOWN
from beamfield.errors import FormatError
from beamfield.geometry import FloatArray, interpolate_poses
from beamfield.io.files.text_lines import parse_numbers
from beamfield.io.files.text_rows import MAX_ID, expect_columns, word_rows
from beamfield.maps.landmarks import LandmarkMap

# Motion capture gives a pose a hundred times a second, but loses robots for seconds.
LONGEST_GAP_S = 0.5


def read_mrclam_barcodes(path: str | Path) -> dict[int, int]:
    """Read Barcodes.dat: rows ``subject barcode``; return the subject of each barcode.

    Parameters
    ----------
    path
        The file, plain or gzip.

    Raises
    ------
    FormatError
        If a row is no two whole numbers >= 0, a subject or a barcode appears twice, or there is no row.
    OSError
        As the file system says.
    """
    source = Path(path)
    subjects: dict[int, int] = {}
    for row, line in zip(*_table(source, "subject barcode"), strict=True):
        subject, barcode = (_whole(source, line, float(value), "barcodes") for value in row)
        if barcode in subjects or subject in subjects.values():
            raise FormatError(
                source, f"expected each subject and barcode once, got {subject} {barcode} again", line=line
            )
        subjects[barcode] = subject
    return subjects


def read_mrclam_measurements(
    path: str | Path,
    barcodes: Mapping[int, int],
    landmarks: LandmarkMap,
    *,
    groundtruth: str | Path | None = None,
) -> DetectionLog:
    """Read Robot*_Measurement.dat: rows ``time barcode range bearing``; rows of one time are one observation.

    A barcode of a subject in the map becomes that landmark's id. A barcode of another subject (a robot) becomes
    `SPURIOUS`: it is of no landmark of the map. A barcode that nobody wears was misread and becomes `UNKNOWN`.

    Parameters
    ----------
    path
        The file, plain or gzip.
    barcodes
        The subject of each barcode, from `read_mrclam_barcodes`.
    landmarks
        The map, from `beamfield.io.landmarks.landmark_files.read_mrclam_landmarks`; its ids are the subjects.
    groundtruth
        Robot*_Groundtruth.dat; without it, poses are NaN.

    Raises
    ------
    FormatError
        If a row has not 4 finite numbers, a barcode is no whole number >= 0, a time steps back, or there is no row.
    OSError
        As the file system says.
    """
    source = Path(path)
    rows, lines = _table_in_time(source, "time barcode range bearing")
    seen = [_whole(source, line, float(value), "barcode") for line, value in zip(lines, rows[:, 1], strict=True)]
    in_map = set(landmarks.ids.tolist())
    subjects = [barcodes.get(barcode, UNKNOWN) for barcode in seen]
    ids = np.array([subject if subject in in_map or subject == UNKNOWN else SPURIOUS for subject in subjects])
    stamps, observation = np.unique(rows[:, 0], return_inverse=True)
    poses = np.full((len(stamps), 3), np.nan)
    notes = [_note(ids)]
    if groundtruth is not None:
        poses = interpolate_poses(*read_mrclam_groundtruth(groundtruth), stamps, max_gap=LONGEST_GAP_S)
        n_without = int(np.isnan(poses[:, 0]).sum())
        notes.append(f"{n_without} of {len(stamps)} observations have no pose: the motion capture lost the robot.")
    return DetectionLog(poses, group_detections(observation, stamps, rows[:, 2], rows[:, 3], ids), notes=tuple(notes))


def read_mrclam_groundtruth(path: str | Path) -> tuple[FloatArray, FloatArray]:
    """Read Robot*_Groundtruth.dat: rows ``time x y theta``; return stamps (t,) and poses (t, 3).

    Parameters
    ----------
    path
        The file, plain or gzip.

    Raises
    ------
    FormatError
        If a row has not 4 finite numbers, a time steps back, or there is no row.
    OSError
        As the file system says.
    """
    rows, _ = _table_in_time(Path(path), "time x y theta")
    return rows[:, 0], rows[:, 1:]


def read_mrclam_odometry(path: str | Path) -> tuple[FloatArray, FloatArray]:
    """Read Robot*_Odometry.dat: rows ``time v w``; return stamps (t,) and velocities (t, 2), m/s and rad/s.

    Parameters
    ----------
    path
        The file, plain or gzip.

    Raises
    ------
    FormatError
        If a row has not 3 finite numbers, a time steps back, or there is no row.
    OSError
        As the file system says.
    """
    rows, _ = _table_in_time(Path(path), "time v w")
    return rows[:, 0], rows[:, 1:]


def _table_in_time(path: Path, columns: str) -> tuple[FloatArray, list[int]]:
    """Return the rows, whose first column is a time that does not step back, and the line of each."""
    rows, lines = _table(path, columns)
    times = rows[:, 0]
    back = np.diff(times) < 0.0
    if back.any():
        i = int(back.argmax()) + 1
        raise FormatError(
            path, f"expected times that rise, got {times[i]!s} after {times[i - 1]!s}", line=lines[i], field="time"
        )
    return rows, lines


def _table(path: Path, columns: str) -> tuple[FloatArray, list[int]]:
    """Return the rows and the line of each."""
    names = columns.split()
    rows, lines = [], []
    for line, words in word_rows(path):
        expect_columns(path, line, words, names)
        numbers = parse_numbers(path, line, words, "row")
        if not np.isfinite(numbers).all():
            i = int((~np.isfinite(numbers)).argmax())
            raise FormatError(path, f"expected a finite number, got {words[i][:40]!r}", line=line, field=names[i])
        rows.append(numbers)
        lines.append(line)
    if not rows:
        raise FormatError(path, f"no rows of {', '.join(names)}")
    return np.array(rows), lines


def _whole(path: Path, line: int, value: float, what: str) -> int:
    if not 0.0 <= value <= MAX_ID or value != int(value):
        raise FormatError(path, f"expected a whole number >= 0, got {value!r}", line=line, field=what)
    return int(value)


def _note(ids: NDArray[np.int64]) -> str:
    robots, nobody = int((ids == SPURIOUS).sum()), int((ids == UNKNOWN).sum())
    return f"Of {len(ids)} barcodes {robots} are of subjects that the map has not, {nobody} of nobody."
