"""Systematic errors of odometry, by generalised least squares over windows."""

from __future__ import annotations

import numpy as np

from beamfield.geometry import FloatArray

# Standard deviation of a scale, of the drift in rad/m and of the yaw in rad before anything is known: they keep what
# a drive does not show, such as the scale of turns where nothing turns, at 0.
PRIOR = 0.3


def systematic_errors(
    residuals: FloatArray, design: FloatArray, covariance: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the errors (4,) in the order of `SYSTEMATIC`, and what share of their prior spread is left (4,).

    Residuals (w, 3) have the covariance (w, 3, 3); the design (w, 3, 4) is that of `OdometryWindows.design`.
    """
    weighted = np.linalg.solve(covariance, design)
    information = np.sum(np.swapaxes(design, 1, 2) @ weighted, axis=0)
    pull = np.sum(np.swapaxes(weighted, 1, 2) @ residuals[:, :, None], axis=0)[:, 0]
    posterior = np.linalg.inv(information + np.eye(len(pull)) / PRIOR**2)
    return posterior @ pull, np.sqrt(np.diag(posterior)) / PRIOR
