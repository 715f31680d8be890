"""Floor plans that many tests look at: to draw one takes a third of a second."""

from __future__ import annotations

from functools import cache

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.simulation.floor_plan import draw_floor_plan


@cache
def plan(seed: int) -> OccupancyGrid:
    return draw_floor_plan(seed=seed)
