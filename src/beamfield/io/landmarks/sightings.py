"""beamfield's own file of sightings: one CSV row per feature, with the robot's true pose."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path

import numpy as np

from beamfield.arguments import LARGEST
from beamfield.detection_log import DetectionLog, group_detections
from beamfield.detections import SPURIOUS, UNKNOWN
from beamfield.errors import FormatError
from beamfield.geometry import TURN_TOLERANCE, FloatArray
from beamfield.io.files.text_lines import Line, word_lines
from beamfield.io.files.text_rows import is_id

COLUMNS = ("stamp", "x", "y", "theta", "id", "range", "bearing")


def read_sightings(path: str | Path) -> DetectionLog:
    """Read sightings of landmarks from CSV, plain or gzip.

    The header is ``stamp,x,y,theta,id,range,bearing``: seconds, the robot's true pose in metres and radians, which
    landmark it was, metres, radians. Rows with one stamp are one observation. An empty range or bearing was not
    measured; an empty id is not known; the id -1 is of no landmark. Blank lines, and lines that begin with #, are left
    out.

    FormatError if the header is another, a row has another length, a value is no finite number or beyond 10^9, a
    bearing is more than a full turn (degrees), an id is no whole number >= 0 or -1, a row has neither range nor
    bearing, a stamp steps back, or rows with one stamp have different poses.
    """
    source = Path(path)
    rows = word_lines(source, ",")
    header = next(rows, Line(source, 1, []))
    if tuple(word.lower() for word in header.words) != COLUMNS:
        found = ",".join(header.words)[:80]
        raise header.error(f"expected the header {','.join(COLUMNS)}, got {found!r}")
    kept = list(rows)
    if not kept:
        raise FormatError(source, "no sightings: the file has no rows")
    table = np.array([_numbers(row) for row in kept])
    _check_order(kept, table)
    stamps, first, observation = np.unique(table[:, 0], return_index=True, return_inverse=True)
    ids = table[:, 4].astype(np.int64)
    return DetectionLog(table[first, 1:4], group_detections(observation, stamps, table[:, 5], table[:, 6], ids))


def _numbers(row: Line) -> FloatArray:
    if len(row.words) != len(COLUMNS):
        raise row.error(f"expected {len(COLUMNS)} values, got {len(row.words)}")
    which = row.words[4]
    if which and which != str(SPURIOUS) and not is_id(which):
        raise row.error(f"expected a whole number >= 0, -1 or nothing, got {which[:40]!r}", "id")
    if not row.words[5] and not row.words[6]:
        raise row.error("expected a range, a bearing or both, got neither")
    filled = [word or "nan" for word in row.words]
    filled[4] = which or str(UNKNOWN)
    numbers = row._replace(words=filled).numbers(0, field="sighting")
    for name, word, number in zip(COLUMNS, row.words, numbers, strict=True):
        empty_is_fine = name in ("id", "range", "bearing") and not word
        if not np.isfinite(number) and not empty_is_fine:
            raise row.error(f"expected a finite number, got {word[:40]!r}", name)
        if name not in ("stamp", "id") and abs(number) > LARGEST:
            raise row.error(f"expected a number up to {LARGEST:g}, got {word[:40]!r}", name)
    if abs(numbers[-1]) > 2.0 * math.pi + TURN_TOLERANCE:
        raise row.error(f"expected radians, at most a full turn, got {row.words[-1][:40]!r}: degrees?", "bearing")
    return numbers


def _check_order(rows: list[Line], table: FloatArray) -> None:
    for row, (before, numbers) in zip(rows[1:], pairwise(table), strict=True):
        if numbers[0] < before[0]:
            raise row.error(f"expected stamps that do not fall, got {numbers[0]!s} after {before[0]!s}", "stamp")
        if numbers[0] == before[0] and (numbers[1:4] != before[1:4]).any():
            found = f"{numbers[1:4].tolist()} after {before[1:4].tolist()}"
            raise row.error(f"expected one pose per stamp, got {found}")
