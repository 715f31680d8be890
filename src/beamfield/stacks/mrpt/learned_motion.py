"""Calibrated odometry as the parameters of MRPT's motion models."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import TypeVar

import numpy as np

from beamfield.calibration.odometry.noise_family import NoiseFamily
from beamfield.calibration.odometry.result import OdometryCalibration
from beamfield.geometry import FloatArray
from beamfield.stacks.mrpt.motion import MrptGaussianMotion, MrptThrunMotion

M = TypeVar("M", MrptGaussianMotion, MrptThrunMotion)


def gaussian_values(result: OdometryCalibration) -> dict[str, float]:
    """Return the parameters of gaussianModel: its defaults, all times one factor."""
    return _scaled_values(result, MrptGaussianMotion())


def thrun_values(result: OdometryCalibration) -> dict[str, float]:
    """Return the parameters of thrunModel: its defaults, all times one factor."""
    return _scaled_values(result, MrptThrunMotion())


def _scaled_values(result: OdometryCalibration, default: M) -> dict[str, float]:
    names = [item.name for item in fields(default)]

    def scaled(variance: FloatArray) -> M:
        factor = float(np.sqrt(variance[0]))
        return replace(default, **{name: factor * getattr(default, name) for name in names})

    # All standard deviations are linear in the parameters, so the level is the square of the factor.
    model = result.fit(NoiseFamily("one factor", (default,), scaled))
    return {name: float(f"{getattr(model, name):.3g}") for name in names}
