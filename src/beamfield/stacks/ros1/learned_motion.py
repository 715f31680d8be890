"""Calibrated odometry as the parameters of ROS 1's motion models."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from beamfield.calibration.odometry.noise_family import NoiseFamily
from beamfield.calibration.odometry.result import OdometryCalibration
from beamfield.geometry import FloatArray
from beamfield.models.differential_motion import DifferentialMotion
from beamfield.models.omni_motion import OmniMotion
from beamfield.stacks.amcl.learned_motion import named_alphas


def _literal_differential(variance: FloatArray) -> DifferentialMotion:
    alpha = float(np.sqrt(variance[0]))
    return DifferentialMotion(alpha, alpha, alpha, alpha, variance_as_deviation=True)


def _literal_omni(variance: FloatArray) -> OmniMotion:
    alpha = float(np.sqrt(variance[0]))
    return OmniMotion(alpha, alpha, alpha, alpha, alpha, variance_as_deviation=True)


Alphas = Callable[[OdometryCalibration], dict[str, float]]
# "diff" and "omni" take variances for standard deviations: the level is the square of the alpha.
DIFF = NoiseFamily("diff, one alpha", (_literal_differential(np.ones(1)),), _literal_differential)
OMNI = NoiseFamily("omni, one alpha", (_literal_omni(np.ones(1)),), _literal_omni)


def corrected(alphas: Alphas, result: OdometryCalibration) -> dict[str, float]:
    """Return odom_alpha1 to 4 of "diff-corrected" or to 5 of "omni-corrected": nav2's alphas."""
    return {f"odom_{name}": value for name, value in alphas(result).items()}


def literal(family: NoiseFamily, n: int, result: OdometryCalibration) -> dict[str, float]:
    """Return odom_alpha1 to n of "diff" or "omni", one level for all, with the noise of other alphas."""
    model = result.fit(family)
    assert isinstance(model, DifferentialMotion | OmniMotion)
    return named_alphas([model.alpha1] * n, "odom_alpha")
