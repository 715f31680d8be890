"""An occupancy map in log-odds that grows as scans come."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import check_magnitude, checked
from beamfield.kernels import mapping as kernels
from beamfield.maps.followed_beams import FollowedBeams, followed_beams
from beamfield.maps.inverse_sensor import InverseSensorModel, log_odds_steps
from beamfield.maps.log_odds import check_size, grid_of_log_odds
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder

# Eight bytes per cell: 800 MB.
MAX_CELLS = 100_000_000


class OccupancyMapper:
    """A map that grows as scans come; see `beamfield.maps.mapping.build_map` for what it does with them.

    Parameters
    ----------
    resolution
        Side of a cell, metres.
    inverse_model
        What a reading says about cells.
    max_cells
        Largest map, in cells of 8 bytes.

    Raises
    ------
    InvalidInputError
        If the resolution is not positive.

    Examples
    --------
    >>> finder = RangeFinder.from_bearings([0.0], max_range=8.0)
    >>> mapper = OccupancyMapper(0.5, inverse_model=InverseSensorModel(hit=0.9, passed=0.2))
    >>> mapper.add([[1.6]], finder, [[0.25, 0.25, 0.0]])
    >>> mapper.to_grid().occupied.tolist()
    [[False, False, False, True]]
    """

    @checked
    def __init__(
        self, resolution: float, *, inverse_model: InverseSensorModel | None = None, max_cells: int = MAX_CELLS
    ) -> None:
        check_magnitude("resolution", resolution)
        self.resolution = float(resolution)
        self.inverse_model = InverseSensorModel() if inverse_model is None else inverse_model
        self.max_cells = max_cells
        self.n_scans = 0
        # (col, row) of the array's first cell, in cells from the map's zero.
        self._first = np.zeros(2, np.int64)
        self._log_odds = np.zeros((0, 0), np.float32)
        self._stamps = np.zeros((0, 0), np.int32)

    def add(self, ranges: ArrayLike, finder: RangeFinder, poses: ArrayLike) -> None:
        """Enter scans.

        Parameters
        ----------
        ranges
            (t, k) metres in the conventions of `Scan`.
        finder
            The sensor.
        poses
            (t, 3) poses of the robot, metres and radians.

        Raises
        ------
        InvalidInputError
            If shapes do not fit, poses are not finite, or the map would grow beyond its limit.
        """
        beams = followed_beams(ranges, finder, poses, self.resolution, self.inverse_model)
        self._grow(beams)
        starts = beams.starts.copy()
        starts[:, :2] -= self._first
        outside = kernels.update_log_odds(
            starts, beams.fan, beams.lengths, beams.kinds, log_odds_steps(self.inverse_model), 2 * self.n_scans,
            self._log_odds, self._stamps,
        )  # fmt: skip
        if outside:
            raise RuntimeError(f"{outside} beams leave the grid")
        self.n_scans += len(starts)

    def make_room(self, ranges: ArrayLike, finder: RangeFinder, poses: ArrayLike) -> None:
        """Grow so that these scans fit, without entering them; see `add`."""
        self._grow(followed_beams(ranges, finder, poses, self.resolution, self.inverse_model))

    def to_grid(self) -> OccupancyGrid:
        """Return the map so far: all cells that were seen, NaN where none was; one unknown cell if there is none."""
        return grid_of_log_odds(self._log_odds, self._stamps >= 0, self._first, self.resolution)

    def _grow(self, beams: FollowedBeams) -> None:
        """Make the array hold all cells of the beams."""
        extent = beams.extent()
        if extent is None:
            return
        low, high = extent
        rows, cols = self._log_odds.shape
        last = self._first + np.array([cols, rows]) - 1
        if rows > 0:
            if (low >= self._first).all() and (high <= last).all():
                return
            # A quarter more where it grows, so that a stream of scans is not copied each time.
            slack = np.array([cols, rows]) / 4.0
            from_slack = np.where(low < self._first, low - slack, self._first)
            to_slack = np.where(high > last, high + slack, last)
            low, high = np.minimum(low, self._first), np.maximum(high, last)
            if np.prod(to_slack - from_slack + 1) <= self.max_cells:
                low, high = from_slack, to_slack
        size = np.floor(high) - np.floor(low) + 1
        check_size(size, self.resolution, self.max_cells)
        first = np.floor(low).astype(np.int64)
        shape = int(size[1]), int(size[0])
        log_odds, stamps = np.zeros(shape, np.float32), np.full(shape, -1, np.int32)
        if rows > 0:
            col, row = self._first - first
            log_odds[row : row + rows, col : col + cols] = self._log_odds
            stamps[row : row + rows, col : col + cols] = self._stamps
        self._first, self._log_odds, self._stamps = first, log_odds, stamps
