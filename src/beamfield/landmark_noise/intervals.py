"""Intervals of a landmark sensor's noise by resampling stretches of time."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit

from beamfield.arguments import require
from beamfield.calibration.block_errors import share_interval
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.kernels.threads import run_in_blocks
from beamfield.landmark_noise.em import NoiseLikelihood, NoiseTheta, climb_noise

# The share of intervals that are to hold the truth.
LEVEL = 0.95
# A replicate is found when further iterations promise less than this over all its sightings: a fifth of the standard
# error that independent sightings would have, and theirs depend.
_NATS_LEFT = 0.02
_MOST_ITERATIONS = 200


@dataclass(frozen=True, eq=False)
class NoiseIntervals:
    """95% intervals and standard errors per learned parameter, from a bootstrap of blocks of time or place.

    There are no intervals where there is one block only.
    """

    intervals: Mapping[str, tuple[float, float]]
    standard_errors: Mapping[str, float]
    n_blocks: int


def noise_intervals(
    likelihood: NoiseLikelihood,
    blocks: NDArray[np.int64],
    theta: NoiseTheta,
    *,
    n_replicates: int,
    seed: int,
    progress: Callable[[int, int], None] | None,
) -> NoiseIntervals:
    """Resample blocks with replacement and learn again from each sample: how far the samples scatter tells intervals.

    `blocks` (n,) holds the block of each sighting, `theta` what was learned from all, where each replicate starts;
    `progress` is called with the finished replicates and their total. There are no intervals where there is one block,
    and InvalidInputError where there are fewer than two replicates.

    With s the standard deviation of the replicates times sqrt(B / (B - 1)) for B blocks, which vary less than what they
    are drawn from, and t, z the quantiles of Student's distribution of B - 1 degrees of freedom and of the normal one:

    - Biases and scale: estimate -+ t s. Sigmas: the same for their logarithms.
    - The spurious rate p: Clopper and Pearson's interval for p (1 - p) / (s t / z)^2 independent sightings (Korn and
      Graubard); where no sighting is spurious, the rule of three, times (t / z)^2.

    Percentiles would not do: those that few blocks need lie beyond the outermost of some hundred replicates.

    References: Efron and Tibshirani, "An Introduction to the Bootstrap", 1993, chapters 6 and 12; Korn and Graubard,
    "Confidence intervals for proportions with small expected number of positive counts estimated from survey data",
    Survey Methodology 24, 1998.
    """
    require(n_replicates >= 2, "n_replicates", "at least 2", n_replicates)
    _, number = np.unique(blocks, return_inverse=True)
    n_blocks = int(number.max()) + 1
    if n_blocks == 1:
        return NoiseIntervals({}, {}, 1)
    rng = np.random.default_rng(seed)
    draws = rng.multinomial(n_blocks, np.full(n_blocks, 1.0 / n_blocks), size=n_replicates)
    replicates = _replicates(likelihood, number, theta, draws, progress)
    scatter = replicates.std(axis=0, ddof=1) * math.sqrt(n_blocks / (n_blocks - 1))
    errors = {name: float(scatter[NoiseTheta._fields.index(name)]) for name in _learned(likelihood)}
    intervals = {name: _interval(name, theta, error, n_blocks, len(likelihood)) for name, error in errors.items()}
    return NoiseIntervals(intervals, errors, n_blocks)


def _interval(name: str, theta: NoiseTheta, error: float, n_blocks: int, n_sightings: int) -> tuple[float, float]:
    value = getattr(theta, name)
    t = float(stdtrit(n_blocks - 1, 0.5 + 0.5 * LEVEL))
    if name == "spurious_rate":
        wider = t / float(ndtri(0.5 + 0.5 * LEVEL))
        if value * n_sightings < 1.0 or error == 0.0:
            return 0.0, min(max(value + t * error, -math.log(1.0 - LEVEL) * wider**2 / n_sightings), 1.0)
        return share_interval(value, (error * wider) ** 2, 1.0 - LEVEL)
    if name in ("sigma_range", "sigma_bearing"):
        return value * math.exp(-t * error / value), value * math.exp(t * error / value)
    return value - t * error, value + t * error


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
        "range_bias": has_range,
        "range_scale": has_range and problem.fit_scale,
        "sigma_range": has_range,
        "bearing_bias": has_bearing,
        "sigma_bearing": has_bearing,
        "spurious_rate": problem.fit_spurious,
    }
    return [name for name, is_learned in learned.items() if is_learned]
