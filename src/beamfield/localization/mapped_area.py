"""A robot beyond what its map shows: where it is there, its scans do not tell."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import as_floats
from beamfield.geometry import FloatArray, as_poses
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.base import MeasurementModel
from beamfield.short_repr import short_repr

Z = TypeVar("Z")


@dataclass(frozen=True, eq=False)
class MappedArea:
    """Tells where a map is known.

    Parameters
    ----------
    grid
        The map.
    """

    grid: OccupancyGrid

    __repr__ = short_repr

    def is_beyond(self, poses: ArrayLike) -> NDArray[np.bool_]:
        """Return whether finite poses (..., 3) are in unknown cells, or off the map."""
        return np.asarray(self.grid.look_up(self._unknown, as_poses(poses)[..., :2], outside=True))

    @cached_property
    def _unknown(self) -> NDArray[np.bool_]:
        return self.grid.unknown


@dataclass(frozen=True, eq=False)
class MappedAreaModel(Generic[Z]):
    """A model that says nothing of poses beyond the map.

    Walls that the map does not show would pull a cloud to those that it does, metres away from where the robot is.
    Poses beyond the map are worth as much as the median one within it; and all are worth the same where more than half
    are beyond, so that odometry alone moves the cloud.

    Parameters
    ----------
    model
        Weighs measurements within the map.
    area
        Where that is.
    """

    model: MeasurementModel[Z]
    area: MappedArea

    __repr__ = short_repr

    @property
    def is_normalized(self) -> bool:
        """False: what it gives poses beyond the map is no density."""
        return False

    def log_likelihood(self, z: Z, poses: ArrayLike) -> FloatArray:
        """Return log p(z | x, m), nats, at poses (n, 3) as above; all 0 where most of them are beyond the map."""
        beyond = self.area.is_beyond(poses)
        if 2 * np.count_nonzero(beyond) > beyond.size:
            return np.zeros(beyond.shape)
        values = as_floats(self.model.log_likelihood(z, poses), "log_likelihood")
        if not beyond.any() or values.shape != beyond.shape:  # the filter says what a model must not return
            return values
        return np.where(beyond, np.median(values[~beyond]), values)
