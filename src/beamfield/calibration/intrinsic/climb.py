"""Climb from one start to a maximum of the likelihood, never falling."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from beamfield.calibration.intrinsic.bounded_newton import newton_step
from beamfield.calibration.intrinsic.learning_problem import LearningProblem
from beamfield.calibration.intrinsic.likelihood import (
    N_PARAMETERS,
    SLOPE,
    VARIANCE,
    W_HIT,
    W_MAX,
    W_RAND,
    W_SHORT,
    ExpectedStatistics,
    LikelihoodPasses,
)
from beamfield.calibration.intrinsic.m_steps import m_step
from beamfield.geometry import FloatArray

# EM leads into the basin of a maximum, Newton finishes there. After a rejected Newton step EM walks on. With 5, 6, 8 or
# 16 steps first, 7 to 9 of 250 hard sets miss their best maximum; with 4, they miss it by more.
EM_STEPS_FIRST = 5
EM_STEPS_AFTER_REJECTION = 6
# A rounding error of a sum over beams, relative.
_ROUNDING = 1e-13
_WEIGHTS = np.arange(N_PARAMETERS) < 4


@dataclass(frozen=True)
class Climb:
    """Where a climb ended.

    Parameters
    ----------
    theta
        Working vector, shape (8,).
    objective
        Log-likelihood plus log prior, nats per beam.
    trace
        The objective at the start and after each iteration; it never falls.
    em_steps, newton_steps
        Iterations of each kind.
    converged
        Whether the gain that one more Newton step promises is below the tolerance.
    """

    theta: FloatArray
    objective: float
    trace: tuple[float, ...]
    em_steps: int
    newton_steps: int
    converged: bool


def climb(
    likelihood: LikelihoodPasses,
    problem: LearningProblem,
    start: FloatArray,
    *,
    tolerance: float,
    max_iterations: int,
    accelerate: bool = True,
    em_steps_first: int = EM_STEPS_FIRST,
    known: tuple[float, FloatArray, FloatArray] | None = None,
    report: Callable[[int], None] | None = None,
) -> Climb:
    """Alternate EM steps and, once they have found their basin, Newton steps on the observed likelihood.

    The start is made valid first. It has converged where one more step promises less than the tolerance, nats per beam;
    EM and Newton steps together are at most max_iterations. Newton steps follow the first em_steps_first of EM; without
    `accelerate` there are none. If log-likelihood, gradient and Hessian at the start are known already, that saves the
    first passes. The number of each iteration is reported.
    """
    climber = _Climber(likelihood, problem, problem.apply(start), known)
    em_left = em_steps_first
    converged = False
    for iteration in range(max_iterations):
        if report is not None:
            report(iteration)
        if accelerate and em_left <= 0:
            gain = climber.newton_step(tolerance)
            if gain is not None and gain < tolerance:
                converged = True
                break
            if gain is None:
                em_left = EM_STEPS_AFTER_REJECTION
            continue
        gain = climber.em_step()
        em_left -= 1
        # Without Newton's promise of the gain to come, ask for much less than the tolerance.
        if gain <= (1e-4 if accelerate else 1e-2) * tolerance:
            if accelerate and not climber.at_rest:
                em_left = 0
                continue
            converged = True
            break
    if converged:
        climber.settle(tolerance)
    return Climb(
        climber.theta, climber.trace[-1], tuple(climber.trace), climber.em_steps, climber.newton_steps, converged
    )


class _Climber:
    """The state of a climb: a point, its objective, and what passes at that point have found so far."""

    def __init__(
        self,
        likelihood: LikelihoodPasses,
        problem: LearningProblem,
        theta: FloatArray,
        known: tuple[float, FloatArray, FloatArray] | None,
    ) -> None:
        self.likelihood = likelihood
        self.problem = problem
        self.theta = theta
        self.statistics: ExpectedStatistics | None = None
        self.derivatives: tuple[float, FloatArray, FloatArray] | None = None
        prior_value, prior_gradient, prior_hessian = problem.priors.log_density(theta)
        if known is None:
            self.statistics = self._statistics(theta)
            self.objective = self.statistics.log_likelihood + prior_value
        else:
            value, gradient, hessian = known
            self.derivatives = value, gradient + prior_gradient, hessian + prior_hessian
            self.objective = value + prior_value
        self.trace = [self.objective / likelihood.n_beams]
        self.em_steps = 0
        self.newton_steps = 0
        self.at_rest = False

    def em_step(self) -> float:
        """Take one EM step; returns the gain in nats per beam, 0 if there is none to be had."""
        if self.statistics is None:
            self.statistics = self._statistics(self.theta)
        target = m_step(self.statistics, self.theta, self.problem)
        # An exact M-step cannot fall; interpolation and rounding can, then go only part of the way.
        for share in (1.0, 0.5, 0.1):
            theta = target if share == 1.0 else self.theta + share * (target - self.theta)
            statistics = self._statistics(theta)
            objective = statistics.log_likelihood + self.problem.priors.log_density(theta)[0]
            if objective >= self.objective:
                self.em_steps += 1
                return self._move(theta, objective, statistics=statistics)
        return 0.0

    def newton_step(self, tolerance: float) -> float | None:
        """Take one Newton step; returns the gain it promised in nats per beam, None if the likelihood rejected it."""
        if self.derivatives is None:
            self.derivatives = self._derivatives(self.theta)
        x, step, slope = self._newton_direction(self.derivatives)
        promised = slope / self.likelihood.n_beams
        if not np.isfinite(slope) or promised <= _ROUNDING * max(1.0, abs(self.trace[-1])):
            self.at_rest = True
            return 0.0
        for share in (1.0, 0.5, 0.125):
            theta = self._valid(x + share * step)
            derivatives = self._derivatives(theta)
            objective = derivatives[0] + self.problem.priors.log_density(theta)[0]
            if objective >= self.objective + 1e-4 * share * slope:
                self.newton_steps += 1
                self._move(theta, objective, derivatives=derivatives)
                return promised
            if promised < tolerance:  # converged but for rounding
                self.at_rest = True
                return promised
        return None

    def settle(self, tolerance: float) -> None:
        """Take the Newton step that the last pass allows: the objective no longer tells, but the gradient does.

        Climbs from different starts then end at the same numbers.
        """
        if self.derivatives is None:
            return
        x, step, slope = self._newton_direction(self.derivatives)
        if 0.0 < slope < tolerance * self.likelihood.n_beams:
            self.theta = self._valid(x + step)

    def _newton_direction(
        self, derivatives: tuple[float, FloatArray, FloatArray]
    ) -> tuple[FloatArray, FloatArray, float]:
        """Return the point, with log sigma^2 for sigma^2, a step from it, and what it promises in nats."""
        _, gradient, hessian = derivatives
        x, gradient, hessian, lower, upper = _in_log_variance(self.theta, gradient, hessian, self.problem)
        step = newton_step(
            x, gradient, hessian, free=self.problem.free, lower=lower, upper=upper, summed=_WEIGHTS & self.problem.free
        )
        step *= min(1.0, 2.0 / max(abs(step[VARIANCE]), 1e-300))
        return x, step, float(gradient @ step)

    def _move(
        self,
        theta: FloatArray,
        objective: float,
        *,
        statistics: ExpectedStatistics | None = None,
        derivatives: tuple[float, FloatArray, FloatArray] | None = None,
    ) -> float:
        gain = (objective - self.objective) / self.likelihood.n_beams
        self.theta, self.objective = theta, objective
        self.statistics, self.derivatives = statistics, derivatives
        self.trace.append(objective / self.likelihood.n_beams)
        return gain

    def _statistics(self, theta: FloatArray) -> ExpectedStatistics:
        return self.likelihood.expected_statistics(theta, slope_is_free=bool(self.problem.free[SLOPE]))

    def _derivatives(self, theta: FloatArray) -> tuple[float, FloatArray, FloatArray]:
        value, gradient, hessian = self.likelihood.derivatives(theta)
        _, prior_gradient, prior_hessian = self.problem.priors.log_density(theta)
        return value, gradient + prior_gradient, hessian + prior_hessian

    def _valid(self, x: FloatArray) -> FloatArray:
        theta = x.copy()
        theta[VARIANCE] = np.exp(x[VARIANCE]) if self.problem.free[VARIANCE] else self.theta[VARIANCE]
        if self.problem.free[:4].all() and not self.problem.priors.counts.any():
            # Whatever the other parameters are, the best z_max is the share of readings at max range: keep it exact.
            share = self.likelihood.n_max / self.likelihood.n_beams
            others = [W_HIT, W_SHORT, W_RAND]
            theta[others] *= (1.0 - share) / max(theta[others].sum(), 1e-300)
            theta[W_MAX] = share
        return self.problem.apply(theta)


def _in_log_variance(
    theta: FloatArray, gradient: FloatArray, hessian: FloatArray, problem: LearningProblem
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]:
    """Point, derivatives and bounds with log sigma^2 in place of sigma^2, where the likelihood is rounder."""
    v = theta[VARIANCE]
    x, lower, upper = theta.copy(), problem.lower.copy(), problem.upper.copy()
    x[VARIANCE], lower[VARIANCE], upper[VARIANCE] = np.log([v, lower[VARIANCE], upper[VARIANCE]])
    gradient, hessian = gradient.copy(), hessian.copy()
    gradient[VARIANCE] *= v
    hessian[VARIANCE, :] *= v
    hessian[:, VARIANCE] *= v
    hessian[VARIANCE, VARIANCE] += gradient[VARIANCE]
    return x, gradient, hessian, lower, upper
