"""Intervals of learned parameters that respect that neighbouring beams and scans depend on each other."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import as_floats, checked, require
from beamfield.calibration.intrinsic.em import checked_beams
from beamfield.calibration.intrinsic.jackknife import LEVEL, Jackknife
from beamfield.calibration.intrinsic.learning_problem import LearningProblem, learning_problem
from beamfield.calibration.intrinsic.likelihood import N_PARAMETERS, IntrinsicLikelihood, theta_of
from beamfield.calibration.intrinsic.priors import IntrinsicPriors
from beamfield.calibration.time_split import LONGEST_BLOCK_S, block_length, time_blocks
from beamfield.errors import TooLittleDataError
from beamfield.finding import Finding
from beamfield.geometry import FloatArray
from beamfield.models.beam_parameters import BeamParameters
from beamfield.short_repr import short_repr

# From this much time on, 95% intervals hold the truth in 92 to 97% of simulated logs, also where people walk by in
# bursts every 30 s; in less time such bursts take that down to 84% (docs/reliability.md). With fewer blocks
# than the second number, Student's t is too wide to be of use.
LEAST_TIME_S = 10 * LONGEST_BLOCK_S
FEWEST_COMPARED_BLOCKS = 5

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
) -> IntervalResult:
    """Leave out one block of consecutive time after the other; how far the parameters move tells their 95% intervals.

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
      other parameters following, has fallen by D (t / z)^2 ln(1 / 0.05). Where no reading at all looks like the cause
      of a weight, that is the rule of three, 3 / (n / D). The design effect D is the variance above over that
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
    z, expected, _ = checked_beams(ranges, expected_ranges, max_range, min_range)
    times = as_floats(stamps, "stamps")
    require(times.shape == z.shape, "stamps", f"shape {z.shape}, as of ranges", times.shape)
    length = block_length(times, block_s)
    used = (expected < max_range) & ~np.isnan(z)
    if not used.any():
        raise TooLittleDataError(f"0 of {z.size} beams have a reading and a ray that hits something in the map")
    _, blocks = np.unique(time_blocks(times, block_s)[used], return_inverse=True)
    z, expected = z[used], expected[used]
    problem = learning_problem(
        max_range,
        min_range=min_range,
        hold=hold,
        priors=priors,
        fit_offset=fit_offset,
        fit_sigma_slope=fit_sigma_slope,
    )
    theta = problem.apply(theta_of(parameters))
    gradients, hessian = _derivatives_of_blocks(z, expected, blocks, theta, problem)
    result, _ = intervals_of_blocks(problem, theta, gradients, hessian, np.bincount(blocks), length)
    return result


def intervals_of_blocks(
    problem: LearningProblem,
    theta: FloatArray,
    gradients: FloatArray,
    hessian: FloatArray,
    sizes: NDArray[np.int64],
    length: float,
) -> tuple[IntervalResult, FloatArray]:
    """Return what `block_intervals` does from sums over the beams of each block, wherever they lie.

    theta (8,) is the working vector at the maximum; gradients (b, 8) are those of each block's log-likelihood there,
    the hessian (8, 8) that of all beams, sizes (b,) are beams of each block, and a block lasts `length` seconds.

    The second result is the covariance (8, 8) of the working vector: 0 for what is held or sits on a bound, NaN if
    there is one block only.
    """
    if len(sizes) == 1:
        nothing = np.full((N_PARAMETERS, N_PARAMETERS), np.nan)
        return IntervalResult({}, {}, LEVEL, 1, tuple(_findings(1, length))), nothing
    jackknife = Jackknife(problem, theta, gradients, hessian, sizes)
    learned = [name for name in _NAMES if problem.free[problem.position(name)]]
    intervals = IntervalResult(
        intervals={name: jackknife.interval(problem.position(name)) for name in learned},
        standard_errors={name: jackknife.standard_error(problem.position(name)) for name in learned},
        level=LEVEL,
        n_blocks=len(sizes),
        findings=tuple(_findings(len(sizes), length)),
    )
    return intervals, jackknife.errors.robust


def _derivatives_of_blocks(
    z: FloatArray, expected: FloatArray, blocks: NDArray[np.int64], theta: FloatArray, problem: LearningProblem
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
