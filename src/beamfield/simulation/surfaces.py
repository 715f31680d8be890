"""Straight walls with corners and edges, as sound meets them: given as outlines, or found in an occupancy grid."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.kernels import acoustics as kernels
from beamfield.maps.occupancy import BoolArray, OccupancyGrid

# An outline that bends outwards by less at a vertex is taken as round there, radians.
ROUND_BEND = np.radians(75.0)
# An inner corner sends sound back where it came from if its walls are square to each other within this, radians.
SQUARE_WITHIN = np.radians(12.0)
# Walls that make such a corner are at least so long, metres: a sonar's waves are 7 mm long.
CORNER_WALL = 0.05


@dataclass(frozen=True, eq=False)
class Surfaces:
    """Walls as sound meets them: straight pieces with free space on one side.

    Parameters
    ----------
    starts, ends
        (m, 2) metres in the map frame; free space is on the left on the way from start to end.
    following
        (m,) index of the wall that goes on at a wall's end; -1 for none.

    Raises
    ------
    InvalidInputError
        If there is no wall, a number is not finite, a wall has no length, or an index is out of range.
    """

    starts: FloatArray
    ends: FloatArray
    following: NDArray[np.int64]

    def __post_init__(self) -> None:
        check_fields(self)
        starts, ends = (np.array(points, dtype=np.float64) for points in (self.starts, self.ends))
        following = np.array(self.following, dtype=np.int64)
        if starts.ndim != 2 or starts.shape[1] != 2 or starts.shape != ends.shape or len(starts) == 0:
            raise InvalidInputError(
                f"walls: expected starts and ends of one shape (m, 2) with m > 0, got {starts.shape} and {ends.shape}"
            )
        if not (np.isfinite(starts).all() and np.isfinite(ends).all()):
            raise InvalidInputError("walls: expected finite numbers of metres")
        if following.shape != (len(starts),) or following.min() < -1 or following.max() >= len(starts):
            raise InvalidInputError(f"following: expected ({len(starts)},) indices of walls or -1, got {following}")
        if (np.hypot(*(ends - starts).T) <= 0.0).any():
            raise InvalidInputError(f"walls: wall {int(np.argmin(np.hypot(*(ends - starts).T)))} has no length")
        for name, array in (("starts", starts), ("ends", ends), ("following", following)):
            array.flags.writeable = False
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.starts)

    @classmethod
    def from_outlines(cls, outlines: Sequence[ArrayLike], *, closed: bool = True) -> Surfaces:
        """Build walls from outlines.

        Parameters
        ----------
        outlines
            Each (n, 2) points in metres, walked with free space on the left: the walls of a room counter-clockwise,
            a thing that stands in it clockwise.
        closed
            Whether the last point of each is joined to the first.

        Returns
        -------
        Walls in the order of the points.

        Raises
        ------
        InvalidInputError
            If there is no outline, one is not (n, 2) with n > 1, or as for the class.

        Examples
        --------
        >>> room = Surfaces.from_outlines([[[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]]])
        >>> len(room), room.following.tolist()
        (4, [1, 2, 3, 0])
        """
        starts, ends, following = [], [], []
        n_walls = 0
        for outline in outlines:
            points = np.asarray(outline, dtype=np.float64)
            if points.ndim != 2 or points.shape[1:] != (2,) or len(points) < 2:
                raise InvalidInputError(f"outline: expected shape (n, 2) with n > 1, got {points.shape}")
            n = len(points) if closed else len(points) - 1
            starts.append(points[:n])
            ends.append(np.roll(points, -1, axis=0)[:n])
            after = n_walls + np.arange(1, n + 1)
            after[-1] = n_walls if closed else -1
            following.append(after)
            n_walls += n
        if not starts:
            raise InvalidInputError("outlines: expected at least one, got none")
        return cls(np.concatenate(starts), np.concatenate(ends), np.concatenate(following))

    @property
    def bends(self) -> FloatArray:
        """(m,) turn at each wall's end in radians, to the left positive: an inner corner; NaN where nothing goes on."""
        along = self.ends - self.starts
        after = along[self.following]
        cross = along[:, 0] * after[:, 1] - along[:, 1] * after[:, 0]
        return np.where(self.following < 0, np.nan, np.arctan2(cross, (along * after).sum(axis=1)))

    def walls(self) -> kernels.Walls:
        """Return the walls, with their directions, lengths and ends, as the kernel wants them: columns (m,), metres."""
        along = self.ends - self.starts
        length = np.hypot(along[:, 0], along[:, 1])
        unit = along / length[:, None]
        joined = self.following >= 0
        after = np.where(joined[:, None], unit[self.following], 0.0)
        bends = self.bends
        with np.errstate(invalid="ignore"):
            square = np.abs(bends - 0.5 * np.pi) <= SQUARE_WITHIN
        # An end that nothing follows is an edge.
        end = np.full(len(self), kernels.SHARP_EDGE)
        end[joined & (bends > 0.0)] = kernels.PLAIN_END
        end[joined & (bends <= 0.0) & (bends > -ROUND_BEND)] = kernels.ROUND
        long_enough = (length >= CORNER_WALL) & (length[self.following] >= CORNER_WALL)
        end[joined & square & long_enough] = kernels.INNER_CORNER
        columns = (self.starts[:, 0], self.starts[:, 1], unit[:, 0], unit[:, 1], length, after[:, 0], after[:, 1])
        ax, ay, ux, uy, long, after_x, after_y = (np.ascontiguousarray(column) for column in columns)
        return kernels.Walls(ax, ay, ux, uy, long, after_x, after_y, end.astype(np.int64))


def surfaces_of_grid(grid: OccupancyGrid, *, smoothing: float = 1.25) -> Surfaces:
    """Find the walls of an occupancy grid: the faces of its occupied cells, joined and straightened.

    A wall that does not run along the grid is a staircase of cell faces there. To sound a staircase is something else
    than a wall, so outlines are straightened: vertices are left out as long as the outline moves by no more than
    `smoothing` cells. Stairs reach almost a cell to one side of a line through some of their corners, and further if
    its ends happen to be inner ones; 1.25 straightens walls of any direction and keeps things of two cells.

    Parameters
    ----------
    grid
        The map; walls stand between occupied cells and all others.
    smoothing
        Largest distance of a left-out vertex from the straight line, in cells; 0 joins only faces in one line.

    Returns
    -------
    Surfaces
        In the map frame.

    Raises
    ------
    InvalidInputError
        If no cell is occupied, or `smoothing` is negative or not finite.

    Examples
    --------
    >>> grid = OccupancyGrid([[0.0, 0.0, 0.0], [0.0, 1.0, 1.0], [0.0, 0.0, 0.0]], resolution=0.5)
    >>> len(surfaces_of_grid(grid))
    4
    """
    if not 0.0 <= smoothing < np.inf:
        raise InvalidInputError(f"smoothing: expected a finite number of cells >= 0, got {smoothing}")
    occupied = grid.occupied
    if not occupied.any():
        raise InvalidInputError("the map has no occupied cell: there is nothing to measure")
    outlines = [_straightened(loop, smoothing) for loop in _loops(occupied)]
    return Surfaces.from_outlines([grid.to_map(loop) for loop in outlines])


def _loops(occupied: BoolArray) -> list[FloatArray]:
    """Return the closed outlines of occupied cells as corners (col, row), with what is not occupied on the left."""
    padded = np.pad(occupied, 1)
    below, above = padded[:-1, 1:-1], padded[1:, 1:-1]
    left, right = padded[1:-1, :-1], padded[1:-1, 1:]
    faces = []
    # Above an occupied cell to the right, below it to the left, at its left side upwards, at its right side downwards:
    # what is free is then on the left.
    for there, start, step in (
        (below & ~above, (0, 0), (1, 0)),
        (~below & above, (1, 0), (-1, 0)),
        (right & ~left, (0, 0), (0, 1)),
        (~right & left, (0, 1), (0, -1)),
    ):
        row, col = np.nonzero(there)
        x, y = col + start[0], row + start[1]
        faces.append(np.column_stack([x, y, x + step[0], y + step[1]]))
    face = np.concatenate(faces)
    after = _next_faces(face, occupied.shape[1] + 1).tolist()
    seen = np.zeros(len(face), dtype=bool)
    loops = []
    for first in range(len(face)):
        if seen[first]:
            continue
        loop, at = [], first
        while not seen[at]:
            seen[at] = True
            loop.append(at)
            at = after[at]
        loops.append(face[loop, :2].astype(np.float64))
    return loops


def _next_faces(face: NDArray[np.int64], n_cols: int) -> NDArray[np.int64]:
    """Return the face that goes on at the end of each; where two cells touch at a corner they are taken as joined."""
    start, end = face[:, 0] + n_cols * face[:, 1], face[:, 2] + n_cols * face[:, 3]
    order = np.argsort(start, kind="stable")
    low = np.searchsorted(start[order], end, side="left")
    high = np.searchsorted(start[order], end, side="right")
    one, other = order[low], order[high - 1]
    along = face[:, 2:] - face[:, :2]
    turn = along[:, 0] * along[one, 1] - along[:, 1] * along[one, 0]
    # Of two ways to go on, the one to the left keeps to the same free cell.
    return np.where(turn > 0, one, other)


def _straightened(loop: FloatArray, tolerance: float) -> FloatArray:
    """Leave out vertices of a closed outline that are within the tolerance (Douglas and Peucker)."""
    before, after = np.roll(loop, 1, axis=0), np.roll(loop, -1, axis=0)
    corners: FloatArray = loop[((loop - before) != (after - loop)).any(axis=1)]
    if tolerance == 0.0 or len(corners) <= 4:
        return corners
    # The ends of the first two lines are far apart, and corners of the outline's hull, which stay in any case.
    first = int(np.argmin(corners.sum(axis=1)))
    corners = np.roll(corners, -first, axis=0)
    middle = int(np.argmax(np.hypot(*(corners - corners[0]).T)))
    closed = np.concatenate([corners, corners[:1]])
    keep = np.zeros(len(closed), dtype=bool)
    keep[[0, middle, -1]] = True
    spans = [(0, middle), (middle, len(closed) - 1)]
    while spans:
        i, j = spans.pop()
        if j - i < 2:
            continue
        line = closed[j] - closed[i]
        offset = closed[i + 1 : j] - closed[i]
        along = np.clip(offset @ line / max(float(line @ line), 1e-300), 0.0, 1.0)
        distance = np.hypot(*(offset - along[:, None] * line).T)
        worst = int(np.argmax(distance))
        if distance[worst] > tolerance:
            keep[i + 1 + worst] = True
            spans += [(i, i + 1 + worst), (i + 1 + worst, j)]
    kept: FloatArray = closed[:-1][keep[:-1]]
    # A single post of a few cells keeps its corners rather than becoming a line without an inside.
    return kept if len(kept) >= 3 else corners
