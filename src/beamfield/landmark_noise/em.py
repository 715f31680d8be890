"""EM for the noise of a landmark sensor: a normal with bias and scale, and features of no landmark (6.40), 6.6.3."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.special import erf

from beamfield.geometry import FloatArray, wrap_angle
from beamfield.landmark_noise.sighting_table import SightingTable

# Residuals that all agree have no noise to learn; a density there would grow without limit.
LEAST_SIGMA_RANGE, LEAST_SIGMA_BEARING = 1e-6, 1e-7
# A normal of so wide a bearing is cut off at the half turn: 0.3 rad are ten deviations away from it, above 20 half
# turns it is flat.
CUT_SIGMA, WIDEST_SIGMA = 0.3, 20.0 * math.pi
_LOG_2PI = math.log(2.0 * math.pi)


class NoiseTheta(NamedTuple):
    """Where the climb is, in metres and radians; sigmas are NaN for what was never measured."""

    range_bias: float
    range_scale: float
    sigma_range: float
    bearing_bias: float
    sigma_bearing: float
    spurious_rate: float


@dataclass(frozen=True)
class NoiseProblem:
    """What is free, and what the sensor can do.

    Parameters
    ----------
    max_range
        Limit of features of no landmark, metres; None if nothing has a range or none is spurious.
    fit_scale, fit_spurious
        Whether to learn scale and spurious rate, or to hold them at 1 and 0.
    """

    max_range: float | None
    fit_scale: bool = False
    fit_spurious: bool = True


@dataclass(frozen=True, eq=False)
class NoiseClimb:
    """Where EM ended, and the log-likelihood per sighting after each iteration, nats; it never falls.

    Converged: what further iterations promise is below the tolerance.
    """

    theta: NoiseTheta
    trace: tuple[float, ...]
    converged: bool


class NoiseLikelihood:
    """The log-likelihood of a table's sightings as a function of the noise.

    Parameters
    ----------
    table
        The sightings.
    problem
        Limits and what is free.
    """

    def __init__(self, table: SightingTable, problem: NoiseProblem) -> None:
        self.problem = problem
        self.real = table.landmarks >= 0
        self.distances: FloatArray = np.where(self.real, table.expected_ranges, 0.0)
        self.ranges, self.bearings = table.range_residuals, table.bearing_residuals
        self.has_range, self.has_bearing = ~np.isnan(self.ranges), ~np.isnan(self.bearings)
        self.log_spurious = np.where(np.isnan(table.bearings), 0.0, -_LOG_2PI)
        if problem.max_range is not None:
            inside = (table.ranges >= 0.0) & (table.ranges <= problem.max_range)
            density = np.where(inside, -math.log(problem.max_range), -np.inf)
            self.log_spurious += np.where(np.isnan(table.ranges), 0.0, density)

    def __len__(self) -> int:
        return len(self.ranges)

    def log_landmark(self, theta: NoiseTheta) -> FloatArray:
        """Return log p(r, phi | the landmark) of each sighting, (n,) nats; -inf for features known to be of none."""
        total: FloatArray = np.where(self.real, 0.0, -np.inf)
        if self.has_range.any():
            mean = theta.range_bias + (theta.range_scale - 1.0) * self.distances
            a = (self.ranges - mean) / theta.sigma_range
            total += np.where(self.has_range, -0.5 * (a * a + _LOG_2PI) - math.log(theta.sigma_range), 0.0)
        if self.has_bearing.any():
            b = wrap_angle(self.bearings - theta.bearing_bias) / theta.sigma_bearing
            value = -0.5 * (b * b + _LOG_2PI) - _log_width(theta.sigma_bearing)
            total += np.where(self.has_bearing, value, 0.0)
        return total

    def e_step(self, theta: NoiseTheta) -> tuple[FloatArray, FloatArray]:
        """Return log densities in nats, and how probably each sighting is of its landmark, both (n,)."""
        landmark = self.log_landmark(theta)
        if theta.spurious_rate == 0.0:
            return landmark, np.where(self.real, 1.0, 0.0)
        landmark += math.log1p(-theta.spurious_rate)
        both = np.logaddexp(landmark, self.log_spurious + math.log(theta.spurious_rate))
        return both, np.exp(landmark - both)

    def m_step(self, theta: NoiseTheta, of_landmark: FloatArray, weights: FloatArray) -> NoiseTheta:
        """Return the parameters that maximise the expected log-likelihood; never less likely than `theta`.

        What is held stays. `of_landmark` (n,) are the responsibilities of the landmarks, from `e_step` at theta;
        weights (n,) say how often each sighting counts.
        """
        w = of_landmark * weights
        rate = theta.spurious_rate
        if self.problem.fit_spurious:
            rate = min(max(1.0 - float(w.sum() / weights.sum()), 0.0), 1.0 - 1e-9)
        return NoiseTheta(*self._range_step(theta, w), *self._bearing_step(theta, w), rate)

    def _range_step(self, theta: NoiseTheta, w: FloatArray) -> tuple[float, float, float]:
        used = self.has_range & (w > 0.0)
        if not used.any():
            return theta.range_bias, theta.range_scale, theta.sigma_range
        e, d, w = self.ranges[used], self.distances[used], w[used]
        centre, slope = _mean(d, w), 0.0
        if self.problem.fit_scale:
            spread = _mean(np.square(d - centre), w)
            slope = _mean((d - centre) * e, w) / spread if spread > 0.0 else 0.0
        bias = _mean(e, w) - slope * centre
        sigma = math.sqrt(_mean(np.square(e - bias - slope * d), w))
        return bias, 1.0 + slope, max(sigma, LEAST_SIGMA_RANGE)

    def _bearing_step(self, theta: NoiseTheta, w: FloatArray) -> tuple[float, float]:
        used = self.has_bearing & (w > 0.0)
        if not used.any():
            return theta.bearing_bias, theta.sigma_bearing
        e, w = self.bearings[used], w[used]
        # Moving to the mean of the wrapped residuals never makes their squares larger, and neither does wrapping.
        bias = float(wrap_angle(theta.bearing_bias + _mean(wrap_angle(e - theta.bearing_bias), w)))
        return bias, _sigma_within_half_turn(_mean(np.square(wrap_angle(e - bias)), w))


def fit_noise(likelihood: NoiseLikelihood, *, max_iterations: int = 1000) -> NoiseClimb:
    """Climb from every start and return the highest end."""
    climbs = [climb_noise(likelihood, start, max_iterations=max_iterations) for start in noise_starts(likelihood)]
    return max(climbs, key=lambda climb: climb.trace[-1])


def climb_noise(
    likelihood: NoiseLikelihood,
    start: NoiseTheta,
    *,
    weights: FloatArray | None = None,
    tolerance: float = 1e-9,
    max_iterations: int = 1000,
) -> NoiseClimb:
    """Climb the log-likelihood by EM.

    Weights (n,) say how often each sighting counts; None for once. It ends where all further iterations together
    promise less than the tolerance, in nats per sighting, judged from how fast gains shrink.
    """
    counts = np.ones(len(likelihood)) if weights is None else weights
    theta = best = start
    trace, gain = list[float](), math.inf
    for _ in range(max_iterations + 1):
        each, of_landmark = likelihood.e_step(theta)
        value = _mean(each, counts)
        if trace:
            last, gain = gain, value - trace[-1]
            # Rounding ends the climb where it begins to fall.
            if gain <= 0.0:
                return NoiseClimb(best, tuple(trace), converged=True)
            shrinking = min(gain / last, 0.999) if math.isfinite(last) else 0.5
            if gain * shrinking / (1.0 - shrinking) < tolerance and gain < tolerance * 100.0:
                return NoiseClimb(theta, (*trace, value), converged=True)
        trace.append(value)
        best = theta
        theta = likelihood.m_step(theta, of_landmark, counts)
    return NoiseClimb(best, tuple(trace), converged=False)


def noise_starts(likelihood: NoiseLikelihood) -> list[NoiseTheta]:
    """Return where to begin: one start trusts the middle half of the residuals, one all of them.

    Sigmas are NaN for what was never measured.
    """
    e = likelihood.ranges[likelihood.real & likelihood.has_range]
    b = likelihood.bearings[likelihood.real & likelihood.has_bearing]
    centre = math.atan2(float(np.sin(b).mean()), float(np.cos(b).mean())) if len(b) else 0.0
    starts = []
    for robust, rate in ((True, 0.1), (False, 0.01)):
        bias, sigma_range = _location(e, LEAST_SIGMA_RANGE, robust=robust)
        shift, sigma_bearing = _location(wrap_angle(b - centre), LEAST_SIGMA_BEARING, robust=robust)
        rate = rate if likelihood.problem.fit_spurious else 0.0
        starts.append(NoiseTheta(bias, 1.0, sigma_range, float(wrap_angle(centre + shift)), sigma_bearing, rate))
    return starts


def _location(values: FloatArray, least: float, *, robust: bool) -> tuple[float, float]:
    if not len(values):
        return 0.0, math.nan
    if not robust:
        return float(values.mean()), max(float(values.std()), least)
    middle = float(np.median(values))
    # 1.4826: the factor from the median of absolute values to the deviation of a normal.
    return middle, max(1.4826 * float(np.median(np.abs(values - middle))), least)


def _log_width(sigma: float) -> float:
    """Return the log of sigma times the share of a normal that lies within half a turn of its mean."""
    return math.log(sigma) + math.log(float(erf(math.pi / (sigma * math.sqrt(2.0)))))


def _sigma_within_half_turn(square: float) -> float:
    """Return the most likely sigma of a normal cut off at half a turn, given the mean square of its values."""
    sigma = max(math.sqrt(square), LEAST_SIGMA_BEARING)
    if sigma < CUT_SIGMA:
        return sigma
    cost = lambda log_sigma: 0.5 * square * math.exp(-2.0 * log_sigma) + _log_width(math.exp(log_sigma))  # noqa: E731
    bounds = (math.log(0.9 * sigma), math.log(WIDEST_SIGMA))
    return math.exp(minimize_scalar(cost, bounds=bounds, method="bounded", options={"xatol": 1e-9}).x)


def _mean(values: FloatArray, w: FloatArray) -> float:
    # Not w @ values: the dot product of a threaded BLAS takes 30 times as long while other threads work.
    return float((w * values).sum() / w.sum())
