"""MRPT's motion models of CActionRobotMovement2D, with the names, units and defaults of its files."""

# ruff: noqa: N815  (the names are MRPT's)
from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from beamfield.geometry import FloatArray, wrapped
from beamfield.models.motion import OdometryMotion, check_not_negative, odometry_step
from beamfield.models.motion_steps import GaussianStep, RotationTranslationRotation, rotations_and_translation
from beamfield.stacks.emulation.parameter_checks import check_choice

GAUSSIAN, THRUN = "mmGaussian", "mmThrun"
# The parameters of each.
NAMES = {
    GAUSSIAN: ("a1", "a2", "a3", "a4", "minStdXY", "minStdPHI"),
    THRUN: ("alfa1_rot_rot", "alfa2_rot_trans", "alfa3_trans_trans", "alfa4_trans_rot", "additional_std_XY",
            "additional_std_phi"),
}  # fmt: skip


@dataclass(frozen=True)
class MrptMotion(OdometryMotion):
    """What stands under ``motion_model_2d`` in a file of mrpt_pf_localization.

    For a step of d metres, an angle turned of phi, and angles r1 and r2 of the rotations before and after it, none of
    them negative, standard deviations are

    - of mmGaussian minStdXY + a1 d + a2 phi for the position, and minStdPHI + a3 d + a4 phi for the heading; the noise
      enters half-way through the turn;
    - of mmThrun alfa1 r1 + alfa2 d, alfa3 d + alfa4 (r1 + r2) and alfa1 r2 + alfa2 d for rotation, translation and
      rotation, and a little more of the pose. Driving backwards is as noisy as a half turn.

    Both are sums where others add squares.

    Parameters
    ----------
    modelSelection
        "mmGaussian" or "mmThrun".
    a1, a2
        Noise of the position per metre and per radian, metres.
    a3, a4
        Noise of the heading per metre, degrees, and per radian, radians.
    minStdXY, minStdPHI
        Noise of every step, metres and degrees.
    alfa1_rot_rot, alfa2_rot_trans, alfa3_trans_trans, alfa4_trans_rot
        As above; radians and metres.
    additional_std_XY, additional_std_phi
        Noise of every step, metres and degrees.

    Raises
    ------
    InvalidInputError
        If the model is another, or a number is negative or not finite.

    References
    ----------
    MRPT, CActionRobotMovement2D.cpp: computeFromOdometry_modelGaussian, computeFromOdometry_modelThrun.

    Examples
    --------
    >>> step = MrptMotion().step(np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    >>> step.deviations.round(4).tolist()
    [0.02, 0.02, 0.0209]
    """

    modelSelection: str = GAUSSIAN
    a1: float = 0.01
    a2: float = math.degrees(0.001)
    a3: float = field(default=1.0, metadata={"unit": "deg"})
    a4: float = 0.05
    minStdXY: float = 0.01
    minStdPHI: float = field(default=0.2, metadata={"unit": "deg"})
    alfa1_rot_rot: float = 0.05
    alfa2_rot_trans: float = math.radians(4.0)
    alfa3_trans_trans: float = 0.01
    alfa4_trans_rot: float = math.degrees(0.0001)
    additional_std_XY: float = 0.001
    additional_std_phi: float = field(default=0.05, metadata={"unit": "deg"})

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice(self, "modelSelection", (GAUSSIAN, THRUN))
        check_not_negative(self, *NAMES[GAUSSIAN], *NAMES[THRUN])

    def step(self, odometry: FloatArray) -> GaussianStep | RotationTranslationRotation:
        """Return the distribution of the step between two odometry poses (2, 3)."""
        return self._gaussian(odometry) if self.modelSelection == GAUSSIAN else self._rotations(odometry)

    def _gaussian(self, odometry: FloatArray) -> GaussianStep:
        mean = odometry_step(odometry)
        ahead, left, turn = mean.tolist()
        distance, angle = math.hypot(ahead, left), abs(turn)
        position = self.minStdXY + self.a1 * distance + self.a2 * angle
        heading = math.radians(self.minStdPHI + self.a3 * distance) + self.a4 * angle
        cos, sin = math.cos(0.5 * turn), math.sin(0.5 * turn)
        transform = np.array(
            [[cos, -sin, -sin * ahead - cos * left], [sin, cos, cos * ahead - sin * left], [0.0, 0.0, 1.0]]
        )
        return GaussianStep(mean, transform, np.array([position, position, heading]))

    def _rotations(self, odometry: FloatArray) -> RotationTranslationRotation:
        rotation_1, translation, rotation_2 = rotations_and_translation(odometry, 0.0)
        if translation == 0.0:  # where atan2(0, 0) is an angle of its own
            rotation_1, rotation_2 = 0.0, wrapped(rotation_2 + rotation_1)
        size_1, size_2 = abs(rotation_1), abs(rotation_2)
        return RotationTranslationRotation(
            rotation_1,
            translation,
            rotation_2,
            self.alfa1_rot_rot * size_1 + self.alfa2_rot_trans * translation,
            self.alfa3_trans_trans * translation + self.alfa4_trans_rot * (size_1 + size_2),
            self.alfa1_rot_rot * size_2 + self.alfa2_rot_trans * translation,
            self.additional_std_XY,
            math.radians(self.additional_std_phi),
        )
