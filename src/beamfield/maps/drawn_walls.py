"""The walls in a map drawn from scans: where they lie, to a fraction of a cell, and where the map is sure of them."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, compose
from beamfield.maps.hit_counts import N_MOMENTS, N_SECTORS, HitCounts
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder

# A ray is stopped by the first cell in which more than this share of the scans that reached it ended, the prior
# included: "most cells are empty", worth three passes and half a hit. Six passes outvote one hit.
STOPPING_SHARE, PRIOR_HITS, PRIOR_PASSES = 0.15, 0.5, 3.0
# Hits with hardly another within two cells are readings of unexpected objects, mostly: rays pass them.
NEIGHBOURHOOD_CELLS, FEWEST_NEIGHBOURS = 5, 3

# A line is fitted to the end points within so many cells: the first window in which they make a line, ...
WINDOWS = (2, 4, 8)
FEWEST_HITS = 10
# ... around which they scatter by less than this share of their scatter along it.
FLATNESS = 0.4
# More scatter than is usual in the map, by this factor, means a corner or more than one surface.
UNUSUAL_NOISE = 1.3
# A ray meets a line less grazingly than this (sine of 30 degrees), no further from the middle of the end points than
# this many of their deviations, and from a cell before the one that stopped it to this far behind.
SMALLEST_SINE = 0.5
WIDEST_REACH = 1.8
AHEAD_CELLS, BEHIND_CELLS, BEHIND_DEVIATIONS = 1.0, 3.0, 3.0
# Of the scans that reach a wall, which is as thick as so many cells and deviations of the noise, at least this share
# end in it, as measured by hits in it and passes behind it.
HALF_THICKNESS_CELLS, HALF_THICKNESS_DEVIATIONS = 1.0, 2.0
SHARE_AT_LINE = 0.5
# The same where no line is: corners, furniture, walls seen at a slant. Below the lower share, hits are those of
# unexpected objects among many passes, and the ray goes on behind them.
SHARE_AT_CLUTTER, SHARE_OF_NOTHING = 0.7, 0.15
FEWEST_HITS_IN_CLUTTER = 3
CELLS_SKIPPED, MOST_STEPS = 2.0, 6

# What a ray meets.
UNSEEN, UNSURE, LINE, CLUTTER, NOTHING = range(5)


class WallRanges(NamedTuple):
    """Expected ranges in a drawn map, each of shape (t, k).

    Parameters
    ----------
    expected
        z* in metres; `max_range` where nothing stops the ray.
    met
        What the ray meets: `LINE`, a wall whose place is known to a fraction of a cell; `CLUTTER`, something that
        stops rays, known to about a cell, or anything behind cells with some hits among many passes; `UNSURE`, cells
        that stop some scans and let others pass; `UNSEEN` space, or `NOTHING` within max_range. Only for the first two
        is `expected` to be relied on.
    """

    expected: FloatArray
    met: NDArray[np.int8]


def ranges_to_walls(counts: HitCounts, poses: FloatArray, finder: RangeFinder) -> WallRanges:
    """Return the ranges that beams are expected to measure in a map drawn from scans, and how sure the map is of them.

    A ray goes to the first cell that stopped scans. A wall is the line through the end points around that cell, of
    beams in about the same direction, if they make a line, the ray meets it near the cell and not too grazingly, and
    most scans that reach it end there. Where there is no line, but nearly all scans end there, the ray ends at the mean
    of the hits along it. Where nearly all scans pass, it goes on. All this looks at the map alone, what `count_hits`
    found in other scans, never at the reading that is going to be judged.
    """
    from scipy import ndimage  # takes a third of a second to import

    grid = _stopping_cells(counts)
    free, stopping = RayCaster(grid), RayCaster(grid, unknown="occupied")
    hits, passes = (ndimage.uniform_filter(n, 3, mode="constant") for n in (counts.hits, counts.passes))
    origins = compose(np.asarray(poses)[:, None, :], finder.mounts).reshape(-1, 3)
    expected: FloatArray = np.full(len(origins), finder.max_range)
    met = np.full(len(origins), UNSURE, np.int8)
    behind = np.zeros(len(origins))
    left, noise = np.arange(len(origins)), None
    for _ in range(MOST_STEPS):
        starts = _moved(origins[left], behind[left])
        to_cell = free.cast(starts, finder.max_range)
        to_unseen = stopping.cast(starts, finder.max_range)
        beyond = behind[left] + np.minimum(to_cell, to_unseen) >= finder.max_range
        met[left[to_unseen < to_cell]] = UNSEEN
        met[left[beyond]] = NOTHING
        stopped = ~beyond & (to_unseen >= to_cell)
        left, to_cell = left[stopped], (behind[left] + to_cell)[stopped]
        if not len(left):
            break
        cells = free.cast_hits(starts[stopped], finder.max_range).astype(np.int64)
        rays = _rays(counts, origins[left], cells)
        lines = _fit_lines(counts, rays)
        noise = _noise(lines) if noise is None else noise
        to_line, good = _meet(lines, noise, rays, to_cell / counts.resolution)
        half = HALF_THICKNESS_CELLS + HALF_THICKNESS_DEVIATIONS * noise
        share, _, _ = _profile(hits, passes, rays, to_line, -half, half)
        is_line = good & (share >= SHARE_AT_LINE)
        # The cell that stops the ray is at the near edge of what is there.
        share, n_hits, mean = _profile(hits, passes, rays, to_cell / counts.resolution + 0.5, -1.0, 2.0 * half)
        is_clutter = ~is_line & (share >= SHARE_AT_CLUTTER) & (n_hits >= FEWEST_HITS_IN_CLUTTER)
        metres = np.where(is_line, to_line, mean) * counts.resolution
        inside = (is_line | is_clutter) & (metres < finder.max_range)
        expected[left[inside]] = metres[inside]
        met[left[inside]] = np.where(is_line & (behind[left] == 0.0), LINE, CLUTTER)[inside]
        goes_on = ~is_line & ~is_clutter & (share < SHARE_OF_NOTHING)
        left = left[goes_on]
        behind[left] = to_cell[goes_on] + CELLS_SKIPPED * counts.resolution
    shape = len(poses), finder.n_beams
    return WallRanges(expected.reshape(shape), met.reshape(shape))


def _moved(origins: FloatArray, length: FloatArray) -> FloatArray:
    step = length[:, None] * np.column_stack([np.cos(origins[:, 2]), np.sin(origins[:, 2])])
    return np.column_stack([origins[:, :2] + step, origins[:, 2]])


class _Rays(NamedTuple):
    """Rays that a cell stops, n of them: origin from the middle of the cell, in cells, direction, and the cell."""

    x: FloatArray
    y: FloatArray
    dx: FloatArray
    dy: FloatArray
    row: NDArray[np.int64]
    col: NDArray[np.int64]
    sector: NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class _Lines:
    """Lines through end points, one per ray: a point, normal, deviations along and across; from the ray's cell."""

    x: FloatArray
    y: FloatArray
    nx: FloatArray
    ny: FloatArray
    along: FloatArray
    across: FloatArray
    flat: NDArray[np.bool_]


def _stopping_cells(counts: HitCounts) -> OccupancyGrid:
    from scipy import ndimage

    share = (counts.hits + PRIOR_HITS) / (counts.hits + counts.passes + PRIOR_HITS + PRIOR_PASSES)
    around = ndimage.uniform_filter(counts.hits, NEIGHBOURHOOD_CELLS, mode="constant") * NEIGHBOURHOOD_CELLS**2
    stops = ((share > STOPPING_SHARE) & (around > FEWEST_NEIGHBOURS - 0.5)).astype(np.float32)
    stops[~counts.seen] = np.nan
    return OccupancyGrid(stops, counts.resolution, np.array([*(counts.first * counts.resolution), 0.0]))


def _rays(counts: HitCounts, origins: FloatArray, cells: NDArray[np.int64]) -> _Rays:
    row, col = cells.T
    theta = origins[:, 2]
    sector = np.floor(theta * (N_SECTORS / (2.0 * np.pi))).astype(np.int64) % N_SECTORS
    x = origins[:, 0] / counts.resolution - counts.first[0] - col - 0.5
    y = origins[:, 1] / counts.resolution - counts.first[1] - row - 0.5
    return _Rays(x, y, np.cos(theta), np.sin(theta), row, col, sector)


def _fit_lines(counts: HitCounts, rays: _Rays) -> _Lines:
    """Fit lines to the end points around the rays' cells, of beams in their sector or the two next to it."""
    key = (rays.row * counts.hits.shape[1] + rays.col) * N_SECTORS + rays.sector
    keys, which = np.unique(key, return_inverse=True)
    sums = np.zeros((len(keys), N_MOMENTS))
    lines = _principal_axes(sums)
    inner = -1
    for window in WINDOWS:
        todo = np.flatnonzero(~lines.flat)
        sums[todo] += _window_moments(counts, keys[todo], inner, window)
        inner = window
        found = _principal_axes(sums[todo])
        for name in _Lines.__dataclass_fields__:
            getattr(lines, name)[todo] = getattr(found, name)
    return _Lines(*(getattr(lines, name)[which] for name in _Lines.__dataclass_fields__))


def _window_moments(counts: HitCounts, keys: NDArray[np.int64], inner: int, outer: int) -> FloatArray:
    """Sum the moments of the cells further than `inner` and up to `outer` cells away, (n, 6), about the keys' cells."""
    rows, cols = counts.hits.shape
    where = np.full(rows * cols, -1, np.int32)
    where[counts.cells] = np.arange(len(counts.cells))
    around = counts.moments + np.roll(counts.moments, 1, axis=1) + np.roll(counts.moments, -1, axis=1)
    row, col, sector = keys // N_SECTORS // cols, keys // N_SECTORS % cols, keys % N_SECTORS
    sums = np.zeros((len(keys), N_MOMENTS))
    steps = range(-outer, outer + 1)
    for dr, dc in product(steps, steps):
        if max(abs(dr), abs(dc)) > inner:
            r, c = row + dr, col + dc
            inside = np.flatnonzero((r >= 0) & (r < rows) & (c >= 0) & (c < cols))
            index = where[r[inside] * cols + c[inside]]
            hit = inside[index >= 0]
            n, x, y, xx, xy, yy = around[index[index >= 0], sector[hit]].T
            first = n, x + dc * n, y + dr * n, xx + 2 * dc * x + dc * dc * n
            second = xy + dc * y + dr * x + dc * dr * n, yy + 2 * dr * y + dr * dr * n
            sums[hit] += np.column_stack([*first, *second])
    return sums


def _principal_axes(sums: FloatArray) -> _Lines:
    """Return the lines through the means of end points along which they scatter most."""
    n = np.maximum(sums[:, 0], 1.0)
    x, y = sums[:, 1] / n, sums[:, 2] / n
    xx, xy, yy = sums[:, 3] / n - x * x, sums[:, 4] / n - x * y, sums[:, 5] / n - y * y
    half_trace, half_difference = np.maximum(0.5 * (xx + yy), 0.0), 0.5 * (xx - yy)
    root = np.hypot(half_difference, xy)
    angle = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    along, across = np.sqrt(half_trace + root), np.sqrt(np.maximum(half_trace - root, 0.0))
    flat = (sums[:, 0] >= FEWEST_HITS) & (across <= FLATNESS * along)
    return _Lines(x, y, -np.sin(angle), np.cos(angle), along, across, flat)


def _noise(lines: _Lines) -> float:
    """Return how far end points usually scatter across their line, in cells."""
    return float(np.median(lines.across[lines.flat])) if lines.flat.any() else 0.0


def _meet(lines: _Lines, noise: float, rays: _Rays, to_cell: FloatArray) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the rays' lengths to their lines, in cells, and whether they meet them well."""
    sine = lines.nx * rays.dx + lines.ny * rays.dy
    steep = np.abs(sine) >= SMALLEST_SINE
    length = lines.nx * (lines.x - rays.x) + lines.ny * (lines.y - rays.y)
    length = np.divide(length, sine, out=np.zeros_like(length), where=steep)
    x, y = rays.x + length * rays.dx - lines.x, rays.y + length * rays.dy - lines.y
    reach = np.abs(y * lines.nx - x * lines.ny)
    behind = length - to_cell
    good = lines.flat & (lines.across <= UNUSUAL_NOISE * noise) & steep & (reach <= WIDEST_REACH * lines.along)
    good &= (behind >= -AHEAD_CELLS) & (behind <= max(BEHIND_CELLS, BEHIND_DEVIATIONS * noise)) & (length > 0.0)
    return np.where(good, length, to_cell), good


def _profile(
    hits: NDArray[np.float32], passes: NDArray[np.float32], rays: _Rays, length: FloatArray, first: float, last: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Look at cells along rays, from `first` to `last` cells before or behind a length.

    Returns the share of the scans reaching them that end in them, by their hits and the passes behind them; how many
    hits there are; and how far away their mean is, in cells.
    """
    total, moment = np.zeros(len(length)), np.zeros(len(length))
    steps = np.arange(first, last + 1.0)
    for step in steps:
        here = _look_up(hits, rays, length + step)
        total += here
        moment += here * step
    reached = total + _look_up(passes, rays, length + steps[-1])
    share = np.divide(total, reached, out=np.zeros_like(total), where=total > 0.0)
    mean = length + np.divide(moment, total, out=np.zeros_like(total), where=total > 0.0)
    # `hits` are means of nine cells.
    return share, 9.0 * total, np.maximum(mean, 0.0)


def _look_up(values: NDArray[np.float32], rays: _Rays, length: FloatArray) -> NDArray[np.float32]:
    """Return the values at a length along the rays, in cells; the nearest ones beside the grid."""
    row = np.floor(rays.row + 0.5 + rays.y + length * rays.dy).astype(np.int64)
    col = np.floor(rays.col + 0.5 + rays.x + length * rays.dx).astype(np.int64)
    return values[np.clip(row, 0, values.shape[0] - 1), np.clip(col, 0, values.shape[1] - 1)]
