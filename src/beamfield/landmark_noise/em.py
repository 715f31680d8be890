"""EM for the noise of a landmark sensor: a normal with bias and scale, and features of no landmark (6.40), 6.6.3."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, wrap_angle
from beamfield.landmark_noise.sighting_table import SightingTable
from beamfield.landmark_noise.truncated_normal import fit_window_normal, log_window_mass

# Residuals that all agree have no noise to learn; a density there would grow without limit.
LEAST_SIGMA_RANGE, LEAST_SIGMA_BEARING = 1e-6, 1e-7
DISTANCE_BINS = 1024
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
    truncated_at
        Residuals (metres, radians) beyond which features were taken away; None where none were.
    fit_range_bias, fit_bearing_bias, fit_scale, fit_spurious
        Whether to learn biases, scale and spurious rate, or to hold them at 0, 1 and 0.
    """

    max_range: float | None
    truncated_at: tuple[float | None, float | None] = (None, None)
    fit_range_bias: bool = True
    fit_bearing_bias: bool = True
    fit_scale: bool = False
    fit_spurious: bool = True


@dataclass(frozen=True, eq=False)
class NoiseClimb:
    """Where EM ended.

    Parameters
    ----------
    theta
        The parameters.
    trace
        Log-likelihood per sighting after each iteration, nats; it never falls.
    converged
        Whether what further iterations promise is below the tolerance.
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
        self.log_spurious = self._log_spurious(table)
        self.bin, self.bins = np.zeros(len(table), dtype=np.int64), np.zeros(1)
        if problem.fit_scale and problem.truncated_at[0] is not None:
            # The mass within the cut depends on the distance; distances rounded to a thousandth of their span share it,
            # and move a mean by no more than |range_scale - 1| of that.
            self.bin, self.bins = _rounded(self.distances)
            self.distances = self.bins[self.bin]
        self.ranges, self.bearings = table.range_residuals, table.bearing_residuals
        self.has_range = ~np.isnan(self.ranges)
        self.has_bearing = ~np.isnan(self.bearings)

    def __len__(self) -> int:
        return len(self.ranges)

    def log_landmark(self, theta: NoiseTheta) -> FloatArray:
        """Return log p(r, phi | the landmark) of each sighting, (n,) nats; -inf for features known to be of none."""
        total: FloatArray = np.where(self.real, 0.0, -np.inf)
        cut_range, cut_bearing = self.problem.truncated_at
        if self.has_range.any():
            mean = theta.range_bias + (theta.range_scale - 1.0) * self.distances
            a = (self.ranges - mean) / theta.sigma_range
            value = -0.5 * (a * a + _LOG_2PI) - math.log(theta.sigma_range)
            if cut_range is not None:
                means = theta.range_bias + (theta.range_scale - 1.0) * self.bins
                value -= log_window_mass(means, theta.sigma_range, cut_range)[self.bin]
            total += np.where(self.has_range, value, 0.0)
        if self.has_bearing.any():
            if cut_bearing is None:
                b, mass = (
                    wrap_angle(self.bearings - theta.bearing_bias),
                    log_window_mass(0.0, theta.sigma_bearing, math.pi),
                )
            else:
                b = self.bearings - theta.bearing_bias
                mass = log_window_mass(theta.bearing_bias, theta.sigma_bearing, cut_bearing)
            b = b / theta.sigma_bearing
            value = -0.5 * (b * b + _LOG_2PI) - math.log(theta.sigma_bearing) - mass
            total += np.where(self.has_bearing, value, 0.0)
        return total

    def log_likelihood_each(self, theta: NoiseTheta) -> FloatArray:
        """Return each sighting's log density, (n,) nats."""
        return self.e_step(theta)[0]

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

        Parameters
        ----------
        theta
            Where the responsibilities come from.
        of_landmark
            (n,) responsibilities of the landmarks, from `e_step`.
        weights
            (n,) how often each sighting counts.

        Returns
        -------
        The new parameters; what is held stays.
        """
        w = of_landmark * weights
        bias, scale, sigma_range = self._range_step(theta, w)
        bearing_bias, sigma_bearing = self._bearing_step(theta, w)
        rate = theta.spurious_rate
        if self.problem.fit_spurious:
            rate = min(max(1.0 - float(w.sum() / weights.sum()), 0.0), 1.0 - 1e-9)
        return NoiseTheta(bias, scale, sigma_range, bearing_bias, sigma_bearing, rate)

    def _range_step(self, theta: NoiseTheta, w: FloatArray) -> tuple[float, float, float]:
        used = self.has_range & (w > 0.0)
        if not used.any():
            return theta.range_bias, theta.range_scale, theta.sigma_range
        e, d, w = self.ranges[used], self.distances[used], w[used]
        cut = self.problem.truncated_at[0]
        if not self.problem.fit_scale:
            mean, square = _mean(e, w), _mean(e * e, w)
            free = self.problem.fit_range_bias
            if cut is None:
                bias = mean if free else 0.0
                return bias, 1.0, _at_least(square - 2.0 * bias * mean + bias * bias, LEAST_SIGMA_RANGE)
            start = (np.full(int(free), theta.range_bias), theta.sigma_range)
            beta, sigma = fit_window_normal(*_one_row(mean, square, free), cut, start)
            return float(beta[0]) if free else 0.0, 1.0, max(sigma, LEAST_SIGMA_RANGE)
        centre = _mean(d, w)
        if cut is None:
            spread = _mean(np.square(d - centre), w)
            slope = _mean((d - centre) * e, w) / spread if spread > 0.0 else 0.0
            beta = np.array([_mean(e, w), slope])
            sigma = _at_least(_mean(np.square(e - beta[0] - slope * (d - centre)), w), LEAST_SIGMA_RANGE)
        else:
            slope = theta.range_scale - 1.0
            start = (np.array([theta.range_bias + slope * centre, slope]), theta.sigma_range)
            number = self.bin[used]
            counts: FloatArray = np.bincount(number, w, len(self.bins)).astype(np.float64)
            there = counts > 0.0
            means, squares = (np.bincount(number, w * y, len(self.bins))[there] / counts[there] for y in (e, e * e))
            design = np.column_stack([np.ones(len(means)), self.bins[there] - centre])
            beta, sigma = fit_window_normal(means, squares, design, counts[there], cut, start)
        return float(beta[0] - beta[1] * centre), float(1.0 + beta[1]), max(float(sigma), LEAST_SIGMA_RANGE)

    def _bearing_step(self, theta: NoiseTheta, w: FloatArray) -> tuple[float, float]:
        used = self.has_bearing & (w > 0.0)
        if not used.any():
            return theta.bearing_bias, theta.sigma_bearing
        e, w, cut = self.bearings[used], w[used], self.problem.truncated_at[1]
        free = self.problem.fit_bearing_bias
        if cut is not None:
            start = (np.full(int(free), theta.bearing_bias), theta.sigma_bearing)
            beta, sigma = fit_window_normal(*_one_row(_mean(e, w), _mean(e * e, w), free), cut, start)
            return float(beta[0]) if free else 0.0, max(sigma, LEAST_SIGMA_BEARING)
        bias = theta.bearing_bias if free else 0.0
        if free:
            # Moving to the mean of the wrapped residuals never makes their squares larger, and neither does wrapping.
            bias = float(wrap_angle(bias + _mean(wrap_angle(e - bias), w)))
        square = _mean(np.square(wrap_angle(e - bias)), w)
        if math.sqrt(square) < 0.3:  # ten deviations to the half turn: nothing is cut off
            return bias, _at_least(square, LEAST_SIGMA_BEARING)
        _, sigma = fit_window_normal(*_one_row(0.0, square, free=False), math.pi, (np.empty(0), theta.sigma_bearing))
        return bias, sigma

    def _log_spurious(self, table: SightingTable) -> FloatArray:
        """Return log p(r, phi | no landmark), (n,): uniform, within the window where features were taken away."""
        cut_range, cut_bearing = self.problem.truncated_at
        total: FloatArray = np.zeros(len(table))
        limit = self.problem.max_range
        measured = ~np.isnan(table.ranges)
        if limit is not None and measured.any():
            low, high = np.zeros(len(table)), np.full(len(table), limit)
            if cut_range is not None:
                low = np.where(self.real, np.maximum(self.distances - cut_range, 0.0), 0.0)
                high = np.where(self.real, np.minimum(self.distances + cut_range, limit), limit)
            inside = (table.ranges >= low) & (table.ranges <= high) & (high > low)
            with np.errstate(divide="ignore", invalid="ignore"):
                total += np.where(measured, np.where(inside, -np.log(high - low), -np.inf), 0.0)
        whole = np.full(len(table), _LOG_2PI)
        if cut_bearing is not None:
            whole = np.where(self.real, math.log(2.0 * cut_bearing), whole)
        return np.asarray(total - np.where(np.isnan(table.bearings), 0.0, whole))


def climb_noise(
    likelihood: NoiseLikelihood,
    start: NoiseTheta,
    *,
    weights: FloatArray | None = None,
    tolerance: float = 1e-9,
    max_iterations: int = 1000,
) -> NoiseClimb:
    """Climb the log-likelihood by EM.

    Parameters
    ----------
    likelihood
        What is climbed.
    start
        Where to begin.
    weights
        (n,) how often each sighting counts; None for once.
    tolerance
        Nats per sighting that all further iterations together may promise, judged from how fast gains shrink.
    max_iterations
        Most iterations.

    Returns
    -------
    The end of the climb, converged or not.
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

    Parameters
    ----------
    likelihood
        The sightings.

    Returns
    -------
    Two starts; sigmas are NaN for what was never measured.
    """
    real, fits = likelihood.real, likelihood.problem
    e, b = likelihood.ranges[real & likelihood.has_range], likelihood.bearings[real & likelihood.has_bearing]
    centre = _circular_centre(b)
    turned: NDArray[np.float64] = wrap_angle(b - centre)
    starts = []
    for robust in (True, False):
        bias, sigma_range = _location(e, robust=robust)
        shift, sigma_bearing = _location(turned, robust=robust)
        if not fits.fit_range_bias:
            bias, sigma_range = 0.0, math.hypot(bias, sigma_range)
        bearing_bias = float(wrap_angle(centre + shift))
        if not fits.fit_bearing_bias:
            bearing_bias, sigma_bearing = 0.0, math.hypot(bearing_bias, sigma_bearing)
        starts.append(
            NoiseTheta(
                bias,
                1.0,
                max(sigma_range, LEAST_SIGMA_RANGE) if len(e) else math.nan,
                bearing_bias,
                max(sigma_bearing, LEAST_SIGMA_BEARING) if len(b) else math.nan,
                (0.1 if robust else 0.01) if fits.fit_spurious else 0.0,
            )
        )
    return starts


def _rounded(distances: FloatArray) -> tuple[NDArray[np.int64], FloatArray]:
    """Return the number of each distance's bin, and the bins' centres."""
    low, span = float(distances.min()), float(np.ptp(distances))
    width = max(span / DISTANCE_BINS, 1e-12)
    number = np.minimum(((distances - low) / width).astype(np.int64), DISTANCE_BINS - 1)
    return np.asarray(number), np.asarray(low + (np.arange(DISTANCE_BINS) + 0.5) * width)


def _location(values: FloatArray, *, robust: bool) -> tuple[float, float]:
    if not len(values):
        return 0.0, math.nan
    if not robust:
        return float(values.mean()), float(values.std())
    middle = float(np.median(values))
    # 1.4826: the factor from the median of absolute values to the deviation of a normal.
    return middle, 1.4826 * float(np.median(np.abs(values - middle)))


def _circular_centre(angles: FloatArray) -> float:
    if not len(angles):
        return 0.0
    return math.atan2(float(np.sin(angles).mean()), float(np.cos(angles).mean()))


def _mean(values: FloatArray, w: FloatArray) -> float:
    # Not w @ values: the dot product of a threaded BLAS takes 30 times as long while other threads work.
    return float((w * values).sum() / w.sum())


def _at_least(square: float, least: float) -> float:
    return max(math.sqrt(max(square, 0.0)), least)


def _one_row(mean: float, square: float, free: bool) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return values, squares, design and weights of data that share one row of the design."""
    return np.array([mean]), np.array([square]), np.ones((1, int(free))), np.ones(1)
