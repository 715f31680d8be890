"""What every feature has: the vector f = (r, phi, s) of (6.38) and its covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import checked
from beamfield.geometry import FloatArray


@dataclass(frozen=True, eq=False)
class Feature:
    """Something a scan shows, as seen from the robot.

    Parameters
    ----------
    measurement
        (3,) range in metres, bearing in radians in (-pi, pi], signature (its meaning and unit depend on the kind).
        Range and bearing are polar coordinates in the robot frame. For the sensor frame give the finder no mount.
    covariance
        (3, 3) of the measurement's error, from the noise of the ranges to first order.
    beams
        (n,) the beams of the scan that showed it, in order of bearing.
    """

    measurement: FloatArray
    covariance: FloatArray
    beams: NDArray[np.int64]

    @property
    def position(self) -> FloatArray:
        """(2,) x, y in the robot frame, metres."""
        distance, bearing = self.measurement[:2]
        return np.array([distance * np.cos(bearing), distance * np.sin(bearing)])

    @property
    def signature(self) -> float:
        """The third entry of the measurement."""
        return float(self.measurement[2])


@checked
def stack_features(features: Sequence[Feature]) -> tuple[FloatArray, FloatArray]:
    """Return the measurements (n, 3) and covariances (n, 3, 3) of features, also of none.

    Examples
    --------
    >>> measurements, covariances = stack_features([])
    >>> measurements.shape, covariances.shape
    ((0, 3), (0, 3, 3))
    """
    measurements = np.array([feature.measurement for feature in features]).reshape(-1, 3)
    covariances = np.array([feature.covariance for feature in features]).reshape(-1, 3, 3)
    return measurements, covariances


def polar_jacobian(position: FloatArray) -> FloatArray:
    """Return the (2, 2) derivative of (range, bearing) in (x, y)."""
    x, y = position
    distance = float(np.hypot(x, y))
    return np.array([[x / distance, y / distance], [-y / distance**2, x / distance**2]])
