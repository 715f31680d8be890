"""A log cut into stretches for replaying filters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.odometry.windows import update_scans
from beamfield.errors import TooLittleDataError
from beamfield.sensors import SensorLog

# Updates of a stretch: the least that says anything, and as many as it has before there are more stretches.
FEWEST_UPDATES, USUAL_UPDATES = 12, 25
# Stretches that lead in to one. From a start 0.25 m off, filters in corridors take one for the particles to gather, and
# what is left of the start counts for more than how they track.
LEAD_IN = 2
# Motion between two updates of amcl, metres and radians.
USUAL_DISTANCES = 0.25, 0.2


def cut_segments(
    log: SensorLog, update_min_d: float, update_min_a: float, *, most: int, longest: int
) -> tuple[SensorLog, ...]:
    """Cut a log into stretches with as many updates of a filter each, every one with the two before it as a lead-in.

    The second has the first alone.

    What leads in is not judged: it has no reference poses but for the first scan's, from which the filter starts. Where
    places look alike, particles from a wide start need long to gather, which would count for more than all tracking.

    Updates are update_min_d metres or update_min_a radians apart; where the filter takes every scan (0 for both),
    stretches are as long as those of amcl. There are two to `most` stretches of at most `longest` updates, and twice as
    many lead in: of a long log the rest is left out. TooLittleDataError if there are not enough updates for three
    stretches.
    """
    with_reference = np.where(np.isfinite(log.poses).all(axis=1, keepdims=True), log.odometry, np.nan)
    if update_min_d == update_min_a == 0.0:
        update_min_d, update_min_a = USUAL_DISTANCES
    updates = update_scans(with_reference, update_min_d, update_min_a)
    if len(updates) < 3 * FEWEST_UPDATES:
        raise TooLittleDataError(
            f"a replay needs {3 * FEWEST_UPDATES} updates of the filter with reference poses, this drive has "
            f"{len(updates)}"
        )
    n = int(np.clip(len(updates) // USUAL_UPDATES - 1, 2, most))
    parts = np.array_split(updates, n + 1)
    return tuple(
        _judged_after(log, np.concatenate(parts[max(0, i - LEAD_IN) : i])[-LEAD_IN * longest :], parts[i][:longest])
        for i in range(1, n + 1)
    )


def _judged_after(log: SensorLog, lead: NDArray[np.int64], judged: NDArray[np.int64]) -> SensorLog:
    """Return the scans of some updates that lead in and of those that are judged, which alone keep reference poses."""
    first, start, last = int(lead[0]), int(judged[0]), int(judged[-1])
    segment = log[first : last + 1]
    poses = segment.poses.copy()
    poses[1 : start - first] = np.nan
    return replace(segment, poses=poses)
