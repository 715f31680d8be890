"""Intervals of a landmark sensor's noise by resampling stretches of time."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtrit

from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.kernels.threads import run_in_blocks
from beamfield.landmark_noise.em import NoiseLikelihood, NoiseTheta, climb_noise

# A replicate is found when further iterations promise less than this over all its sightings: a fifth of the standard
# error that independent sightings would have, and theirs depend.
_NATS_LEFT = 0.02
_MOST_ITERATIONS = 200


@dataclass(frozen=True, eq=False)
class NoiseIntervals:
    """Intervals by block bootstrap.

    Parameters
    ----------
    intervals
        (low, high) per learned parameter; empty where there is one block only.
    standard_errors
        Standard deviation of the replicates per learned parameter.
    level
        The share of such intervals that are to hold the truth.
    n_blocks
        Stretches of time or place that were resampled.
    """

    intervals: Mapping[str, tuple[float, float]]
    standard_errors: Mapping[str, float]
    level: float
    n_blocks: int


def noise_intervals(
    likelihood: NoiseLikelihood,
    blocks: NDArray[np.int64],
    theta: NoiseTheta,
    *,
    n_replicates: int = 200,
    level: float = 0.95,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> NoiseIntervals:
    """Resample blocks with replacement, learn again from each sample, return percentiles.

    Parameters
    ----------
    likelihood
        The sightings.
    blocks
        (n,) block of each sighting.
    theta
        What was learned from all sightings; each replicate starts there.
    n_replicates, level, seed
        Number of samples, share of intervals that are to hold the truth, and the seed for the samples.
    progress
        Called with the number of finished replicates and their total.

    Returns
    -------
    Intervals and standard errors of what was learned; none where there is one block.

    Raises
    ------
    InvalidInputError
        If there are fewer than two replicates, or the level is no share.

    Notes
    -----
    Percentiles are taken further out than `level` says, by Student's t for the number of blocks (Hesterberg's expanded
    percentile interval): few blocks vary less than what they are drawn from.

    References
    ----------
    Hesterberg, "What teachers should know about the bootstrap", American Statistician 69, 2015.
    """
    if n_replicates < 2:
        raise InvalidInputError(f"n_replicates: expected at least 2, got {n_replicates}")
    if not 0.0 < level < 1.0:
        raise InvalidInputError(f"level: expected a share between 0 and 1, got {level}")
    _, number = np.unique(blocks, return_inverse=True)
    n_blocks = int(number.max()) + 1
    if n_blocks == 1:
        return NoiseIntervals({}, {}, level, 1)
    rng = np.random.default_rng(seed)
    draws = rng.multinomial(n_blocks, np.full(n_blocks, 1.0 / n_blocks), size=n_replicates)
    replicates = _replicates(likelihood, number, theta, draws, progress)
    tail = _expanded_tail(level, n_blocks)
    low, high = np.quantile(replicates, [tail, 1.0 - tail], axis=0)
    learned = [NoiseTheta._fields.index(name) for name in _learned(likelihood)]
    names = NoiseTheta._fields
    rate, n = names.index("spurious_rate"), len(likelihood)
    if theta.spurious_rate * n < 1.0:
        # Samples of blocks without a spurious sighting have none; the rule of three says what that excludes.
        low[rate], high[rate] = 0.0, max(high[rate], 3.0 / n)
    return NoiseIntervals(
        {names[i]: (float(low[i]), float(high[i])) for i in learned},
        {names[i]: float(replicates[:, i].std(ddof=1)) for i in learned},
        level,
        n_blocks,
    )


def _replicates(
    likelihood: NoiseLikelihood,
    number: NDArray[np.int64],
    theta: NoiseTheta,
    draws: NDArray[np.int64],
    progress: Callable[[int, int], None] | None,
) -> FloatArray:
    out: FloatArray = np.empty((len(draws), len(theta)))

    lock = threading.Lock()
    n_done = 0

    def work(first: int, last: int) -> None:
        nonlocal n_done
        for row in range(first, last):
            weights = draws[row].astype(np.float64)[number]
            # A sample of blocks without a single sighting tells nothing; it keeps the estimate.
            end = theta
            if weights.sum() > 0.0:
                tolerance = _NATS_LEFT / weights.sum()
                climbed = climb_noise(
                    likelihood, theta, weights=weights, tolerance=tolerance, max_iterations=_MOST_ITERATIONS
                )
                end = climbed.theta
            out[row] = end
            with lock:
                n_done += 1
                if progress is not None:
                    progress(n_done, len(draws))

    run_in_blocks(work, len(draws), work_per_row=20 * len(likelihood))
    bearing = NoiseTheta._fields.index("bearing_bias")
    out[:, bearing] = theta.bearing_bias + wrap_angle(out[:, bearing] - theta.bearing_bias)
    return out


def _learned(likelihood: NoiseLikelihood) -> list[str]:
    problem = likelihood.problem
    has_range = bool((likelihood.has_range & likelihood.real).any())
    has_bearing = bool((likelihood.has_bearing & likelihood.real).any())
    learned = {
        "range_bias": has_range and problem.fit_range_bias,
        "range_scale": has_range and problem.fit_scale,
        "sigma_range": has_range,
        "bearing_bias": has_bearing and problem.fit_bearing_bias,
        "sigma_bearing": has_bearing,
        "spurious_rate": problem.fit_spurious,
    }
    return [name for name, is_learned in learned.items() if is_learned]


def _expanded_tail(level: float, n_blocks: int) -> float:
    """Return the share of the replicates beyond each end of an interval from so many blocks (Hesterberg).

    It is below (1 - level) / 2, which it approaches with more blocks.
    """
    quantile = stdtrit(n_blocks - 1, 0.5 * (1.0 - level))
    return float(ndtr(np.sqrt(n_blocks / (n_blocks - 1.0)) * quantile))
