"""Where a global search looks: a window of the map, and the lattice of poses in it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, keep, require, restore
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_pose, transform_points, wrap_angle
from beamfield.maps.occupancy import OccupancyGrid

# Points this far below a cell border, in cells, are on it.
SNAP = 1e-9
# The coarsest blocks have 2^3 = 8 candidates a side, or up to 2^5 = 32 where there would be more of them than this, as
# each is bounded. Measured with trajectories: in a storey of 26 m x 42 m, 32 a side take half as long again; in one of
# 80 m x 80 m, 8 a side take twice as long as 16.
LEVELS, MOST_LEVELS, MOST_BLOCKS = 4, 6, 500_000
# Entries of the largest table, 8 bytes each.
MAX_ENTRIES = 50_000_000


@dataclass(frozen=True, eq=False)
class SearchWindow:
    """The poses among which to search.

    Parameters
    ----------
    center
        (3,) pose in the middle, metres and radians.
    width, height
        Extent along the x and y axis of the grid, metres.
    turn
        Extent of the heading, radians; 2 pi or more: all headings.

    Raises
    ------
    InvalidInputError
        If the centre is not a pose or an extent is negative or not finite.

    Examples
    --------
    >>> window = SearchWindow.whole_map(OccupancyGrid([[0.0, 0.0, 0.0, 1.0]], resolution=0.5))
    >>> window.center.tolist(), window.width, window.height
    ([1.0, 0.25, 0.0], 2.0, 0.5)
    """

    center: FloatArray
    width: float = 20.0
    height: float = 20.0
    turn: float = 2.0 * np.pi

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(
            self, center: ArrayLike, width: float = 20.0, height: float = 20.0, turn: float = 2.0 * np.pi
        ) -> None: ...

    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        keep(self, center=as_pose(self.center, "center"))
        for name in ("width", "height", "turn"):
            require(0.0 <= getattr(self, name) < np.inf, name, "a finite number >= 0", getattr(self, name))

    @classmethod
    def whole_map(cls, grid: OccupancyGrid) -> SearchWindow:
        """Return the window that covers a map, at all headings.

        Parameters
        ----------
        grid
            The map.

        Returns
        -------
        A window around the middle of the map.
        """
        rows, cols = grid.shape
        x, y = grid.to_map([cols / 2.0, rows / 2.0])
        return cls(np.array([x, y, 0.0]), cols * grid.resolution, rows * grid.resolution)


class SearchLattice(NamedTuple):
    """The candidates: their number along each axis, and where the first one is, in the grid's cells."""

    grid: OccupancyGrid
    n_rows: int
    n_cols: int
    first: FloatArray
    headings: FloatArray
    step: float

    @classmethod
    def of(cls, grid: OccupancyGrid, window: SearchWindow, angle_step: float) -> SearchLattice:
        """Return the lattice in a window, in steps of the map's cells and of at most this angle, radians."""
        for name, extent, step in (
            ("width", window.width, grid.resolution), ("height", window.height, grid.resolution),
            ("angle_step", min(window.turn, 2.0 * np.pi), angle_step),
        ):  # fmt: skip
            if not extent <= MAX_ENTRIES * step:
                raise InvalidInputError(f"{name}: {extent:g} in steps of {step:g} are more than {MAX_ENTRIES:,} poses")
        # 20 m at 5 cm are 400 steps, also where the division gives 399.999.
        n_cols, n_rows = (2 * int(side / grid.resolution / 2.0 + SNAP) + 1 for side in (window.width, window.height))
        if window.turn >= 2.0 * np.pi - SNAP:
            n_headings = int(np.ceil(2.0 * np.pi / angle_step - SNAP))
            step = 2.0 * np.pi / n_headings
            offsets = np.arange(n_headings) * step
        else:
            half = int(window.turn / angle_step / 2.0 + SNAP)
            step = angle_step
            offsets = np.arange(-half, half + 1) * step
        first = grid.to_cells(window.center[:2]) - [n_cols // 2, n_rows // 2]
        return cls(grid, n_rows, n_cols, first, window.center[2] + offsets, step)

    @property
    def levels(self) -> int:
        """Levels of blocks."""
        levels = LEVELS
        while levels < MOST_LEVELS and self._n_blocks(levels) > MOST_BLOCKS:
            levels += 1
        return levels

    def _n_blocks(self, levels: int) -> float:
        """Return about how many blocks there are, rather too many."""
        side = float(1 << (levels - 1))
        return len(self.headings) * (self.n_rows / side + 1) * (self.n_cols / side + 1)

    @property
    def n_candidates(self) -> int:
        """Number of poses."""
        return len(self.headings) * self.n_rows * self.n_cols

    def check_size(self, n_points: int) -> None:
        """Refuse a search whose tables would fill the memory."""
        if len(self.headings) * n_points + self._n_blocks(MOST_LEVELS) > MAX_ENTRIES:
            raise InvalidInputError(
                f"window: {len(self.headings)} headings of {self.n_rows} x {self.n_cols} poses are too many for "
                f"{n_points} points; search a smaller window, or with a larger angle_step"
            )

    def first_cells(self, points: FloatArray) -> NDArray[np.int64]:
        """Return (n, 2, p) row and column of the points at the first candidate of each heading."""
        turn = self.headings - self.grid.origin[2]
        poses = np.column_stack([np.tile(self.first * self.grid.resolution, (len(turn), 1)), turn])
        cells = transform_points(poses[:, None, :], points) / self.grid.resolution
        limits = np.clip(np.floor(cells + SNAP), -(2**40), 2**40)
        return np.ascontiguousarray(np.moveaxis(limits.astype(np.int64)[..., ::-1], -1, 1))

    def pose(self, key: int) -> FloatArray:
        """Return the pose of a candidate."""
        heading, rest = divmod(key, self.n_rows * self.n_cols)
        row, col = divmod(rest, self.n_cols)
        place = self.grid.to_map(self.first + np.array([col, row]))
        return np.array([*place, float(wrap_angle(self.headings[heading]))])

    def neighbourhood(self, key: int, distance: float, turn: float) -> NDArray[np.int64]:
        """Return what `search_blocks` must leave out around a candidate."""
        heading, rest = divmod(key, self.n_rows * self.n_cols)
        row, col = divmod(rest, self.n_cols)
        near = np.abs(wrap_angle(self.headings - self.headings[heading])) <= turn + SNAP
        square = int(min(distance / self.grid.resolution, 1e9) ** 2 + SNAP)
        return np.concatenate([[row, col, square, 0], near.astype(np.int64)])
