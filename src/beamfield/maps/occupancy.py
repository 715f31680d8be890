"""Occupancy grids: the location-based, volumetric maps of section 6.2."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.argument_kinds import expect
from beamfield.arguments import LARGEST, as_floats, check_fields, check_magnitude, checked, keep, require, restore
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_pose, invert, transform_points
from beamfield.short_repr import short_repr

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class OccupancyGrid:
    """A grid of square cells, each free, occupied or unknown.

    Row 0 has the lowest y, as in nav_msgs/OccupancyGrid. In the grid's own frame the cell (row, col) spans
    [col s, (col + 1) s) x [row s, (row + 1) s) with s the resolution; `origin` is the pose of that frame in the map.

    Parameters
    ----------
    probability
        (rows, cols) probability that the cell is occupied, in [0, 1]; NaN where nothing is known. It is copied, but for
        a float32 array that is read-only and no view of another one: maps can take a quarter of the memory there is.
    resolution
        Side of a cell in metres.
    origin
        (3,) pose (x, y, yaw) of the lower-left corner in the map frame, metres and radians.
    occupied_thresh
        Cells with probability >= this are occupied.
    free_thresh
        Cells with probability <= this are free; what is neither is unknown.

    Raises
    ------
    InvalidInputError
        If a value is outside its range, the origin is beyond 10^9 m, or the grid is empty.

    References
    ----------
    Probabilistic Robotics, section 6.2, (6.3): a location-based map. The third category, unknown: section 6.4.2.

    Examples
    --------
    >>> grid = OccupancyGrid([[0.0, np.nan, 1.0]], resolution=0.5, origin=(1.0, 0.0, 0.0))
    >>> grid.free.tolist(), grid.occupied.tolist()
    ([[True, False, False]], [[False, False, True]])
    """

    probability: NDArray[np.float32]
    resolution: float
    origin: FloatArray = (0.0, 0.0, 0.0)  # type: ignore[assignment]
    occupied_thresh: float = 0.65
    free_thresh: float = 0.25

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(
            self,
            probability: ArrayLike,
            resolution: float,
            origin: ArrayLike = (0.0, 0.0, 0.0),
            occupied_thresh: float = 0.65,
            free_thresh: float = 0.25,
        ) -> None: ...

    __repr__ = short_repr
    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        with np.errstate(over="ignore"):  # what overflows is refused below
            probability = np.asarray(self.probability, dtype=np.float32, order="C")
        if probability.flags.writeable or not probability.flags.owndata:
            probability = np.array(probability)
        if probability.ndim != 2 or probability.size == 0:
            raise InvalidInputError(f"probability: expected a 2-D array with cells, got shape {probability.shape}")
        # These two ignore NaN, and need no mask of the map's size.
        if np.fmin.reduce(probability, axis=None) < 0 or np.fmax.reduce(probability, axis=None) > 1:
            row, col = np.argwhere((probability < 0) | (probability > 1))[0]
            raise InvalidInputError(
                f"probability: expected [0, 1] or NaN, got {probability[row, col]} at (row, col) = ({row}, {col}); "
                "OccupancyGrid.from_ros(data, resolution) takes percent"
            )
        check_magnitude("resolution", self.resolution)
        if not 0.0 <= self.free_thresh < self.occupied_thresh <= 1.0:
            raise InvalidInputError(
                "thresholds: expected 0 <= free_thresh < occupied_thresh <= 1, "
                f"got free_thresh {self.free_thresh} and occupied_thresh {self.occupied_thresh}"
            )
        origin = as_pose(self.origin, "origin")
        require(np.abs(origin).max() <= LARGEST, "origin", f"numbers up to {LARGEST:g}", origin.tolist())
        keep(self, probability=probability, origin=origin, resolution=float(self.resolution))

    @classmethod
    @checked
    def from_ros(cls, data: ArrayLike, resolution: float, origin: ArrayLike = (0.0, 0.0, 0.0)) -> OccupancyGrid:
        """Build a grid from the values of a nav_msgs/OccupancyGrid.

        Parameters
        ----------
        data
            (rows, cols) integers: -1 unknown, 0 to 100 percent occupied; row 0 has the lowest y.
        resolution, origin
            As for the class.

        Returns
        -------
        A grid with the class's thresholds.

        Raises
        ------
        InvalidInputError
            If a value is below -1 or above 100, none is above 1 (but of a message's int8), or as for the class.

        Examples
        --------
        >>> OccupancyGrid.from_ros([[0, -1, 100]], resolution=0.05).probability.tolist()
        [[0.0, nan, 1.0]]
        """
        expect("data", data, ArrayLike)
        values = np.asarray(data)
        if values.ndim == 2 and values.size and (values.min() < -1 or values.max() > 100):
            bad = values[(values < -1) | (values > 100)][0]
            raise InvalidInputError(f"data: expected -1 or 0 to 100, got {bad}")
        require(values.ndim == 2, "data", "shape (rows, cols)", values.shape)
        if values.dtype != np.int8 and values.size and 0 < values.max() <= 1:
            raise InvalidInputError(
                f"data: expected percent, 100 where occupied, got {values.max()} at most: 100 * data is percent, "
                "if 1 is occupied"
            )
        # Step by step, for maps whose copies would not fit into memory.
        probability = values.astype(np.float32, order="C")
        probability /= np.float32(100.0)
        probability[values < 0] = np.nan
        probability.flags.writeable = False
        return cls(probability, resolution, as_floats(origin, "origin"))

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, cols)."""
        rows, cols = self.probability.shape
        return rows, cols

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """Left, bottom, right and top of the map, metres in the map frame."""
        rows, cols = self.shape
        corners = self.to_map([[0, 0], [cols, 0], [cols, rows], [0, rows]])
        (left, bottom), (right, top) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
        return left, bottom, right, top

    @property
    def occupied(self) -> BoolArray:
        """(rows, cols) mask of occupied cells."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.probability >= np.float32(self.occupied_thresh))

    @property
    def free(self) -> BoolArray:
        """(rows, cols) mask of free cells."""
        with np.errstate(invalid="ignore"):
            return np.asarray(self.probability <= np.float32(self.free_thresh))

    @property
    def unknown(self) -> BoolArray:
        """(rows, cols) mask of cells that are neither free nor occupied."""
        return ~(self.occupied | self.free)

    @checked
    def to_cells(self, points: ArrayLike) -> FloatArray:
        """Return where points of the map are in the grid, in cells.

        Parameters
        ----------
        points
            (..., 2) metres.

        Returns
        -------
        (..., 2) fractional (col, row): the cell is their floor. Points off the map are negative or past its last cell.

        Examples
        --------
        >>> OccupancyGrid([[0.0, 1.0]], resolution=0.5, origin=(1.0, 0.0, 0.0)).to_cells([1.75, 0.25]).tolist()
        [1.5, 0.5]
        """
        with np.errstate(over="ignore"):
            return transform_points(invert(self.origin), points) / self.resolution

    @checked
    def to_map(self, cells: ArrayLike) -> FloatArray:
        """Return where places of the grid are in the map; inverse of `to_cells`.

        Parameters
        ----------
        cells
            (..., 2) fractional (col, row); the middle of a cell is half a cell on.

        Returns
        -------
        (..., 2) metres.
        """
        with np.errstate(over="ignore"):
            return transform_points(self.origin, as_floats(cells, "cells") * self.resolution)

    @checked
    def look_up(self, mask: NDArray[Any], points: ArrayLike, *, outside: float = False) -> NDArray[Any]:
        """Return the value of a mask, or of any table of the map's cells, at points.

        Parameters
        ----------
        mask
            (rows, cols), such as `free` or `occupied`.
        points
            (..., 2) finite, metres.
        outside
            The value of points off the map.

        Returns
        -------
        (...) bool, or what the table holds.
        """
        rows, cols = self.shape
        # A cell off the map on each side stands for all beyond, however far.
        places = np.floor(np.clip(self.to_cells(points), -1.0, [cols, rows])).astype(np.int64)
        col, row = places[..., 0], places[..., 1]
        inside = (col >= 0) & (row >= 0) & (col < cols) & (row < rows)
        return np.where(inside, mask[np.clip(row, 0, rows - 1), np.clip(col, 0, cols - 1)], outside)
