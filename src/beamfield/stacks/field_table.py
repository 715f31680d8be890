"""The distance map of a stack's likelihood field, and the look-up of end points in it."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.kernels import stacks as kernels
from beamfield.kernels.threads import run_in_slices
from beamfield.maps.distance import DistanceArray, distance_to_obstacles
from beamfield.maps.occupancy import BoolArray, OccupancyGrid

DistanceChoice = Literal["exact", "brushfire"]
# Steps (row, col).
_RIGHT, _UP, _LEFT, _DOWN = (0, 1), (1, 0), (0, -1), (-1, 0)


class Brushfire(NamedTuple):
    """In which order a program's brushfire runs; see `beamfield.kernels.stacks.brushfire`."""

    neighbours: tuple[tuple[int, int], ...]
    columns_first: bool
    remove_last: bool
    settle_beyond: bool


AMCL_FIRE = Brushfire((_LEFT, _DOWN, _RIGHT, _UP), columns_first=True, remove_last=True, settle_beyond=False)
BELUGA_FIRE = Brushfire((_RIGHT, _UP, _LEFT, _DOWN), columns_first=False, remove_last=False, settle_beyond=True)


class FieldTable(NamedTuple):
    """What each cell of a map holds for a likelihood field."""

    grid: OccupancyGrid
    distance: DistanceArray
    """(rows, cols) metres, single precision; +inf where no obstacle was found."""
    unknown: BoolArray
    """(rows, cols)."""

    def look_up(
        self, poses: FloatArray, ends: FloatArray, threads: int | None = None
    ) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
        """Return distances and places, (n, k) each, of end points (2, k) in the robot frame at poses (n, 3)."""
        n, k = len(poses), ends.shape[1]
        distances, places = np.empty((n, k), np.float32), np.empty((n, k), np.int8)
        rows = np.require(poses, requirements=["C", "W"])
        x, y, yaw = self.grid.origin.tolist()
        run_in_slices(
            lambda a, b: kernels.look_up_ends(
                rows[a:b],
                (x, y, yaw),
                self.grid.resolution,
                ends,
                self.distance,
                self.unknown,
                distances[a:b],
                places[a:b],
            ),
            n,
            threads=threads,
            work_per_row=k,
        )
        return distances, places


def field_table(
    grid: OccupancyGrid,
    distance: DistanceChoice,
    fire: Brushfire,
    max_distance: float,
    *,
    only_boundaries: bool = False,
) -> FieldTable:
    """Work out a stack's distance map.

    Parameters
    ----------
    grid
        The map as the stack reads it.
    distance
        "exact" measures to the nearest obstacle; "brushfire" does what the program does, with its errors.
    fire
        The program's brushfire.
    max_distance
        Where the brushfire ends, metres. Exact distances are not cut off.
    only_boundaries
        Count only those occupied cells as obstacles that have a neighbour which is not occupied.

    Raises
    ------
    InvalidInputError
        If there is no such distance.
    """
    if distance not in ("exact", "brushfire"):
        raise InvalidInputError(f"distance: expected 'exact' or 'brushfire', got {distance!r}")
    if distance == "exact":
        metres = distance_to_obstacles(grid, only_boundaries=only_boundaries)
        return FieldTable(grid, metres, grid.unknown)
    obstacles = _boundaries(grid.occupied) if only_boundaries else grid.occupied
    squared = np.empty(grid.shape, np.int32)
    limit = (max_distance / grid.resolution) ** 2
    order = fire.columns_first, fire.remove_last, fire.settle_beyond
    kernels.brushfire(obstacles, limit, np.array(fire.neighbours), *order, squared)
    metres = np.where(squared < 0, np.inf, np.sqrt(np.maximum(squared, 0)) * grid.resolution).astype(np.float32)
    return FieldTable(grid, metres, grid.unknown)


def _boundaries(occupied: BoolArray) -> BoolArray:
    padded = np.pad(occupied, 1, constant_values=True)
    return occupied & ~(padded[:-2, 1:-1] & padded[2:, 1:-1] & padded[1:-1, :-2] & padded[1:-1, 2:])


def end_points(mounts: FloatArray, ranges: FloatArray) -> FloatArray:
    """Return the end points (2, k) in the robot frame of beams with mounts (k, 3) and ranges (k,), metres (6.32)."""
    x, y, theta = mounts.T
    return np.ascontiguousarray([x + ranges * np.cos(theta), y + ranges * np.sin(theta)])
