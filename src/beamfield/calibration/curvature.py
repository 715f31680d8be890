"""Covariances of learned parameters from the curvature of the likelihood at its maximum."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.intrinsic_likelihood import N_PARAMETERS, IntrinsicLikelihood
from beamfield.calibration.learning_problem import LearningProblem
from beamfield.geometry import FloatArray

# Directions flatter than this, relative to the steepest after scaling, get the variance that this curvature gives.
_LEAST_CURVATURE = 1e-12
# Parameters of which the data say less than this (a variance of 1e20) count as unknown to that degree.
_LEAST_INFORMATION = 1e-20


def naive_covariance(likelihood: IntrinsicLikelihood, problem: LearningProblem, theta: FloatArray) -> FloatArray:
    """Return the inverse of the observed information, as if beams were independent.

    Real beams depend on their neighbours: standard errors from this are 4 to 24 times too small; it serves to compare
    directions, not to report.

    Parameters
    ----------
    likelihood, problem
        The beams, and what is free.
    theta
        (8,) working vector at the maximum.

    Returns
    -------
    (8, 8) covariance of the working vector; 0 for what is held or sits on a bound.
    """
    basis, inverse = _inverse_information(likelihood, problem, theta)
    return np.asarray(basis @ inverse @ basis.T)


def clustered_covariance(
    likelihood: IntrinsicLikelihood, problem: LearningProblem, theta: FloatArray, groups: NDArray[np.int64]
) -> FloatArray:
    """Return the sandwich covariance for beams that depend on each other within groups.

    Parameters
    ----------
    likelihood, problem, theta
        As for `naive_covariance`.
    groups
        (n,) number of each beam's group, from 0 on, in the caller's order of beams.

    Returns
    -------
    (8, 8) covariance of the working vector; 0 for what is held or sits on a bound.

    References
    ----------
    Liang and Zeger, "Longitudinal data analysis using generalized linear models", Biometrika 73, 1986.
    """
    basis, inverse = _inverse_information(likelihood, problem, theta)
    scores = likelihood.scores(theta) @ basis
    n_groups = int(groups.max()) + 1
    sums = np.stack([np.bincount(groups, weights=column, minlength=n_groups) for column in scores.T], axis=1)
    spread = sums.T @ sums * (n_groups / max(n_groups - 1.0, 1.0))
    return np.asarray(basis @ inverse @ spread @ inverse @ basis.T)


def _inverse_information(
    likelihood: IntrinsicLikelihood, problem: LearningProblem, theta: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Directions in which the maximum may move, as columns, and the inverse information along them."""
    _, _, hessian = likelihood.derivatives(theta)
    hessian = hessian + problem.priors.log_density(theta)[2]
    basis = _free_directions(problem, theta)
    information = -basis.T @ hessian @ basis
    if not information.size:
        return basis, information
    scale = 1.0 / np.sqrt(np.maximum(np.abs(np.diag(information)), _LEAST_INFORMATION))
    curvature, directions = np.linalg.eigh(information * np.outer(scale, scale))
    curvature = np.maximum(curvature, _LEAST_CURVATURE)
    inverse = (directions / curvature) @ directions.T * np.outer(scale, scale)
    return basis, inverse


def _free_directions(problem: LearningProblem, theta: FloatArray) -> FloatArray:
    inside = problem.free & (theta > problem.lower) & (theta < problem.upper)
    weights = [i for i in range(4) if inside[i]]
    pivot = max(weights, key=lambda i: float(theta[i]), default=-1)
    columns = []
    for i in np.flatnonzero(inside):
        if i == pivot:
            continue
        column = np.zeros(N_PARAMETERS)
        column[i] = 1.0
        if i < 4:
            column[pivot] = -1.0
        columns.append(column)
    return np.stack(columns, axis=1) if columns else np.zeros((N_PARAMETERS, 0))
