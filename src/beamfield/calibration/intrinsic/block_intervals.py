"""Intervals of learned parameters that respect that neighbouring beams and scans depend on each other."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import betaincinv, ndtri, stdtrit

from beamfield.arguments import as_floats, checked
from beamfield.calibration.intrinsic.curvature import free_directions, inverse_root
from beamfield.calibration.intrinsic.identifiability import FEWEST_BEAMS_OF_A_CAUSE
from beamfield.calibration.intrinsic.learning_problem import LearningProblem, learning_problem
from beamfield.calibration.intrinsic.likelihood import (
    N_PARAMETERS,
    OFFSET,
    RATE,
    SLOPE,
    VARIANCE,
    W_HIT,
    W_SHORT,
    IntrinsicLikelihood,
    theta_of,
)
from beamfield.calibration.intrinsic.priors import IntrinsicPriors
from beamfield.calibration.time_split import LONGEST_BLOCK_S, block_length, time_blocks
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.finding import Finding
from beamfield.geometry import FloatArray
from beamfield.models.beam_parameters import BeamParameters
from beamfield.short_repr import short_repr

# From this much time on, 95 % intervals hold the truth in 92 to 97 % of simulated logs, also where people walk by in
# bursts every 30 s; in less time such bursts take that down to 83 % (docs/reliability.md). With fewer blocks
# than the second number, Student's t is too wide to be of use.
LEAST_TIME_S = 10 * LONGEST_BLOCK_S
FEWEST_COMPARED_BLOCKS = 5
# Beyond these levels the quantiles are all alike, or far beyond what a few blocks tell.
LEVELS = (0.01, 0.999999)
# The design effect of a cause is known from this many of its beams on.
_BEAMS_OF_A_DESIGN_EFFECT = 10.0

_NAMES = tuple(item.name for item in fields(BeamParameters))


@dataclass(frozen=True, eq=False)
class IntervalResult:
    """Intervals from blocks of time.

    Parameters
    ----------
    intervals
        (low, high) per learned parameter, by the names of `BeamParameters`; empty where there is one block only.
        (0, inf) for lambda_short where it is undetermined: fewer than 3 beams look like unexpected objects, or the
        interval reaches the bound of the search; (-inf, inf) for a range_offset at its limit. Never without width.
    standard_errors
        Standard error per learned parameter; inf where it is undetermined, NaN where the parameter is on its bound, so
        that its error has one side only.
    level
        The share of such intervals that are to hold the truth.
    n_blocks
        Blocks of time that were compared.
    findings
        Warnings.
    """

    intervals: Mapping[str, tuple[float, float]]
    standard_errors: Mapping[str, float]
    level: float
    n_blocks: int
    findings: tuple[Finding, ...]

    __repr__ = short_repr


@checked
def block_intervals(
    ranges: ArrayLike,
    expected_ranges: ArrayLike,
    stamps: ArrayLike,
    max_range: float,
    parameters: BeamParameters,
    *,
    min_range: float = 0.0,
    fit_offset: bool = False,
    fit_sigma_slope: bool = False,
    hold: Mapping[str, float] | None = None,
    priors: IntrinsicPriors | None = None,
    block_s: float | None = None,
    level: float = 0.95,
) -> IntervalResult:
    """Leave out one block of consecutive time after the other; how far the parameters move tells their intervals.

    Beams of one scan and neighbouring scans err together: intervals from the curvature of the likelihood are 4 to 24
    times too narrow. Blocks of 20 s hold what hangs together.

    Parameters
    ----------
    ranges, expected_ranges, max_range
        As `learn_intrinsic_parameters`.
    stamps
        Time of each beam, seconds, shape (n,).
    parameters
        What was learned from all beams with the same options.
    min_range, fit_offset, fit_sigma_slope, hold, priors
        As `learn_intrinsic_parameters`.
    block_s
        Length of a block, seconds; None: 20 s, or a twelfth of a shorter log.
    level
        Share of intervals that are to hold the truth, 0.01 to 0.999999.

    Returns
    -------
    Intervals and standard errors of what was learned, not of what was held; without intervals where there is one block.

    Raises
    ------
    InvalidInputError
        If shapes differ, a stamp is not finite, or an option is out of range.
    TooLittleDataError
        If no beam remains.

    Notes
    -----
    Variances are those of the block jackknife (Kuensch). Without block b the parameters move by about
    d_b = -A^-1 s_b n / (n - n_b), with s_b the gradient of the log-likelihood of b's n_b beams, and A its negative
    Hessian for all n beams; the variance is (B - 1) / B times the sum of d_b d_b' over B blocks. With t, the quantile
    of Student's distribution of B - 1 degrees of freedom, s, a standard error, and a, the skewness of the d_b over
    sqrt(B):

    - An interval reaches max(t, h(t)) s down and max(t, -h(-t)) s up, with Hall's
      h(x) = 3 / a ((1 + a x - a^2 / 6)^(1/3) - 1). Where a few blocks hold most of a cause, such as people who walk by,
      a log with too few of them looks more certain than it is.
    - lambda_short, range_offset, the squares of sigma_hit and sigma_slope: so far from the estimate, cut to what is
      possible.
    - A weight w: for either end, with r s the reach and z the Gaussian quantile, that of Clopper and Pearson for the
      share w of w (1 - w) / s^2 (z / r)^2 independent beams (Korn and Graubard). It is as lopsided as a share of
      independent beams, (1 - 2 w) s / (w (1 - w)), which is taken from a. Where these beams hold less than one reading
      of the cause, the upper end is at most w + r s or that of one reading.
    - A parameter on its bound, such as a weight of 0: one-sided, to where the log-likelihood, to second order and the
      other parameters following, has fallen by D (t / z)^2 ln(1 / (1 - level)). Where no reading at all looks like the
      cause of a weight, that is the rule of three, 3 / (n / D). The design effect D is the variance above over that
      of independent beams; a weight of 0 takes the largest that this log shows for another weight or for sigma_hit.

    References
    ----------
    Kuensch, "The jackknife and the bootstrap for general stationary observations", Annals of Statistics 17, 1989.
    Hall, "On the removal of skewness by transformation", Journal of the Royal Statistical Society B 54, 1992.
    Korn and Graubard, "Confidence intervals for proportions with small expected number of positive counts estimated
    from survey data", Survey Methodology 24, 1998.
    Hanley and Lippman-Hand, "If nothing goes wrong, is everything all right?", JAMA 249, 1983.

    Examples
    --------
    Hits alone, whose noise is known to a hundredth of its size:

    >>> rng = np.random.default_rng(0)
    >>> expected = rng.uniform(1.0, 9.0, 2000)
    >>> ranges, stamps = rng.normal(expected, 0.05), np.arange(2000) * 0.2
    >>> hold = {"z_short": 0.0, "z_max": 0.0, "z_rand": 0.0, "lambda_short": 0.0}
    >>> truth = BeamParameters(1.0, 0.0, 0.0, 0.0, sigma_hit=0.05, lambda_short=0.0)
    >>> result = block_intervals(ranges, expected, stamps, 10.0, truth, hold=hold)
    >>> low, high = result.intervals["sigma_hit"]
    >>> low < 0.05 < high, high - low < 0.01
    (True, True)
    """
    if not LEVELS[0] <= level <= LEVELS[1]:
        raise InvalidInputError(f"level: expected a share between {LEVELS[0]:g} and {LEVELS[1]:g}, got {level}")
    z, expected, times = _checked(ranges, expected_ranges, stamps, max_range, min_range)
    length = block_length(times, block_s)
    used = (expected < max_range) & ~np.isnan(z)
    _, blocks = np.unique(time_blocks(times, block_s)[used], return_inverse=True)
    z, expected = z[used], expected[used]
    problem = learning_problem(
        float(max_range),
        min_range=float(min_range),
        hold=hold,
        priors=priors,
        fit_offset=fit_offset,
        fit_sigma_slope=fit_sigma_slope,
    )
    theta = problem.apply(theta_of(parameters))
    gradients, hessian = _derivatives_of_blocks(z, expected, blocks, theta, problem)
    result, _ = intervals_of_blocks(problem, theta, gradients, hessian, np.bincount(blocks), length, level=level)
    return result


def intervals_of_blocks(
    problem: LearningProblem,
    theta: FloatArray,
    gradients: FloatArray,
    hessian: FloatArray,
    sizes: NDArray[np.int64],
    length: float,
    *,
    level: float = 0.95,
) -> tuple[IntervalResult, FloatArray]:
    """Return what `block_intervals` does from sums over the beams of each block, wherever they lie.

    Parameters
    ----------
    problem, theta
        What was learned, and the working vector (8,) at the maximum.
    gradients
        Gradient of each block's log-likelihood there, (b, 8).
    hessian
        Of the log-likelihood of all beams, (8, 8).
    sizes
        Beams of each block, (b,).
    length
        Of a block, seconds.
    level
        As `block_intervals`.

    Returns
    -------
    The intervals, and the covariance (8, 8) of the working vector: 0 for what is held or sits on a bound, NaN if there
    is one block only.
    """
    if len(sizes) == 1:
        nothing = np.full((N_PARAMETERS, N_PARAMETERS), np.nan)
        return IntervalResult({}, {}, level, 1, tuple(_findings(1, length))), nothing
    jackknife = _Jackknife(problem, theta, gradients, hessian, sizes, level)
    learned = [name for name in _NAMES if problem.free[problem.position(name)]]
    intervals = IntervalResult(
        intervals={name: jackknife.interval(problem.position(name)) for name in learned},
        standard_errors={name: jackknife.standard_error(problem.position(name)) for name in learned},
        level=level,
        n_blocks=len(sizes),
        findings=tuple(_findings(len(sizes), length)),
    )
    return intervals, jackknife.errors.robust


def share_interval(share: float, variance: float, outside: float) -> tuple[float, float]:
    """Return Clopper and Pearson's interval for a share in (0, 1), from the sample size that its variance implies.

    Parameters
    ----------
    share, variance
        The estimate, and its variance, positive.
    outside
        The share of such intervals that may miss the truth.
    """
    n = share * (1.0 - share) / variance
    hits, misses = share * n, (1.0 - share) * n
    low = float(betaincinv(hits, misses + 1.0, 0.5 * outside)) if hits > 1e-100 else 0.0  # SciPy's is NaN there
    return low, float(betaincinv(hits + 1.0, misses, 1.0 - 0.5 * outside))


def _checked(
    ranges: ArrayLike, expected_ranges: ArrayLike, stamps: ArrayLike, max_range: float, min_range: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    z, expected, times = (
        as_floats(values, name)
        for name, values in (("ranges", ranges), ("expected_ranges", expected_ranges), ("stamps", stamps))
    )
    for name, column in (("ranges", z), ("expected_ranges", expected), ("stamps", times)):
        if column.shape != z.shape or column.ndim != 1:
            raise InvalidInputError(f"{name}: expected one dimension as long as ranges, got shape {column.shape}")
    for name, column, least in (("ranges", z, min_range), ("expected_ranges", expected, 0.0)):
        bad = (column < least) if name == "ranges" else ~(column >= least)  # a range of NaN is not a measurement
        if bad.any():
            index = int(np.flatnonzero(bad)[0])
            raise InvalidInputError(f"{name}[{index}]: expected a number >= {least:g}, got {column[index]}")
    if not np.isfinite(times).all():
        index = int(np.flatnonzero(~np.isfinite(times))[0])
        raise InvalidInputError(f"stamps[{index}]: expected a finite number of seconds, got {times[index]}")
    if not ((expected < max_range) & ~np.isnan(z)).any():
        raise TooLittleDataError(f"0 of {z.size} beams have a reading and a ray that hits something in the map")
    return z, expected, times


def _derivatives_of_blocks(
    z: FloatArray,
    expected: FloatArray,
    blocks: NDArray[np.int64],
    theta: FloatArray,
    problem: LearningProblem,
) -> tuple[FloatArray, FloatArray]:
    """Return the gradient of each block's log-likelihood, (b, 8), and the Hessian of all, (8, 8)."""
    order = np.argsort(blocks, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(blocks))[:-1])
    gradients, hessian = np.empty((len(parts), N_PARAMETERS)), np.zeros((N_PARAMETERS, N_PARAMETERS))
    for b, part in enumerate(parts):
        likelihood = IntrinsicLikelihood(z[part], expected[part], problem.max_range, min_range=problem.min_range)
        _, gradients[b], of_block = likelihood.derivatives(theta)
        hessian += of_block
    return gradients, hessian


@dataclass(frozen=True, eq=False)
class _Errors:
    """Covariances of the working vector (8, 8), 0 for what may not move: of the jackknife, and of independent beams.

    `moves` (b, 8) is by how much each block pulls the working vector.
    """

    robust: FloatArray
    naive: FloatArray
    moves: FloatArray

    def design_effect(self, i: int) -> float:
        return float(self.robust[i, i] / self.naive[i, i])

    def skewness(self, i: int) -> float:
        """Return the skewness of the blocks' moves; 0 where none moves."""
        centred = self.moves[:, i] - self.moves[:, i].mean()
        variance = float(np.mean(centred**2))
        return float(np.mean(centred**3)) / variance**1.5 if variance > 0.0 else 0.0


class _Jackknife:
    """How far the parameters move when one block of time is left out, and the intervals that follow."""

    def __init__(
        self,
        problem: LearningProblem,
        theta: FloatArray,
        gradients: FloatArray,
        hessian: FloatArray,
        sizes: NDArray[np.int64],
        level: float,
    ) -> None:
        _, prior_gradient, prior_hessian = problem.priors.log_density(theta)
        self.problem = problem
        self.theta = theta
        self.n_beams = int(sizes.sum())
        # At a bound they do not add up to 0: what counts is how blocks differ beside their numbers of beams.
        share = (sizes / self.n_beams)[:, None]
        self.scores = (gradients - share * gradients.sum(axis=0)) / (1.0 - share)
        self.gradient = gradients.sum(axis=0) + prior_gradient
        self.hessian = hessian + prior_hessian
        # Expected beams per cause: weight times the sum of density over mixture.
        self.counts = theta[:4] * gradients[:, :4].sum(axis=0)
        self.tail = 0.5 * (1.0 - level)
        self.t = float(stdtrit(len(gradients) - 1, 1.0 - self.tail))
        self.gaussian = float(ndtri(1.0 - self.tail))
        self.wider = self.t / self.gaussian
        self.most_nats = -math.log(1.0 - level) * self.wider**2
        # A weight of 1 is not a bound of its own: the others' are at 0.
        self.inside = problem.free & (theta > problem.lower) & ((theta < problem.upper) | (np.arange(N_PARAMETERS) < 4))

    def interval(self, i: int) -> tuple[float, float]:
        """Return (low, high) of entry i of the working vector, in the units of `BeamParameters`."""
        if i == RATE and self._rate_is_undetermined:
            return 0.0, math.inf
        low, high = self._weight_interval(i) if i <= 3 else self._shape_interval(i)
        return (math.sqrt(low), math.sqrt(high)) if i in (VARIANCE, SLOPE) else (low, high)

    def standard_error(self, i: int) -> float:
        """Return the standard error of entry i of the working vector, in the units of `BeamParameters`."""
        if i == RATE and self._rate_is_undetermined:
            return math.inf
        if not self.inside[i]:
            return math.nan
        error = math.sqrt(self.errors.robust[i, i])
        return error / (2.0 * math.sqrt(self.theta[i])) if i in (VARIANCE, SLOPE) else error

    @cached_property
    def errors(self) -> _Errors:
        return self._errors(self.inside)

    def _errors(self, moving: NDArray[np.bool_]) -> _Errors:
        basis = free_directions(moving, self.theta)
        if basis.shape[1] == 0:
            nothing = np.zeros((N_PARAMETERS, N_PARAMETERS))
            return _Errors(nothing, nothing, np.zeros_like(self.scores))
        root = inverse_root(-basis.T @ self.hessian @ basis)
        inverse = basis @ root @ root.T @ basis.T
        moves = self.scores @ inverse
        n_blocks = len(moves)
        return _Errors((n_blocks - 1) / n_blocks * moves.T @ moves, inverse, moves)

    def _reaches(self, i: int, known_skewness: float = 0.0) -> tuple[float, float]:
        """Return how many standard errors an interval reaches down and up."""
        a = self.errors.skewness(i) / math.sqrt(len(self.scores)) - known_skewness
        if not 1e-6 < abs(a) < 1e6:  # beyond either end the formula gives t, but for rounding
            return self.t, self.t
        low, high = (3.0 / a * (math.cbrt(1.0 + a * x - a**2 / 6.0) - 1.0) for x in (self.t, -self.t))
        return max(low, self.t), max(-high, self.t)

    def _weight_interval(self, i: int) -> tuple[float, float]:
        w, variance = float(self.theta[i]), float(self.errors.robust[i, i])
        most = 1.0 - float(self.theta[:4][~self.problem.free[:4]].sum())
        if w <= self.problem.lower[i]:
            return 0.0, min(self._rise_from_bound(i, self._largest_design_effect), most)
        if not (variance > 0.0 and w < 1.0):
            # All of the weight there is, unless a cause that this log does not show has some.
            absent = [k for k in range(4) if self.problem.free[k] and self.theta[k] <= self.problem.lower[k]]
            rise = max((self._rise_from_bound(k, self._largest_design_effect) for k in absent), default=0.0)
            return max(w - rise, 0.0), w
        error = math.sqrt(variance)
        down, up = self._reaches(i, (1.0 - 2.0 * w) * error / (w * (1.0 - w)))
        low, _ = share_interval(w, variance * (down / self.gaussian) ** 2, 2.0 * self.tail)
        _, high = share_interval(w, variance * (up / self.gaussian) ** 2, 2.0 * self.tail)
        # Less than one reading in all is not a share: what moves such a weight are readings of other causes.
        of_one_reading = float(betaincinv(2.0, (1.0 - w) / w, 1.0 - self.tail))
        high = min(high, max(w + up * error, of_one_reading))  # in this order: the second may be NaN
        return low, min(high, most)

    def _shape_interval(self, i: int) -> tuple[float, float]:
        value, lower, upper = (float(a[i]) for a in (self.theta, self.problem.lower, self.problem.upper))
        if value <= lower and i != OFFSET:
            # The floor of sigma_hit is that of the search: the noise itself may be anything below.
            return 0.0, min(lower + self._rise_from_bound(i, 1.0), upper)
        if not self.inside[i]:  # at a limit of the search that no data set
            return (-math.inf if i == OFFSET else 0.0), math.inf
        error = math.sqrt(self.errors.robust[i, i])
        below, above = (reach * error for reach in self._reaches(i))
        low = value - below if value - below > lower else (0.0 if i == VARIANCE else lower)
        return low, min(value + above, upper)

    def _rise_from_bound(self, i: int, least_design_effect: float) -> float:
        """Return how far above its lower bound entry i may be before the likelihood has fallen by too many nats."""
        moving = self.inside.copy()
        moving[i] = True
        basis, errors = free_directions(moving, self.theta), self._errors(moving)
        inwards = basis[:, np.argmax(basis[i])]
        slope = max(-float(inwards @ self.gradient), 0.0)
        if not inwards @ self.hessian @ inwards < 0.0:  # no maximum nearby: the slope alone tells
            nats = self.most_nats * least_design_effect
            return nats / slope if slope > 0.0 else math.inf
        nats = self.most_nats * max(errors.design_effect(i), least_design_effect)
        curvature = 1.0 / float(errors.naive[i, i])
        return 2.0 * nats / (slope + math.sqrt(slope**2 + 2.0 * curvature * nats))

    @cached_property
    def _largest_design_effect(self) -> float:
        known = [
            i
            for i in range(4)
            if self.inside[i] and min(self.counts[i], self.n_beams - self.counts[i]) >= _BEAMS_OF_A_DESIGN_EFFECT
        ]
        known += [VARIANCE] if self.inside[VARIANCE] and self.counts[W_HIT] >= _BEAMS_OF_A_DESIGN_EFFECT else []
        return max([1.0, *(self.errors.design_effect(i) for i in known if self.errors.naive[i, i] > 0.0)])

    @cached_property
    def _rate_is_undetermined(self) -> bool:
        ceiling = self.problem.upper[RATE]
        if self.counts[W_SHORT] < FEWEST_BEAMS_OF_A_CAUSE or self.theta[RATE] >= ceiling:
            return True
        return bool(self._shape_interval(RATE)[1] >= ceiling)


def _findings(n_blocks: int, length: float) -> Iterator[Finding]:
    if n_blocks == 1:
        yield Finding(
            "no-intervals",
            "warning",
            "All beams lie in one block of time, so there are no intervals.",
            {"n_blocks": 1.0},
            why="Nothing says how much the values would change with another drive.",
            do="Record a longer log.",
        )
    elif n_blocks < FEWEST_COMPARED_BLOCKS or n_blocks * length < 0.999 * LEAST_TIME_S:
        yield Finding(
            "few-blocks",
            "warning",
            f"The intervals rest on {n_blocks} blocks of {length:.3g} s.",
            {"n_blocks": float(n_blocks), "block_s": length},
            why="Rare events, such as people walking by every half minute, hardly show in them.",
            do=f"Record a log of {1.5 * LEAST_TIME_S / 60.0:.0f} minutes in motion ({LEAST_TIME_S:.0f} s of fitted "
            "beams).",
        )
