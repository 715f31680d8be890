"""Intervals of learned parameters that respect that neighbouring beams and scans depend on each other."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr, stdtrit

from beamfield.arguments import as_count, as_floats, checked
from beamfield.calibration.climb import climb
from beamfield.calibration.finding import Finding
from beamfield.calibration.identifiability import FEWEST_BEAMS_OF_A_CAUSE
from beamfield.calibration.intrinsic_likelihood import RATE, W_SHORT, IntrinsicLikelihood, parameters_of, theta_of
from beamfield.calibration.learning_problem import LearningProblem, learning_problem
from beamfield.calibration.priors import IntrinsicPriors
from beamfield.calibration.time_split import time_blocks
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import FloatArray
from beamfield.kernels.threads import run_in_slices
from beamfield.models.beam_parameters import BeamParameters
from beamfield.thread_count import check_threads

# Fewer blocks tell too little of how parameters vary from one stretch of time to the next.
FEWEST_TRUSTED_BLOCKS = 8
# More beams are thinned to this many. What is lost is noise within blocks, far smaller than that between them.
MOST_BEAMS = 400_000
# A replicate is found when one more Newton step promises less than this many nats over all its beams: a fifth of a
# naive standard error, hence a few per cent of an interval's half width.
_NATS_LEFT = 0.02
_MOST_ITERATIONS = 30

_NAMES = tuple(item.name for item in fields(BeamParameters))
_RATE_COLUMN = _NAMES.index("lambda_short")


@dataclass(frozen=True, eq=False)
class IntervalResult:
    """Intervals by block bootstrap.

    Parameters
    ----------
    intervals
        (low, high) per learned parameter, by the names of `BeamParameters`; empty where there is one block only.
        (0, inf) for lambda_short where it is undetermined: fewer than 3 beams look like unexpected objects, or
        replicates reach the bound of the search.
    standard_errors
        Standard deviation of the replicates per learned parameter; inf where it is undetermined.
    replicates
        Learned parameters of each replicate, shape (n_replicates, 8), in the order of `BeamParameters`.
    level
        The share of such intervals that are to hold the truth.
    n_blocks
        Blocks of time that were resampled.
    findings
        Warnings.
    """

    intervals: Mapping[str, tuple[float, float]]
    standard_errors: Mapping[str, float]
    replicates: FloatArray
    level: float
    n_blocks: int
    findings: tuple[Finding, ...]


@checked
def bootstrap_intervals(
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
    block_s: float | None = 20.0,
    n_replicates: int = 200,
    level: float = 0.95,
    seed: int = 0,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> IntervalResult:
    """Resample blocks of consecutive time with replacement, learn again from each sample, return percentiles.

    Beams of one scan and neighbouring scans err together: intervals from the curvature of the likelihood are 4 to 24
    times too narrow. Blocks of 20 s hold what hangs together.

    Parameters
    ----------
    ranges, expected_ranges, max_range
        As `learn_intrinsic_parameters`.
    stamps
        Time of each beam, seconds, shape (n,).
    parameters
        What was learned from all beams with the same options; each replicate starts there.
    min_range, fit_offset, fit_sigma_slope, hold, priors
        As `learn_intrinsic_parameters`.
    block_s
        Length of a block, seconds; None: 20 s, or less for a short log.
    n_replicates
        Number of samples.
    level
        Share of intervals that are to hold the truth.
    seed
        For the samples.
    threads
        Number of threads; None uses what pays. It changes no bit of the result.
    progress
        Called with the number of finished replicates and their total.

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
    Each replicate is learned for real, by Newton steps with bounds from `parameters` (the first of them free, from
    derivatives summed per block), because a linearisation breaks where a parameter sits on its bound: lambda_short = 0
    and weights of 0 are frequent. Percentiles are taken further out than `level` says, by Student's t for the number of
    blocks (Hesterberg's expanded percentile interval), since few blocks vary less than their population.

    References
    ----------
    Kuensch, "The jackknife and the bootstrap for general stationary observations", Annals of Statistics 17, 1989.
    Hesterberg, "What teachers should know about the bootstrap", American Statistician 69, 2015.

    Examples
    --------
    Hits alone, whose noise is known to a hundredth of its size:

    >>> rng = np.random.default_rng(0)
    >>> expected = rng.uniform(1.0, 9.0, 2000)
    >>> ranges, stamps = rng.normal(expected, 0.05), np.arange(2000) * 0.1
    >>> hold = {"z_short": 0.0, "z_max": 0.0, "z_rand": 0.0, "lambda_short": 0.0}
    >>> truth = BeamParameters(1.0, 0.0, 0.0, 0.0, sigma_hit=0.05, lambda_short=0.0)
    >>> result = bootstrap_intervals(ranges, expected, stamps, 10.0, truth, hold=hold, n_replicates=50)
    >>> low, high = result.intervals["sigma_hit"]
    >>> low < 0.05 < high, high - low < 0.01
    (True, True)
    """
    check_threads(threads)
    z, expected, blocks = _checked(ranges, expected_ranges, stamps, max_range, min_range, block_s)
    as_count(n_replicates, "n_replicates", least=2, most=1_000_000)
    as_count(seed, "seed", least=0)
    if not 0.0 < level < 1.0:
        raise InvalidInputError(f"level: expected a share between 0 and 1, got {level}")
    problem = learning_problem(
        float(max_range),
        min_range=float(min_range),
        hold=hold,
        priors=priors,
        fit_offset=fit_offset,
        fit_sigma_slope=fit_sigma_slope,
    )
    rng = np.random.default_rng(seed)
    n_used = z.size
    z, expected, blocks = _thinned(z, expected, blocks, rng)
    _, blocks = np.unique(blocks, return_inverse=True)
    n_blocks = int(blocks.max()) + 1
    theta = problem.apply(theta_of(parameters))
    if n_blocks == 1:
        return IntervalResult({}, {}, np.empty((0, len(_NAMES))), level, 1, _findings(1))

    draws = rng.multinomial(n_blocks, np.full(n_blocks, 1.0 / n_blocks), size=n_replicates)
    replicates = _learn_replicates(z, expected, blocks, theta, problem, draws, threads, progress)
    tail = expanded_tail(level, n_blocks)
    n_shorts = _n_shorts(z, expected, theta, problem) * n_used / z.size
    is_undetermined = n_shorts < FEWEST_BEAMS_OF_A_CAUSE or _reaches_ceiling(replicates, tail, problem)
    centre = _parameter_row(theta)
    if z.size < np.size(ranges):  # thinned beams have an estimate of their own: keep the deviations, not the places
        everything = np.ones((1, n_blocks), dtype=np.int64)
        own = _learn_replicates(z, expected, blocks, theta, problem, everything, threads, None)[0]
        replicates = np.maximum(replicates - own + centre, np.where(np.array(_NAMES) == "range_offset", -np.inf, 0.0))
    low, high = np.quantile(replicates, [tail, 1.0 - tail], axis=0)
    errors = replicates.std(axis=0, ddof=1)
    if is_undetermined:
        low[_RATE_COLUMN], high[_RATE_COLUMN], errors[_RATE_COLUMN] = 0.0, np.inf, np.inf
    learned = [i for i, name in enumerate(_NAMES) if _is_free(name, problem)]
    return IntervalResult(
        intervals={_NAMES[i]: (float(low[i]), float(high[i])) for i in learned},
        standard_errors={_NAMES[i]: float(errors[i]) for i in learned},
        replicates=replicates,
        level=level,
        n_blocks=n_blocks,
        findings=_findings(n_blocks),
    )


def _checked(
    ranges: ArrayLike,
    expected_ranges: ArrayLike,
    stamps: ArrayLike,
    max_range: float,
    min_range: float,
    block_s: float | None,
) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    z, expected, times = (
        as_floats(values, name)
        for name, values in (("ranges", ranges), ("expected_ranges", expected_ranges), ("stamps", stamps))
    )
    for name, column in (("ranges", z), ("expected_ranges", expected), ("stamps", times)):
        if column.shape != z.shape or column.ndim != 1:
            raise InvalidInputError(f"{name}: expected one dimension as long as ranges, got shape {column.shape}")
    for name, column, least in (("ranges", z, min_range), ("expected_ranges", expected, 0.0)):
        if not (column >= least).all():
            index = int(np.flatnonzero(~(column >= least))[0])
            raise InvalidInputError(f"{name}[{index}]: expected a number >= {least:g}, got {column[index]}")
    if not np.isfinite(times).all():
        index = int(np.flatnonzero(~np.isfinite(times))[0])
        raise InvalidInputError(f"stamps[{index}]: expected a finite number of seconds, got {times[index]}")
    used = expected < max_range
    if not used.any():
        raise TooLittleDataError(f"0 of {z.size} beams have a ray that hits something in the map")
    blocks = time_blocks(times, block_s)
    return z[used], expected[used], blocks[used]


def _thinned(
    z: FloatArray, expected: FloatArray, blocks: NDArray[np.int64], rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    if z.size <= MOST_BEAMS:
        return z, expected, blocks
    chosen = np.sort(rng.choice(z.size, MOST_BEAMS, replace=False))
    return z[chosen], expected[chosen], blocks[chosen]


def _learn_replicates(
    z: FloatArray,
    expected: FloatArray,
    blocks: NDArray[np.int64],
    theta: FloatArray,
    problem: LearningProblem,
    draws: NDArray[np.int64],
    threads: int | None,
    progress: Callable[[int, int], None] | None,
) -> FloatArray:
    """Learn once per row of `draws`, which says how often each block counts; returns parameters, shape (rows, 8)."""
    whole = _likelihood(z, expected, problem)
    values, gradients, hessians = _derivatives_per_block(z, expected, blocks, theta, problem)
    out = np.empty((len(draws), len(_NAMES)))
    lock = threading.Lock()
    n_done = 0

    def work(first: int, last: int) -> None:
        nonlocal n_done
        for row in range(first, last):
            counts = draws[row].astype(np.float64)
            sample = whole.reweighted(counts[blocks])
            end = climb(
                sample,
                problem,
                theta,
                tolerance=_NATS_LEFT / sample.n_beams,
                max_iterations=_MOST_ITERATIONS,
                em_steps_first=0,
                known=(
                    float(counts @ values),
                    counts @ gradients,
                    np.tensordot(counts, hessians, axes=1),
                ),
            )
            out[row] = _parameter_row(end.theta)
            with lock:
                n_done += 1
                if progress is not None:
                    progress(n_done, len(draws))

    run_in_slices(work, len(draws), threads=threads, work_per_row=z.size)
    return out


def _derivatives_per_block(
    z: FloatArray, expected: FloatArray, blocks: NDArray[np.int64], theta: FloatArray, problem: LearningProblem
) -> tuple[FloatArray, FloatArray, FloatArray]:
    order = np.argsort(blocks, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(blocks))[:-1])
    derivatives = [_likelihood(z[part], expected[part], problem).derivatives(theta) for part in parts]
    return (
        np.array([item[0] for item in derivatives]),
        np.stack([item[1] for item in derivatives]),
        np.stack([item[2] for item in derivatives]),
    )


def _likelihood(z: FloatArray, expected: FloatArray, problem: LearningProblem) -> IntrinsicLikelihood:
    return IntrinsicLikelihood(z, expected, problem.max_range, min_range=problem.min_range, threads=1)


def _parameter_row(theta: FloatArray) -> FloatArray:
    parameters = parameters_of(theta)
    return np.array([getattr(parameters, name) for name in _NAMES])


def _n_shorts(z: FloatArray, expected: FloatArray, theta: FloatArray, problem: LearningProblem) -> float:
    """Return how many of these beams look like unexpected objects, by their responsibilities."""
    return float(_likelihood(z, expected, problem).expected_statistics(theta).counts[W_SHORT])


def _reaches_ceiling(replicates: FloatArray, tail: float, problem: LearningProblem) -> bool:
    """Return whether the interval of lambda_short would end where the search does, which says nothing about it."""
    # Not interpolated: half way from a rate to the ceiling is no bound either.
    end = np.quantile(replicates[:, _RATE_COLUMN], 1.0 - tail, method="higher")
    return bool(problem.free[RATE] and end >= problem.upper[RATE])


def _is_free(name: str, problem: LearningProblem) -> bool:
    return bool(problem.free[problem.position(name)])


def expanded_tail(level: float, n_blocks: int) -> float:
    """Return the share of the replicates beyond each end of an interval from so many blocks (Hesterberg).

    Parameters
    ----------
    level
        Share of intervals that are to hold the truth.
    n_blocks
        Number of blocks, at least 2.

    Returns
    -------
    A share below (1 - level) / 2, which it approaches with more blocks.

    Examples
    --------
    >>> round(expanded_tail(0.95, 10), 4), round(expanded_tail(0.95, 1000), 4)
    (0.0086, 0.0248)
    """
    quantile = stdtrit(n_blocks - 1, 0.5 * (1.0 - level))
    return float(ndtr(np.sqrt(n_blocks / (n_blocks - 1.0)) * quantile))


def _findings(n_blocks: int) -> tuple[Finding, ...]:
    if n_blocks == 1:
        return (
            Finding(
                "no-intervals",
                "warning",
                "All beams lie in one block of time, so there are no intervals: a longer log is needed.",
                {"n_blocks": 1.0},
            ),
        )
    if n_blocks < FEWEST_TRUSTED_BLOCKS:
        return (
            Finding(
                "few-blocks",
                "warning",
                f"The intervals rest on {n_blocks} blocks of time, fewer than {FEWEST_TRUSTED_BLOCKS}, and are rough: "
                "a longer log would settle them.",
                {"n_blocks": float(n_blocks)},
            ),
        )
    return ()
