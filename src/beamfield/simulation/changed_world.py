"""A world that has changed since its map was drawn: furniture that stands elsewhere, and new walls."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from beamfield.arguments import checked, require
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.simulation.trajectory import clearance_map

# The legs of one chair are this near to each other, metres; pieces smaller than this stay where they are.
JOINED, SMALLEST_PIECE = 0.3, 0.4
# How many pieces of furniture are moved, how far, and the size of the new wall, metres.
MOST_MOVED, MOVES, WALL = 6, (1.0, 6.0), (2.0, 0.15)
# A change must leave a robot of this radius, metres, so much of the floor that it reaches.
ROBOT_RADIUS, ROOM_LEFT = 0.3, 0.95
ATTEMPTS = 100

Cells = NDArray[np.int64]


@dataclass(frozen=True)
class Change:
    """A thing that is new or gone, as `find_changed_places` calls it; its middle and extent in the map, metres."""

    kind: Literal["new obstacle", "missing wall"]
    x: float
    y: float
    width: float
    height: float


@checked
def change_world(
    grid: OccupancyGrid, bare: OccupancyGrid, rng: np.random.Generator
) -> tuple[OccupancyGrid, tuple[Change, ...]]:
    """Move up to six pieces of furniture, and build a wall if there is room; return the world, and what is new or gone.

    `bare` is the world without furniture (see `draw_floor_plan`), a grid of the same shape.
    """
    require(grid.shape == bare.shape, "bare", f"shape {grid.shape}, as the grid has", bare.shape)
    world, changes = grid, list[Change]()
    pieces, n_moved = iter(_pieces(grid, bare, rng)), 0
    while n_moved < MOST_MOVED and (piece := next(pieces, None)) is not None:
        if (found := _put(world, piece, (piece + step for step in _steps(grid, rng)))) is not None:
            world, goal = found
            changes += [_change("missing wall", piece, grid), _change("new obstacle", goal, grid)]
            n_moved += 1
    if (found := _put(world, None, (_wall(grid, rng) for _ in range(ATTEMPTS)))) is not None:
        world, goal = found
        changes.append(_change("new obstacle", goal, grid))
    return world, tuple(changes)


def _pieces(grid: OccupancyGrid, bare: OccupancyGrid, rng: np.random.Generator) -> list[Cells]:
    """Return the cells (n, 2) of each piece of furniture that is not too small, in random order."""
    furniture = bare.free & ~grid.free
    reach = max(1, round(JOINED / 2 / grid.resolution))
    labels, n = ndimage.label(ndimage.binary_dilation(furniture, iterations=reach))
    labels[~furniture] = 0
    pieces = [np.argwhere(labels == number) for number in rng.permutation(n) + 1]
    return [piece for piece in pieces if np.ptp(piece, axis=0).min() * grid.resolution >= SMALLEST_PIECE]


def _steps(grid: OccupancyGrid, rng: np.random.Generator) -> Cells:
    angle, length = rng.uniform(-np.pi, np.pi, ATTEMPTS), rng.uniform(*MOVES, ATTEMPTS) / grid.resolution
    return np.column_stack([length * np.sin(angle), length * np.cos(angle)]).astype(np.int64)


def _wall(grid: OccupancyGrid, rng: np.random.Generator) -> Cells:
    size = np.round(np.array(WALL)[rng.permutation(2)] / grid.resolution).astype(np.int64)
    return np.argwhere(np.ones(size, bool)) + rng.integers(0, np.array(grid.shape))


def _put(world: OccupancyGrid, piece: Cells | None, goals: Iterator[Cells]) -> tuple[OccupancyGrid, Cells] | None:
    """Put something where there is room for it, and return the world and where; None if there is none."""
    room = _room(world)
    for goal in goals:
        if (goal < 0).any() or (goal >= world.shape).any() or not world.free[tuple(goal.T)].all():
            continue
        probability = np.array(world.probability)
        if piece is not None:
            probability[tuple(piece.T)] = 0.0
        probability[tuple(goal.T)] = 1.0
        after = replace(world, probability=probability)
        if _room(after) >= ROOM_LEFT * room:
            return after, goal
    return None


def _room(world: OccupancyGrid) -> int:
    """Return how many cells are in the largest region where the robot fits."""
    labels, _ = ndimage.label(clearance_map(world) >= ROBOT_RADIUS)
    return int(np.bincount(labels.ravel())[1:].max(initial=0))


def _change(kind: Literal["new obstacle", "missing wall"], cells: Cells, grid: OccupancyGrid) -> Change:
    points: FloatArray = grid.to_map(cells[:, ::-1] + 0.5)
    low, high = points.min(axis=0), points.max(axis=0)
    x, y = (0.5 * (low + high)).tolist()
    width, height = (high - low + grid.resolution).tolist()
    return Change(kind, x, y, width, height)
