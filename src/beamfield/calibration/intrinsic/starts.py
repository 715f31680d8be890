"""Where to start learning: first guesses that the data themselves suggest."""

from __future__ import annotations

import numpy as np

from beamfield.calibration.intrinsic.learning_problem import LearningProblem
from beamfield.calibration.intrinsic.likelihood import IntrinsicLikelihood
from beamfield.geometry import FloatArray

# Each start: width of a hit relative to the robust spread, lambda relative to 1 / mean of the near shorts, and how
# hits, shorts and random readings share what returned. They span the ways in which causes can trade places: shorts
# uniform or near the sensor, hits narrow or wide, the tail given to shorts or to random readings.
_STARTS = (
    (1.0, 1.0, (0.70, 0.15, 0.15)),
    (1.0, 0.0, (0.75, 0.20, 0.05)),
    (0.5, 0.3, (0.50, 0.25, 0.25)),
    (2.0, 3.0, (0.80, 0.05, 0.15)),
    (0.3, 0.0, (0.40, 0.30, 0.30)),
    (3.0, 0.3, (0.60, 0.35, 0.05)),
)
# Median of |x| of a standard normal variable.
_MEDIAN_ABSOLUTE = 0.6745
MOST_STARTS = len(_STARTS)


def data_driven_starts(likelihood: IntrinsicLikelihood, problem: LearningProblem, n: int) -> list[FloatArray]:
    """Return n (1 to 6) valid working vectors (8,) to climb from, widest hopes first; one if no beam has a return."""
    z, expected = likelihood.ranges, likelihood.expected
    max_range = likelihood.max_range
    share_max = likelihood.n_max / likelihood.n_beams
    if z.size == 0:
        return [problem.apply(np.array([0.0, 0.0, 1.0, 0.0, (0.01 * max_range) ** 2, 0.0, 0.0, 0.0]))]
    error = z - expected
    offset = float(np.clip(np.median(error), problem.lower[6], problem.upper[6]))
    deviation = np.abs(error - offset)
    spread = max(float(np.median(deviation)) / _MEDIAN_ABSOLUTE, 1e-4 * max_range)
    near = z[error < offset - 4.0 * spread]
    rate = 1.0 / max(float(near.mean()), 1e-3 * max_range) if near.size else 1.0 / float(max(expected.mean(), 1e-3))
    starts = []
    for width, relative_rate, (hit, short, rand) in _STARTS[:n]:
        returned = 1.0 - share_max
        variance = (width * spread) ** 2
        slope = (0.3 * width * spread / max(float(np.median(expected)), 1e-3 * max_range)) ** 2
        theta = np.array(
            [
                hit * returned,
                short * returned,
                share_max,
                rand * returned,
                variance,
                slope,
                offset,
                relative_rate * rate,
            ]
        )
        starts.append(problem.apply(theta))
    return starts
