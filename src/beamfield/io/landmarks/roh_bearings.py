"""Roh's bearings of infrared beacons: a folder with one CSV file per place of a robot that stands still."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np

from beamfield.detection_log import DetectionLog, group_detections
from beamfield.errors import FormatError, InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.io.files.text_lines import read_lines
from beamfield.io.files.text_rows import finite_numbers
from beamfield.maps.landmarks import LandmarkMap

HEADING = math.pi / 2.0
_PLACE = re.compile(r"\(X(-?\d{1,6}(?:\.\d{1,9})?),Y(-?\d{1,6}(?:\.\d{1,9})?)\)\.csv")
NOTE = "The files have no times: stamps are the numbers of the rows, place after place."


def read_roh_bearings(folder: str | Path) -> tuple[LandmarkMap, DetectionLog]:
    """Read the beacons, and their bearings as seen from surveyed places.

    ``landmark.csv`` has a row ``x, y`` per beacon, in metres; the beacons get the ids 1, 2, and so on. ``(Xa,Yb).csv``
    has rows with one bearing in degrees per beacon, measured at (a, b) with the heading +90 degrees.

    Parameters
    ----------
    folder
        The folder; other files in it are left alone.

    Returns
    -------
    landmarks, log
        The beacons, and one observation per row. Its `places` say from which place.

    Raises
    ------
    FormatError
        If landmark.csv or a row has another number of values, a value is no finite number, a file has no row, or no
        file's name is a place.
    OSError
        As the file system says.
    """
    root = Path(folder)
    landmarks = _beacons(root / "landmark.csv")
    places_in_names = [(match, path) for path in sorted(root.iterdir()) if (match := _PLACE.fullmatch(path.name))]
    if not places_in_names:
        raise FormatError(root, "expected files with names like '(X1.5,Y3.0).csv', got none")
    poses, bearings = [], []
    for match, path in places_in_names:
        rows = _rows(path, len(landmarks), "bearing")
        bearings.append(np.deg2rad(rows))
        poses.append(np.tile([float(match[1]), float(match[2]), HEADING], (len(rows), 1)))
    places = np.repeat(np.arange(len(places_in_names)), [len(rows) for rows in bearings])
    angles = np.concatenate(bearings)
    t, k = angles.shape
    detections = group_detections(
        np.repeat(np.arange(t), k), np.arange(t), np.full(t * k, np.nan), angles.ravel(), np.tile(landmarks.ids, t)
    )
    return landmarks, DetectionLog(np.concatenate(poses), detections, places, notes=(NOTE,))


def _beacons(path: Path) -> LandmarkMap:
    try:
        return LandmarkMap(_rows(path, 2, "position"))
    except InvalidInputError as error:
        raise FormatError(path, str(error)) from error


def _rows(path: Path, n: int, what: str) -> FloatArray:
    rows = []
    for line, text in read_lines(path):
        if not text.strip():
            continue
        words = [word.strip() for word in text.split(",")]
        if len(words) != n:
            raise FormatError(path, f"expected {n} values, got {len(words)}", line=line)
        rows.append(finite_numbers(path, line, words, what))
    if not rows:
        raise FormatError(path, "no rows")
    return np.array(rows)
