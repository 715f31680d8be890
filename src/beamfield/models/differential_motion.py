"""Rotation, translation, rotation: the odometry motion model of Table 5.6, as AMCL and its heirs compute it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from beamfield.geometry import FloatArray
from beamfield.models.motion import OdometryMotion, check_not_negative
from beamfield.models.motion_steps import RotationTranslationRotation, from_line, rotations_and_translation

# AMCL gives shorter steps no first rotation, metres.
SHORTEST_TRANSLATION = 0.01


@dataclass(frozen=True)
class DifferentialMotion(OdometryMotion):
    """A robot that turns, drives straight and turns again; its noise grows with the step.

    The variances are alpha1 r1^2 + alpha2 d^2 of the first rotation r1, alpha3 d^2 + alpha4 (r1^2 + r2^2) of the
    translation d, and alpha1 r2^2 + alpha2 d^2 of the second rotation r2, where a rotation counts from the nearer of
    straight ahead and straight back. So do nav2, ROS 1's amcl ("diff-corrected") and Beluga.

    Parameters
    ----------
    alpha1
        Rotation from rotation.
    alpha2
        Rotation from translation, rad^2/m^2.
    alpha3
        Translation from translation.
    alpha4
        Translation from rotation, m^2/rad^2.
    variance_as_deviation
        Take those variances for standard deviations, as ROS 1's "diff" does by mistake.

    Raises
    ------
    InvalidInputError
        If an alpha is negative or not finite.

    Notes
    -----
    The standard deviation grows with the length of a step, not with its root: ten steps of 0.1 m are less noisy than
    one of a metre. Alphas belong to the distance between updates (nav2's update_min_d). In place the translation is
    the second rotation's noise along the old heading, and nothing moves sideways.

    References
    ----------
    Probabilistic Robotics, Table 5.6. ROS 1 amcl_odom.cpp, nav2 differential_motion_model.cpp,
    Beluga differential_drive_model.hpp.

    Examples
    --------
    >>> import numpy as np
    >>> model = DifferentialMotion(0.0, 0.0, 0.04, 0.0)
    >>> odometry = [[0.0, 0.0, 0.0], [0.5, 0.0, 0.0]]
    >>> particles = model.sample(np.zeros((1000, 3)), odometry, np.random.default_rng(0))
    >>> particles[:, 0].std().round(2).item()
    0.1
    """

    alpha1: float = 0.2
    alpha2: float = 0.2
    alpha3: float = 0.2
    alpha4: float = 0.2
    variance_as_deviation: bool = False

    def __post_init__(self) -> None:
        super().__post_init__()
        check_not_negative(self, "alpha1", "alpha2", "alpha3", "alpha4")

    def step(self, odometry: FloatArray) -> RotationTranslationRotation:
        """Return the distribution of the step between two odometry poses (2, 3)."""
        rotation_1, translation, rotation_2 = rotations_and_translation(odometry, SHORTEST_TRANSLATION)
        square_1, square_2, square = from_line(rotation_1) ** 2, from_line(rotation_2) ** 2, translation**2
        return RotationTranslationRotation(
            rotation_1,
            translation,
            rotation_2,
            self._deviation(self.alpha1 * square_1 + self.alpha2 * square),
            self._deviation(self.alpha3 * square + self.alpha4 * (square_1 + square_2)),
            self._deviation(self.alpha1 * square_2 + self.alpha2 * square),
        )

    def _deviation(self, variance: float) -> float:
        return variance if self.variance_as_deviation else math.sqrt(variance)
