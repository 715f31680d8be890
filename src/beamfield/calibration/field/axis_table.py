"""The axis table: how far from obstacles a reading and its beam's whole axis are; all that learning a field needs."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, compose, invert
from beamfield.indices import subset_of
from beamfield.kernels.axis import count_along_axes
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.distance import DistanceField
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog, usable_ranges

# Pieces of an axis are this long: a quarter of a cell, so that the cells it crosses count by their length.
PIECE_CELLS = 0.25
# A hit farther from its obstacle is none: distances are sorted into classes up to here, metres.
FARTHEST = 4.0
# Distances of few cells are classes of their own, exactly; beyond so many cells each class is a tenth wider.
EXACT_CELLS = 8
WIDENING = 1.1
# So many beams settle three parameters far below what differs from one stretch of a log to the next.
MOST_BEAMS = 20_000


@dataclass(frozen=True, eq=False)
class AxisTable:
    """Readings that are a range, each with the distances to obstacles at its end point and along its axis.

    Parameters
    ----------
    squares
        (n,) squared distance of the end point to the nearest obstacle, m^2; inf beyond `FARTHEST`.
    counts
        (n, c) how many pieces of the axis, from min_range to max_range, are in each class of distance.
    class_squares
        (c,) squared distance of each class, m^2; inf for the last.
    spacing
        Length of a piece, metres.
    span
        max_range - min_range, metres.
    scan
        (n,) index of the scan in the log.
    no_return_scan
        (m,) the same of the readings at max_range, which are not rows of the table.
    resolution
        Of the map, metres.
    n_excluded
        Ranges left out because no obstacle of the map is on their beam's axis.
    """

    squares: FloatArray
    counts: FloatArray
    class_squares: FloatArray
    spacing: float
    span: float
    scan: NDArray[np.int64]
    no_return_scan: NDArray[np.int64]
    resolution: float
    n_excluded: int

    def __len__(self) -> int:
        return len(self.squares)

    def select(self, rows: ArrayLike) -> AxisTable:
        """Return the table with only the given rows, by indices or a mask (n,), and all readings at max_range."""
        return subset_of(self, rows, len(self), "rows", ("squares", "counts", "scan"))

    def of_scans(self, scans: NDArray[np.bool_]) -> AxisTable:
        """Return the table of some scans, by a mask over the scans of the log."""
        return replace(self.select(scans[self.scan]), no_return_scan=self.no_return_scan[scans[self.no_return_scan]])


class _Classes(NamedTuple):
    of_cell: NDArray[np.uint8]
    squares: FloatArray


def build_axis_table(log: SensorLog, grid: OccupancyGrid, scans: ArrayLike, *, seed: int = 0) -> AxisTable:
    """Follow the axes of the beams of scans (indices or a mask) from their reference poses to max_range.

    One row per reading below max_range with an obstacle on its axis, in the order of the log; `seed` draws those that
    are followed where there are more than 20,000. All measured readings count, also those whose beam crosses unknown
    space: a likelihood field scores them all. The distances are those of `LikelihoodFieldModel` with the nearest
    look-up and its defaults. InvalidInputError if the map has no obstacle.
    """
    if not grid.occupied.any():
        raise InvalidInputError("the map has no occupied cell: there is no distance to obstacles")
    finder = log.finder
    chosen = np.arange(len(log))[np.asarray(scans)]
    ranges = usable_ranges(log.ranges[chosen], finder)
    in_log, beam = np.nonzero(np.isfinite(ranges))
    if len(in_log) > MOST_BEAMS:
        drawn = np.sort(np.random.default_rng(seed).choice(len(in_log), MOST_BEAMS, replace=False))
        in_log, beam = in_log[drawn], beam[drawn]
    ranges, scan = ranges[in_log, beam], chosen[in_log]

    distances = DistanceField.from_grid(grid, margin=FARTHEST)
    classes = _classes(distances)
    starts = _starts(compose(log.poses[scan], finder.mounts[beam]), distances)
    n_pieces = int(np.ceil((finder.max_range - finder.min_range) / (PIECE_CELLS * grid.resolution)))
    spacing = (finder.max_range - finder.min_range) / n_pieces
    counts = np.empty((len(ranges), len(classes.squares)))
    first, step = finder.min_range / grid.resolution, spacing / grid.resolution
    off = len(classes.squares) - 1
    run_in_blocks(
        lambda a, b: count_along_axes(starts[a:b], classes.of_cell, off, first, step, n_pieces, counts[a:b]),
        len(starts),
        work_per_row=n_pieces,
    )
    meets = counts[:, 0] > 0.0
    returned = ranges < finder.max_range
    used = meets & returned
    return AxisTable(
        squares=_squares_at(starts[used], ranges[used] / grid.resolution, distances),
        counts=counts[used],
        class_squares=classes.squares,
        spacing=spacing,
        span=finder.max_range - finder.min_range,
        scan=scan[used],
        no_return_scan=scan[meets & ~returned],
        resolution=grid.resolution,
        n_excluded=int((returned & ~meets).sum()),
    )


def _classes(distances: DistanceField) -> _Classes:
    """Sort the cells of a field by distance; the first class is that of obstacles, the last of all beyond FARTHEST."""
    # Squares of distances between cells are whole numbers.
    farthest = (FARTHEST / distances.grid.resolution) ** 2
    n_wider = int(np.ceil(max(0.0, np.log(farthest / EXACT_CELLS**2)) / np.log(WIDENING**2)))
    few = np.arange(EXACT_CELLS + 1) ** 2
    exact = np.unique(few[:, None] + few)
    edges = np.append(exact[exact <= EXACT_CELLS**2], EXACT_CELLS**2 * WIDENING ** (2 * np.arange(1, n_wider + 1)))
    beyond = int(edges[-1]) + 1
    in_cells = distances.distance.ravel() / np.float32(distances.grid.resolution)
    squares = np.minimum(np.round(np.square(in_cells)), beyond).astype(np.int32)
    of_square = np.searchsorted(edges, np.arange(beyond + 1)).astype(np.uint8)
    n_cells = np.bincount(squares, minlength=beyond + 1)
    total = np.bincount(of_square, weights=n_cells * np.arange(beyond + 1.0), minlength=len(edges) + 1)
    number = np.bincount(of_square, weights=n_cells, minlength=len(edges) + 1)
    means = np.divide(total, number, out=np.zeros_like(total), where=number > 0.0)
    means[-1] = np.inf
    return _Classes(of_square[squares].reshape(distances.distance.shape), means * distances.grid.resolution**2)


def _starts(sensors: FloatArray, distances: DistanceField) -> FloatArray:
    """Return (n, 4) column, row, cosine and sine of sensors (n, 3) in the field's cells."""
    local = compose(invert(distances.grid.origin), sensors)
    at = local[:, :2] / distances.grid.resolution + distances.margin_cells
    return np.ascontiguousarray(np.column_stack([at, np.cos(local[:, 2]), np.sin(local[:, 2])]))


def _squares_at(starts: FloatArray, ranges: FloatArray, distances: DistanceField) -> FloatArray:
    """Return the squared distance (n,) to obstacles at ranges (n,) along axes, m^2."""
    cells = np.floor(starts[:, :2] + ranges[:, None] * starts[:, 2:]).astype(np.int64)
    rows, cols = distances.distance.shape
    inside = ((cells >= 0) & (cells < [cols, rows])).all(axis=1)
    found = np.full(len(starts), np.inf)
    found[inside] = distances.distance[cells[inside, 1], cells[inside, 0]]
    return np.where(found > FARTHEST, np.inf, np.square(found))
