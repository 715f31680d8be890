"""The likelihood of one scan over a whole map, maximised over the heading (Figure 6.7)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import check_magnitude, checked
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses, compose, invert, transform_points, wrap_angle
from beamfield.localization.fan_headings import fan_headings
from beamfield.localization.matching_headings import matching_headings, simple_ratio
from beamfield.localization.shared_fan import SharedFan, shared_fan
from beamfield.maps.occupancy import BoolArray, OccupancyGrid
from beamfield.models.base import MeasurementModel
from beamfield.models.beam import BeamModel
from beamfield.models.local_map_cells import LocalMap
from beamfield.models.map_matching import MapMatchingModel
from beamfield.sensors import Scan
from beamfield.short_repr import short_repr

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Progress = Callable[[int, int], None]

# Poses per call of a model: progress moves, memory does not.
POSES_PER_CHUNK = 200_000
# Two bytes for the best heading of each cell.
MAX_HEADINGS = 3600
MAX_CELLS = 100_000_000


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
    shifts
        (h, 2) metres in the lattice's frame: the pose that stands for a cell is at the cell's centre plus the shift of
        its heading, which stays inside the cell. 0 unless rays were shared (see `likelihood_map`).
    resolution
        Side of a cell, metres.
    origin
        (3,) pose of the lattice's lower-left corner in the map frame: that of the map.
    direction_error
        Largest difference between the direction of a beam and that of the ray that stood for it when the best heading
        was chosen, radians; 0 where rays were not shared.
    """

    log_likelihood: FloatArray
    evaluated: BoolArray
    heading_index: NDArray[np.int16]
    headings: FloatArray
    shifts: FloatArray
    resolution: float
    origin: FloatArray
    direction_error: float = 0.0

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
        return compose(self.origin, np.concatenate([centre + self.shifts[index], heading[..., None]], axis=-1))

    def cell_of(self, pose: FloatArray) -> tuple[int, int] | None:
        """Return (row, col) of the cell in which a pose lies; None off the lattice.

        Parameters
        ----------
        pose
            (3,) metres and radians.
        """
        x, y, _ = compose(invert(self.origin), as_poses(pose, "pose"))
        row, col = int(np.floor(y / self.resolution)), int(np.floor(x / self.resolution))
        inside = 0 <= row < self.evaluated.shape[0] and 0 <= col < self.evaluated.shape[1]
        return (row, col) if inside else None

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
    where: Literal["free", "known", "all"] | BoolArray = "free",
    direction_tolerance: float = np.radians(0.25),
    progress: Progress | None = None,
) -> LikelihoodMap:
    """Evaluate p(z | x, m) over all x and y of a map, maximised over theta: Figure 6.7b.

    The lattice has the map's origin; its cells have the given side. A cell is worth the likelihood of the pose at its
    centre with the best of the headings.

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
        Side of the lattice's cells, metres. Within 1e-6 of a simple ratio to the map's cells (2, 1 / 2 ...), the
        lattice takes exactly that ratio: 0.1 m on cells of 0.05000000075 m are two cells.
    headings
        Number of headings, equally spaced over the circle from 0 on.
    where
        The cells to evaluate, by what the map says at their centre: "free" ones, "known" ones (free or occupied),
        "all"; or a mask (rows, cols) of the lattice.
    direction_tolerance
        Radians. A `BeamModel` whose beams start at one point shares rays between the headings of a place (see Notes);
        a beam may then be off by at most so much. 0 casts each beam for itself.
    progress
        Called with how much is done and how much there is, in cells or poses.

    Returns
    -------
    LikelihoodMap
        Values, best headings and which cells were evaluated. A scan without any measurement has the same value
        everywhere (`is_flat`).

    Raises
    ------
    InvalidInputError
        If a number is out of range, the mask does not fit, or no cell is to be evaluated.

    Notes
    -----
    The values are the model's own, log p(z | x, m) at `LikelihoodMap.poses`. Only the choice of the best heading is
    made a quicker way, with two models.

    With a `BeamModel`, rays are shared: turning the robot by one heading step turns every beam onto the place of
    another beam, if the step between beams and the step between headings have a common measure. A fan of rays at that
    measure, cast once per place, then holds the expected ranges of all headings, a few hundred rays instead of headings
    times beams; and log p(z^k | z*) of each beam is read from a table. The measure taken is the coarsest for which
    every beam is within `direction_tolerance` of a ray; for beams 1 degree apart and 72 headings it is 1 degree and
    exact, for others at most 0.5 degree. If the sensor is not in the robot's centre, it is the sensor that stands in
    the centre of a cell; the robot is then up to half a cell away from the centre of its own (`LikelihoodMap.shifts`).

    With a `MapMatchingModel`, Fourier transforms give the correlations of all places at one heading
    (`matching_headings`), if that takes less time and the lattice's step is a simple ratio of the map's cells. The
    correlation of the heading that is chosen is at most 1e-3 less than that of the best. For local maps of many cells
    the transforms are in double precision, and the values are theirs: exp of a value is within 1e-8 of the model's.

    A lattice can miss peaks that are narrower than its step; see `widened_for_lattice`.

    References
    ----------
    Probabilistic Robotics, section 6.3.2, Figure 6.7b.
    """
    shape = _lattice_shape(grid, resolution)
    if not 1 <= headings <= MAX_HEADINGS:
        raise InvalidInputError(f"headings: expected 1 to {MAX_HEADINGS}, got {headings}")
    if not 0.0 <= direction_tolerance < np.pi:
        raise InvalidInputError(f"direction_tolerance: expected [0, pi) radians, got {direction_tolerance}")
    ratio = simple_ratio(resolution, grid.resolution)
    if ratio is not None and not np.isclose(float(ratio) * grid.resolution, resolution, rtol=1e-12, atol=0.0):
        resolution = float(ratio) * grid.resolution
    angles = wrap_angle(2.0 * np.pi * np.arange(headings) / headings)
    lattice = _Lattice(grid.origin, resolution, _mask(grid, shape, resolution, where), angles)
    if isinstance(model, MapMatchingModel):
        return _by_transforms(model, scan, lattice, progress)
    if isinstance(model, BeamModel) and isinstance(scan, Scan):
        chosen = scan.subset(model.used_beams(scan))
        fan = shared_fan(chosen, angles, float(grid.origin[2]), resolution, direction_tolerance)
        if fan is not None:
            return _by_shared_fan(model, chosen, fan, lattice, progress)
    return _pose_by_pose(model, scan, lattice, progress)


class _Lattice(NamedTuple):
    """Where to evaluate: origin (3,), side of a cell in metres, mask (rows, cols), and headings (h,) in radians."""

    origin: FloatArray
    resolution: float
    mask: BoolArray
    headings: FloatArray

    def map_of(
        self, heading_index: NDArray[np.int16], shifts: FloatArray | None = None, direction_error: float = 0.0
    ) -> LikelihoodMap:
        """Return a map with these best headings, (rows, cols), and without values yet."""
        values = np.full(self.mask.shape, -np.inf)
        shifts = np.zeros((len(self.headings), 2)) if shifts is None else shifts
        return LikelihoodMap(
            values, self.mask, heading_index, self.headings, shifts, self.resolution, self.origin, direction_error
        )


def _lattice_shape(grid: OccupancyGrid, resolution: float) -> tuple[int, int]:
    check_magnitude("resolution", resolution)
    # The sides of a map are rarely exact multiples in floating point.
    rows, cols = (max(1.0, float(np.ceil(n * grid.resolution / resolution - 1e-6))) for n in grid.shape)
    if not rows * cols <= MAX_CELLS:
        raise InvalidInputError(
            f"resolution: {resolution:g} m makes {rows:.0f} x {cols:.0f} cells, more than {MAX_CELLS:,}"
        )
    return int(rows), int(cols)


def _mask(
    grid: OccupancyGrid, shape: tuple[int, int], resolution: float, where: Literal["free", "known", "all"] | BoolArray
) -> BoolArray:
    """Return which cells (rows, cols) of the lattice to evaluate."""
    if isinstance(where, np.ndarray):
        mask = where.astype(np.bool_)
        if mask.shape != shape:
            raise InvalidInputError(f"where: expected a mask of shape {shape}, got {mask.shape}")
    elif where == "all":
        mask = np.ones(shape, np.bool_)
    elif where in ("free", "known"):
        # A centre on a border belongs to the cell above, as everywhere; the last one may lie past the map's edge.
        rows, cols = (
            np.floor((np.arange(n) + 0.5) * resolution / grid.resolution + 1e-9).astype(np.int64) for n in shape
        )
        inside = np.ix_(rows < grid.shape[0], cols < grid.shape[1])
        categories = grid.free if where == "free" else ~grid.unknown
        mask = np.zeros(shape, np.bool_)
        mask[inside] = categories[np.ix_(rows[rows < grid.shape[0]], cols[cols < grid.shape[1]])]
    else:
        raise InvalidInputError(f"where: expected 'free', 'known', 'all' or a mask, got {where!r}")
    if not mask.any():
        raise InvalidInputError(f"where: no cell to evaluate; the map has {int(grid.free.sum())} free cells")
    return mask


def _pose_by_pose(
    model: MeasurementModel[Any], scan: LocalMap, lattice: _Lattice, progress: Progress | None
) -> LikelihoodMap:
    """Ask the model for every pose."""
    result = lattice.map_of(np.where(lattice.mask, 0, -1).astype(np.int16))
    rows, cols = np.nonzero(lattice.mask)
    n_headings = len(lattice.headings)
    step = max(1, POSES_PER_CHUNK // n_headings)
    for start in range(0, len(rows), step):
        row, col = rows[start : start + step], cols[start : start + step]
        centres = transform_points(lattice.origin, (np.column_stack([col, row]) + 0.5) * lattice.resolution)
        poses = np.empty((len(row), n_headings, 3))
        poses[..., :2] = centres[:, None]
        poses[..., 2] = lattice.headings
        values = model.log_likelihood(scan, poses)
        best = np.argmax(values, axis=1)
        result.log_likelihood[row, col] = values[np.arange(len(row)), best]
        result.heading_index[row, col] = best
        if progress is not None:
            progress(min(start + step, len(rows)), len(rows))
    return result


def _by_transforms(model: MapMatchingModel, z: LocalMap, lattice: _Lattice, progress: Progress | None) -> LikelihoodMap:
    """Find the best heading of each cell from correlations at all translations; ask the model where these round."""
    rows, cols = np.nonzero(lattice.mask)
    found = matching_headings(model, z, (rows, cols), lattice.headings, lattice.origin, lattice.resolution, progress)
    if found is None:
        return _pose_by_pose(model, z, lattice, progress)
    index = np.full(lattice.mask.shape, -1, np.int16)
    index[rows, cols] = found.heading_index
    result = lattice.map_of(index)
    if found.is_exact:
        with np.errstate(divide="ignore"):
            result.log_likelihood[rows, cols] = np.log(found.correlation)
    else:
        result.log_likelihood[rows, cols] = model.log_likelihood(z, result.poses(rows, cols))
    return result


def _by_shared_fan(
    model: BeamModel, scan: Scan, fan: SharedFan, lattice: _Lattice, progress: Progress | None
) -> LikelihoodMap:
    """Find the best heading of each cell from one fan of rays per place of the sensor; then ask the model."""
    index = fan_headings(model, scan, fan, lattice.mask, lattice.origin, lattice.resolution, progress)
    result = lattice.map_of(index, fan.shifts, fan.direction_error)
    rows, cols = np.nonzero(lattice.mask)
    result.log_likelihood[rows, cols] = model.log_likelihood(scan, result.poses(rows, cols))
    return result
