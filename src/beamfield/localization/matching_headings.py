"""The best heading of map matching at every place of a lattice, from Fourier transforms."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from scipy.fft import next_fast_len

from beamfield.geometry import FloatArray, as_poses, compose
from beamfield.kernels.threads import run_in_blocks
from beamfield.localization.translation_sums import (
    Integers,
    MapSpectra,
    Places,
    Precision,
    map_spectra,
    translation_sums,
    turned_template,
)
from beamfield.maps.mapping import scan_map
from beamfield.maps.occupancy import BoolArray, OccupancyGrid
from beamfield.maps.smoothing import smooth_map
from beamfield.models.local_map_cells import LocalCells, LocalMap, OverlapSums, local_cells
from beamfield.models.map_matching import MapMatchingModel
from beamfield.sensors import Scan

# A lattice lines up with a map if their steps are as p to q to this relative difference, q at most LARGEST_DIVISOR.
SAME_RATIO = 1e-6
LARGEST_DIVISOR = 8
# Cells of a map along one side that are transformed at a time, besides what the local map reaches.
CELLS_PER_TILE = 1024
# Sizes of transforms per axis, so that headings along which the local map is short get short transforms.
SIZES_PER_AXIS = 4
# Headings between two calls of `progress`.
HEADINGS_PER_BATCH = 8
# Measured nanoseconds: a cell of the local map at one pose of the model; one point of all transforms of a heading, for
# each doubling of their size.
DIRECT_NS, SINGLE_NS, DOUBLE_NS = 3.0, 1.3, 2.4
# Variances below these are left to the model: correlations are quotients by them, and their error grows. With those
# above, correlations are right to the errors of `tests/localization/test_matching_headings.py`.
LEAST_VARIANCE_SINGLE, LEAST_VARIANCE_DOUBLE = 1e-3, 1e-6
# Single precision is not taken if sums may be wrong by more than this share of the least overlap.
LARGEST_NOISE = 1e-4


@dataclass(frozen=True, eq=False)
class MatchingHeadings:
    """The best headings of n places.

    Parameters
    ----------
    heading_index
        (n,) which heading is the best; the first of equals.
    correlation
        (n,) its correlation, 0 where no heading has a positive one.
    is_exact
        Whether the correlations are the model's to 1e-8 (double precision). If not, that of the heading may be smaller
        by 1e-3 than that of the best, and the model is to be asked for its value. Both hold in all tests, and are no
        proven bounds.
    """

    heading_index: Integers
    correlation: FloatArray
    is_exact: bool


@dataclass(frozen=True)
class _Tile:
    """Places that are transformed together: (n,) lattice places, their cells in the map, and where they stand there."""

    members: Integers
    rows: Integers
    cols: Integers
    phase: tuple[float, float]


def matching_headings(
    model: MapMatchingModel,
    z: LocalMap,
    places: tuple[Integers, Integers],
    angles: FloatArray,
    origin: FloatArray,
    resolution: float,
    progress: Callable[[int, int], None] | None = None,
    *,
    precision: Precision | None = None,
) -> MatchingHeadings | None:
    """Return the best of some headings at each place of a lattice, without asking the model for every pose.

    At one heading, the sums behind (6.35) at all translations are six correlations of pictures; Fourier transforms
    give them for all places in a time that does not depend on how many cells the local map has.

    Parameters
    ----------
    model
        The model.
    z
        A scan, or a local map in the robot's frame.
    places
        (n,) rows and (n,) columns of the lattice.
    angles
        (h,) headings, radians in the map frame.
    origin
        (3,) pose of the lattice's corner in the map frame.
    resolution
        Side of the lattice's cells, metres.
    progress
        Called with the number of poses done and in total.
    precision
        float32 or float64; None takes the one with which the whole takes less time.

    Returns
    -------
    None if asking the model takes less time, the lattice and the map do not line up, or the measurement has no cell.

    References
    ----------
    Probabilistic Robotics, section 6.5, (6.35) to (6.37).
    """
    ratio = simple_ratio(resolution, model.grid.resolution)
    local = (
        scan_map(z, resolution=model.grid.resolution, inverse_model=model.inverse_model) if isinstance(z, Scan) else z
    )
    cells = local_cells(local, model.grid.resolution, model.inverse_model)
    if ratio is None or not np.array_equal(origin, model.grid.origin) or not len(cells.x):
        return None
    grid = model.grid if model.smoothing is None else smooth_map(model.grid, model.smoothing)
    reach = int(np.ceil(np.hypot(cells.x, cells.y).max())) + 1
    tiles = list(_tiles(places, ratio, max(CELLS_PER_TILE, 2 * reach)))
    if precision is None:
        precision = _cheapest(grid, tiles, reach, len(cells.x), len(angles), model.min_overlap)
        if precision is None:
            return None
    search = _Search(model, grid, local, cells, angles, origin, resolution, places, precision, reach)
    return search.run(tiles, progress)


def simple_ratio(resolution: float, cell: float) -> Fraction | None:
    """Return a lattice's step in cells of a map if it is p / q with a small q, else None.

    Parameters
    ----------
    resolution, cell
        Sides of the lattice's and of the map's cells, metres.

    Returns
    -------
    Cells per step, with q at most `LARGEST_DIVISOR`; None if no such ratio is near enough.
    """
    ratio = Fraction(resolution / cell).limit_denominator(LARGEST_DIVISOR)
    return ratio if abs(float(ratio) * cell - resolution) <= SAME_RATIO * resolution else None


def _tiles(places: tuple[Integers, Integers], ratio: Fraction, side: int) -> Iterator[_Tile]:
    """Yield the places by where they stand in their cell of the map, and by tiles of the map."""
    p, q = ratio.numerator, 2 * ratio.denominator
    # The centre of lattice cell i lies at (2 i + 1) p / 2 q cells.
    (row, row_phase), (col, col_phase) = (np.divmod((2 * index + 1) * p, q) for index in places)
    # One number for each combination: sorting rows of numbers takes ten times as long.
    n_cols = int(col.max()) // side + 1
    key = ((row // side * n_cols + col // side) * q + row_phase) * q + col_phase
    order = np.argsort(key, kind="stable")
    for members in np.split(order, np.flatnonzero(np.diff(key[order])) + 1):
        of_row, of_col = int(row_phase[members[0]]), int(col_phase[members[0]])
        yield _Tile(members, row[members], col[members], (of_row / q, of_col / q))


def _cheapest(
    grid: OccupancyGrid, tiles: list[_Tile], reach: int, n_cells: int, n_headings: int, min_overlap: float
) -> Precision | None:
    """Return the precision that takes the least time with all that follows; None if asking the model takes less."""
    n_places = sum(len(tile.members) for tile in tiles)
    points = 0.0
    noise = 0.0
    for tile in tiles:
        part = _part(grid, tile, (reach, reach))
        if part is not None:
            size = float(np.prod([_span(part[axis]) + reach for axis in (0, 1)]))
            points += size * np.log2(size)
            noise = max(noise, _noise(np.float32, size, min_overlap))
    asking = DIRECT_NS * n_places * n_cells
    single = SINGLE_NS * points * n_headings + asking if noise <= LARGEST_NOISE else np.inf
    double = DOUBLE_NS * points * n_headings
    if asking * n_headings <= min(single, double):
        return None
    return np.float32 if single <= double else np.float64


def _noise(precision: Precision, size: float, min_overlap: float) -> float:
    """Return how wrong sums may be, as a share of the least number of common cells."""
    return float(np.finfo(precision).eps * np.log2(size) / min_overlap)


def _part(grid: OccupancyGrid, tile: _Tile, reach: tuple[int, int]) -> tuple[slice, slice] | None:
    """Return the part of the map to which the local map reaches from a tile, without undefined margins."""
    rows, cols = (
        slice(max(0, int(index.min()) - r), max(0, int(index.max()) + r + 1))
        for index, r in zip((tile.rows, tile.cols), reach, strict=True)
    )
    defined = ~np.isnan(grid.probability[rows, cols])
    in_rows, in_cols = np.flatnonzero(defined.any(axis=1)), np.flatnonzero(defined.any(axis=0))
    if not len(in_rows):
        return None
    return (
        slice(rows.start + int(in_rows[0]), rows.start + int(in_rows[-1]) + 1),
        slice(cols.start + int(in_cols[0]), cols.start + int(in_cols[-1]) + 1),
    )


def _span(part: slice) -> int:
    return int(part.stop - part.start)


class _Search:
    """One call of `matching_headings`: keeps the best heading of each place so far."""

    def __init__(
        self,
        model: MapMatchingModel,
        grid: OccupancyGrid,
        local: OccupancyGrid,
        cells: LocalCells,
        angles: FloatArray,
        origin: FloatArray,
        resolution: float,
        places: tuple[Integers, Integers],
        precision: Precision,
        reach: int,
    ) -> None:
        self._model, self._grid, self._local, self._cells = model, grid, local, cells
        self._angles, self._origin, self._resolution, self._places = angles, origin, resolution, places
        self._precision, self._reach = precision, reach
        self._turns = angles - grid.origin[2]
        self._defined: BoolArray = ~np.isnan(grid.probability)
        # The model's values, which are rounded. A correlation is the same whatever is taken from all of them; around
        # their mean the sums are small.
        of_map, of_cells = (p - np.float32(0.5) for p in (grid.probability, cells.probability))
        mean_of_map = float(of_map[self._defined].mean(dtype=np.float64)) if self._defined.any() else 0.0
        self._centre = 0.5 * (mean_of_map + float(of_cells.mean(dtype=np.float64)))
        self._of_map, self._of_cells = of_map, of_cells.astype(np.float64) - self._centre
        self._best = np.zeros(len(places[0]))
        self._index = np.zeros(len(places[0]), np.int64)

    def run(self, tiles: list[_Tile], progress: Callable[[int, int], None] | None) -> MatchingHeadings:
        total = sum(len(tile.members) for tile in tiles) * len(self._angles)
        done = 0
        for tile in tiles:
            where = _places_of(tile)
            for reach, headings in self._headings_by_reach():
                part = _part(self._grid, tile, reach)
                spectra = None if part is None else self._spectra(part, reach, tile)
                for start in range(0, len(headings), HEADINGS_PER_BATCH):
                    batch = headings[start : start + HEADINGS_PER_BATCH]
                    if spectra is not None:
                        self._compare(tile, where, spectra, batch)
                    done += len(batch) * len(tile.members)
                    if progress is not None:
                        progress(done, total)
        return MatchingHeadings(self._index, self._best, self._precision is np.float64)

    def _headings_by_reach(self) -> Iterator[tuple[tuple[int, int], Integers]]:
        """Yield headings along which the turned local map reaches about as far, and how far in rows and columns."""
        step = max(1, -(-self._reach // SIZES_PER_AXIS))
        c, s = np.cos(self._turns)[:, None], np.sin(self._turns)[:, None]
        corners = _corners(self._cells)
        extent = np.stack([np.abs(s * corners[0] + c * corners[1]), np.abs(c * corners[0] - s * corners[1])])
        reaches = (np.ceil((extent.max(axis=2) + 1.0) / step) * step).astype(np.int64)
        distinct, group = np.unique(reaches.T, axis=0, return_inverse=True)
        for g, (rows, cols) in enumerate(distinct):
            yield (int(rows), int(cols)), np.flatnonzero(group.reshape(-1) == g)

    def _spectra(self, part: tuple[slice, slice], reach: tuple[int, int], tile: _Tile) -> MapSpectra:
        values = self._of_map[part].astype(np.float64) - self._centre
        shape = []
        for axis, index in enumerate((tile.rows, tile.cols)):
            # A template must not meet the part's other end.
            least = max(
                int(index.max()) + reach[axis] - part[axis].start, part[axis].stop - int(index.min()) + reach[axis]
            )
            shape.append(next_fast_len(max(least + 1, _span(part[axis])), real=axis == 1))
        first = part[0].start, part[1].start
        return map_spectra(values, self._defined[part], first, (shape[0], shape[1]), self._precision)

    def _compare(self, tile: _Tile, where: Places, spectra: MapSpectra, batch: Integers) -> None:
        """Keep what is better at some headings."""
        scores = np.empty((len(batch), len(tile.members)))
        size = spectra.shape[0] * spectra.shape[1]

        def fill(start: int, stop: int) -> None:
            for b in range(start, stop):
                template = turned_template(self._cells, self._of_cells, self._turns[batch[b]], tile.phase)
                scores[b], doubtful = self._scores(translation_sums(spectra, template, where), size)
                if doubtful.any():
                    scores[b, doubtful] = self._ask(tile.members[doubtful], self._angles[batch[b]])

        run_in_blocks(fill, len(batch), work_per_row=size)
        for score, heading in zip(scores, batch, strict=True):
            best, index = self._best[tile.members], self._index[tile.members]
            better = (score > best) | ((score == best) & (heading < index) & (score > 0.0))
            self._best[tile.members] = np.where(better, score, best)
            self._index[tile.members] = np.where(better, heading, index)

    def _scores(self, sums: OverlapSums, size: int) -> tuple[FloatArray, BoolArray]:
        """Return max(rho, 0) of (6.35), and where rounding decides, so that it is not known."""
        n = np.maximum(sums.n, 1.0)
        mean = (sums.local + sums.map) / (2.0 * n)
        numerator = sums.product / n - mean**2
        variance = sums.local_square / n - 2.0 * mean * sums.local / n + mean**2
        of_map = sums.map_square / n - 2.0 * mean * sums.map / n + mean**2
        least = LEAST_VARIANCE_DOUBLE if self._precision is np.float64 else LEAST_VARIANCE_SINGLE
        enough = sums.n / len(self._cells.x) >= self._model.min_overlap
        clear = np.minimum(variance, of_map) > least
        rho = numerator / np.sqrt(np.where(clear, variance * of_map, 1.0))
        # A negative correlation is worth nothing, however uncertain.
        noise = _noise(self._precision, size, self._model.min_overlap)
        doubtful = enough & ~clear & (numerator > -noise)
        return np.where(enough & clear, np.clip(rho, 0.0, 1.0), 0.0), doubtful

    def _ask(self, members: Integers, angle: float) -> FloatArray:
        """Return max(rho, 0) of the model itself."""
        rows, cols = (index[members] for index in self._places)
        inside = np.column_stack([cols + 0.5, rows + 0.5, np.zeros(len(rows))]) * self._resolution
        poses = as_poses(compose(self._origin, inside))
        poses[:, 2] = angle
        return np.maximum(self._model.correlation(self._local, poses), 0.0)


def _places_of(tile: _Tile) -> Places:
    rows, index = np.unique(tile.rows, return_inverse=True)
    return Places(rows, index.reshape(-1), tile.cols)


def _corners(cells: LocalCells) -> FloatArray:
    """Return (2, 4) x, y of the corners of the box around a local map, which reach at least as far as its cells."""
    xs, ys = (float(cells.x.min()), float(cells.x.max())), (float(cells.y.min()), float(cells.y.max()))
    return np.array([(x, y) for x in xs for y in ys]).T
