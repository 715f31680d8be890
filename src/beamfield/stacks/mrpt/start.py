"""The particles that MRPT's filter starts with."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, transform_points, wrapped
from beamfield.localization.replay import PoseBelief
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.stacks.filters.particles import MOST_PARTICLES

# Fewer square metres count as so many.
LEAST_AREA = 10.0


def initial_poses(
    seen: OccupancyGrid, start: PoseBelief | None, n_sigmas: float, count: int, per_square_metre: int,
    rng: np.random.Generator,
) -> FloatArray:  # fmt: skip
    """Return poses (n, 3) spread evenly over free cells in a box around the start.

    Each is up to a cell's side off the centre of a free cell, in x and in y. Where the box has no free cell, poses are
    spread over all of it.

    Parameters
    ----------
    seen
        The map, its axes along those of the map frame.
    start
        The box reaches n_sigmas standard deviations to either side, headings no farther than -pi and pi, although a
        heading near one of them may be beyond. None for the whole map and all headings.
    n_sigmas
        As above.
    count
        How many; 0 for so many per square metre of the box, of which there are 10 at least.
    per_square_metre
        As above.
    rng
        Source of all randomness.

    Raises
    ------
    InvalidInputError
        If there would be more particles than memory has room for.

    References
    ----------
    mrpt_pf_localization_core.cpp: onStateToBeInitialized; CMonteCarloLocalization2D.cpp: resetUniformFreeSpace.
    """
    low, high = _box(seen, start, n_sigmas)
    if count == 0:
        count = int(per_square_metre * max(LEAST_AREA, float(np.prod(high[:2] - low[:2]))))
    if count > MOST_PARTICLES:
        raise InvalidInputError(f"initial_particles_per_m2: expected at most {MOST_PARTICLES} particles, got {count}")
    headings = rng.uniform(low[2], high[2], count)
    cells = _free_cells(seen, low, high)
    if not len(cells):
        return np.column_stack([rng.uniform(low[:2], high[:2], (count, 2)), headings])
    drawn = cells[rng.integers(len(cells), size=count)] + 0.5 + rng.uniform(-1.0, 1.0, (count, 2))
    return np.column_stack([transform_points(seen.origin, drawn * seen.resolution), headings])


def _box(seen: OccupancyGrid, start: PoseBelief | None, n_sigmas: float) -> tuple[FloatArray, FloatArray]:
    """Return the lower and the upper corner, (3,) each."""
    if start is None:
        size = np.array(seen.shape[::-1]) * seen.resolution
        return np.array([*seen.origin[:2], -math.pi]), np.array([*(seen.origin[:2] + size), math.pi])
    half = n_sigmas * np.sqrt(np.diag(start.covariance))
    mean = np.array([*start.mean[:2], wrapped(float(start.mean[2]))])
    low, high = mean - half, mean + half
    low[2], high[2] = max(low[2], -math.pi), min(high[2], math.pi)
    return low, high


def _free_cells(seen: OccupancyGrid, low: FloatArray, high: FloatArray) -> NDArray[np.int64]:
    """Return column and row (n, 2) of the free cells that the box touches."""
    rows, cols = np.nonzero(seen.free)
    cells = np.column_stack([cols, rows])
    first, last = (np.floor((corner[:2] - seen.origin[:2]) / seen.resolution) for corner in (low, high))
    return np.asarray(cells[((cells >= first) & (cells <= last)).all(axis=1)])
