"""People who walk about a robot, and hide what is behind them: drawn into the scans of a log."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beamfield.sensors import SensorLog, usable_ranges

# Each is a disc, metres, that wanders about the robot: within twice so many metres mostly, for so many seconds to one
# side, and no nearer than the last.
RADIUS, REACH, SECONDS, NEAREST = 0.25, 2.0, 6.0, 0.7
NOISE = 0.02


def with_crowd(log: SensorLog, n_people: int, seed: int) -> tuple[SensorLog, float]:
    """Return a log as the sensor had seen it in a crowd that goes with the robot, and the share of readings hidden."""
    rng = np.random.default_rng(seed)
    ranges, hidden, x, y, theta = log.ranges.copy(), 0, *log.finder.mounts.T
    people = rng.normal(0.0, REACH, (n_people, 2))
    for i, seconds in enumerate(np.diff(log.stamps, prepend=log.stamps[0])):
        stays = np.exp(-max(seconds, 0.0) / SECONDS)
        people = stays * people + np.sqrt(1.0 - stays**2) * rng.normal(0.0, REACH, people.shape)
        shown = people * np.maximum(1.0, NEAREST / np.hypot(*people.T))[:, None]
        seen = usable_ranges(ranges[i], log.finder)
        for person in shown:
            ahead = (person[0] - x) * np.cos(theta) + (person[1] - y) * np.sin(theta)
            aside = (person[1] - y) * np.cos(theta) - (person[0] - x) * np.sin(theta)
            z = ahead - np.sqrt(np.maximum(RADIUS**2 - aside**2, 0.0)) + NOISE * rng.normal(size=len(x))
            meets = (ahead > 0.0) & (np.abs(aside) < RADIUS) & (z > log.finder.min_range) & (z < seen)
            seen[meets] = z[meets]
        is_hidden = seen < usable_ranges(ranges[i], log.finder)
        hidden += int(is_hidden.sum())
        ranges[i, is_hidden] = seen[is_hidden]
    return replace(log, ranges=ranges), hidden / ranges.size
