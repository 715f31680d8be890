"""Whether readings can be metres in a map."""

from __future__ import annotations

import numpy as np

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog, usable_ranges

# So many scans tell enough.
SCANS = 200


def longest_in(grid: OccupancyGrid) -> float:
    """Return how long a reading between two places of a map can be, metres."""
    return float(np.hypot(*grid.shape)) * grid.resolution


def require_metres(log: SensorLog, grid: OccupancyGrid) -> None:
    """Refuse scans most of whose readings are longer than the map, or shorter than a cell: another unit or place."""
    ranges = usable_ranges(log.ranges[:: max(1, len(log) // SCANS)], log.finder)
    hits = ranges[ranges < log.finder.max_range]
    if not len(hits):
        return
    middle = float(np.median(hits))
    if middle < grid.resolution:
        raise InvalidInputError(
            f"{log.finder.name or 'log'}: half of the readings are shorter than {middle:.4g} m, and a map's cell is "
            f"{grid.resolution:.4g} m wide; expected readings in metres, and a map's resolution in metres per cell"
        )
    if middle > longest_in(grid):
        raise InvalidInputError(
            f"{log.finder.name or 'log'}: half of the readings are longer than {middle:.4g} m, and the map is "
            f"{longest_in(grid):.4g} m from corner to corner; expected readings in metres, "
            "not millimetres, and a map of that place"
        )
