"""MRPT's ways to draw particles by their weights."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray
from beamfield.stacks.filters.particles import draw_by_weight

# The cumulated weights are searched from the particle that holds the next lower of so many even thresholds.
THRESHOLDS = 20
METHODS = ("prMultinomial", "prResidual", "prStratified", "prSystematic")


def resampled(method: str, weights: FloatArray, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return n indices of particles, drawn by their weights (n,), which sum to 1.

    prMultinomial draws each for itself; prStratified one in every nth of the cumulated weights, and prSystematic all of
    these at the same distance. prResidual takes floor(n w) copies of each; for the r that are left, it uses the
    smallest r of n numbers, which favours the first particles.

    References
    ----------
    MRPT, CParticleFilterCapable.cpp: computeResampling.
    """
    n = len(weights)
    if method == "prMultinomial":
        return draw_by_weight(weights, n, rng)
    if method == "prResidual":
        copies = np.floor(n * weights).astype(np.int64)
        rest = weights - copies / n
        points = np.sort(rng.random(n))[: n - copies.sum()]
        return np.concatenate([np.repeat(np.arange(n), copies), _at(points, rest)])
    offsets = rng.random(n if method == "prStratified" else 1)
    return _at((np.arange(n) + offsets) / n, weights)


def fast_draws(weights: FloatArray, n: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return n indices of particles, each drawn for itself, about by their weights (m,), which sum to 1.

    The search begins at a threshold as if the whole weight of the particle that holds it came after it: that particle
    is drawn too often and those before the next threshold too rarely, the more so the heavier they are.

    References
    ----------
    MRPT, CParticleFilterCapable.cpp: prepareFastDrawSample, fastDrawSample.
    """
    sums = np.cumsum(weights)
    sums[-1] = 1.0
    thresholds = np.arange(THRESHOLDS) / THRESHOLDS
    holds = np.searchsorted(sums, thresholds, side="right")
    draws = rng.random(n)
    at = (draws * (THRESHOLDS - 0.05)).astype(np.int64)
    before = np.where(holds > 0, sums[holds - 1], 0.0)
    points = draws - thresholds[at] + before[at]
    return np.maximum(np.searchsorted(sums, points, side="left"), holds[at])


def _at(points: FloatArray, weights: FloatArray) -> NDArray[np.int64]:
    """Return where points of [0, 1) lie on the cumulated weights."""
    sums = np.cumsum(weights)
    return np.minimum(np.searchsorted(sums / sums[-1], points, side="right"), len(weights) - 1)
