"""Smoothing of occupancy maps with a Gaussian kernel (section 6.5)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beamfield.arguments import checked
from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid

# Where the kernel is cut off, in standard deviations.
CUT_OFF = 4.0


@checked
def smooth_map(grid: OccupancyGrid, sigma: float) -> OccupancyGrid:
    """Convolve a map with a Gaussian kernel, so that scores of map matching vary smoothly with the pose.

    Only defined cells count: each becomes the weighted mean of the defined cells around it, and undefined cells stay
    undefined, so that nothing leaks into space that no sensor saw.

    Parameters
    ----------
    grid
        The map.
    sigma
        Standard deviation of the kernel, metres; cut off at four of them.

    Returns
    -------
    OccupancyGrid
        The same cells with smoothed probabilities.

    Raises
    ------
    InvalidInputError
        If sigma is not positive and finite, is so small that the kernel does not reach the next cell, or so large that
        it reaches beyond the whole map.

    References
    ----------
    Probabilistic Robotics, section 6.5, after (6.37).

    Examples
    --------
    >>> smooth_map(OccupancyGrid([[0.0, 0.0, 1.0, np.nan]], resolution=0.1), 0.05).probability.round(2).tolist()
    [[0.0, 0.1..., 0.8..., nan]]
    """
    from scipy import ndimage  # takes a third of a second to import

    longest = max(grid.shape) * grid.resolution
    if not grid.resolution / CUT_OFF < sigma < longest / CUT_OFF:
        raise InvalidInputError(
            f"smoothing: expected a standard deviation between a quarter of a cell, {grid.resolution / CUT_OFF:g} m, "
            f"and a quarter of the map's longer side, {longest / CUT_OFF:g} m; got {sigma:g}"
        )
    defined = ~np.isnan(grid.probability)
    cells = sigma / grid.resolution
    total = ndimage.gaussian_filter(
        np.where(defined, grid.probability, 0.0).astype(np.float64), cells, mode="constant", truncate=CUT_OFF
    )
    weight = ndimage.gaussian_filter(defined.astype(np.float64), cells, mode="constant", truncate=CUT_OFF)
    mean = np.full(grid.shape, np.nan)
    np.divide(total, weight, out=mean, where=defined)
    # Rounding may leave [0, 1] by 1e-16.
    return replace(grid, probability=np.clip(mean, 0.0, 1.0))
