"""How often the cells of a map were hit and passed, and where in them the hits lie."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import check_magnitude
from beamfield.errors import TooLittleDataError
from beamfield.geometry import FloatArray
from beamfield.kernels import mapping as kernels
from beamfield.maps.followed_beams import FollowedBeams, followed_beams
from beamfield.maps.inverse_sensor import InverseSensorModel, log_odds_steps
from beamfield.maps.log_odds import check_size, grid_of_log_odds
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.occupancy_mapper import MAX_CELLS
from beamfield.sensors import SensorLog
from beamfield.short_repr import short_repr

Progress = Callable[[int, int], None]

SCANS_PER_CHUNK = 128
# Beams are told apart by their direction: both sides of a thin wall are surfaces of their own.
N_SECTORS = 8
# Number of hits, and sums of x, y, xx, xy, yy.
N_MOMENTS = 6
# Probabilities up to this are free: one pass more than hits make up for.
FREE_AFTER_ONE_PASS = 0.45


@dataclass(frozen=True, eq=False)
class HitCounts:
    """Counts of a log's scans in cells, and moments of the end points of their hits.

    Parameters
    ----------
    hits, passes
        (rows, cols) float32: scans that ended in a cell, and scans that passed it without ending in it.
    first
        (col, row) of the first cell, in cells from the map's zero.
    resolution
        Side of a cell, metres.
    cells
        (m,) flat indices of the cells with hits, increasing.
    moments
        (m, 8, 6) number of end points and sums of x, y, xx, xy, yy from the middle of the cell, in cells, for beams
        whose direction lies in each of 8 sectors; sector 0 begins at the map's x axis.
    """

    hits: NDArray[np.float32]
    passes: NDArray[np.float32]
    first: NDArray[np.int64]
    resolution: float
    cells: NDArray[np.int64]
    moments: FloatArray

    __repr__ = short_repr

    def to_grid(self) -> OccupancyGrid:
        """Return the occupancy map by log-odds of the counts."""
        return grid_of_counts(self.hits, self.passes, self.first, self.resolution)

    @property
    def seen(self) -> NDArray[np.bool_]:
        """(rows, cols) cells that a scan passed or hit."""
        return np.asarray(self.hits + self.passes > 0)


def count_hits(
    log: SensorLog, scans: NDArray[np.bool_], resolution: float, *, progress: Progress | None = None
) -> HitCounts:
    """Count for each cell how many scans end in it and how many pass it, of those in the mask (t,) that have poses.

    A scan counts once per cell, however many of its beams meet it, and a hit counts before a pass. Readings without
    return say nothing. The grid holds all beams of the log, those of scans that were not chosen too.

    TooLittleDataError if no scan has a pose; InvalidInputError if the resolution is not positive, or the map would have
    more than 10^8 cells; nothing is allocated then.
    """
    check_magnitude("resolution", resolution)
    posed = np.isfinite(log.poses).all(axis=1)
    chosen = np.flatnonzero(scans & posed)
    if len(chosen) == 0:
        raise TooLittleDataError("building a map: none of the chosen scans has a pose")
    model = InverseSensorModel()

    def follow(part: NDArray[np.int64]) -> FollowedBeams:
        return followed_beams(log.ranges[part], log.finder, log.poses[part], resolution, model)

    first, shape = _frame([follow(part).extent() for part in _chunks(np.flatnonzero(posed))], resolution)
    hits, passes = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    stamps = np.full(shape, -1, np.int32)
    # A hit is only stamped here, so that no other beam of the scan counts as a pass.
    steps = np.array([0.0, 1.0, 0.0, np.finfo(np.float32).max], np.float32)
    ends: list[tuple[NDArray[np.int64], FloatArray]] = []
    done = 0
    for part in _chunks(chosen):
        beams = follow(part)
        beams.starts[:, :2] -= first
        kernels.update_log_odds(*beams, steps, 2 * done, passes, stamps)
        ends.append(_count_ends(beams, hits))
        done += len(part)
        if progress is not None:
            progress(done, len(chosen))
    cells, moments = _moments(np.concatenate([e[0] for e in ends]), np.concatenate([e[1] for e in ends], axis=1))
    return HitCounts(hits, passes, first, resolution, cells, moments)


def grid_of_counts(
    hits: NDArray[np.float32], passes: NDArray[np.float32], first: NDArray[np.int64], resolution: float
) -> OccupancyGrid:
    """Return the occupancy map by log-odds of counts; NaN where nothing was seen.

    It is as of `build_map`, but for bounds, which are applied to the sums, and for cells that were passed once, which
    are free.
    """
    hit, passed, low, high = log_odds_steps(InverseSensorModel())
    log_odds = np.clip(hit * hits + passed * passes, low, high)
    grid = grid_of_log_odds(log_odds, hits + passes > 0, first, resolution)
    return replace(grid, free_thresh=FREE_AFTER_ONE_PASS)


def _frame(
    extents: list[tuple[FloatArray, FloatArray] | None], resolution: float
) -> tuple[NDArray[np.int64], tuple[int, int]]:
    """Return the first cell and the shape of a grid that holds all beams; one cell if there is none."""
    known = [extent for extent in extents if extent is not None]
    if not known:
        return np.zeros(2, np.int64), (1, 1)
    low, high = np.stack([e[0] for e in known]).min(axis=0), np.stack([e[1] for e in known]).max(axis=0)
    size = high - low + 1
    check_size(size, resolution, MAX_CELLS)
    return low.astype(np.int64), (int(size[1]), int(size[0]))


def _chunks(scans: NDArray[np.int64]) -> list[NDArray[np.int64]]:
    return [scans[i : i + SCANS_PER_CHUNK] for i in range(0, len(scans), SCANS_PER_CHUNK)]


def _count_ends(beams: FollowedBeams, hits: NDArray[np.float32]) -> tuple[NDArray[np.int64], FloatArray]:
    """Count the cells that scans end in; return cell and sector (n,) of all hits, and their places in the cell."""
    hit = beams.kinds == kernels.HIT
    x, y, c, s = (np.ascontiguousarray(column) for column in beams.rays()[:, hit])
    lengths = beams.lengths[hit]
    ends = np.empty((len(x), 2), np.int64)
    kernels.last_cells(x, y, c, s, lengths, ends)
    flat = ends[:, 1] * hits.shape[1] + ends[:, 0]
    scan = np.nonzero(hit)[0]
    once = np.unique(scan * hits.size + flat) % hits.size
    hits.ravel()[:] += np.bincount(once, minlength=hits.size)
    sector = np.floor(np.arctan2(s, c) * (N_SECTORS / (2.0 * np.pi))).astype(np.int64) % N_SECTORS
    places = np.array([x + lengths * c, y + lengths * s], dtype=np.float64) - ends.T - 0.5
    return flat * N_SECTORS + sector, places


def _moments(keys: NDArray[np.int64], places: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Sum the hits of each cell and sector."""
    cells, row = np.unique(keys // N_SECTORS, return_inverse=True)
    row = row * N_SECTORS + keys % N_SECTORS
    x, y = places
    sums = [np.bincount(row, w, len(cells) * N_SECTORS) for w in (None, x, y, x * x, x * y, y * y)]
    moments: FloatArray = np.stack(sums, axis=-1).reshape(-1, N_SECTORS, N_MOMENTS).astype(np.float64)
    return cells, moments
