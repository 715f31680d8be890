"""What mapping with beams and mapping with cones share: what a reading's end is, and from log-odds to a map."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.kernels import mapping as kernels
from beamfield.maps.inverse_sensor import InverseSensorModel
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, usable_ranges


def lengths_and_kinds(
    ranges: ArrayLike, finder: RangeFinder, model: InverseSensorModel
) -> tuple[FloatArray, NDArray[np.uint8]]:
    """Return how far readings (..., k) are followed, metres, and what the last cell of each is.

    That is `kernels.mapping.HIT`, `PASS` or `SKIP`: no measurement, of length 0.
    """
    z = usable_ranges(ranges, finder)
    kinds = np.full(z.shape, kernels.HIT, np.uint8)
    kinds[np.isnan(z)] = kernels.SKIP
    lost = z == finder.max_range
    kinds[lost] = kernels.PASS if model.clear_without_return > 0 else kernels.SKIP
    z[lost] = min(model.clear_without_return, finder.max_range)
    if model.longest_hit is not None:
        with np.errstate(invalid="ignore"):
            far = z > model.longest_hit
        kinds[far & (kinds == kernels.HIT)] = kernels.PASS
        z[far] = model.longest_hit
    z[kinds == kernels.SKIP] = 0.0
    return z, kinds


def check_size(size: FloatArray, resolution: float, max_cells: int) -> None:
    """Refuse a map of too many cells, before it is allocated."""
    if not np.prod(size) <= max_cells:
        wide, tall = size * resolution
        raise InvalidInputError(
            f"building a map: {wide:.6g} m x {tall:.6g} m at {resolution:g} m are {size[1]:.0f} x {size[0]:.0f} cells, "
            f"and the limit is {max_cells}; use a coarser resolution or a longest_hit"
        )


def grid_of_log_odds(
    log_odds: NDArray[np.float32], seen: NDArray[np.bool_], first: NDArray[np.int64], resolution: float
) -> OccupancyGrid:
    """Return the smallest grid, without yaw, with all cells that were seen, or one unknown cell; others are NaN.

    Log-odds of being occupied, and which cells were seen, are (rows, cols); the first cell is (col, row) cells from the
    map's zero.
    """
    rows, cols = np.flatnonzero(seen.any(axis=1)), np.flatnonzero(seen.any(axis=0))
    if len(rows) == 0:
        return OccupancyGrid(np.full((1, 1), np.nan, np.float32), resolution)
    part = slice(rows[0], rows[-1] + 1), slice(cols[0], cols[-1] + 1)
    probability = np.float32(1.0) / (np.float32(1.0) + np.exp(-log_odds[part]))
    probability[~seen[part]] = np.nan
    origin = (first + np.array([cols[0], rows[0]])) * resolution
    return OccupancyGrid(probability, resolution, np.array([*origin, 0.0]))
