"""Matching maps by the squared differences of their cells, an older relative of map matching (section 6.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beamfield.arguments import require
from beamfield.geometry import FloatArray
from beamfield.models.local_map_cells import LocalCells, LocalMapModel, overlap_sums


@dataclass(frozen=True, eq=False, repr=False)
class CellDifferenceModel(LocalMapModel):
    """log p(m_local | x, m) = -D / (2 sigma^2), D the sum of squared differences of the cells that both maps define.

    So that a pose does not gain by leaving the map, D is the mean over the common cells times the number of all defined
    cells of the local map. Unlike the correlation it never calls a match good because both maps vary together.

    Parameters
    ----------
    grid
        The global map.
    sigma
        Standard deviation of the difference of a cell. Cells of one wall are not independent, so that values of several
        units are usual: at 1, a hundred wrong cells cost 50 nats.
    min_overlap
        As for `MapMatchingModel`.

    Raises
    ------
    InvalidInputError
        If sigma is not positive and finite or min_overlap is not in (0, 1].

    Notes
    -----
    Measurements, the cells that are compared, and measurements without any defined cell are as for `MapMatchingModel`.

    References
    ----------
    Probabilistic Robotics, sections 6.5 and 6.9. The score is that of Thrun, "Exploration and model building in mobile
    robot domains" (1993), in the form given above.

    Examples
    --------
    >>> from beamfield.maps.occupancy import OccupancyGrid
    >>> grid = OccupancyGrid([[0.0, 0.0, 0.0, 1.0]], resolution=0.5)
    >>> seen = OccupancyGrid([[0.0, 0.0, 1.0]], resolution=0.5, origin=(0.0, -0.25, 0.0))
    >>> CellDifferenceModel(grid).log_likelihood(seen, [[0.5, 0.25, 0.0], [0.0, 0.25, 0.0]]).round(2).tolist()
    [0.0, -0.5]
    """

    sigma: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        require(0.0 < self.sigma < np.inf, "sigma", "a positive, finite number", self.sigma)

    def _log_likelihoods(self, cells: LocalCells, poses: FloatArray) -> FloatArray:
        total = len(cells.x)
        sums = overlap_sums(self.grid, self._table, cells, poses)
        # Rounding may leave less than 0.
        difference = np.maximum(sums.local_square - 2.0 * sums.product + sums.map_square, 0.0)
        scaled = difference * total / np.maximum(sums.n, 1.0)
        return np.where(sums.n >= self.min_overlap * total, 0.0 - scaled / (2.0 * self.sigma**2), -np.inf)
