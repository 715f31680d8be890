"""The covariance of learned parameters from the curvature of the likelihood at its maximum."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.intrinsic.learning_problem import LearningProblem
from beamfield.calibration.intrinsic.likelihood import N_PARAMETERS, IntrinsicLikelihood
from beamfield.geometry import FloatArray

# Directions flatter than this, relative to the steepest after scaling, get the variance that this curvature gives.
_LEAST_CURVATURE = 1e-12
# Parameters of which the data say less than this (a variance of 1e20) count as unknown to that degree.
_LEAST_INFORMATION = 1e-20


def naive_covariance(likelihood: IntrinsicLikelihood, problem: LearningProblem, theta: FloatArray) -> FloatArray:
    """Return the inverse of the observed information (8, 8) at the maximum theta (8,), as if beams were independent.

    Real beams depend on their neighbours: standard errors from this are 4 to 24 times too small; it serves to compare
    directions, not to report. 0 for what is held or sits on a bound.
    """
    _, _, hessian = likelihood.derivatives(theta)
    hessian = hessian + problem.priors.log_density(theta)[2]
    inside = problem.free & (theta > problem.lower) & (theta < problem.upper)
    basis = free_directions(inside, theta)
    root = basis @ inverse_root(-basis.T @ hessian @ basis)
    return np.asarray(root @ root.T)


def inverse_root(information: FloatArray) -> FloatArray:
    """Return R with R R' the inverse of an information matrix, flat and falling directions taken as nearly flat.

    The matrix (m, m) is symmetric, the negative of a Hessian at a maximum; R' information R is the unit matrix.
    """
    scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(information)), _LEAST_INFORMATION))
    curvature, directions = np.linalg.eigh(information * np.outer(scale, scale))
    return np.asarray(scale[:, None] * directions / np.sqrt(np.maximum(curvature, _LEAST_CURVATURE)))


def free_directions(moving: NDArray[np.bool_], theta: FloatArray) -> FloatArray:
    """Return the directions in which the maximum may move, (8, m): a column per entry that moves on its own, in order.

    The largest moving weight of the working vector theta (8,) gives or takes what the others change.
    """
    weights = [i for i in range(4) if moving[i]]
    pivot = max(weights, key=lambda i: float(theta[i]), default=-1)
    columns = []
    for i in np.flatnonzero(moving):
        if i == pivot:
            continue
        column = np.zeros(N_PARAMETERS)
        column[i] = 1.0
        if i < 4:
            column[pivot] = -1.0
        columns.append(column)
    return np.stack(columns, axis=1) if columns else np.zeros((N_PARAMETERS, 0))
