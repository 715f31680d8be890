"""A belief as weighted poses, and what it says: mean, covariance, the best of its clusters."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import as_count, check_fields, checked, require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses, compose, pose_rows
from beamfield.kernels import particles as kernels
from beamfield.localization.replay import PoseBelief
from beamfield.localization.resampling import BIN_SECTORS, IndexArray, as_weights, bin_numbers
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.short_repr import short_repr

_ALL: IndexArray = np.empty(0, np.int64)


class Estimate(NamedTuple):
    """Where the robot is by a cloud of particles, or by one cluster of it."""

    pose: FloatArray
    """(3,) weighted mean; the heading is the circular mean, in (-pi, pi]."""
    covariance: FloatArray
    """(3, 3) of the weighted deviations from it, m^2, m rad and rad^2, headings the short way round."""
    weight: float
    """Share of the belief that it stands for: 1 for the whole cloud."""

    @property
    def spread(self) -> float:
        """Root of the summed variances of x and y, metres."""
        return math.sqrt(self.covariance[0, 0] + self.covariance[1, 1])


@dataclass(frozen=True, eq=False)
class Particles:
    """A belief: poses with weights.

    Parameters
    ----------
    poses
        (n, 3) metres and radians.
    weights
        (n,) at least 0, with the sum 1; equal ones by default.

    Raises
    ------
    InvalidInputError
        If there is no pose, one is not finite, or the weights do not fit.

    Examples
    --------
    >>> cloud = Particles([[1.0, 0.0, 3.1], [1.2, 0.0, -3.1], [9.0, 9.0, 0.0]], [0.4, 0.4, 0.2])
    >>> cloud.best_cluster.pose.round(3).tolist(), round(cloud.best_cluster.weight, 3)
    ([1.1, 0.0, 3.142], 0.8)
    """

    poses: FloatArray
    weights: FloatArray = None  # type: ignore[assignment]  # always there once constructed

    if TYPE_CHECKING:  # lists will do, and arrays of any numbers

        def __init__(self, poses: ArrayLike, weights: ArrayLike | None = None) -> None: ...

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        poses = as_poses(self.poses)
        require(poses.ndim == 2 and len(poses), "poses", "shape (n, 3) with n at least 1", poses.shape)
        if self.weights is None:
            weights: FloatArray = np.full(len(poses), 1.0 / len(poses))
        else:
            weights = as_weights(self.weights, len(poses))
        object.__setattr__(self, "poses", pose_rows(poses))
        object.__setattr__(self, "weights", weights)

    @classmethod
    def unchecked(cls, poses: FloatArray, weights: FloatArray) -> Particles:
        """Build one from arrays that are known to be valid: checks would take as long as a step of the filter."""
        particles = object.__new__(cls)
        particles.__dict__.update(poses=poses, weights=weights)
        return particles

    def __len__(self) -> int:
        return len(self.poses)

    @cached_property
    def whole(self) -> Estimate:
        """Mean and covariance of the whole cloud."""
        return self._moments(_ALL, 0)

    @cached_property
    def best_cluster(self) -> Estimate:
        """Mean and covariance of the cluster with the most weight; bins of poses that touch are one cluster."""
        numbers, _, keys, slots = self.numbered_bins
        clusters = np.empty(len(keys), np.int64)
        n_clusters = kernels.join_neighbours(keys, BIN_SECTORS, slots, clusters)
        if n_clusters == 1:
            return self.whole
        of_each = clusters[numbers]
        heaviest = int(np.argmax(np.bincount(of_each, self.weights)))
        return self._moments(of_each, heaviest)

    @cached_property
    def numbered_bins(self) -> tuple[IndexArray, int, IndexArray, NDArray[np.int32]]:
        """What `bin_numbers` says of the poses."""
        return bin_numbers(self.poses)

    def _moments(self, groups: IndexArray, which: int) -> Estimate:
        mean, covariance = np.zeros(3), np.zeros((3, 3))
        weight = kernels.fill_moments(self.poses, self.weights, groups, which, mean, covariance)
        return Estimate(mean, covariance, weight if len(groups) else 1.0)


@checked
def belief_poses(belief: PoseBelief, n: int, rng: np.random.Generator) -> FloatArray:
    """Draw poses from a normal belief: where a filter starts if the pose is known roughly.

    Parameters
    ----------
    belief
        Mean and covariance, which may be singular.
    n
        How many.
    rng
        Source of randomness.

    Returns
    -------
    (n, 3) poses, headings not wrapped.

    Raises
    ------
    InvalidInputError
        If n < 1.
    """
    return normal_poses(belief, as_count(n, "n", least=1), rng)


def normal_poses(belief: PoseBelief, n: int, rng: np.random.Generator) -> FloatArray:
    """Do what `belief_poses` does, for callers whose own argument is to be named if it is no belief."""
    variances, axes = np.linalg.eigh(belief.covariance)
    drawn = rng.standard_normal((n, 3))
    return np.asarray(belief.mean + (drawn * np.sqrt(np.maximum(variances, 0.0))) @ axes.T)


@checked
def free_poses(grid: OccupancyGrid, n: int, rng: np.random.Generator) -> FloatArray:
    """Draw poses uniformly over the free cells of a map, at all headings: where a filter starts if nothing is known.

    Parameters
    ----------
    grid
        The map.
    n
        How many.
    rng
        Source of randomness.

    Returns
    -------
    (n, 3) poses.

    Raises
    ------
    InvalidInputError
        If the map has no free cell, or n < 1.
    """
    n = as_count(n, "n", least=1)
    require_free(grid)
    rows, cols = np.nonzero(grid.free)
    chosen = rng.integers(0, len(rows), n)
    within = (np.column_stack([cols[chosen], rows[chosen]]) + rng.random((n, 2))) * grid.resolution
    return compose(grid.origin, np.column_stack([within, rng.uniform(-np.pi, np.pi, n)]))


def require_free(grid: OccupancyGrid) -> None:
    """Refuse a map without a free cell."""
    if not grid.free.any():
        raise InvalidInputError("grid: the map has no free cell, so there is no place for the robot")
