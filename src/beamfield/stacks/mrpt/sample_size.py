"""How many particles MRPT draws: its KLD sampling."""

from __future__ import annotations

from statistics import NormalDist

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.stacks.filters.histogram import BinSizes, Histogram, chi_square_quantiles


def enough_particles(poses: FloatArray, sizes: BinSizes, least: int, error: float, delta: float) -> int | None:
    """Return how many of these poses (n, 3), from the first on, are enough; None if all are too few.

    With k bins, enough are round(q / (2 error)), where q is the 1 - delta quantile of chi-square with k - 1 degrees of
    freedom, and at least `least`. A bin reaches half its side to either side of a whole number of sides.

    References
    ----------
    MRPT, PF_implementations.h: PF_SLAM_implementation_pfStandardProposal; CMonteCarloLocalization2D.cpp:
    KLF_loadBinFromParticle.
    """
    quantiles = chi_square_quantiles(len(poses), NormalDist().inv_cdf(1.0 - delta))
    needed = np.maximum(np.rint(quantiles / (2.0 * error)), least)
    # The histogram wants the number that must be exceeded.
    found = Histogram(poses + 0.5 * np.array(sizes), sizes, needed - 1.0)
    return found.n_particles if found.is_enough else None
