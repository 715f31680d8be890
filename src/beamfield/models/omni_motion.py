"""The odometry motion model of robots that drive in any direction, as AMCL and its heirs compute it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.models.motion import OdometryMotion, check_not_negative, odometry_step
from beamfield.models.motion_steps import GaussianStep, from_line


@dataclass(frozen=True)
class OmniMotion(OdometryMotion):
    """A robot that drives in any direction: noise along and across it and of the heading, all independent.

    The variances are alpha3 d^2 + alpha4 r^2 along the direction driven, alpha5 d^2 + alpha4 r^2 across it, and
    alpha1 r^2 + alpha2 d^2 of the heading, for a distance d and a turn r, as in nav2.

    Parameters
    ----------
    alpha1
        Rotation from rotation.
    alpha2
        Rotation from translation, rad^2/m^2.
    alpha3
        Translation from translation.
    alpha4
        Translation, along and across, from rotation, m^2/rad^2.
    alpha5
        Translation across from translation.
    variance_as_deviation
        Take those variances for standard deviations, as ROS 1's "omni" does by mistake.
    shortest_translation
        Steps up to this length, metres, count as straight ahead (Beluga: 0.01).
    turns_from_line
        A turn counts from the nearer of no turn and a half turn (Beluga).

    Raises
    ------
    InvalidInputError
        If a number is negative or not finite.

    Notes
    -----
    ROS 1's amcl has alpha1 and alpha4 the other way round in "omni", and before Melodic in "omni-corrected", too.

    References
    ----------
    ROS 1 amcl_odom.cpp, nav2 omni_motion_model.cpp, Beluga omnidirectional_drive_model.hpp.

    Examples
    --------
    >>> import numpy as np
    >>> model = OmniMotion(0.0, 0.0, 0.0, 0.0, alpha5=0.04)
    >>> odometry = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]
    >>> particles = model.sample(np.zeros((1000, 3)), odometry, np.random.default_rng(0))
    >>> particles.std(axis=0).round(2).tolist()
    [0.0, 0.1, 0.0]
    """

    alpha1: float = 0.2
    alpha2: float = 0.2
    alpha3: float = 0.2
    alpha4: float = 0.2
    alpha5: float = 0.2
    variance_as_deviation: bool = False
    shortest_translation: float = 0.0
    turns_from_line: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        check_not_negative(self, "alpha1", "alpha2", "alpha3", "alpha4", "alpha5", "shortest_translation")

    def step(self, odometry: FloatArray) -> GaussianStep:
        """Return the distribution of the step between two odometry poses (2, 3)."""
        ahead, left, turn = odometry_step(odometry).tolist()
        distance = math.hypot(ahead, left)
        if distance <= self.shortest_translation:
            ahead, left = distance, 0.0
        counted = from_line(turn) if self.turns_from_line else turn
        from_distance, from_turn = distance**2, counted**2
        variances = np.array(
            [
                self.alpha3 * from_distance + self.alpha4 * from_turn,
                self.alpha5 * from_distance + self.alpha4 * from_turn,
                self.alpha1 * from_turn + self.alpha2 * from_distance,
            ]
        )
        deviations = variances if self.variance_as_deviation else np.sqrt(variances)
        return GaussianStep(np.array([ahead, left, turn]), _along_and_across(ahead, left), deviations)


def _along_and_across(ahead: float, left: float) -> FloatArray:
    """Return the axes of the noise: along the step, to its right, and the heading."""
    bearing = math.atan2(left, ahead)
    cos, sin = math.cos(bearing), math.sin(bearing)
    return np.array([[cos, sin, 0.0], [sin, -cos, 0.0], [0.0, 0.0, 1.0]])
