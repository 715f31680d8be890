"""A log cut into stretches for replaying filters: those that a choice is made on, and those that judge it."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.odometry.windows import update_scans
from beamfield.errors import TooLittleDataError
from beamfield.sensors import SensorLog

# Updates of a stretch in which particles gather from the start's wide belief; they are not judged, or they would count
# more than all tracking that follows.
WARM_UP = 8
# Updates of a stretch: the least that says anything, and as many as it has before there are more stretches.
FEWEST_UPDATES, USUAL_UPDATES = 16, 25


class ReplaySegments(NamedTuple):
    """Stretches of one log in turn; each is replayed from its own start, and judged after the first updates.

    Scans that are not judged have no reference pose, but for the first, from which a filter starts.
    """

    choosing: tuple[SensorLog, ...]
    judging: tuple[SensorLog, ...]

    @property
    def names(self) -> tuple[list[str], list[str]]:
        """What the stretches of both kinds are called."""
        return [f"stretch {2 * i + 1}" for i in range(len(self.choosing))], [
            f"stretch {2 * i + 2}" for i in range(len(self.judging))
        ]


def cut_segments(
    log: SensorLog, update_min_d: float, update_min_a: float, *, most: int, longest: int
) -> ReplaySegments:
    """Cut a log into an even number of stretches with as many updates of a filter each.

    Reference poses of the first updates of each stretch are left out, but for the first scan's.

    Parameters
    ----------
    log
        With odometry and reference poses.
    update_min_d, update_min_a
        Motion between two updates, metres and radians.
    most
        Stretches at most, even.
    longest
        Updates of a stretch at most: of a long log the end of each stretch is left out.

    Raises
    ------
    TooLittleDataError
        If there are not enough updates for two stretches.
    """
    with_reference = np.where(np.isfinite(log.poses).all(axis=1, keepdims=True), log.odometry, np.nan)
    updates = update_scans(with_reference, update_min_d, update_min_a)
    if len(updates) < 2 * FEWEST_UPDATES:
        raise TooLittleDataError(
            f"replaying needs {2 * FEWEST_UPDATES} updates of a filter with reference poses, the drive has "
            f"{len(updates)}"
        )
    n = 2 * int(np.clip(len(updates) // (2 * USUAL_UPDATES), 1, most // 2))
    parts = np.array_split(updates, n)
    segments = [_judged_after(WARM_UP, log, part[: longest + 1]) for part in parts]
    return ReplaySegments(tuple(segments[::2]), tuple(segments[1::2]))


def _judged_after(n_updates: int, log: SensorLog, updates: NDArray[np.int64]) -> SensorLog:
    """Return the scans from the first update to the last, without the reference poses of the first updates."""
    first, judged, last = (int(updates[i]) for i in (0, n_updates, -1))
    segment = log[first : last + 1]
    poses = segment.poses.copy()
    poses[1 : judged - first] = np.nan
    return replace(segment, poses=poses)
