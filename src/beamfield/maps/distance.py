"""Distance to the nearest obstacle: line 7 of Table 6.3, worked out once for every cell of a map."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import check_fields, checked, keep, require, restore
from beamfield.errors import InvalidInputError
from beamfield.kernels.distance import MAX_SIDE_CELLS, fill_heights, fill_metres
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.occupancy import BoolArray, OccupancyGrid
from beamfield.short_repr import short_repr

DistanceArray = NDArray[np.float32]
# 16 GiB, and what tables of a field can count in 32 bits.
MAX_CELLS = 2**32
# How many take as long as what `run_in_blocks` calls a unit of work.
DISTANCES_PER_UNIT_OF_WORK, HEIGHTS_PER_UNIT_OF_WORK = 8.0, 128.0


@checked
def distance_to_obstacles(
    grid: OccupancyGrid, *, max_distance: float | None = None, only_boundaries: bool = False, margin_cells: int = 0
) -> DistanceArray:
    """Return the distance from each cell's centre to the centre of the nearest occupied cell.

    It is the exact Euclidean distance, not a brushfire approximation. Unknown cells are not obstacles; distances are
    measured through them as through free space.

    Parameters
    ----------
    grid
        The map.
    max_distance
        Distances are cut off here, metres; None leaves them.
    only_boundaries
        Count only those occupied cells as obstacles that have a neighbour (left, right, below, above) on the map that
        is not occupied. A beam never ends deep inside a thick wall; without this, all of the wall's inside is as likely
        as its surface.
    margin_cells
        Extend the result past the map's edges by so many cells on each side.

    Returns
    -------
    (rows + 2 margin_cells, cols + 2 margin_cells) metres. In a map without obstacles, and in one that is all obstacle
    if only boundaries count, it is max_distance everywhere, +inf if that is None.

    Raises
    ------
    InvalidInputError
        If max_distance is not positive and finite, margin_cells is negative, or the result has more than 67,108,864
        cells a side or 4,294,967,296 in all.

    Notes
    -----
    Squares of distances in cells are whole numbers and exact; their roots are taken in double precision and rounded
    once to single. 1 byte per cell of memory is in use besides the result.

    References
    ----------
    Probabilistic Robotics, sections 6.4.1 and 6.4.2.

    Examples
    --------
    >>> distance_to_obstacles(OccupancyGrid([[0.0, 0.0, 0.0, 1.0]], resolution=0.5)).tolist()
    [[1.5, 1.0, 0.5, 0.0]]
    """
    if max_distance is not None and not 0.0 < max_distance < np.inf:
        raise InvalidInputError(
            f"max_distance: expected a positive, finite number of metres or None, got {max_distance}"
        )
    require(margin_cells >= 0, "margin_cells", "a number >= 0", margin_cells)
    shape = (grid.shape[0] + 2 * margin_cells, grid.shape[1] + 2 * margin_cells)
    if max(shape) > MAX_SIDE_CELLS or shape[0] * shape[1] > MAX_CELLS:
        raise InvalidInputError(
            f"grid: expected at most {MAX_SIDE_CELLS} cells a side and {MAX_CELLS} in all with margin, got {shape}"
        )
    obstacles = _boundaries(grid.occupied) if only_boundaries else grid.occupied
    with np.errstate(over="ignore"):
        limit = np.float32(np.inf if max_distance is None else max_distance)
    if not obstacles.any():
        return np.full(shape, limit)
    if margin_cells:
        obstacles = np.pad(obstacles, margin_cells)
    return _to_nearest(np.ascontiguousarray(obstacles), grid.resolution, float(limit))


def _boundaries(occupied: BoolArray) -> BoolArray:
    """Return the occupied cells next to a cell of the map that is not."""
    p = np.pad(occupied, 1, constant_values=True)
    return occupied & ~(p[:-2, 1:-1] & p[2:, 1:-1] & p[1:-1, :-2] & p[1:-1, 2:])


def _to_nearest(obstacles: BoolArray, resolution: float, limit: float) -> DistanceArray:
    """Return the distance in metres to the nearest obstacle, of which there is at least one, at most `limit`."""
    rows, cols = obstacles.shape
    distance = np.empty((rows, cols), np.float32)
    heights = distance.view(np.int32)
    # One more, so that rounding leaves nothing beyond it that is less than the limit.
    reach = math.ceil(min(limit / resolution, rows + cols)) + 1
    per_col, per_row = rows / HEIGHTS_PER_UNIT_OF_WORK, cols / DISTANCES_PER_UNIT_OF_WORK
    run_in_blocks(lambda a, b: fill_heights(obstacles, a, b, heights), cols, work_per_row=per_col)
    run_in_blocks(lambda a, b: fill_metres(reach, resolution, limit, distance[a:b]), rows, work_per_row=per_row)
    return distance


@dataclass(frozen=True, eq=False)
class DistanceField:
    """The distance to the nearest obstacle over a map and, if asked for, around it.

    Parameters
    ----------
    grid
        The map.
    distance
        (rows + 2 margin_cells, cols + 2 margin_cells) metres, as from `distance_to_obstacles`.
    margin_cells
        How many cells the field extends past the map on each side.
    max_distance
        The distance of everything beyond, metres; inf if it is not cut off.

    Raises
    ------
    InvalidInputError
        If the shape does not fit the map, a distance is negative or NaN, or max_distance is not positive.

    Examples
    --------
    >>> field = DistanceField.from_grid(OccupancyGrid([[0.0, 0.0, 1.0]], resolution=0.5), margin=0.5)
    >>> field.distance[1].tolist()
    [1.5, 1.0, 0.5, 0.0, 0.5]
    """

    grid: OccupancyGrid
    distance: DistanceArray
    margin_cells: int = 0
    max_distance: float = math.inf

    __repr__ = short_repr
    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        rows, cols = self.grid.shape
        expected = (rows + 2 * self.margin_cells, cols + 2 * self.margin_cells)
        distance = np.asarray(self.distance, dtype=np.float32)
        if self.margin_cells < 0 or distance.shape != expected:
            raise InvalidInputError(
                f"distance: expected shape {expected} for the map and a margin of {self.margin_cells} cells, "
                f"got {distance.shape}"
            )
        if not distance.min() >= 0.0:
            raise InvalidInputError(f"distance: expected metres >= 0, got {distance.min()}")
        require(self.max_distance > 0.0, "max_distance", "a positive number of metres", self.max_distance)
        keep(self, distance=distance.view())

    @classmethod
    @checked
    def from_grid(
        cls, grid: OccupancyGrid, *, max_distance: float | None = None, only_boundaries: bool = False,
        margin: float = 0.0,
    ) -> DistanceField:  # fmt: skip
        """Work out the field of a map, as `distance_to_obstacles`.

        The margin is how far it extends past the map's edges, metres, rounded up to whole cells; neither negative nor
        infinite.
        """
        if not 0.0 <= margin <= MAX_SIDE_CELLS * grid.resolution:
            raise InvalidInputError(f"margin: expected metres >= 0 and at most {MAX_SIDE_CELLS} cells, got {margin}")
        margin_cells = math.ceil(margin / grid.resolution)
        distance = distance_to_obstacles(
            grid, max_distance=max_distance, only_boundaries=only_boundaries, margin_cells=margin_cells
        )
        return cls(grid, distance, margin_cells, math.inf if max_distance is None else float(max_distance))
