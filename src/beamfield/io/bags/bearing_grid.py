"""Scans of one topic whose beams differ from scan to scan, brought onto one grid of bearings."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from statistics import median_high
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, wrap_angle

BEARING_TOLERANCE = 1e-3  # radians: beams that are no further apart are the same


class ScanGeometry(NamedTuple):
    """Where the beams of a scan point: beam i at ``angle_min + i increment``, radians."""

    angle_min: float
    increment: float
    n_beams: int

    @property
    def angles(self) -> FloatArray:
        """(k,) radians, not wrapped."""
        return np.asarray(self.angle_min + self.increment * np.arange(self.n_beams), dtype=np.float64)

    def is_close_to(self, other: ScanGeometry) -> bool:
        """Return whether both have the same beams, within `BEARING_TOLERANCE`."""
        first = self.angle_min - other.angle_min
        last = first + (self.increment - other.increment) * (self.n_beams - 1)
        return self.n_beams == other.n_beams and max(abs(first), abs(last)) <= BEARING_TOLERANCE


def usual_geometry(geometries: Sequence[ScanGeometry]) -> ScanGeometry:
    """Return the median number of beams with the angles that most scans of that number have; the earliest of equals.

    The first scan of a topic would be a bad choice: lidars that spin up send a part of a turn. The median keeps what
    scans need on one grid below twice what they hold, whatever a damaged bag says.
    """
    n_beams = median_high(one.n_beams for one in geometries)
    (chosen, _), *_ = Counter(one for one in geometries if one.n_beams == n_beams).most_common(1)
    return chosen


class NearestBeams(NamedTuple):
    """Which beams (m,) of a scan lie nearest to which bearings of a grid, indices (m,).

    `moved` tells by how much the bearing of any of these changes, at most, radians.
    """

    grid: NDArray[np.int64]
    beams: NDArray[np.int64]
    moved: float


def nearest_beams(geometry: ScanGeometry, grid: ScanGeometry) -> NearestBeams:
    """Find for each bearing of a grid the nearest beam of a scan, within half a step of the grid.

    A reading is used once or not at all, and none is made up between two: a bearing without a beam is left out. Nothing
    is interpolated because the mean of a near and a far reading is where neither of them was. No pairs of indices if
    the scan looks elsewhere.
    """
    # A single beam has no step to its neighbour.
    step = grid.increment if grid.n_beams > 1 else 2.0 * BEARING_TOLERANCE
    middle = grid.angle_min + 0.5 * grid.increment * (grid.n_beams - 1)
    angles = geometry.angles - middle
    # Both ends of a full turn have the same bearing: only what lies beyond them is wrapped.
    angles = np.where(np.abs(angles) <= np.pi + 0.5 * abs(step), angles, wrap_angle(angles))
    place = np.clip(angles / step + 0.5 * (grid.n_beams - 1), -1.0, grid.n_beams)
    index = np.rint(place).astype(np.int64)
    away = np.abs(place - index)
    # The nearest beam of each bearing comes first.
    order = np.lexsort((away, index))
    order = order[(index[order] >= 0) & (index[order] < grid.n_beams)]
    found, first = np.unique(index[order], return_index=True)
    chosen = order[first]
    return NearestBeams(found, chosen, float(away[chosen].max(initial=0.0) * abs(step)))


class GriddedScans(NamedTuple):
    """Scans on one grid of bearings: ranges (t, k) in metres, NaN where a scan has no beam.

    The notes say what was done to them, if anything was; `elsewhere` is the first scan of which no beam is on the grid.
    """

    ranges: NDArray[np.float32]
    grid: ScanGeometry
    notes: tuple[str, ...] = ()
    elsewhere: int | None = None


def on_one_grid(ranges: Sequence[NDArray[np.float32]], geometries: Sequence[ScanGeometry]) -> GriddedScans:
    """Bring scans, (k_i,) metres each, onto the usual one of their grids, each beam to the nearest bearing."""
    grid = usual_geometry(geometries)
    pairs: dict[ScanGeometry, NearestBeams] = {}
    gridded = np.full((len(ranges), grid.n_beams), np.nan, dtype=np.float32)
    n_other, filled, moved = 0, 0, 0.0
    for i, (z, geometry) in enumerate(zip(ranges, geometries, strict=True)):
        if geometry.is_close_to(grid):
            gridded[i] = z
            continue
        if geometry not in pairs:
            pairs[geometry] = nearest_beams(geometry, grid)
        to, of, away = pairs[geometry]
        if not len(to):
            return GriddedScans(gridded, grid, elsewhere=i)
        gridded[i, to] = z[of]
        n_other, filled, moved = n_other + 1, filled + len(to), max(moved, away)
    if not n_other:
        return GriddedScans(gridded, grid)
    others = [one for one in geometries if not one.is_close_to(grid)]
    counts = sorted({one.n_beams for one in others})
    beams = f"{counts[0]}" if len(counts) == 1 else f"{counts[0]} to {counts[-1]}"
    dropped = sum(one.n_beams for one in others) - filled
    note = (
        f"{n_other} of {len(ranges)} scans have other bearings ({beams} beams) than usual ({grid.n_beams} beams from "
        f"{np.degrees(grid.angle_min):.1f} degrees, every {np.degrees(grid.increment):.3f}); their readings are taken "
        f"at the nearest of those, at most {np.degrees(moved):.2f} degrees away; {dropped / (filled + dropped):.1%} of "
        f"them are dropped, and {1.0 - filled / (n_other * grid.n_beams):.1%} of the bearings have none (NaN)"
    )
    return GriddedScans(gridded, grid, (note,))
