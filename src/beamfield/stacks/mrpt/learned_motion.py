"""Calibrated odometry as the parameters of MRPT's motion models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beamfield.calibration.odometry.noise_family import NoiseFamily
from beamfield.calibration.odometry.result import OdometryCalibration
from beamfield.geometry import FloatArray
from beamfield.stacks.mrpt.motion import NAMES, MrptMotion


def scaled_values(kind: str, result: OdometryCalibration) -> dict[str, float]:
    """Return the parameters of mmGaussian or mmThrun: its defaults, all times one factor."""
    default, names = MrptMotion(kind), NAMES[kind]

    def scaled(variance: FloatArray) -> MrptMotion:
        factor = float(np.sqrt(variance[0]))
        return replace(default, **{name: factor * getattr(default, name) for name in names})

    # All standard deviations are linear in the parameters, so the level is the square of the factor.
    model = result.fit(NoiseFamily("one factor", (default,), scaled))
    return {name: float(f"{getattr(model, name):.3g}") for name in names}
