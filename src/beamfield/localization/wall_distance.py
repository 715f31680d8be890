"""Signed distances to a map's walls: what end points of hits are held against."""

from __future__ import annotations

import numpy as np

from beamfield.kernels.trajectory import Walls
from beamfield.maps.distance import distance_to_obstacles
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.solids import DEEPEST_HIT, DEEPEST_IN_FILL


def walls_of(grid: OccupancyGrid) -> Walls:
    """Return the signed distance to the surfaces of a map's obstacles, cell by cell.

    It is the distance to the nearest occupied cell that has a neighbour which is not; negative in the occupied cells
    behind those. So hits that lie inside walls painted too thick still say in which direction the surface is.

    Parameters
    ----------
    grid
        The map; it has occupied cells and others.
    """
    distance = distance_to_obstacles(grid, only_boundaries=True)
    signed = np.where(grid.occupied, -distance, distance)
    x, y, yaw = (float(value) for value in grid.origin)
    is_filled = np.count_nonzero(signed < -DEEPEST_HIT) > 0.5 * np.count_nonzero(grid.occupied)
    deepest = DEEPEST_IN_FILL if is_filled else DEEPEST_HIT
    return Walls(np.ascontiguousarray(signed), x, y, yaw, grid.resolution, deepest)
