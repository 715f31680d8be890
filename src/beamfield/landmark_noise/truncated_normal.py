"""The normal distribution cut to a window: its mass, and its maximum-likelihood fit by Newton steps."""

from __future__ import annotations

import numpy as np
from scipy.special import log_ndtr, ndtr

from beamfield.geometry import FloatArray

# Beyond this many half windows the cut normal is flat, and its deviation means nothing.
WIDEST = 20.0
_MOST_STEPS = 100
# From so many deviations beyond the window on, its share is computed by logarithms, which take longer.
_FAR = 5.0
_LOG_2PI = float(np.log(2.0 * np.pi))


def log_window_mass(mean: FloatArray | float, sigma: float, half_window: float) -> FloatArray:
    """Return the log of the share of N(mean, sigma) that lies in [-half_window, half_window].

    Parameters
    ----------
    mean
        (...) means.
    sigma, half_window
        Positive numbers, in the same unit.

    Returns
    -------
    (...) nats, at most 0; exact far outside of the window too.
    """
    # Below the window by symmetry, where the tails are small numbers and nothing cancels.
    centre = -np.abs(np.asarray(mean, dtype=np.float64))
    low, high = (-half_window - centre) / sigma, (half_window - centre) / sigma
    if np.size(low) and np.max(low) > _FAR:
        log_tail = log_ndtr(-low)
        return np.asarray(log_tail + np.log1p(-np.exp(log_ndtr(-high) - log_tail)))
    return np.asarray(np.log(ndtr(-low) - ndtr(-high)))


def fit_window_normal(
    values: FloatArray,
    squares: FloatArray,
    design: FloatArray,
    weights: FloatArray,
    half_window: float,
    start: tuple[FloatArray, float],
) -> tuple[FloatArray, float]:
    """Return the coefficients b and sigma that maximise sum_i w_i log N_cut(y_i; x_i' b, sigma).

    The normal is cut to [-half_window, half_window].

    The cut normal is an exponential family in (b / sigma^2, 1 / sigma^2), where its log-likelihood is concave: Newton
    steps with halving climb it from any start.

    Parameters
    ----------
    values, squares
        (n,) means of y and of y^2 of the data that share a row of the design.
    design
        (n, p) regressors x; p = 0 for a mean of zero.
    weights
        (n,) weight of each row.
    half_window
        Half the width of the window.
    start
        Coefficients (p,) and sigma to begin with; what is returned is never less likely.

    Returns
    -------
    Coefficients (p,) and sigma.

    Notes
    -----
    Where the data fill the window evenly sigma would be infinite; it stops at 20 half windows.
    """
    c = half_window
    y, y2, x = values / c, squares / (c * c), design
    w = weights / weights.sum()
    least = 1.0 / WIDEST**2
    precision = max(1.0 / (start[1] / c) ** 2, least)
    first = np.append(start[0] / c * precision, precision)
    theta = first
    if np.abs(design @ start[0]).max() > c:
        # Means far outside the window leave moments that are nothing but rounding.
        theta = np.append(np.zeros(design.shape[1]), 1.0)
    value = _objective(theta, y, y2, x, w)
    for _ in range(_MOST_STEPS):
        gradient, curvature = _derivatives(theta, y, y2, x, w)
        at_bound = theta[-1] <= least and gradient[-1] < 0.0
        step = _newton_step(gradient, curvature, hold_last=at_bound)
        promise = float(gradient @ step)
        if not promise > 1e-15:
            break
        size, moved = 1.0, False
        while size > 1e-10:
            trial = theta + size * step
            trial[-1] = max(trial[-1], least)
            reached = _objective(trial, y, y2, x, w)
            if reached > value:
                theta, value, moved = trial, reached, True
                break
            size *= 0.5
        if not moved:
            break
    if value < _objective(first, y, y2, x, w):
        theta = first
    return theta[:-1] / theta[-1] * c, float(c / np.sqrt(theta[-1]))


def _objective(theta: FloatArray, y: FloatArray, y2: FloatArray, x: FloatArray, w: FloatArray) -> float:
    precision = theta[-1]
    mean = x @ (theta[:-1] / precision)
    sigma = 1.0 / np.sqrt(precision)
    log_density = -0.5 * (y2 - 2.0 * y * mean + mean * mean) * precision - np.log(sigma) - 0.5 * _LOG_2PI
    return float((w * (log_density - log_window_mass(mean, sigma, 1.0))).sum())


def _derivatives(
    theta: FloatArray, y: FloatArray, y2: FloatArray, x: FloatArray, w: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return gradient, and the negative of the Hessian: the covariance of the sufficient statistics (y x, -y^2 / 2)."""
    precision = theta[-1]
    mean, sigma = x @ (theta[:-1] / precision), 1.0 / np.sqrt(precision)
    m1, m2, m3, m4 = _moments(mean, float(sigma))
    gradient = np.append(x.T @ (w * (y - m1)), float((w * (m2 - y2)).sum()) / 2.0)
    p = x.shape[1]
    curvature = np.empty((p + 1, p + 1))
    curvature[:p, :p] = (x * (w * (m2 - m1 * m1))[:, None]).T @ x
    curvature[:p, p] = curvature[p, :p] = -0.5 * (x.T @ (w * (m3 - m1 * m2)))
    curvature[p, p] = 0.25 * float((w * (m4 - m2 * m2)).sum())
    return gradient, curvature


def _moments(mean: FloatArray, sigma: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return E[y], ..., E[y^4] of normals cut to [-1, 1]."""
    a, b = (-1.0 - mean) / sigma, (1.0 - mean) / sigma
    log_mass = log_window_mass(mean, sigma, 1.0)
    at_a = np.exp(-0.5 * (a * a + _LOG_2PI) - log_mass)
    at_b = np.exp(-0.5 * (b * b + _LOG_2PI) - log_mass)
    t1 = at_a - at_b
    t2 = 1.0 + a * at_a - b * at_b
    t3 = 2.0 * t1 + a * a * at_a - b * b * at_b
    t4 = 3.0 * t2 + a**3 * at_a - b**3 * at_b
    s = sigma
    return (
        mean + s * t1,
        mean**2 + 2.0 * mean * s * t1 + s**2 * t2,
        mean**3 + 3.0 * mean**2 * s * t1 + 3.0 * mean * s**2 * t2 + s**3 * t3,
        mean**4 + 4.0 * mean**3 * s * t1 + 6.0 * mean**2 * s**2 * t2 + 4.0 * mean * s**3 * t3 + s**4 * t4,
    )


def _newton_step(gradient: FloatArray, curvature: FloatArray, *, hold_last: bool) -> FloatArray:
    free = len(gradient) - hold_last
    step = np.zeros_like(gradient)
    if free:
        inner = curvature[:free, :free]
        # A ridge of rounding's size keeps two rows that say the same (all landmarks at one distance) solvable.
        ridge = 1e-13 * max(float(np.trace(inner)) / free, 1e-300)
        step[:free] = np.linalg.solve(inner + ridge * np.eye(free), gradient[:free])
    return step
