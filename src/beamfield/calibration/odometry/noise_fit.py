"""Maximum likelihood of the levels of several kinds of noise, in normal residuals."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray
from beamfield.kernels.window_noise import negative_log_likelihood

# Levels are searched between these; below, the reference's error hides all noise.
LEAST_LEVEL, LARGEST_LEVEL = 1e-7, 30.0
# Windows this unlikely (one in a million of a normal of three dimensions) are faults, not noise; but never more than
# this share of them.
FAULT_NEES = 30.7
MOST_FAULTS = 0.1
MEDIAN_NEES = 2.366
# Steps of the search, and the longest one in the logarithm of a level.
MOST_STEPS, LONGEST_STEP = 60, 2.0
# What is added to a step's curvature, as a share of it, and how often levels take turns where a step meets bounds.
RIDGE, SWEEPS = 1e-6, 30


def fit_levels(
    residuals: FloatArray, reference: FloatArray, units: FloatArray, start: FloatArray | None = None
) -> FloatArray:
    """Return the levels (k,) that make the windows likeliest, by their residuals (w, 3).

    The reference (w, 3, 3) is the known covariance, the units (k, w, 3, 3) are what level 1 of each kind of noise adds
    to it. The start (k,) is positive; None: where the median window is as far off as it should be.
    """
    start = common_start(residuals, reference, units) if start is None else start
    by_window = np.ascontiguousarray(np.swapaxes(units, 0, 1))
    residuals, reference = np.ascontiguousarray(residuals), np.ascontiguousarray(reference)
    gradient, information = np.empty(len(start)), np.empty((len(start), len(start)))

    def loss(at: FloatArray) -> float:
        return float(negative_log_likelihood(residuals, reference, by_window, np.exp(at), gradient, information))

    # Fisher scoring in the logarithms of the levels, with steps halved until the likelihood rises.
    low, high = np.log(LEAST_LEVEL), np.log(LARGEST_LEVEL)
    at = np.log(start)
    value = loss(at)
    for _ in range(MOST_STEPS):
        levels = np.exp(at)
        # Each level has bounds of its own: a long step of one that hardly shows must not shorten the others'.
        step = _step_within(
            gradient * levels, information * np.outer(levels, levels),
            np.maximum(low - at, -LONGEST_STEP), np.minimum(high - at, LONGEST_STEP),
        )  # fmt: skip
        for _ in range(20):
            there = np.clip(at + step, low, high)
            new = loss(there)
            if new <= value:
                break
            step *= 0.5
        moved, gained = float(np.abs(there - at).max()), value - new
        if gained < 0.0:
            break
        at, value = there, new
        if moved < 1e-6 or gained < 1e-9 * len(residuals):
            break
    return np.asarray(np.exp(at))


def _step_within(slope: FloatArray, curvature: FloatArray, low: FloatArray, high: FloatArray) -> FloatArray:
    """Return the step (k,) within bounds that lowers the quadratic of a slope and a curvature; 0 where that is flat."""
    step, shown = np.zeros(len(slope)), np.flatnonzero(curvature.diagonal() > 0.0)
    slope, curvature, low, high = slope[shown], curvature[np.ix_(shown, shown)], low[shown], high[shown]
    # Of levels that no window tells apart, neither leads astray.
    curvature = curvature + np.diag(RIDGE * curvature.diagonal())
    best = -np.linalg.solve(curvature, slope)
    if (best < low).any() or (best > high).any():
        best = np.zeros(len(shown))
        for _ in range(SWEEPS):
            for i in range(len(shown)):
                wanted = best[i] - (slope[i] + curvature[i] @ best) / curvature[i, i]
                best[i] = min(max(wanted, low[i]), high[i])
    step[shown] = best
    return step


def common_start(residuals: FloatArray, reference: FloatArray, units: FloatArray) -> FloatArray:
    """Return equal levels (k,) at which the median window is as far off as it should be; wild ones do not count."""
    low, high = np.log(LEAST_LEVEL), np.log(LARGEST_LEVEL)
    for _ in range(30):
        middle = 0.5 * (low + high)
        covariance = reference + np.exp(middle) * units.sum(axis=0)
        wide = float(np.median(squared_distances(residuals, covariance))) < MEDIAN_NEES
        low, high = (low, middle) if wide else (middle, high)
    return np.full(len(units), np.exp(0.5 * (low + high)))


def matched_levels(covariances: FloatArray, units: FloatArray) -> FloatArray:
    """Return equal levels (k,) whose noise is as wide as given covariances (w, 3, 3), in position and heading alike."""
    ours, theirs = units.sum(axis=0), covariances
    position = np.trace(theirs[:, :2, :2].sum(axis=0)) / np.trace(ours[:, :2, :2].sum(axis=0))
    heading = theirs[:, 2, 2].sum() / ours[:, 2, 2].sum()
    return np.full(len(units), np.sqrt(position * heading))


def not_faults(residuals: FloatArray, reference: FloatArray, units: FloatArray) -> NDArray[np.bool_]:
    """Return which windows (w,) are noise and not faults of the odometry: no slips, missed turns, lost signs."""
    levels = common_start(residuals, reference, units)
    kept = np.zeros(len(residuals), dtype=np.bool_)
    for _ in range(10):
        distances = squared_distances(residuals, reference + np.tensordot(levels, units, 1))
        before, kept = kept, distances <= max(FAULT_NEES, float(np.quantile(distances, 1.0 - MOST_FAULTS)))
        if np.array_equal(before, kept):
            break
        levels = fit_levels(residuals[kept], reference[kept], units[:, kept], levels)
    return kept


def log_densities(residuals: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the log density of each residual (w, 3) under a normal of mean 0: (w,)."""
    spread = np.linalg.slogdet(covariance)[1] + 3.0 * np.log(2.0 * np.pi)
    return np.asarray(-0.5 * (spread + squared_distances(residuals, covariance)))


def squared_distances(residuals: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the normalised error squared of each residual (w, 3): (w,)."""
    solved = np.linalg.solve(covariance, residuals[:, :, None])[:, :, 0]
    return np.asarray(np.sum(residuals * solved, axis=1))
