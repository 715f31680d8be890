"""What AMCL's node does to a scan before its models see it, and how it reads the map; ROS 1 and nav2 alike."""

from __future__ import annotations

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import Scan
from beamfield.stacks.amcl.parameters import AmclParameters
from beamfield.stacks.emulation.stack_map import MapMode, read_as_stack


def amcl_ranges(scan: Scan, parameters: AmclParameters) -> tuple[FloatArray, float]:
    """Return the ranges (k,) that the models get, and the longest: what is too short becomes that.

    The shortest and the longest range that count are the tighter of the sensor's and the parameters', compared in
    single precision, as messages hold ranges: 8.1 is a little more there, and so the same limit.
    """
    finder = scan.finder
    with np.errstate(over="ignore"):
        low, high = np.float32(parameters.laser_min_range), np.float32(parameters.laser_max_range)
    range_min = float(low) if low > np.float32(finder.min_range) else finder.min_range
    range_max = float(high) if 0.0 < high < np.float32(finder.max_range) else finder.max_range
    ranges = np.array(scan.ranges)
    ranges[ranges <= range_min] = range_max
    return ranges, range_max


def amcl_grid(grid: OccupancyGrid, map_mode: MapMode) -> OccupancyGrid:
    """Return the map as AMCL sees it: the origin's yaw ignored, cell (0, 0) centred on the origin."""
    return read_as_stack(grid, map_mode, ignore_yaw=True, shift_cells=-0.5)
