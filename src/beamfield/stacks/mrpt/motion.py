"""MRPT's motion models of CActionRobotMovement2D, with its names and defaults."""

# ruff: noqa: N815  (the names are MRPT's)
from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.models.motion import OdometryMotion, check_not_negative, odometry_step
from beamfield.models.motion_steps import GaussianStep, RotationTranslationRotation, rotations_and_translation


@dataclass(frozen=True)
class MrptGaussianMotion(OdometryMotion):
    """MRPT's gaussianModel, its default.

    The standard deviation is minStdXY + a1 d + a2 |phi| of the position, and minStdPHI + a3 d + a4 |phi| of the
    heading, for a distance d and a turn phi; the noise enters half-way through the turn.

    Parameters
    ----------
    a1, a2
        Noise of the position per metre and per radian, metres.
    a3, a4
        Noise of the heading per metre and per radian, radians.
    minStdXY, minStdPHI
        Noise of every step, metres and radians.

    Raises
    ------
    InvalidInputError
        If a number is negative or not finite.

    References
    ----------
    MRPT, CActionRobotMovement2D::computeFromOdometry_modelGaussian.

    Examples
    --------
    >>> step = MrptGaussianMotion().step(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    >>> step.deviations.round(4).tolist()
    [0.02, 0.02, 0.0209]
    """

    a1: float = 0.01
    a2: float = math.degrees(0.001)
    a3: float = math.radians(1.0)
    a4: float = 0.05
    minStdXY: float = 0.01
    minStdPHI: float = math.radians(0.2)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_not_negative(self, "a1", "a2", "a3", "a4", "minStdXY", "minStdPHI")

    def step(self, odometry: FloatArray) -> GaussianStep:
        """Return the distribution of the step between two odometry poses (2, 3)."""
        mean = odometry_step(odometry)
        ahead, left, turn = mean.tolist()
        distance, angle = math.hypot(ahead, left), abs(turn)
        position = self.minStdXY + self.a1 * distance + self.a2 * angle
        heading = self.minStdPHI + self.a3 * distance + self.a4 * angle
        cos, sin = math.cos(0.5 * turn), math.sin(0.5 * turn)
        transform = np.array(
            [[cos, -sin, -sin * ahead - cos * left], [sin, cos, cos * ahead - sin * left], [0.0, 0.0, 1.0]]
        )
        return GaussianStep(mean, transform, np.array([position, position, heading]))


@dataclass(frozen=True)
class MrptThrunMotion(OdometryMotion):
    """MRPT's thrunModel: rotation, translation, rotation, and a little noise of the pose.

    The standard deviations are alfa1 |r1| + alfa2 d, alfa3 d + alfa4 (|r1| + |r2|) and alfa1 |r2| + alfa2 d: sums where
    others add squares, and driving backwards is as noisy as a half turn.

    Parameters
    ----------
    alfa1_rot_rot, alfa2_rot_trans, alfa3_trans_trans, alfa4_trans_rot
        As above.
    additional_std_XY, additional_std_phi
        Noise of every step, metres and radians.

    Raises
    ------
    InvalidInputError
        If a number is negative or not finite.

    References
    ----------
    MRPT, CActionRobotMovement2D::computeFromOdometry_modelThrun.

    Examples
    --------
    >>> step = MrptThrunMotion(alfa3_trans_trans=0.1).step(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    >>> round(step.deviation_translation, 12)
    0.1
    """

    alfa1_rot_rot: float = 0.05
    alfa2_rot_trans: float = math.radians(4.0)
    alfa3_trans_trans: float = 0.01
    alfa4_trans_rot: float = math.degrees(0.0001)
    additional_std_XY: float = 0.001
    additional_std_phi: float = math.radians(0.05)

    def __post_init__(self) -> None:
        super().__post_init__()
        check_not_negative(
            self, "alfa1_rot_rot", "alfa2_rot_trans", "alfa3_trans_trans", "alfa4_trans_rot", "additional_std_XY",
            "additional_std_phi",
        )  # fmt: skip

    def step(self, odometry: FloatArray) -> RotationTranslationRotation:
        """Return the distribution of the step between two odometry poses (2, 3)."""
        rotation_1, translation, rotation_2 = rotations_and_translation(odometry, 0.0)
        if translation == 0.0:  # where atan2(0, 0) is an angle of its own
            rotation_1, rotation_2 = 0.0, rotation_2 + rotation_1
        size_1, size_2 = abs(rotation_1), abs(rotation_2)
        return RotationTranslationRotation(
            rotation_1,
            translation,
            rotation_2,
            self.alfa1_rot_rot * size_1 + self.alfa2_rot_trans * translation,
            self.alfa3_trans_trans * translation + self.alfa4_trans_rot * (size_1 + size_2),
            self.alfa1_rot_rot * size_2 + self.alfa2_rot_trans * translation,
            self.additional_std_XY,
            self.additional_std_phi,
        )
