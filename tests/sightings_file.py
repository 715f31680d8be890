"""Writes what `read_sightings` reads: no user of the library has needed it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from beamfield.detection_log import DetectionLog
from beamfield.detections import UNKNOWN
from beamfield.io.files.text_rows import write_csv
from beamfield.io.landmarks.sightings import COLUMNS


def write_sightings(path: str | Path, log: DetectionLog) -> None:
    """Write the features of a log whose poses are known, to the last bit.

    Observations without a feature or without a pose have no row; signatures, places and notes have no column.
    """
    rows = []
    for pose, seen in zip(log.poses, log.detections, strict=True):
        if np.isnan(pose).any():
            continue
        ids = np.full(len(seen), UNKNOWN) if seen.ids is None else seen.ids
        start = [repr(value) for value in (float(seen.stamp), *pose.tolist())]
        for which, distance, bearing in zip(ids.tolist(), seen.ranges.tolist(), seen.bearings.tolist(), strict=True):
            values = ["" if np.isnan(value) else repr(value) for value in (distance, bearing)]
            rows.append([*start, "" if which == UNKNOWN else which, *values])
    write_csv(path, COLUMNS, rows)
