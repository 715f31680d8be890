"""Expected ranges as other programs find them: along Bresenham's line from cell to cell, or exactly."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, compose, transform_points
from beamfield.kernels import stacks as kernels
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder

RayChoice = Literal["bresenham", "exact"]
RAYS = ("bresenham", "exact")
# A step along Bresenham's line costs about as much as a ray's share of a unit of work.
WORK_PER_RAY = 10


class Line(NamedTuple):
    """How a program follows Bresenham's line; see `beamfield.kernels.stacks.cast_bresenham`."""

    edge_stops: bool
    """The first cell off the map is an obstacle; otherwise a ray that leaves the map meets nothing."""
    overshoot: int
    """How many cells past the one max_range away are looked at."""
    ties_turn: bool
    """The line changes rows already where it passes midway between two cells."""


AMCL_LINE = Line(edge_stops=True, overshoot=1, ties_turn=True)
BELUGA_LINE = Line(edge_stops=False, overshoot=0, ties_turn=False)


def line_cells(grid: OccupancyGrid) -> NDArray[np.uint8]:
    """Return what the map's cells do to `bresenham_ranges`, made once for many scans; cells that are not free stop."""
    return np.pad(np.where(grid.free, kernels.PASSES, kernels.STOPS), 1, constant_values=kernels.EDGE)


def bresenham_ranges(
    grid: OccupancyGrid, cells: NDArray[np.uint8], poses: FloatArray, mounts: FloatArray, max_range: float, line: Line
) -> FloatArray:
    """Return the ranges (n, k) of Bresenham's line between centres of cells, to the first cell that is not free.

    The map is as the stack reads it, and `cells` its `line_cells`. The line's last cell is max_range metres away;
    ranges of that cell may be a little more. Poses (n, 3) are the robot's, mounts (k, 3) the beams'.
    """
    ranges: FloatArray = np.empty((len(poses), len(mounts)))
    rows = np.require(poses, requirements=["C", "W"])
    starts = np.array(mounts[:, :2].T, order="C")
    bearings = np.array(mounts[:, 2])
    x, y, yaw = grid.origin.tolist()

    def work(a: int, b: int) -> None:
        kernels.cast_bresenham(
            rows[a:b], (x, y, yaw), grid.resolution, starts, bearings, max_range, cells, *line, ranges[a:b]
        )

    run_in_blocks(work, len(rows), work_per_row=WORK_PER_RAY * len(mounts))
    return ranges


def exact_ranges(
    caster: RayCaster, seen: OccupancyGrid, poses: FloatArray, mounts: FloatArray, max_range: float, *, off_map: float
) -> FloatArray:
    """Return exact expected ranges (n, k) in metres; the rest as for `bresenham_ranges`.

    The caster's map may have a frame around `seen`, the map as the stack reads it. Rays that start off the map have the
    range that the program gives them.
    """
    ranges = caster.expected_ranges(poses, RangeFinder(mounts, max_range))
    # Most lasers send all beams from one place, and to look it up for each beam takes as long as to cast the rays.
    places, place_of = np.unique(mounts[:, :2], axis=0, return_inverse=True)
    is_off = ~seen.look_up(np.ones(seen.shape, np.bool_), transform_points(poses[:, None], places))
    if is_off.any():
        ranges[is_off[:, place_of.ravel()]] = off_map
    return ranges


def walled(grid: OccupancyGrid) -> OccupancyGrid:
    """Return the grid with a frame of one occupied cell, for programs to which the map's edge is a wall."""
    corner = compose(grid.origin, [-grid.resolution, -grid.resolution, 0.0])
    return OccupancyGrid(np.pad(grid.probability, 1, constant_values=1.0), grid.resolution, corner)
