"""Files of landmarks and of what robots saw of them: CSV, UTIAS MRCLAM, and the Freiburg course."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from beamfield.detections import Detections
from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.io.files.text_lines import parse_numbers
from beamfield.io.files.text_rows import (
    IdRows,
    csv_rows,
    expect_columns,
    finite_numbers,
    parse_id,
    word_rows,
    write_csv,
)
from beamfield.maps.landmarks import LandmarkMap, SignatureKind


@dataclass(frozen=True, eq=False)
class CourseLog:
    """Odometry and features of the Freiburg course, step by step.

    Parameters
    ----------
    odometry
        (t, 3) each step's motion: first rotation, translation, second rotation; radians and metres.
    detections
        What the robot saw after each step; ids are known.
    """

    odometry: FloatArray
    detections: tuple[Detections, ...]

    def __len__(self) -> int:
        return len(self.detections)


def read_landmarks(path: str | Path) -> LandmarkMap:
    """Read a map of landmarks from CSV, plain or gzip.

    The header is ``id,x,y``, then nothing, or ``signature`` (a number), or ``type`` (0, 1, 2 ...), or ``signature_1,
    signature_2, ...`` (a vector). Blank lines, and lines that begin with #, are left out.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    FormatError
        If the header is another, a value is no finite number, a row has another length, an id is no whole number >= 0
        or appears twice, or there is no landmark; the line and the value are named.
    OSError
        As the file system says.
    """
    source = Path(path)
    rows = csv_rows(source)
    line, header = next(rows, (None, []))
    names = [name.lower() for name in header]
    kind = _kind_of(names[3:])
    if names[:3] != ["id", "x", "y"] or kind is None:
        raise FormatError(
            source,
            f"expected the header id,x,y and then nothing, signature, type, or signature_1,signature_2,...; "
            f"got {','.join(header)[:80]!r}",
            line=line,
        )
    landmarks = IdRows(source, "landmark")
    for line, words in rows:
        if len(words) != len(header):
            raise FormatError(source, f"expected {len(header)} values, got {len(words)}", line=line)
        landmarks.add(line, words)
    return _as_map(landmarks, kind)


def write_landmarks(path: str | Path, landmarks: LandmarkMap) -> None:
    """Write a map of landmarks as CSV that `read_landmarks` reads back without loss; an existing file is replaced.

    Parameters
    ----------
    path
        The file.
    landmarks
        The map.

    Raises
    ------
    OSError
        As the file system says; the old file is left as it was.
    """
    columns, names = [landmarks.positions], ["id", "x", "y"]
    if landmarks.signatures is not None:
        columns.append(landmarks.signatures.reshape(len(landmarks), -1))
        d = columns[-1].shape[1]
        names += (
            [f"signature_{i + 1}" for i in range(d)]
            if landmarks.kind == "vector"
            else ["type" if landmarks.kind == "type" else "signature"]
        )
    rows = []
    for which, values in zip(landmarks.ids.tolist(), np.column_stack(columns).tolist(), strict=True):
        shown = [repr(value) for value in values]
        if landmarks.kind == "type":
            shown[-1] = str(int(values[-1]))
        rows.append([which, *shown])
    write_csv(path, names, rows)


def read_mrclam_landmarks(path: str | Path) -> LandmarkMap:
    """Read Landmark_Groundtruth.dat of the UTIAS MRCLAM sets, plain or gzip.

    Rows are ``subject x y x_std y_std``; the standard deviations of the survey (below a millimetre) are checked and
    left out.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    FormatError
        If a row has not 5 finite numbers, a deviation is negative, an id is no whole number >= 0 or appears twice, or
        there is no landmark.
    OSError
        As the file system says.
    """
    source = Path(path)
    landmarks = IdRows(source, "landmark")
    for line, words in word_rows(source):
        expect_columns(source, line, words, ("subject", "x", "y", "x_std", "y_std"))
        deviations = parse_numbers(source, line, words[3:], "standard deviation")
        if not (np.isfinite(deviations) & (deviations >= 0.0)).all():
            raise FormatError(
                source, f"expected standard deviations >= 0, got {words[3]!r} and {words[4]!r}", line=line
            )
        landmarks.add(line, words[:3])
    return _as_map(landmarks, "none")


def read_course_world(path: str | Path) -> LandmarkMap:
    """Read world.dat of the Freiburg course: rows ``id x y``.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    FormatError
        If a row has not 3 finite numbers, an id is no whole number >= 0 or appears twice, or there is no landmark.
    OSError
        As the file system says.
    """
    source = Path(path)
    landmarks = IdRows(source, "landmark")
    for line, words in word_rows(source):
        expect_columns(source, line, words, ("id", "x", "y"))
        landmarks.add(line, words)
    return _as_map(landmarks, "none")


def read_course_log(path: str | Path) -> CourseLog:
    """Read sensor_data.dat of the Freiburg course.

    ``ODOMETRY rotation translation rotation`` begins a step, ``SENSOR id range bearing`` are its features. Values are
    kept as they are: the file has a negative range and bearings beyond pi, and `Detections` says what they mean.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    FormatError
        If a line is neither, a value is no finite number, an id is no whole number >= 0, a feature comes before the
        first step, or there is no step.
    OSError
        As the file system says.
    """
    source = Path(path)
    odometry: list[FloatArray] = []
    seen: list[list[tuple[int, float, float]]] = []
    for line, words in word_rows(source):
        kind = words[0]
        if kind not in ("ODOMETRY", "SENSOR"):
            raise FormatError(source, f"expected ODOMETRY or SENSOR, got {kind[:40]!r}", line=line)
        if len(words) != 4:
            raise FormatError(source, f"expected 3 values, got {len(words) - 1}", line=line, field=kind)
        if kind == "ODOMETRY":
            odometry.append(finite_numbers(source, line, words[1:], kind))
            seen.append([])
            continue
        if not seen:
            raise FormatError(source, "expected ODOMETRY before the first feature", line=line, field=kind)
        distance, bearing = finite_numbers(source, line, words[2:], kind).tolist()
        seen[-1].append((parse_id(source, line, words[1]), distance, bearing))
    if not seen:
        raise FormatError(source, "no steps: the file has no ODOMETRY line")
    return CourseLog(np.array(odometry), tuple(_as_detections(features) for features in seen))


def _kind_of(columns: list[str]) -> SignatureKind | None:
    """Return what the columns behind the position hold; None if they are none of those known."""
    known: dict[tuple[str, ...], SignatureKind] = {(): "none", ("signature",): "number", ("type",): "type"}
    is_vector = columns == [f"signature_{i + 1}" for i in range(len(columns))]
    return known.get(tuple(columns), "vector" if is_vector else None)


def _as_map(landmarks: IdRows, kind: SignatureKind) -> LandmarkMap:
    ids, values = landmarks.table()
    signatures = None if kind == "none" else values[:, 2:] if kind == "vector" else values[:, 2]
    try:
        return LandmarkMap(values[:, :2], ids, signatures, kind)
    except InvalidInputError as error:
        raise FormatError(landmarks.path, str(error)) from error


def _as_detections(features: list[tuple[int, float, float]]) -> Detections:
    ids, ranges, bearings = zip(*features, strict=True) if features else ((), (), ())
    return Detections(np.array(ranges), np.array(bearings), ids=np.array(ids, dtype=np.int64))
