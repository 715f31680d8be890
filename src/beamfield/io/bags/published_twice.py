"""Poses that two nodes publish, such as the odometry of the wheels and of a filter, on one and the same topic."""

from __future__ import annotations

import numpy as np

from beamfield.geometry import FloatArray

# A step back and forth goes farther than this, metres, and ends nearer to where it began than this share of it.
FAR, NEAR = 0.1, 0.3
# So many steps back and forth, and at least this share of all: none in any real bag.
LEAST, SHARE = 10, 0.05


def published_twice(what: str, poses: FloatArray) -> list[str]:
    """Return a note that begins with `what` if poses (t, 3), NaN where unknown, jump between two paths all the time."""
    places = poses[:, :2]
    step, over = (np.hypot(*(places[n:] - places[:-n]).T) for n in (1, 2))
    far = np.minimum(step[:-1], step[1:])
    counted = (far > FAR) & (over < NEAR * far)
    if counted.sum() < max(LEAST, SHARE * len(poses)):
        return []
    jumps = f"back and forth {counted.sum()} times, by up to {far[counted].max():.2f} m"
    return [f"{what}: {jumps}: two nodes publish them, and a robot that follows them gets lost; stop one"]
