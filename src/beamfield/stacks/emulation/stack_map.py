"""How other programs read a map: which cells are occupied, free and unknown, and where cells lie."""

from __future__ import annotations

from typing import Literal

import numpy as np

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid

MapMode = Literal["trinary", "scale", "raw"]
MODES = ("trinary", "scale", "raw")


def read_as_stack(
    grid: OccupancyGrid, mode: MapMode = "trinary", *, ignore_yaw: bool = False, shift_cells: float = 0.0
) -> OccupancyGrid:
    """Return the map as a localisation program sees it: occupied where the map message says 100, free where it says 0.

    Cells with other values are neither. AMCL takes them for unknown cells; Beluga only those with -1.

    Parameters
    ----------
    grid
        The map.
    mode
        How the map server makes the message: "trinary" by the grid's two thresholds; "scale" the same with percents in
        between (which round to 0 or 100 only next to a threshold); "raw" takes the probability itself in percent, as
        if `grid` came from a message.
    ignore_yaw
        The program takes only x and y of the map's origin.
    shift_cells
        The program places cells so far from where the map has them, in x and y; nav2 -1/2: its cell (0, 0) is centred
        on the origin.

    Returns
    -------
    A grid with the probabilities 1, 0, NaN where the message says -1, and 0.5 where it says anything else; the latter
    two are `unknown`. Its resolution is the message's.

    Raises
    ------
    InvalidInputError
        If there is no such mode.
    """
    if mode not in MODES:
        raise InvalidInputError(f"map_mode: expected one of {', '.join(map(repr, MODES))}, got {mode!r}")
    probability = grid.probability.astype(np.float64)
    if mode == "raw":
        value = np.round(100.0 * probability)
        occupied, free = value == 100.0, value == 0.0
    else:
        occupied, free = grid.occupied, grid.free
        if mode == "scale":
            ratio = (probability - grid.free_thresh) / (grid.occupied_thresh - grid.free_thresh)
            value = np.round(100.0 * ratio)
            between = grid.unknown & ~np.isnan(probability)
            occupied, free = occupied | (between & (value == 100.0)), free | (between & (value == 0.0))
    has_value = np.zeros(grid.shape, np.bool_) if mode == "trinary" else ~np.isnan(probability)
    seen = np.where(has_value, np.float32(0.5), np.float32(np.nan))
    seen[free] = 0.0
    seen[occupied] = 1.0
    x, y, yaw = grid.origin
    yaw = 0.0 if ignore_yaw else yaw
    resolution = message_resolution(grid.resolution)
    shift = shift_cells * resolution
    # Along the grid's own axes.
    corner = x + shift * (np.cos(yaw) - np.sin(yaw)), y + shift * (np.sin(yaw) + np.cos(yaw)), yaw
    return OccupancyGrid(seen, resolution, np.array(corner))


def message_resolution(resolution: float) -> float:
    """Return the size of a cell, metres, as programs get it: nav_msgs/OccupancyGrid has it in single precision.

    That matters where they count whole cells: 0.5 m has 10 cells of 0.05 m, but 9 of what the message says.
    """
    return float(np.float32(resolution))
