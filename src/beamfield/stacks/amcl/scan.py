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

    The shortest and the longest range that count are the tighter of the sensor's and the parameters'.
    """
    finder, low, high = scan.finder, parameters.laser_min_range, parameters.laser_max_range
    range_min = max(finder.min_range, low) if low > 0.0 else finder.min_range
    range_max = min(finder.max_range, high) if high > 0.0 else finder.max_range
    ranges = np.array(scan.ranges)
    ranges[ranges <= range_min] = range_max
    return ranges, range_max


def amcl_grid(grid: OccupancyGrid, map_mode: MapMode) -> OccupancyGrid:
    """Return the map as AMCL sees it: the origin's yaw ignored, cell (0, 0) centred on the origin."""
    return read_as_stack(grid, map_mode, ignore_yaw=True, shift_cells=-0.5)
