"""Signed distances to a map's walls: what end points of hits are held against."""

from __future__ import annotations

import math

import numpy as np

from beamfield.geometry import compose
from beamfield.kernels.trajectory import Walls
from beamfield.maps.distance import distance_to_obstacles
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.solids import DEEPEST_HIT, DEEPEST_IN_FILL, is_filled

# So far beyond the map's edge end points count, metres: maps are cropped to their outer walls.
MARGIN = 0.5


def walls_of(grid: OccupancyGrid) -> Walls:
    """Return the signed distance to the surfaces of a map's obstacles, cell by cell.

    It is the distance to the nearest occupied cell that has a neighbour which is not; negative in the occupied cells
    behind those. So hits that lie inside walls painted too thick still say in which direction the surface is. The table
    reaches half a metre beyond the map, which has occupied cells and others.
    """
    margin = math.ceil(MARGIN / grid.resolution)
    distance = distance_to_obstacles(grid, only_boundaries=True, margin_cells=margin)
    occupied = np.pad(grid.occupied, margin)
    signed = np.where(occupied, -distance, distance)
    x, y, yaw = compose(grid.origin, np.array([-margin * grid.resolution, -margin * grid.resolution, 0.0])).tolist()
    deepest = DEEPEST_IN_FILL if is_filled(occupied, distance) else DEEPEST_HIT
    return Walls(np.ascontiguousarray(signed), x, y, yaw, grid.resolution, deepest)
