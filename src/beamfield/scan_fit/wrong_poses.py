"""Poses that a lost robot might believe in, for scans whose true poses are known."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, between, compose
from beamfield.maps.occupancy import OccupancyGrid

# A lost robot is this far off, metres and radians.
NEAR_DISTANCE = (0.5, 3.0)
NEAR_TURN = (math.radians(20.0), math.pi)
TRIES = 40


def wrong_poses(
    poses: FloatArray, stretch: NDArray[np.int64], grid: OccupancyGrid, rng: np.random.Generator,
    *, share_near: float = 0.5,
) -> FloatArray:  # fmt: skip
    """Draw wrong poses (t, 3) that follow the robot's motion, as those of a filter that is lost.

    In each stretch the path is moved as a whole: near its place (0.5 to 3 m away, or turned by 20 to 180 degrees, or
    both), in this share of the stretches, or to a random free place with a random heading. It stays on free cells as
    far as a few tries allow.

    Stretch (t,) is the number of each scan's; NaN poses stay NaN. InvalidInputError if the map has no free cell.
    """
    free = grid.free
    rows, cols = np.nonzero(free)
    if len(rows) == 0:
        raise InvalidInputError("the map has no free cell to draw wrong poses in")
    result: FloatArray = np.full(poses.shape, np.nan)
    for number in np.unique(stretch):
        mine = np.flatnonzero((stretch == number) & np.isfinite(poses).all(axis=1))
        if len(mine) == 0:
            continue
        centre = poses[mine[len(mine) // 2]]
        shape = between(centre, poses[mine])
        near = bool(rng.random() < share_near)
        best = -1.0
        for _ in range(TRIES):
            place = _beside(centre, rng) if near else _anywhere(grid, rows, cols, rng)
            path = compose(place, shape)
            on_free = float(grid.look_up(free, path[:, :2]).mean())
            if on_free > best:
                best, result[mine] = on_free, path
            if best == 1.0:
                break
    return result


def _beside(centre: FloatArray, rng: np.random.Generator) -> FloatArray:
    kind = rng.integers(3)
    distance = 0.0 if kind == 0 else rng.uniform(*NEAR_DISTANCE)
    turn = 0.0 if kind == 1 else rng.choice([-1.0, 1.0]) * rng.uniform(*NEAR_TURN)
    towards = rng.uniform(-math.pi, math.pi)
    return np.asarray(centre + np.array([distance * math.cos(towards), distance * math.sin(towards), turn]))


def _anywhere(
    grid: OccupancyGrid, rows: NDArray[np.int64], cols: NDArray[np.int64], rng: np.random.Generator
) -> FloatArray:
    i = int(rng.integers(len(rows)))
    x, y = grid.to_map(np.array([cols[i] + 0.5, rows[i] + 0.5]))
    return np.array([x, y, rng.uniform(-math.pi, math.pi)])
