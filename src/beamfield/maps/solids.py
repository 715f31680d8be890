"""Where everything that is not free is painted black: the inside of solids, which no beam reaches."""

from __future__ import annotations

import numpy as np

from beamfield.maps.distance import distance_to_obstacles
from beamfield.maps.occupancy import OccupancyGrid

# No hit lies deeper in a solid, metres: more than poses and walls are wrong by.
DEEPEST_HIT = 0.5
# Nor so deep where the solids are no walls that were painted thick, but all that is not free.
DEEPEST_IN_FILL = 0.2


def hollowed(grid: OccupancyGrid) -> OccupancyGrid:
    """Return a map whose cells more than `DEEPEST_HIT` inside solids are unknown; the same map if there are none.

    A likelihood field is highest in all of a solid. Where the unknown is painted black, as in maps drawn by hand or of
    race tracks, any pose fits whose readings end in it.
    """
    deep = grid.occupied & (distance_to_obstacles(grid, only_boundaries=True) > DEEPEST_HIT)
    # Where all is obstacle there is no boundary to be far from.
    if not deep.any() or deep.all():
        return grid
    return OccupancyGrid(
        np.where(deep, np.float32(np.nan), grid.probability), grid.resolution, grid.origin,
        grid.occupied_thresh, grid.free_thresh,
    )  # fmt: skip
