"""Maps and rays that are hard to decide: corners, borders, parallels, many turns, obstacles just at max_range."""

from __future__ import annotations

import math

import numpy as np

from beamfield.maps.occupancy import OccupancyGrid

# Offsets around every tolerance of the caster (1e-9 cells, 1e-12 of a direction) and around float32's resolution.
TINY = np.array([0, 0, 0, 1e-16, 1e-14, 1e-12, 0.999e-9, 1.001e-9, 1e-8, 1e-7, 3e-7, 1e-6, 1e-5, 1e-4])
RESOLUTIONS = (1.0, 0.5, 0.1, 0.05, float(np.float32(0.05)), 0.025, 0.3)


def random_grid(rng: np.random.Generator) -> OccupancyGrid:
    """Return a small map of one of several kinds, somewhere in the world, turned or not."""
    occupied = _KINDS[rng.integers(len(_KINDS))](rng)
    resolution = float(rng.choice(RESOLUTIONS))
    origin = [0.0, 0.0, 0.0]
    if rng.random() < 0.6:
        origin[:2] = rng.choice([1.0, 50.0, 3000.0]) * rng.normal(size=2)
    if rng.random() < 0.4:
        origin[2] = rng.choice([rng.uniform(-math.pi, math.pi), math.pi / 2, 1e-9, -0.25])
    return OccupancyGrid(occupied.astype(np.float32), resolution, origin)


def random_rays(rng: np.random.Generator, grid: OccupancyGrid, n: int) -> np.ndarray:
    """Return n rays (x, y, theta) in the map's frame, chosen to be hard."""
    rows, cols = grid.shape
    start = rng.uniform(-3.0, 3.0, (n, 2)) + rng.random((n, 2)) * [cols, rows]
    kind = rng.integers(0, 4, n)
    start[kind == 0] = np.round(start[kind == 0])
    start[kind == 1] = np.round(start[kind == 1] * 4) / 4
    start += _tiny(rng, (n, 2)) * (kind < 3)[:, None]
    far = rng.random(n) < 0.002
    start[far] *= rng.choice([10.0, 100.0], (far.sum(), 1))

    theta = rng.uniform(-math.pi, math.pi, n)
    kind = rng.integers(0, 6, n)
    theta[kind == 0] = math.pi / 4 * rng.integers(-8, 9, (kind == 0).sum())
    small = rng.integers(-7, 8, ((kind == 1).sum(), 2))
    theta[kind == 1] = np.arctan2(small[:, 1], small[:, 0])
    # At a corner of a cell, seen from the start.
    corner = np.round(rng.uniform(-1.0, 1.0, (n, 2)) + rng.random((n, 2)) * [cols, rows])
    aimed = np.arctan2(corner[:, 1] - start[:, 1], corner[:, 0] - start[:, 0])
    theta[(kind == 2) | (kind == 3)] = aimed[(kind == 2) | (kind == 3)]
    theta += _tiny(rng, n) * (kind < 5)
    turning = rng.random(n) < 0.05
    theta[turning] += 2 * math.pi * np.round(10 ** rng.uniform(0, 5, turning.sum()))

    # Into the map's frame, in float64: what comes out is the ray that everybody is asked about.
    x, y, yaw = grid.origin.tolist()
    c, s = math.cos(yaw), math.sin(yaw)
    metres = start * grid.resolution
    return np.column_stack(
        [x + c * metres[:, 0] - s * metres[:, 1], y + s * metres[:, 0] + c * metres[:, 1], theta + yaw]
    )


def random_fan(rng: np.random.Generator, k: int) -> np.ndarray:
    """Return the mounts (k, 3) of a sensor's beams: many at right angles and diagonals, at one place or at several."""
    mounts = np.zeros((k, 3))
    mounts[:, 2] = rng.uniform(-math.pi, math.pi, k)
    straight = rng.random(k) < 0.5
    mounts[straight, 2] = math.pi / 4 * rng.integers(-4, 5, straight.sum())
    mounts[:, 2] += _tiny(rng, k)
    kind = rng.integers(3)
    if kind:
        mounts[:, :2] = rng.uniform(-0.6, 0.6, (1 if kind == 1 else k, 2))
    return mounts


def random_limit(rng: np.random.Generator, grid: OccupancyGrid) -> float:
    """Return a longest range in metres, often a whole number of cells, so that obstacles lie just at it."""
    cells = float(rng.choice([rng.uniform(0.5, 80.0), rng.integers(1, 60), 1e6]))
    limit = cells * grid.resolution
    return float(rng.choice([limit, np.nextafter(limit, 0), np.nextafter(limit, np.inf)]))


def _tiny(rng: np.random.Generator, shape: int | tuple[int, int]) -> np.ndarray:
    return rng.choice(TINY, shape) * rng.choice([-1.0, 1.0], shape)


def _clutter(rng: np.random.Generator) -> np.ndarray:
    return rng.random(rng.integers(1, 60, 2)) < rng.choice([0.0, 0.01, 0.05, 0.2, 0.5, 0.9])


def _checkerboard(rng: np.random.Generator) -> np.ndarray:
    row, col = np.indices(rng.integers(2, 30, 2))
    return ((row + col) % 2 == 0) & (rng.random(row.shape) < rng.choice([0.05, 0.5, 1.0]))


def _diagonals(rng: np.random.Generator) -> np.ndarray:
    row, col = np.indices(rng.integers(4, 60, 2))
    return (row + rng.choice([-1, 1]) * col) % rng.integers(3, 20) == 0


def _rooms(rng: np.random.Generator) -> np.ndarray:
    rows, cols = rng.integers(20, 90, 2)
    occupied = rng.random((rows, cols)) < 0.01
    occupied[:: rows // 3], occupied[:, :: cols // 3] = True, True
    occupied[rows // 6 :: rows // 3], occupied[:, cols // 6 :: cols // 3] = False, False
    return occupied


def _corridor(rng: np.random.Generator) -> np.ndarray:
    occupied = np.zeros((rng.integers(3, 9), rng.integers(300, 1200)), bool)
    occupied[0], occupied[-1] = True, True
    occupied[rng.integers(0, occupied.shape[0], 3), rng.integers(0, occupied.shape[1], 3)] = True
    return occupied if rng.random() < 0.5 else occupied.T.copy()


_KINDS = (_clutter, _clutter, _checkerboard, _diagonals, _rooms, _corridor)
