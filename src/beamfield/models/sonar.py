"""The beam model of sonars: section 6.3 with cones instead of rays."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from beamfield.errors import InvalidInputError
from beamfield.maps.cone import ConeCaster
from beamfield.maps.landmark_cone import LandmarkCones
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.range_mixture import RangeMixtureModel, RangeSource
from beamfield.sensors import RangeFinder
from beamfield.short_repr import short_repr


@dataclass(frozen=True, eq=False)
class SonarModel(RangeMixtureModel):
    """p(z | x, m) of a scan of sonars, each of which measures the nearest obstacle in its cone.

    The mixture (6.12) is that of `BeamModel`, and so are all methods. The expected range z* of each sensor is the
    distance to the nearest visible point of an obstacle within half of `finder.opening_angle` to either side of its
    axis; in a feature-based map, to the nearest landmark in that cone. It is a proper density over scans.

    Use it for sonars and for other wide rangers (time-of-flight chips, infrared). A beam model instead expects ranges
    that are too long wherever a wall is oblique or a post stands beside the axis. Smooth walls that mirror a pulse away
    are not in z*: their readings are too long or missing, and z_rand and z_max have to take them.

    Parameters
    ----------
    map
        A grid, or landmarks.
    parameters
        Weights and shapes of the four densities.
    exponent, n_beams, finder
        As for `BeamModel`.
    unknown
        Whether cones see through unknown cells of a grid ("free") or end at them ("occupied").
    landmark_radius
        Radius of the landmarks, metres: one number or one each; 0 for points.

    Raises
    ------
    InvalidInputError
        If the exponent is not positive and finite, n_beams < 1, a radius is negative, or given for a grid.

    Notes
    -----
    Readings follow `Scan`. A sensor without opening angle is a beam: over a grid the model is then `BeamModel`.
    Neighbouring sonars overlap, and one person or one wall counts in all of them: `exponent` and `n_beams` matter as
    they do for beams (6.3.4).

    Instances are immutable, can be pickled and may be used from several threads.

    References
    ----------
    Probabilistic Robotics, section 6.1, (6.2); 6.3 for cones; 6.3.1, (6.4) to (6.12), Table 6.1, and for feature-based
    maps.

    Examples
    --------
    >>> room = np.zeros((40, 40))
    >>> room[[0, -1]] = 100
    >>> room[:, [0, -1]] = 100
    >>> grid = OccupancyGrid.from_ros(room, resolution=0.1)
    >>> parameters = BeamParameters(z_hit=0.8, z_short=0.1, z_max=0.05, z_rand=0.05, sigma_hit=0.1, lambda_short=0.5)
    >>> finder = RangeFinder.from_bearings([0.2, np.pi / 2], max_range=8.0, opening_angle=0.5)
    >>> model = SonarModel(grid, parameters, finder=finder)
    >>> model.expected([1.95, 2.95, 0.0]).round(3).tolist()
    [1.95, 0.95]
    """

    map: OccupancyGrid | LandmarkMap
    parameters: BeamParameters
    exponent: float = field(default=None, kw_only=True)  # type: ignore[assignment]  # always there once constructed
    n_beams: int | None = field(default=None, kw_only=True)
    unknown: Literal["free", "occupied"] = field(default="free", kw_only=True)
    landmark_radius: ArrayLike = field(default=0.0, kw_only=True)
    finder: RangeFinder | None = field(default=None, kw_only=True)
    _source: RangeSource = field(init=False, repr=False)

    __repr__ = short_repr

    def _make_source(self) -> RangeSource:
        if isinstance(self.map, LandmarkMap):
            return LandmarkCones(self.map, self.landmark_radius)
        if np.any(np.asarray(self.landmark_radius) != 0.0):
            raise InvalidInputError(
                f"landmark_radius: expected 0 with a grid, which has no landmarks, got {self.landmark_radius}"
            )
        return ConeCaster(self.map, unknown=self.unknown)


def model_of_sensor(finder: RangeFinder) -> type[BeamModel | SonarModel]:
    """Return the model of a sensor's readings on a grid: of cones where it has an opening angle."""
    return SonarModel if finder.opening_angle > 0.0 else BeamModel
