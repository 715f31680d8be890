"""Shared by all models that compare a local map with the global one."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, checked, keep, require, restore
from beamfield.geometry import FloatArray, as_poses
from beamfield.kernels import correlation as kernels
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.mapping import scan_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import Scan
from beamfield.short_repr import short_repr

# What these models take as a measurement: a scan, or a local map in the robot's frame.
LocalMap = Scan | OccupancyGrid


@dataclass(frozen=True, eq=False)
class LocalMapModel(ABC):
    """A model of a local map by those of its cells that lie on defined cells of the global map.

    Parameters
    ----------
    grid
        The global map.
    min_overlap
        Least share of the local map's defined cells that must lie on defined cells of the map.

    Raises
    ------
    InvalidInputError
        If min_overlap is not in (0, 1].
    """

    is_normalized: ClassVar[bool] = False

    grid: OccupancyGrid
    min_overlap: float = field(default=0.2, kw_only=True)
    _table: NDArray[Any] = field(init=False, repr=False)

    __repr__ = short_repr
    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        require(0.0 < self.min_overlap <= 1.0, "min_overlap", "a share in (0, 1]", self.min_overlap)
        keep(self, _table=self._make_table())

    @checked
    def log_likelihood(self, z: LocalMap, poses: ArrayLike) -> FloatArray:
        """Return log p(m_local | x, m) of one local map at many poses.

        Parameters
        ----------
        z
            A scan, or a local map in the robot's frame.
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        (...) nats up to a constant, at most 0; -inf where fewer than `min_overlap` of the local map's cells are defined
        in the map, or the two have nothing in common; 0 everywhere for a measurement without any defined cell.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        robots, cells = as_poses(poses), self._cells(z)
        if len(cells.x) == 0:
            return np.zeros(robots.shape[:-1])
        return self._log_likelihoods(cells, robots.reshape(-1, 3)).reshape(robots.shape[:-1])

    @abstractmethod
    def _log_likelihoods(self, cells: LocalCells, poses: FloatArray) -> FloatArray:
        """Return the log-likelihoods (n,) of the defined cells of a local map at poses (n, 3)."""

    def _make_table(self) -> NDArray[Any]:
        """Return the map's cells as the kernels take them."""
        return value_table(self.grid)

    def _cells(self, z: LocalMap) -> LocalCells:
        """Return the defined cells of a measurement."""
        return local_cells(z, self.grid.resolution)


class LocalCells(NamedTuple):
    """The defined cells of a local map.

    Parameters
    ----------
    x, y
        (L,) centres in the robot frame, in cells of the global map.
    probability
        (L,) float32.
    """

    x: FloatArray
    y: FloatArray
    probability: NDArray[np.float32]


class OverlapSums(NamedTuple):
    """Sums over the cells that both maps define, each (n,) for n poses; values are probabilities less 0.5."""

    n: FloatArray
    local: FloatArray
    map: FloatArray
    product: FloatArray
    local_square: FloatArray
    map_square: FloatArray


def local_cells(z: LocalMap, resolution: float) -> LocalCells:
    """Return the defined cells of a measurement, perhaps none; a scan is turned into a map first."""
    local = scan_map(z, resolution=resolution) if isinstance(z, Scan) else z
    rows, cols = np.nonzero(~np.isnan(local.probability))
    centres = local.to_map(np.column_stack([cols, rows]) + 0.5) / resolution
    return LocalCells(centres[:, 0].copy(), centres[:, 1].copy(), local.probability[rows, cols])


def value_table(grid: OccupancyGrid) -> NDArray[np.float32]:
    """Return a map's probabilities less 0.5, in a frame of undefined cells, as kernels take them.

    ((rows + 2) * (cols + 2),) `kernels.correlation.UNDEFINED` where the map has no probability.
    """
    values = np.full((grid.shape[0] + 2, grid.shape[1] + 2), kernels.UNDEFINED, np.float32)
    defined = ~np.isnan(grid.probability)
    values[1:-1, 1:-1][defined] = grid.probability[defined] - np.float32(0.5)
    return values.reshape(-1)


def poses_in_cells(grid: OccupancyGrid, poses: FloatArray) -> FloatArray:
    """Return poses in the grid's frame (n, 4): x and y in cells, cos and sin of the heading."""
    heading = poses[:, 2] - grid.origin[2]
    return np.column_stack([grid.to_cells(poses[:, :2]), np.cos(heading), np.sin(heading)])


def overlap_sums(grid: OccupancyGrid, table: NDArray[np.float32], cells: LocalCells, poses: FloatArray) -> OverlapSums:
    """Return the sums (n,) over the cells that both maps define; all 0 where no cell is common."""
    starts = poses_in_cells(grid, poses)
    values = cells.probability - np.float32(0.5)
    sums = np.empty((len(poses), 6))
    run_in_blocks(
        lambda a, b: kernels.fill_sums(starts[a:b], cells.x, cells.y, values, table, *grid.shape, sums[a:b]),
        len(poses),
        work_per_row=len(cells.x),
    )
    return OverlapSums(*sums.T)
