"""Normal motion models: noise that does not depend on how often odometry is read, and noise alone."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.models.motion import OdometryMotion, check_not_negative, odometry_step
from beamfield.models.motion_steps import GaussianStep


@dataclass(frozen=True)
class GaussianMotion(OdometryMotion):
    """A normal step whose variances grow with the distance driven and the angle turned.

    For a step of d metres and a turn of a radians, the variance of the position is forward^2 d + shift^2 a along the
    robot's mean heading and sideways^2 d + shift^2 a across it, that of the heading drift^2 d + turn^2 a. The heading
    errs all along the step, so the end point errs with it: with half of the heading's noise at the end, and a
    further twelfth of its variance.

    Unlike the alphas of AMCL, ten short steps straight ahead have together the distribution of one long one.

    Parameters
    ----------
    forward, sideways
        Standard deviation of the position after one metre, metres.
    shift
        Standard deviation of the position, along and across, after one radian turned, metres.
    drift
        Standard deviation of the heading after one metre, radians.
    turn
        Standard deviation of the heading after one radian turned, radians.
    position_floor, heading_floor
        Standard deviations that are added to every step, however short, metres and radians.

    Raises
    ------
    InvalidInputError
        If a number is negative or not finite.

    Examples
    --------
    >>> import numpy as np
    >>> model = GaussianMotion(forward=0.05)
    >>> odometry = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0]]
    >>> particles = model.sample(np.zeros((1000, 3)), odometry, np.random.default_rng(0))
    >>> particles[:, 0].std().round(2).item()
    0.1
    """

    forward: float = 0.03
    sideways: float = 0.01
    shift: float = 0.02
    drift: float = 0.03
    turn: float = 0.05
    position_floor: float = 0.0
    heading_floor: float = 0.0

    def __post_init__(self) -> None:
        super().__post_init__()
        check_not_negative(
            self, "forward", "sideways", "shift", "drift", "turn", "position_floor", "heading_floor"
        )  # fmt: skip

    def step(self, odometry: FloatArray) -> GaussianStep:
        """Return the distribution of the step between two odometry poses (2, 3)."""
        mean = odometry_step(odometry)
        ahead, left, turn = mean.tolist()
        distance, angle = math.hypot(ahead, left), abs(turn)
        heading = self.drift**2 * distance + self.turn**2 * angle
        still = self.position_floor**2 + self.shift**2 * angle
        cos, sin = math.cos(0.5 * turn), math.sin(0.5 * turn)
        axes = np.array([[cos, -sin], [sin, cos]])
        across_step = np.array([-left, ahead])  # where the end point goes if all before it turns
        covariance = np.zeros((3, 3))
        covariance[:2, :2] = (axes * (still + np.array([self.forward, self.sideways]) ** 2 * distance)) @ axes.T
        covariance[:2, :2] += heading / 3.0 * np.outer(across_step, across_step)
        covariance[:2, 2] = covariance[2, :2] = 0.5 * heading * across_step
        covariance[2, 2] = heading + self.heading_floor**2
        return GaussianStep.from_covariance(mean, covariance)


# A robot on wheels in a building, if nothing is known of its odometry. Wheels hardly slip sideways, but where a map is
# wrong, the pose that fits it shifts sideways as well as forward while the robot drives: docs/evidence/localization.md.
USUAL_MOTION = GaussianMotion(forward=0.06, sideways=0.06, shift=0.02, drift=0.04, turn=0.08)


@dataclass(frozen=True)
class StationaryMotion(OdometryMotion):
    """A robot that stays where it is but for a little noise, whatever its odometry says.

    Parameters
    ----------
    position, heading
        Standard deviations of x, y and of the heading per step, metres and radians.

    Raises
    ------
    InvalidInputError
        If a number is negative or not finite.

    References
    ----------
    Beluga stationary_model.hpp, with 0.02 for both.
    """

    position: float = 0.02
    heading: float = 0.02

    def __post_init__(self) -> None:
        super().__post_init__()
        check_not_negative(self, "position", "heading")

    def step(self, odometry: FloatArray) -> GaussianStep:  # noqa: ARG002  (it is not looked at)
        """Return the distribution of a step."""
        return GaussianStep(np.zeros(3), np.eye(3), np.array([self.position, self.position, self.heading]))
