"""Matching histograms of occupancy, an older relative of map matching (section 6.5)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray
from beamfield.kernels.correlation import fill_histogram_overlap
from beamfield.kernels.threads import run_in_blocks
from beamfield.models.local_map_cells import LocalCells, LocalMapModel, poses_in_cells


@dataclass(frozen=True, eq=False, repr=False)
class HistogramMatchingModel(LocalMapModel):
    """p(m_local | x, m) = share that histograms of the two maps have in common, over columns and over rows.

    A histogram counts the free and the occupied cells of every column (row) of the map, among the cells that both maps
    define. The share is the sum of the smaller counts, divided by the number of cells, and the mean of the two axes.
    Histograms forget where in a column a cell lies: they tell places apart by less than maps do, and bear with more.

    Parameters
    ----------
    grid
        The global map.
    min_overlap
        As for `MapMatchingModel`.

    Raises
    ------
    InvalidInputError
        If min_overlap is not in (0, 1].

    Notes
    -----
    Cells count as occupied above probability 0.5, as free below, and as undefined at 0.5. Histograms run along the axes
    of the global map, into which the local map is turned. Measurements and those without any defined cell are as for
    `MapMatchingModel`.

    References
    ----------
    Probabilistic Robotics, sections 6.5 and 6.9. The idea is that of Duckett and Nehmzow, "Mobile robot
    self-localisation using occupancy histograms and a mixture of Gaussian location hypotheses" (2001), who learn the
    histograms of places; here they are computed from the map, at any pose and heading.

    Examples
    --------
    >>> from beamfield.maps.occupancy import OccupancyGrid
    >>> grid = OccupancyGrid([[0.0, 0.0, 0.0, 1.0]], resolution=0.5)
    >>> seen = OccupancyGrid([[0.0, 0.0, 1.0]], resolution=0.5, origin=(0.0, -0.25, 0.0))
    >>> model = HistogramMatchingModel(grid)
    >>> np.exp(model.log_likelihood(seen, [[0.5, 0.25, 0.0], [0.0, 0.25, 0.0]])).round(2).tolist()
    [1.0, 0.67]
    """

    def _make_table(self) -> NDArray[Any]:
        table = np.full((self.grid.shape[0] + 2, self.grid.shape[1] + 2), 2, np.uint8)
        table[1:-1, 1:-1][self.grid.probability < 0.5] = 0
        table[1:-1, 1:-1][self.grid.probability > 0.5] = 1
        return table.reshape(-1)

    def _log_likelihoods(self, cells: LocalCells, poses: FloatArray) -> FloatArray:
        decided = cells.probability != 0.5
        x, y, occupied = cells.x[decided], cells.y[decided], (cells.probability[decided] > 0.5).astype(np.uint8)
        total = len(x)
        if total == 0:
            return np.zeros(len(poses))
        starts = poses_in_cells(self.grid, poses)
        reach = int(np.ceil(np.hypot(x, y).max()))
        table, shape, counts = self._table, self.grid.shape, np.empty((len(starts), 2))
        run_in_blocks(
            lambda a, b: fill_histogram_overlap(starts[a:b], x, y, occupied, table, *shape, reach, counts[a:b]),
            len(starts),
            work_per_row=total,
        )
        n, common = counts.T
        share = np.where(n >= self.min_overlap * total, common / np.maximum(n, 1.0), 0.0)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(share))
