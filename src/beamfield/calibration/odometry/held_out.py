"""Blocks of consecutive update steps: what is learned without one of them is judged on it, and tells intervals."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from beamfield.geometry import FloatArray

# Windows of two blocks share steps: a block is at least so many windows long.
WINDOWS_OF_A_BLOCK = 2
MOST_BLOCKS = 16
# With fewer, an interval of Student's t says nothing, and no family of models is preferred to another.
FEWEST_BLOCKS = 4


@dataclass(frozen=True, eq=False)
class Blocks:
    """Which block each window begins and ends in.

    Parameters
    ----------
    begins, ends
        (w,) numbers from 0.
    n
        How many blocks there are.
    """

    begins: NDArray[np.int64]
    ends: NDArray[np.int64]
    n: int

    def without(self, block: int) -> NDArray[np.bool_]:
        """Return which windows (w,) touch nothing of a block."""
        return np.asarray((self.begins > block) | (self.ends < block))

    def inside(self, block: int) -> NDArray[np.bool_]:
        """Return which windows (w,) lie in a block."""
        return np.asarray((self.begins == block) & (self.ends == block))


def blocks_of(first: NDArray[np.int64], length: int) -> Blocks:
    """Return blocks of equal numbers of steps, by the step (w,), ascending, that each window begins with."""
    origin, n_steps = int(first[0]), int(first[-1] - first[0] + length)
    n = min(max(n_steps // (WINDOWS_OF_A_BLOCK * length), 1), MOST_BLOCKS)
    begins = (first - origin) * n // n_steps
    return Blocks(begins, (first - origin + length - 1) * n // n_steps, n)


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Log densities of windows under levels learned without their block.

    Parameters
    ----------
    by_block
        (b,) mean nats per window of each block; NaN where it has none.
    """

    by_block: FloatArray

    @property
    def mean(self) -> float:
        """Nats per window, each block counting alike; NaN if there are none."""
        return _nan_mean(self.by_block)

    def gain_over(self, other: HeldOut) -> tuple[float, float]:
        """Return the mean difference to another and its standard error over blocks."""
        difference = self.by_block - other.by_block
        difference = difference[np.isfinite(difference)]
        if len(difference) < 2:
            return _nan_mean(difference), math.inf
        return float(difference.mean()), float(difference.std(ddof=1) / math.sqrt(len(difference)))


def judged(log_density: FloatArray, blocks: Blocks) -> HeldOut:
    """Return given log densities (w,) by block: of windows in a single block alone."""
    density = np.where(blocks.begins == blocks.ends, log_density, np.nan)
    by_block = np.array([_nan_mean(density[blocks.inside(block)]) for block in range(blocks.n)])
    return HeldOut(by_block)


def jackknife_intervals(estimate: FloatArray, without: FloatArray) -> FloatArray:
    """Return intervals (k, 2) of estimates (k,) from those (b, k) without each block; infinite for too few blocks."""
    deviation = np.sqrt(np.diag(jackknife_covariance(without, len(estimate))))
    reach = float(stdtrit(max(len(without) - 1, 1), 0.975)) * deviation
    return np.column_stack([estimate - reach, estimate + reach])


def jackknife_covariance(without: FloatArray, k: int) -> FloatArray:
    """Return the covariance (k, k) of estimates from those (b, k) without each block; infinite for too few blocks."""
    n = len(without)
    if n < FEWEST_BLOCKS:
        return np.diag(np.full(k, np.inf))
    off = without - without.mean(axis=0)
    return np.asarray((n - 1) / n * off.T @ off)


def _nan_mean(values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    return float(finite.mean()) if len(finite) else math.nan
