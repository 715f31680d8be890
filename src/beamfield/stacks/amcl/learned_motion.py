"""Calibrated odometry as the alphas of AMCL's motion models, which nav2, ROS 1 and Beluga share."""

from __future__ import annotations

from collections.abc import Sequence

from beamfield.calibration.odometry.noise_family import OMNI
from beamfield.calibration.odometry.result import OdometryCalibration
from beamfield.models.omni_motion import OmniMotion


def differential_alphas(result: OdometryCalibration) -> dict[str, float]:
    """Return alpha1 to alpha4 of the differential model."""
    alphas = result.alphas
    return named_alphas([alphas.alpha1, alphas.alpha2, alphas.alpha3, alphas.alpha4])


def omni_alphas(result: OdometryCalibration) -> dict[str, float]:
    """Return alpha1 to alpha5 of the omni model: one level for all."""
    model = result.fit(OMNI)
    assert isinstance(model, OmniMotion)
    return named_alphas([model.alpha1, model.alpha2, model.alpha3, model.alpha4, model.alpha5])


def named_alphas(values: Sequence[float], name: str = "alpha") -> dict[str, float]:
    """Return values as alpha1, alpha2 ...: in three digits, more than they are known to."""
    return {f"{name}{i}": float(f"{value:.3g}") for i, value in enumerate(values, start=1)}
