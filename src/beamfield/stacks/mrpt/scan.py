"""What MRPT does to a scan before its models see it, and how it reads the map."""

from __future__ import annotations

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import BoolArray, OccupancyGrid
from beamfield.sensors import Scan
from beamfield.stacks.emulation.beam_selection import Indices
from beamfield.stacks.emulation.field_table import end_points
from beamfield.stacks.emulation.stack_map import MapMode, read_as_stack

# Scans of fewer points are not thinned out.
FEW_POINTS = 10


def valid_readings(scan: Scan) -> BoolArray:
    """Return which readings (k,) are measurements: NaN, missing returns and those outside the limits are not."""
    ranges = scan.ranges
    return np.asarray((ranges >= scan.finder.min_range) & (ranges < scan.finder.max_range))


def scan_points(scan: Scan, least_spacing: float) -> Indices:
    """Return the indices (k,) of the beams that become points.

    The first valid reading after one that is not valid makes no point either. Of points closer together than
    least_spacing, metres, the first stays.
    """
    valid = valid_readings(scan)
    beams = np.flatnonzero(valid & np.concatenate([[True], valid[:-1]]))
    if least_spacing <= 0.0:
        return beams
    return beams[_spaced(end_points(scan.finder.mounts[beams], scan.ranges[beams]), least_spacing)]


def mrpt_grid(grid: OccupancyGrid, map_mode: MapMode) -> OccupancyGrid:
    """Return the map as MRPT sees it.

    Its axes are along the map frame's, its origin is the nearest whole number of cells from the frame's
    (COccupancyGridMap2D::setSize), and its cells are occupied or free on either side of one half.
    """
    read = read_as_stack(grid, map_mode, ignore_yaw=True)
    origin = np.array([*(np.round(read.origin[:2] / read.resolution) * read.resolution), 0.0])
    seen = OccupancyGrid(read.probability, read.resolution, origin)
    if map_mode == "trinary":
        return seen
    value = grid.probability.astype(np.float64)
    if map_mode == "scale":
        value = (value - grid.free_thresh) / (grid.occupied_thresh - grid.free_thresh)
    between = seen.probability == 0.5
    probability = seen.probability.copy()
    probability[between] = np.where(value[between] == 0.5, 0.5, value[between] > 0.5)
    return OccupancyGrid(probability, seen.resolution, seen.origin)


def thinned_out(beams: Indices, decimation: int) -> Indices:
    """Return every n-th point, or all of fewer than `FEW_POINTS`."""
    return beams[::decimation] if len(beams) >= FEW_POINTS else beams


def _spaced(ends: FloatArray, least: float) -> list[int]:
    """Return the indices of points (2, k) that are at least so far from the one kept before."""
    kept: list[int] = []
    x, y = np.inf, np.inf
    for i, (u, v) in enumerate(ends.T.tolist()):
        if (u - x) ** 2 + (v - y) ** 2 >= least * least:
            kept.append(i)
            x, y = u, v
    return kept
