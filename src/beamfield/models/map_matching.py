"""Map matching, the correlation-based measurement model: section 6.5."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import checked
from beamfield.geometry import FloatArray, as_poses
from beamfield.maps.smoothing import smooth_map
from beamfield.models.local_map_cells import LocalCells, LocalMap, LocalMapModel, OverlapSums, overlap_sums, value_table

# Variances below this are 0: values are in [0, 1], and rounding leaves 1e-16 of them.
NO_VARIANCE = 1e-12


class MapMatch(NamedTuple):
    """How well a local map matches the global map at poses (...).

    Parameters
    ----------
    correlation
        (...) rho of (6.35) in [-1, 1]; 0 where it is not determined.
    overlap
        (...) share of the local map's defined cells that lie on defined cells of the global map.
    determined
        (...) False where the overlap is too small, or all cells in it have one and the same value in both maps.
    """

    correlation: FloatArray
    overlap: FloatArray
    determined: NDArray[np.bool_]


@dataclass(frozen=True, eq=False, repr=False)
class MapMatchingModel(LocalMapModel):
    """p(m_local | x, m) = max(rho, 0) by the correlation rho of a local map with the global one: (6.35) to (6.37).

    Use it where free space says as much as walls do: it scores both, while a likelihood field scores end points only.
    It is no density over measurements, has no physical noise behind it, and is not smooth in the pose unless the map is
    smoothed.

    Parameters
    ----------
    grid
        The global map.
    smoothing
        Standard deviation in metres of a Gaussian kernel that smooths the global map (`smooth_map`); None: none.
    min_overlap
        Least share of the local map's defined cells that must lie on defined cells of the map; with less, the
        correlation is not determined.

    Raises
    ------
    InvalidInputError
        If min_overlap is not in (0, 1] or the smoothing kernel makes no sense.

    Notes
    -----
    A measurement is a `Scan`, or an `OccupancyGrid` in the robot's frame (`local_map`). Each defined cell of the local
    map is moved by the pose and compared with the map cell in which its centre falls; a centre within 1e-9 cells below
    a border is on it. The chapter runs over the map's cells instead and looks up the local map: under rotation either
    way counts a few cells twice and others not at all, and this one costs a pass over the local map only.

    The mean of (6.36) runs over both maps, as printed. So the correlation is 1 only if the two maps agree in their
    values and not just in their pattern: a local map of timid values (0.4 for free) lies on one side of the mean of a
    map of 0 and 1 and scores below 0 at the true pose. Therefore scans become confident maps here (0.97 and 0.03).

    The overlap decides nothing as long as it reaches `min_overlap`; a pose half off the map may score as high as one in
    its middle. A measurement without any defined cell says nothing: log p = 0 at every pose.

    References
    ----------
    Probabilistic Robotics, section 6.5, (6.35) to (6.37), Figure 6.12.

    Examples
    --------
    >>> from beamfield.maps.occupancy import OccupancyGrid
    >>> grid = OccupancyGrid([[0.0, 0.0, 0.0, 1.0]], resolution=0.5)
    >>> seen = OccupancyGrid([[0.0, 0.0, 1.0]], resolution=0.5, origin=(0.0, -0.25, 0.0))
    >>> model = MapMatchingModel(grid)
    >>> model.correlation(seen, [[0.5, 0.25, 0.0], [0.0, 0.25, 0.0]]).round(2).tolist()
    [1.0, -0.33]
    >>> np.exp(model.log_likelihood(seen, [[0.5, 0.25, 0.0], [0.0, 0.25, 0.0]])).round(2).tolist()
    [1.0, 0.0]
    """

    smoothing: float | None = field(default=None, kw_only=True)

    def _make_table(self) -> NDArray[Any]:
        return value_table(self.grid if self.smoothing is None else smooth_map(self.grid, self.smoothing))

    @checked
    def match(self, z: LocalMap, poses: ArrayLike) -> MapMatch:
        """Return the correlation at many poses, with the overlap and whether it is determined.

        Parameters
        ----------
        z
            A scan, or a local map in the robot's frame.
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        Arrays (...); a measurement without any defined cell is determined nowhere.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        return self._match(self._cells(z), as_poses(poses))

    def correlation(self, z: LocalMap, poses: ArrayLike) -> FloatArray:
        """Return rho of (6.35) alone; see `match`.

        Parameters
        ----------
        z, poses
            As for `match`.

        Returns
        -------
        (...) in [-1, 1], 0 where it is not determined.
        """
        return self.match(z, poses).correlation

    def _log_likelihoods(self, cells: LocalCells, poses: FloatArray) -> FloatArray:
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(np.maximum(self._match(cells, poses).correlation, 0.0)))

    def _match(self, cells: LocalCells, robots: FloatArray) -> MapMatch:
        sums = overlap_sums(self.grid, self._table, cells, robots.reshape(-1, 3))
        overlap = sums.n / max(len(cells.x), 1)
        rho, varies = _correlation_of_sums(sums)
        determined = varies & (overlap >= self.min_overlap)
        shape, rho = robots.shape[:-1], np.where(determined, rho, 0.0)
        return MapMatch(rho.reshape(shape), overlap.reshape(shape), determined.reshape(shape))


def _correlation_of_sums(sums: OverlapSums) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return rho of (6.35) with the mean of (6.36), and whether it is defined; 0 where it is not.

    With the common mean, the numerator is sum(m l) - N mean^2.
    """
    n = np.maximum(sums.n, 1.0)
    mean = (sums.local + sums.map) / (2.0 * n)
    numerator = sums.product - n * mean**2
    local = sums.local_square - 2.0 * mean * sums.local + n * mean**2
    of_map = sums.map_square - 2.0 * mean * sums.map + n * mean**2
    varies = (local > NO_VARIANCE * n) & (of_map > NO_VARIANCE * n)
    rho = np.divide(numerator, np.sqrt(np.where(varies, local * of_map, 1.0)), where=varies, out=np.zeros_like(n))
    return np.clip(rho, -1.0, 1.0), varies
