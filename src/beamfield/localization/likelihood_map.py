"""The likelihood of one scan over a whole map, maximised over the heading (Figure 6.7)."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import as_count, check_magnitude, checked
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, compose, transform_points, wrap_angle
from beamfield.maps.occupancy import BoolArray, OccupancyGrid
from beamfield.models.base import MeasurementModel, check_takes_poses_alone, checked_log_likelihood
from beamfield.models.local_map_cells import LocalMap
from beamfield.short_repr import short_repr

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Progress = Callable[[int, int], None]

# Poses per call of a model: progress moves, memory does not.
POSES_PER_CHUNK = 200_000
# Two bytes for the best heading of each cell.
MAX_HEADINGS = 3600
MAX_CELLS = 100_000_000
# A place further from the best one than this is another place, metres.
RIVAL_APART = 1.0


@dataclass(frozen=True, eq=False)
class LikelihoodMap:
    """log p(z | x, m) on a lattice of positions, maximised over the heading.

    Parameters
    ----------
    log_likelihood
        (rows, cols) nats; row 0 has the lowest y. -inf where the scan is impossible and where it was not evaluated.
    evaluated
        (rows, cols) mask of the cells that were evaluated.
    heading_index
        (rows, cols) which of `headings` is the best; -1 where not evaluated.
    headings
        (h,) radians in the map frame.
    resolution
        Side of a cell, metres.
    origin
        (3,) pose of the lattice's lower-left corner in the map frame: that of the map.
    """

    log_likelihood: FloatArray
    evaluated: BoolArray
    heading_index: NDArray[np.int16]
    headings: FloatArray
    resolution: float
    origin: FloatArray

    __repr__ = short_repr

    @property
    def n_poses(self) -> int:
        """Number of poses that were compared."""
        return int(self.evaluated.sum()) * len(self.headings)

    @property
    def is_flat(self) -> bool:
        """Whether all poses are equally likely: the scan says nothing, or is impossible everywhere."""
        values = self.log_likelihood[self.evaluated]
        return bool(values.min() == values.max())

    @property
    def best_cell(self) -> tuple[int, int]:
        """(row, col) of the largest value; the first of several."""
        masked = np.where(self.evaluated, self.log_likelihood, -np.inf)
        where = int(np.argmax(masked)) if np.isfinite(masked).any() else int(np.argmax(self.evaluated))
        row, col = np.unravel_index(where, masked.shape)
        return int(row), int(col)

    @property
    def best_pose(self) -> FloatArray:
        """(3,) the pose with the largest value, metres and radians."""
        return np.asarray(self.poses(*self.best_cell))

    def rival(self, apart: float = RIVAL_APART) -> tuple[FloatArray, float] | None:
        """Return the best pose at another place: how sure the scan is of the best one.

        Parameters
        ----------
        apart
            How far from `best_pose` the place lies at least, metres.

        Returns
        -------
        The pose (3,), metres and radians, and by how many nats its value is below the largest; None if no place that
        far away is possible.
        """
        check_magnitude("apart", apart)
        rows, cols = np.nonzero(self.evaluated & np.isfinite(self.log_likelihood))
        best = self.best_cell
        away = np.hypot(rows - best[0], cols - best[1]) * self.resolution >= apart
        rows, cols = rows[away], cols[away]
        if not len(rows):
            return None
        first = np.argmax(self.log_likelihood[rows, cols])
        below = self.log_likelihood[best] - self.log_likelihood[rows[first], cols[first]]
        return self.poses(rows[first], cols[first]), float(below)

    def plot(self, grid: OccupancyGrid) -> Figure:
        """Return a Matplotlib figure of the map, the darker the more likely.

        Parameters
        ----------
        grid
            The map.
        """
        from beamfield.figures.likelihood_over_map import plot_likelihood_map

        return plot_likelihood_map(self, grid)

    def poses(self, rows: NDArray[np.int64] | int, cols: NDArray[np.int64] | int) -> FloatArray:
        """Return the pose with the best heading in cells, (..., 3); `log_likelihood` is its value.

        Parameters
        ----------
        rows, cols
            (...) indices of cells that were evaluated.
        """
        index = self.heading_index[rows, cols]
        centre = (np.stack([np.asarray(cols), np.asarray(rows)], axis=-1) + 0.5) * self.resolution
        heading = wrap_angle(self.headings[index] - self.origin[2])
        return compose(self.origin, np.concatenate([centre, heading[..., None]], axis=-1))

    def share_above(self, log_likelihood: float) -> float:
        """Return the share of the evaluated cells whose value is larger than this."""
        return float((self.log_likelihood[self.evaluated] > log_likelihood).mean())


@checked
def likelihood_map(
    model: MeasurementModel[Any],
    scan: LocalMap,
    grid: OccupancyGrid,
    *,
    resolution: float = 0.10,
    headings: int = 72,
    progress: Progress | None = None,
) -> LikelihoodMap:
    """Evaluate p(z | x, m) over all x and y of a map, maximised over theta: Figure 6.7b.

    The lattice has the map's origin; its cells have the given side. A cell whose centre is free is worth the likelihood
    of the pose there with the best of the headings.

    Parameters
    ----------
    model
        Any measurement model of range scans. How dependent its beams are taken to be, and which are used, is the
        model's own choice (`exponent`, `n_beams`).
    scan
        The scan; for models that match maps a local map does as well.
    grid
        The map that tells where the robot may be: the model's.
    resolution
        Side of the lattice's cells, metres.
    headings
        Number of headings, equally spaced over the circle from 0 on.
    progress
        Called with how many cells are done, and of how many.

    Returns
    -------
    LikelihoodMap
        Values, best headings and which cells were evaluated. A scan without any measurement has the same value
        everywhere (`is_flat`).

    Raises
    ------
    InvalidInputError
        If a number is out of range, no cell is free, or the model weighs poses together.

    Notes
    -----
    A lattice can miss peaks that are narrower than its step; see `widened_for_lattice`.

    References
    ----------
    Probabilistic Robotics, section 6.3.2, Figure 6.7b.
    """
    check_takes_poses_alone(model)
    shape = lattice_shape(grid, resolution, MAX_CELLS)
    as_count(headings, "headings", least=1, most=MAX_HEADINGS)
    mask = free_cells(grid, shape, resolution)
    rows, cols = np.nonzero(mask)
    angles = wrap_angle(2.0 * np.pi * np.arange(headings) / headings)
    values, index = np.full(shape, -np.inf), np.full(shape, -1, np.int16)
    centres = transform_points(grid.origin, (np.column_stack([cols, rows]) + 0.5) * resolution)
    for part, each in over_headings(model, scan, centres, angles):
        best = np.argmax(each, axis=1)
        values[rows[part], cols[part]], index[rows[part], cols[part]] = each[np.arange(len(each)), best], best
        if progress is not None:
            progress(part.start + len(each), len(rows))
    return LikelihoodMap(values, mask, index, angles, resolution, grid.origin)


def over_headings(
    model: MeasurementModel[Any], z: Any, centres: FloatArray, headings: FloatArray
) -> Iterator[tuple[slice, FloatArray]]:
    """Yield log likelihoods (m, h) at positions (n, 2) with all headings (h,), and of which m positions they are."""
    step = max(1, POSES_PER_CHUNK // len(headings))
    for start in range(0, len(centres), step):
        part = slice(start, start + step)
        poses = np.empty((len(centres[part]), len(headings), 3))
        poses[..., :2], poses[..., 2] = centres[part, None], headings
        yield part, checked_log_likelihood(model, z, poses.reshape(-1, 3)).reshape(poses.shape[:-1])


def lattice_shape(grid: OccupancyGrid, resolution: float, most: int) -> tuple[int, int]:
    """Return (rows, cols) of a lattice over a map, of at most so many cells with sides of this length, metres."""
    check_magnitude("resolution", resolution)
    # The sides of a map are rarely exact multiples in floating point.
    rows, cols = (max(1.0, float(np.ceil(n * grid.resolution / resolution - 1e-6))) for n in grid.shape)
    if not rows * cols <= most:
        raise InvalidInputError(f"resolution: {resolution:g} m makes {rows:.0f} x {cols:.0f} cells, more than {most:,}")
    return int(rows), int(cols)


def free_cells(grid: OccupancyGrid, shape: tuple[int, int], resolution: float) -> BoolArray:
    """Return which cells (rows, cols) of the lattice have a centre in a free cell of the map."""
    # A centre on a border belongs to the cell above, as everywhere; the last one may lie past the map's edge.
    rows, cols = (np.floor((np.arange(n) + 0.5) * resolution / grid.resolution + 1e-9).astype(np.int64) for n in shape)
    inside = np.ix_(rows < grid.shape[0], cols < grid.shape[1])
    mask = np.zeros(shape, np.bool_)
    mask[inside] = grid.free[np.ix_(rows[rows < grid.shape[0]], cols[cols < grid.shape[1]])]
    if not mask.any():
        if grid.free.any():
            raise InvalidInputError(f"resolution: no place of a lattice of {resolution:g} m is free; give a finer one")
        raise InvalidInputError("grid: expected a map with free cells where a robot may be, got none")
    return mask
