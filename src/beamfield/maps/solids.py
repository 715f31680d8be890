"""Where everything that is not free is painted black: the inside of solids, which no beam reaches."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.maps.distance import distance_to_obstacles
from beamfield.maps.occupancy import OccupancyGrid

# No hit lies deeper in a solid, metres: more than poses and walls are wrong by.
DEEPEST_HIT = 0.5
# Nor so deep where the solids are no walls that were painted thick, but all that is not free.
DEEPEST_IN_FILL = 0.2
# So much of them is left as walls, as thick as those that a laser draws.
WALL_OF_FILL = 0.1


def is_filled(occupied: NDArray[np.bool_], distance: NDArray[np.float32]) -> bool:
    """Return whether most of what is occupied is no wall, but painted black: far from any surface (metres, by cell)."""
    return bool(np.count_nonzero(occupied & (distance > DEEPEST_HIT)) > 0.5 * np.count_nonzero(occupied))


def has_fill(grid: OccupancyGrid) -> bool:
    """Return whether a map is painted black where nothing is known."""
    return bool(grid.free.any()) and is_filled(grid.occupied, distance_to_obstacles(grid, only_boundaries=True))


def hollowed(grid: OccupancyGrid) -> OccupancyGrid:
    """Return a map in which the inside of solids is unknown; the same map if there is none.

    A likelihood field is highest in all of a solid. Where the unknown is painted black, as in maps drawn by hand or of
    race tracks, any pose fits whose readings end in it. There `WALL_OF_FILL` stays, of thick walls `DEEPEST_HIT`.
    """
    depth = distance_to_obstacles(grid, only_boundaries=True)
    deep = grid.occupied & (depth > (WALL_OF_FILL if is_filled(grid.occupied, depth) else DEEPEST_HIT))
    # Where all is obstacle there is no boundary to be far from.
    if not deep.any() or deep.all():
        return grid
    return OccupancyGrid(
        np.where(deep, np.float32(np.nan), grid.probability), grid.resolution, grid.origin,
        grid.occupied_thresh, grid.free_thresh,
    )  # fmt: skip
