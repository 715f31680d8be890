"""Beams counted by place and visit: on a lattice of small squares, or in places made of several of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray
from beamfield.kernels.crossings import count_crossings
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.scan_fit.place_beams import PlaceBeams
from beamfield.scan_fit.place_visits import Tally

# Side of a square, metres: a reference that is 4 cm and 0.6 degrees off moves an end point at 8 m by a third of it.
SIDE = 0.25


@dataclass(frozen=True)
class Lattice:
    """Squares along the axes of the map frame that cover a map, from the lower left corner x, y on; metres."""

    x: float
    y: float
    side: float
    rows: int
    cols: int

    @classmethod
    def over(cls, grid: OccupancyGrid) -> Lattice:
        """Return a lattice whose squares are at least as large as a cell of the map."""
        side = max(SIDE, grid.resolution)
        low, high = np.floor(np.divide(grid.bounds[:2], side)), np.ceil(np.divide(grid.bounds[2:], side))
        n_cols, n_rows = (high - low).astype(np.int64).tolist()
        return cls(float(low[0] * side), float(low[1] * side), side, n_rows, n_cols)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        return self.rows, self.cols

    def squares(self, points: FloatArray) -> NDArray[np.int64]:
        """Return the square of each point (n, 2), as row * cols + col; -1 off the lattice."""
        place = np.floor((points - [self.x, self.y]) / self.side)
        inside = np.asarray(((place >= 0) & (place < [self.cols, self.rows])).all(axis=1))
        col, row = np.where(inside[:, None], place, 0).astype(np.int64).T
        return np.where(inside, row * self.cols + col, -1)

    def corners(self, squares: NDArray[np.int64]) -> FloatArray:
        """Return the lower left corner of each square, (n, 2) metres."""
        row, col = np.divmod(squares, self.cols)
        return np.asarray([self.x, self.y] + self.side * np.column_stack([col, row]))


def tally_short(beams: PlaceBeams, lattice: Lattice, labels: NDArray[np.int32]) -> Tally:
    """Count per place and visit the beams that crossed it or ended there, and the short readings that end there.

    Labels (rows, cols) are the place of each square, -1 for none.
    """
    rays = np.column_stack([(beams.rays[:, :2] - [lattice.x, lattice.y]) / lattice.side, beams.rays[:, 2]])
    lengths = beams.followed / lattice.side
    places = _places(labels, lattice.squares(beams.ends), beams.short)
    n_places = int(labels.max(initial=-1)) + 1
    parts = []
    for visit in np.unique(beams.visit):
        mine = beams.visit == visit
        crossed = np.zeros(n_places, np.int64)
        count_crossings(rays[mine], lengths[mine], labels, crossed)
        parts.append(_of_visit(int(visit), crossed, places[mine]))
    return _joined(parts)


def tally_walls(beams: PlaceBeams, lattice: Lattice, labels: NDArray[np.int32], differ: NDArray[np.bool_]) -> Tally:
    """Count per place and visit the beams that tested a mapped surface there, and those of them that differ (n,).

    Those are `through` or `silent`; labels are as for `tally_short`.
    """
    squares, n_places = lattice.squares(beams.walls), int(labels.max(initial=-1)) + 1
    tested, differing = _places(labels, squares, beams.tested), _places(labels, squares, beams.tested & differ)
    parts = []
    for visit in np.unique(beams.visit):
        mine = beams.visit == visit
        chances = np.bincount(tested[mine & (tested >= 0)], minlength=n_places)
        parts.append(_of_visit(int(visit), chances, differing[mine]))
    return _joined(parts)


def _places(labels: NDArray[np.int32], squares: NDArray[np.int64], chosen: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the place of each chosen beam's square; -1 for the other beams."""
    found = labels.reshape(-1)[np.maximum(squares, 0)].astype(np.int64)
    return np.where(chosen & (squares >= 0), found, -1)


def _of_visit(visit: int, chances: NDArray[np.int64], places: NDArray[np.int64]) -> Tally:
    readings = np.bincount(places[places >= 0], minlength=len(chances))
    # The end of a reading and the last square of its ray may be rounded to either side of an edge.
    chances = np.maximum(chances, readings)
    seen = np.flatnonzero(chances)
    return Tally(seen, np.full(len(seen), visit), chances[seen], readings[seen])


def _joined(parts: list[Tally]) -> Tally:
    empty = np.zeros(0, np.int64)
    return Tally(*(np.concatenate(columns) for columns in zip((empty,) * 4, *parts, strict=True)))
