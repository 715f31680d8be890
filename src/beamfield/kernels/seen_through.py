"""Readings whose end points other scans of the log see through: of what has moved since, or moved there later."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]
Booleans = NDArray[np.bool_]


@kernel
def mark_seen_through(
    ranges: Floats, max_range: float, bearings: Floats, beams: Integers, lasers: Floats, way: Floats, turn: Floats,
    judged: Integers, others: Integers, bounds: Integers, most_way: float, most_turn: float, step: int,
    tolerance: float, tolerance_share: float, width: float, marks: Booleans,
) -> None:  # fmt: skip
    """Mark readings of scans whose end points more of their neighbours see through than see.

    Parameters
    ----------
    ranges
        (n, k) metres; NaN where there is no reading, max_range where nothing returned.
    bearings, beams
        (b,) radians, increasing, and the beams that they belong to: all of one origin. With a whole turn in sight the
        first comes again at the end.
    lasers
        (n, 3) where the laser was, in any frame that holds over a short way.
    way, turn
        (n,) metres driven and radians turned until each scan.
    judged, others, bounds
        (q,) scans whose readings are marked, (m,) scans that they are compared with, and (q, 2) from which to before
        which of these each is.
    most_way, most_turn
        Scans further away are not compared, metres and radians.
    step
        One of so many neighbouring beams speaks for all of them.
    tolerance, tolerance_share
        Metres, and share of the distance, by which ranges may differ.
    width
        Metres between two beams where they pass an end point: smaller things may lie between them.
    marks
        (n, k), set to True.
    """
    last = len(bearings) - 1
    for q in range(len(judged)):
        i = judged[q]
        x, y, heading = lasers[i]
        for b in range(0, len(bearings), step):
            z = ranges[i, beams[b]]
            if not z < max_range:
                continue
            end_x, end_y = x + z * math.cos(heading + bearings[b]), y + z * math.sin(heading + bearings[b])
            seen = through = 0
            for o in range(bounds[q, 0], bounds[q, 1]):
                j = others[o]
                if j == i or abs(way[j] - way[i]) > most_way or abs(turn[j] - turn[i]) > most_turn:
                    continue
                dx, dy = end_x - lasers[j, 0], end_y - lasers[j, 1]
                distance = math.hypot(dx, dy)
                after = _turned(math.atan2(dy, dx) - lasers[j, 2] - bearings[0])
                after = np.searchsorted(bearings, bearings[0] + after)
                if after == 0 or after > last or (bearings[after] - bearings[after - 1]) * distance > width:
                    continue
                left, right = ranges[j, beams[after - 1]], ranges[j, beams[after]]
                near = tolerance + tolerance_share * distance
                if not (left < max_range and right < max_range):
                    continue
                if min(left, right) > distance + near:
                    through += 1
                elif max(left, right) >= distance - near:
                    seen += 1
            if through > max(seen, 1):
                for k in range(b, min(b + step, len(bearings))):
                    marks[i, beams[k]] = True


@kernel
def _turned(angle: float) -> float:
    """Return an angle in [0, 2 pi)."""
    return angle - 2.0 * math.pi * math.floor(angle / (2.0 * math.pi))
