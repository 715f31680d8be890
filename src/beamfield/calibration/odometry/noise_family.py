"""Motion models as sums of kinds of noise with free levels: what is fitted to odometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from beamfield.geometry import FloatArray
from beamfield.models.differential_motion import DifferentialMotion
from beamfield.models.gaussian_motion import GaussianMotion
from beamfield.models.motion import OdometryMotion
from beamfield.models.omni_motion import OmniMotion


@dataclass(frozen=True)
class NoiseFamily:
    """Motion models whose covariance is a sum of levels times those of given models.

    The units are a model for each level, with level 1 of one kind of noise and 0 of the others; `build` makes the model
    that has the levels it is given. The name is for tables.
    """

    name: str
    units: tuple[OdometryMotion, ...]
    build: Callable[[FloatArray], OdometryMotion]


ONE_ALPHA = NoiseFamily("one alpha", (DifferentialMotion(1, 1, 1, 1),), lambda a: DifferentialMotion(*a, *a, *a, *a))
TWO_ALPHAS = NoiseFamily(
    "two alphas: 1 = 2, 3 = 4",
    (DifferentialMotion(1, 1, 0, 0), DifferentialMotion(0, 0, 1, 1)),
    lambda a: DifferentialMotion(a[0], a[0], a[1], a[1]),
)
FOUR_ALPHAS = NoiseFamily(
    "four alphas",
    (
        DifferentialMotion(1, 0, 0, 0),
        DifferentialMotion(0, 1, 0, 0),
        DifferentialMotion(0, 0, 1, 0),
        DifferentialMotion(0, 0, 0, 1),
    ),
    lambda a: DifferentialMotion(*a),
)
# Of nav2, ROS 1's "diff-corrected" and Beluga, the simplest first.
DIFFERENTIAL = (ONE_ALPHA, TWO_ALPHAS, FOUR_ALPHAS)
# Of nav2 and Beluga, for robots that drive in any direction.
OMNI = NoiseFamily("omni, one alpha", (OmniMotion(1, 1, 1, 1, 1),), lambda a: OmniMotion(*a, *a, *a, *a, *a))
# Sideways and turning in place share the level of driving ahead: alone they hardly show.
_SIDEWAYS, _SHIFT = 0.5, 0.5
GAUSSIAN = NoiseFamily(
    "GaussianMotion: position, drift, turn",
    (
        GaussianMotion(1.0, _SIDEWAYS, _SHIFT, 0.0, 0.0),
        GaussianMotion(0.0, 0.0, 0.0, 1.0, 0.0),
        GaussianMotion(0.0, 0.0, 0.0, 0.0, 1.0),
    ),
    lambda v: GaussianMotion(v[0] ** 0.5, _SIDEWAYS * v[0] ** 0.5, _SHIFT * v[0] ** 0.5, v[1] ** 0.5, v[2] ** 0.5),
)
