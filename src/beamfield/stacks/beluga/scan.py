"""What Beluga's node does to a scan before its models see it, and how it reads the map."""

from __future__ import annotations

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import BoolArray, OccupancyGrid
from beamfield.sensors import Scan
from beamfield.stacks.beluga.parameters import BelugaParameters
from beamfield.stacks.emulation.beam_selection import Indices, even_beams


def beluga_beams(scan: Scan, parameters: BelugaParameters, no_return: str) -> tuple[Indices, FloatArray]:
    """Return the indices (k,) of the beams that become points, and their ranges (k,) in metres.

    Beams are selected first; then NaN and what is outside the limits is dropped. A range of exactly the longest range
    stays, as a hit.
    """
    low = max(scan.finder.min_range, parameters.laser_min_range)
    high = min(scan.finder.max_range, parameters.laser_max_range)
    ranges = np.array(scan.ranges)
    if no_return == "range_max":
        ranges[ranges == np.inf] = scan.finder.max_range
    beams = even_beams(len(ranges), parameters.max_beams)
    beams = beams[(ranges[beams] >= low) & (ranges[beams] <= high)]
    return beams, ranges[beams]


def boundaries(grid: OccupancyGrid) -> BoolArray:
    """Return the occupied cells with a free neighbour (left, right, below, above) on the map."""
    free = np.pad(grid.free, 1)
    return grid.occupied & (free[:-2, 1:-1] | free[2:, 1:-1] | free[1:-1, :-2] | free[1:-1, 2:])
