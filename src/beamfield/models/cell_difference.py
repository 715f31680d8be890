"""Matching maps by the squared differences of their cells, an older relative of map matching (section 6.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import checked, require
from beamfield.geometry import FloatArray, as_poses
from beamfield.models.local_map_cells import LocalMap, LocalMapModel, overlap_sums


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

    @checked
    def log_likelihood(self, z: LocalMap, poses: ArrayLike) -> FloatArray:
        """Return -D / (2 sigma^2) at many poses.

        Parameters
        ----------
        z
            A scan, or a local map in the robot's frame.
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        (...) nats up to a constant, at most 0; -inf where fewer than `min_overlap` of the local map's cells are defined
        in the map; 0 everywhere for a measurement without any defined cell.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        robots = as_poses(poses)
        cells = self._cells(z)
        total = len(cells.x)
        sums = overlap_sums(self.grid, self._table, cells, robots.reshape(-1, 3))
        # Rounding may leave less than 0.
        difference = np.maximum(sums.local_square - 2.0 * sums.product + sums.map_square, 0.0)
        scaled = difference * total / np.maximum(sums.n, 1.0)
        value = np.where(sums.n >= self.min_overlap * total, 0.0 - scaled / (2.0 * self.sigma**2), -np.inf)
        return value.reshape(robots.shape[:-1])
