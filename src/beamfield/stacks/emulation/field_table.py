"""The distance map of a stack's likelihood field, and the look-up of end points in it."""

from __future__ import annotations

from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.kernels import stacks as kernels
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.distance import distance_to_obstacles
from beamfield.maps.occupancy import BoolArray, OccupancyGrid

DistanceChoice = Literal["exact", "brushfire"]
# Single precision but where a program keeps squares.
Metres = NDArray[np.floating[Any]]
# How many look-ups that are only summed take as long as a ray, the unit of work.
SUMMED_PER_WORK_UNIT = 5
# Steps (row, col).
_RIGHT, _UP, _LEFT, _DOWN = (0, 1), (1, 0), (0, -1), (-1, 0)


class BrushfireOrder(NamedTuple):
    """In which order a program's brushfire runs; see `beamfield.kernels.stacks.brushfire`."""

    neighbours: tuple[tuple[int, int], ...]
    columns_first: bool
    remove_last: bool
    settle_beyond: bool
    keeps_squares: bool
    """The program keeps squared distances in single precision, not distances, and compares them with the maximum's
    square; otherwise it counts whole cells (`reach_in_cells`)."""


AMCL_BRUSHFIRE = BrushfireOrder(
    (_LEFT, _DOWN, _RIGHT, _UP), columns_first=True, remove_last=True, settle_beyond=False, keeps_squares=False
)
BELUGA_BRUSHFIRE = BrushfireOrder(
    (_RIGHT, _UP, _LEFT, _DOWN), columns_first=False, remove_last=False, settle_beyond=True, keeps_squares=True
)


class FieldTable(NamedTuple):
    """What each cell of a map holds for a likelihood field."""

    grid: OccupancyGrid
    distance: Metres
    """(rows, cols) metres; +inf where no obstacle was found."""
    unknown: BoolArray
    """(rows, cols) cells of which the map message says nothing (-1)."""

    def look_up(self, poses: FloatArray, ends: FloatArray) -> tuple[Metres, NDArray[np.int8]]:
        """Return distances and places, (n, k) each, of end points (2, k) in the robot frame at poses (n, 3)."""
        n, k = len(poses), ends.shape[1]
        distances, places = np.empty((n, k), self.distance.dtype), np.empty((n, k), np.int8)
        rows = np.require(poses, requirements=["C", "W"])
        x, y, yaw = self.grid.origin.tolist()
        run_in_blocks(
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
            work_per_row=k,
        )
        return distances, places


class CellTerms(NamedTuple):
    """What an end point adds to the logarithm or the sum that makes a scan's weight, for each cell it may lie in."""

    grid: OccupancyGrid
    terms: FloatArray
    """(rows * cols + 1,) row by row; the last is for an end point off the map."""

    def sums(self, poses: FloatArray, ends: FloatArray) -> FloatArray:
        """Return the sums (n,) over end points (2, k) in the robot frame at poses (n, 3)."""
        sums = np.empty(len(poses))
        rows = np.require(poses, requirements=["C", "W"])
        x, y, yaw = self.grid.origin.tolist()
        run_in_blocks(
            lambda a, b: kernels.sum_ends(
                rows[a:b], (x, y, yaw), self.grid.resolution, self.grid.shape, ends, self.terms, sums[a:b]
            ),
            len(rows),
            work_per_row=ends.shape[1] / SUMMED_PER_WORK_UNIT,
        )
        return sums


def field_table(
    grid: OccupancyGrid, obstacles: BoolArray, distance: DistanceChoice, order: BrushfireOrder, max_distance: float
) -> FieldTable:
    """Work out a stack's distance map, from obstacles (rows, cols) in the map as the stack reads it.

    "exact" measures to the nearest obstacle; "brushfire" does what the program does, in its order and with its errors,
    and ends at max_distance metres. Exact distances are not cut off. InvalidInputError if there is no such distance.
    """
    if distance not in ("exact", "brushfire"):
        raise InvalidInputError(f"distance: expected 'exact' or 'brushfire', got {distance!r}")
    if distance == "exact":
        metres: Metres = distance_to_obstacles(OccupancyGrid(obstacles.astype(np.float32), grid.resolution))
    else:
        metres = _brushfire(obstacles, grid.resolution, order, max_distance)
    return FieldTable(grid, metres, np.isnan(grid.probability))


def reach_in_cells(max_distance: float, resolution: float) -> int:
    """Return how many whole cells AMCL looks for an obstacle; farther ones are at the maximum distance to it.

    The quotient is cut down as computed: 0.3 m has 2 cells of 0.1 m.
    """
    return int(max_distance / resolution)


def _brushfire(obstacles: BoolArray, resolution: float, order: BrushfireOrder, max_distance: float) -> Metres:
    """Return the distances in metres that a brushfire finds; +inf where it does not come."""
    squared = np.empty(obstacles.shape, np.int32)
    reach = max_distance / resolution if order.keeps_squares else reach_in_cells(max_distance, resolution)
    limit = float(reach) ** 2
    flags = order.columns_first, order.remove_last, order.settle_beyond
    kernels.brushfire(obstacles, limit, np.array(order.neighbours), *flags, squared)
    cells = np.where(squared < 0, np.inf, squared)
    if order.keeps_squares:
        return np.sqrt((cells * resolution**2).astype(np.float32).astype(np.float64))
    return np.asarray((np.sqrt(cells) * resolution).astype(np.float32))


def end_points(mounts: FloatArray, ranges: FloatArray) -> FloatArray:
    """Return the end points (2, k) in the robot frame of beams with mounts (k, 3) and ranges (k,), metres (6.32)."""
    x, y, theta = mounts.T
    return np.ascontiguousarray([x + ranges * np.cos(theta), y + ranges * np.sin(theta)])
