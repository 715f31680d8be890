"""Whether and when a filter finds a robot whose place it does not know: at a global start, or after a kidnapping."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beamfield.arguments import checked
from beamfield.errors import TooLittleDataError
from beamfield.geometry import FloatArray, between, compose
from beamfield.localization.replay import Replay
from beamfield.sensors import SensorLog

# A robot is found when its position is as close to the reference, metres, in this share of all scans from then on.
FOUND_DISTANCE = 0.5
FOUND_SHARE = 0.95
# The last scans, a share of all, must be among them: fewer may be close by chance.
FOUND_LAST = 0.2
# Of a log in which the robot is carried elsewhere so many scans are cut out, a share of all.
CUT_SHARE = 1.0 / 3.0


@checked
def time_to_find(replay: Replay, log: SensorLog, first: int = 0) -> float | None:
    """Return how long a filter took to find the robot, seconds from the scan `first` until the one that found it.

    From that one on 95% of the scans are within 0.5 m of the reference; None if there is none that leaves at least a
    fifth of the scans. TooLittleDataError if no scan from `first` on has a reference pose.
    """
    known = np.flatnonzero(np.isfinite(log.poses).all(axis=1))
    known = known[known >= first]
    if not len(known):
        raise TooLittleDataError(f"log: no scan from number {first} on has a reference pose")
    off = replay.poses[known, :2] - log.poses[known, :2]
    # Before a filter has said anything it has found nothing.
    is_close = np.nan_to_num(np.hypot(off[:, 0], off[:, 1]), nan=np.inf) <= FOUND_DISTANCE
    share_from = np.cumsum(is_close[::-1])[::-1] / np.arange(len(known), 0, -1)
    found = np.flatnonzero(is_close & (share_from >= FOUND_SHARE))
    if not len(found) or found[0] > (1.0 - FOUND_LAST) * len(known):
        return None
    return float(log.stamps[known[found[0]]] - log.stamps[first])


@checked
def kidnapped(log: SensorLog) -> tuple[SensorLog, int]:
    """Return a log in which the robot is carried elsewhere, and the number of the first scan after that.

    The middle is cut out and odometry does not notice. TooLittleDataError if fewer than two scans on a side of the cut
    have odometry.
    """
    usable = np.flatnonzero(np.isfinite(log.odometry).all(axis=1))
    before = round(0.5 * (1.0 - CUT_SHARE) * len(usable))
    after = len(usable) - before
    if before < 2:
        raise TooLittleDataError(f"log: {len(usable)} scans have odometry, too few to cut out {CUT_SHARE:.0%} of them")
    kept = log.select(np.concatenate([usable[:before], usable[after:]]))
    odometry: FloatArray = np.array(kept.odometry)
    odometry[before:] = compose(odometry[before - 1], between(odometry[before], odometry[before:]))
    stamps: FloatArray = np.array(kept.stamps)
    stamps[before:] -= stamps[before] - stamps[before - 1]
    return replace(kept, odometry=odometry, stamps=stamps), before
