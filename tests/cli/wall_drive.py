"""A short drive along a wall, for the tests of what inspect says and draws."""

from __future__ import annotations

import numpy as np

from beamfield.sensors import NoReturnPolicy, RangeFinder, SensorLog


def make_sensor(n_scans: int = 20, **changes) -> SensorLog:
    """Return a scanner 0.25 m ahead that drives 0.1 m per scan along a wall at its left."""
    finder = RangeFinder.from_bearings(
        np.radians(np.arange(-90.0, 91.0, 10.0)), 8.0, mount=(0.25, 0.0, 0.0), min_range=0.1
    )
    way = 0.1 * np.arange(n_scans)
    poses = np.column_stack([1.0 + way, np.full(n_scans, 2.0), np.zeros(n_scans)])
    with np.errstate(divide="ignore"):
        to_wall = np.where(finder.bearings > 0.05, 1.5 / np.sin(finder.bearings), np.inf)
    to_wall[to_wall >= 8.0] = np.inf
    columns = {
        "finder": finder,
        "stamps": 10.0 + 0.2 * np.arange(n_scans),
        "ranges": np.tile(to_wall, (n_scans, 1)),
        "poses": poses,
        "odometry": (poses - [1.0, 2.0, 0.0]) * [0.9, 1.0, 1.0],  # its wheels slip
        "no_return": NoReturnPolicy((8.0,), 0.5, "detected", "half of it came to nothing"),
    }
    return SensorLog(**{**columns, **changes})
