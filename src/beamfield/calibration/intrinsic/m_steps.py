"""The M-step: exact maximisers of the expected log-likelihood (6.26) of the model that is fitted.

Where (6.30) and (6.31) maximise it for untruncated densities, these do for a hit cut to [0, z_max] and a short cut to
[0, z*]; the weights are (6.29).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.intrinsic.bounded_newton import newton_step
from beamfield.calibration.intrinsic.learning_problem import LearningProblem
from beamfield.calibration.intrinsic.likelihood import OFFSET, RATE, VARIANCE, ExpectedStatistics
from beamfield.geometry import FloatArray
from beamfield.kernels import m_step as kernels

_MOST_STEPS = 50
# A Newton step squares the error: one that promises no more nats per hit, or moves lambda by no more of itself, is the
# last.
_LAST_GAIN, _LAST_STEP = 1e-9, 1e-7
_SHAPE = slice(VARIANCE, OFFSET + 1)
# A cause with fewer expected beams than this is dying: its shape stays what it was.
_LEAST_COUNT = 1e-12
# Where `hit_objective` has the second derivatives.
_SECOND = np.array([[4, 5, 7], [5, 6, 8], [7, 8, 9]])


def m_step(statistics: ExpectedStatistics, theta: FloatArray, problem: LearningProblem) -> FloatArray:
    """Return the parameters (8,) that maximise the expected log-likelihood plus log prior.

    The statistics are of the E-step at the working vector theta (8,). What is held stays, and so do shapes of causes
    that explain no beam.

    References
    ----------
    Probabilistic Robotics, section 6.3.3: (6.26) and (6.29) to (6.31).
    """
    new = theta.copy()
    new[:4] = _weights(statistics.counts + problem.priors.counts, theta, problem)
    if problem.free[_SHAPE].any() and statistics.counts[0] > _LEAST_COUNT:
        new[_SHAPE] = _hit_shape(statistics, theta, problem)
    if problem.free[RATE] and (statistics.counts[1] > _LEAST_COUNT or problem.priors.short_beams > 0.0):
        new[RATE] = _rate(statistics, theta, problem)
    return new


def _weights(counts: FloatArray, theta: FloatArray, problem: LearningProblem) -> FloatArray:
    """(6.29), the free weights sharing what the held ones leave."""
    free = problem.free[:4]
    total = counts[free].sum()
    if total <= 0.0:
        return theta[:4]
    return np.where(free, counts * ((1.0 - theta[:4][~free].sum()) / total), theta[:4])


def _hit_shape(statistics: ExpectedStatistics, theta: FloatArray, problem: LearningProblem) -> FloatArray:
    """Variance, slope and offset of the hits: closed form (6.30) where nothing is cut, else Newton on the 3 of them."""
    x, free, lower, upper = theta[_SHAPE], problem.free[_SHAPE], problem.lower[_SHAPE], problem.upper[_SHAPE]
    if x[1] == 0.0 and not free[1]:
        # Newton may begin there too: cut or not, the objective is concave in 1 / v and b / v, and has one maximum.
        x = _uncut_shape(statistics, x, free, lower, upper, problem)
        if not statistics.cut_matters:
            return x
    y, low, high = _in_log_variance(x), _in_log_variance(lower), _in_log_variance(upper)
    y = np.minimum(np.maximum(y, low), high)
    value, gradient, hessian = _hit_objective(y, statistics, theta, problem)
    nothing = np.zeros(3, dtype=bool)
    for _ in range(_MOST_STEPS):
        step = newton_step(y, gradient, hessian, free=free, lower=low, upper=high, summed=nothing)
        step *= min(1.0, 2.0 / max(abs(step[0]), 1e-300))
        if gradient @ step <= _LAST_GAIN * (statistics.counts[0] + problem.priors.sigma_beams):
            y += step
            break
        for _ in range(30):
            trial = y + step
            new_value, new_gradient, new_hessian = _hit_objective(trial, statistics, theta, problem)
            if new_value > value:
                break
            step *= 0.5
        else:
            break
        y, value, gradient, hessian = trial, new_value, new_gradient, new_hessian
    y[0] = math.exp(y[0])
    return np.where(free, np.minimum(np.maximum(y, lower), upper), x)


def _uncut_shape(
    statistics: ExpectedStatistics, x: FloatArray, free: NDArray[np.bool_], lower: FloatArray, upper: FloatArray,
    problem: LearningProblem,
) -> FloatArray:  # fmt: skip
    count, sum_r, sum_r2 = statistics.node_hit.sum(axis=1)
    offset = min(max(sum_r / count, lower[2]), upper[2]) if free[2] else x[2]
    square = max(sum_r2 - 2.0 * offset * sum_r + offset * offset * count, 0.0)
    imagined = problem.priors.sigma_beams
    variance = (square + imagined * problem.priors.sigma_hit**2) / (count + imagined) if free[0] else x[0]
    return np.array([min(max(variance, lower[0]), upper[0]), x[1], offset])


def _in_log_variance(x: FloatArray) -> FloatArray:
    """Variance, slope and offset with the variance's logarithm: however far the start, the objective is rounder."""
    return np.array([math.log(x[0]), x[1], x[2]])


def _hit_objective(
    y: FloatArray, statistics: ExpectedStatistics, theta: FloatArray, problem: LearningProblem
) -> tuple[float, FloatArray, FloatArray]:
    """Return what `_hit_shape` maximises, with its derivatives in log variance, slope and offset."""
    v, out = math.exp(y[0]), np.empty(10)
    kernels.hit_objective(
        statistics.node_ranges, statistics.node_hit, problem.span, problem.min_range, v, y[1], y[2], out
    )
    value, gradient, hessian = float(out[0]), out[1:4], out[_SECOND]
    if problem.priors.sigma_beams > 0.0:
        prior = theta.copy()
        prior[VARIANCE] = v
        prior_value, prior_gradient, prior_hessian = problem.priors.log_density(prior)
        value += prior_value
        gradient[0] += prior_gradient[VARIANCE]
        hessian[0, 0] += prior_hessian[VARIANCE, VARIANCE]
    gradient[0] *= v
    hessian[0, :] *= v
    hessian[:, 0] *= v
    hessian[0, 0] += gradient[0]
    return value, gradient, hessian


def _rate(statistics: ExpectedStatistics, theta: FloatArray, problem: LearningProblem) -> float:
    """Maximiser in lambda of a concave function: 0 if it falls from there, else Newton between brackets."""
    imagined = problem.priors.short_beams
    floor, ceiling = 0.0, float(problem.upper[RATE])

    def slopes(rate: float) -> tuple[float, float]:
        first, second = kernels.short_slopes(
            statistics.node_ranges, statistics.node_short, statistics.sum_short_range, rate
        )
        if imagined > 0.0:
            first += imagined * (1.0 / rate - problem.priors.mean_short)
            second -= imagined / rate**2
        return first, second

    rate = min(max(float(theta[RATE]), 1e-6 * ceiling), ceiling)
    first, second = slopes(rate)
    if first <= 0.0 and imagined == 0.0 and slopes(0.0)[0] <= 0.0:
        return 0.0
    if first >= 0.0 and slopes(ceiling)[0] >= 0.0:
        return ceiling
    for _ in range(200):
        if first > 0.0:
            floor = rate
        else:
            ceiling = rate
        step = -first / second if second < 0.0 else np.inf
        new = rate + step
        if not floor <= new <= ceiling:
            new = 0.5 * (floor + ceiling)
        elif abs(step) <= _LAST_STEP * rate:
            return float(new)
        if ceiling - floor <= 1e-13 * ceiling:
            return float(new)
        rate = float(new)
        first, second = slopes(rate)
    return rate
