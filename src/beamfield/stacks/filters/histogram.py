"""Particles counted in bins: how many are enough, and which belong together."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray
from beamfield.kernels.bins import STEPS, fill_codes, join_bins, number_bins

Indices = NDArray[np.int64]

_NEIGHBOURS = np.array([a * STEPS[0] + b * STEPS[1] + c for a in (-1, 0, 1) for b in (-1, 0, 1) for c in (-1, 0, 1)])


class BinSizes(NamedTuple):
    """Sides of the bins in x and y, metres, and in the heading, radians."""

    x: float
    y: float
    heading: float


class Histogram:
    """The bins of particles, as long as there are not enough of them.

    Parameters
    ----------
    poses
        (n, 3). Headings are taken as they are: what differs by a full turn lies in different bins.
    sizes
        Of the bins.
    limits
        How many particles are enough with 1, 2, ... bins, see `kld_limits`; None to take them all.

    Attributes
    ----------
    n_particles, n_bins
        How many of the particles were taken: the first whose number exceeds the limit is the last. And their bins.
    is_enough
        Whether there was one whose number exceeds the limit.
    """

    def __init__(self, poses: FloatArray, sizes: BinSizes, limits: FloatArray | None = None) -> None:
        codes = bin_codes(poses, sizes, poses[0] if len(poses) else np.zeros(3))
        self._slots = np.full(1 << (2 * len(codes) + 1).bit_length(), -1)
        self._bins, self._bin_of = np.empty_like(codes), np.empty_like(codes)
        none = np.empty(0)
        self.n_particles, self.n_bins, self.is_enough = number_bins(
            codes, none if limits is None else limits, self._slots, self._bins, self._bin_of
        )

    def clusters(self) -> Indices:
        """Return the cluster of each particle taken, from 0 on: bins that touch, be it at a corner, are one."""
        labels, stack = np.empty(self.n_bins, np.int64), np.empty(self.n_bins, np.int64)
        join_bins(self._slots, self._bins[: self.n_bins], _NEIGHBOURS, stack, labels)
        return labels[self._bin_of[: self.n_particles]]


def bin_codes(poses: FloatArray, sizes: BinSizes, base: FloatArray) -> Indices:
    """Return a number for the bin of each pose, (n,): equal for poses of one bin only.

    Numbers of several calls compare if they have the same base (3,), a pose not too far from the others.
    """
    codes = np.empty(len(poses), np.int64)
    fill_codes(poses, np.array(sizes), base, codes)
    return codes


def kld_limits(n_bins: int, error: float, quantile: float) -> FloatArray:
    """Return how many particles are enough for k = 1 ... n_bins occupied bins (Fox 2001), +inf for one bin.

    With that many, the Kullback-Leibler divergence between the particles' histogram and the distribution that they are
    drawn from stays below `error`, as often as the standard normal quantile says.

    Parameters
    ----------
    n_bins
        At least 1.
    error
        Bound of the divergence, nats.
    quantile
        Standard normal quantile of the probability that the bound is kept.

    References
    ----------
    Fox, "KLD-sampling: adaptive particle filters", NIPS 2001.
    """
    limits = np.ceil(chi_square_quantiles(n_bins, quantile) / (2.0 * error))
    limits[0] = np.inf
    return limits


def chi_square_quantiles(n_bins: int, quantile: float) -> FloatArray:
    """Return quantiles of chi-square with 0, 1, ... n_bins - 1 degrees of freedom, (n_bins,); 0 with none.

    `quantile` is the standard normal one of the same probability (Wilson and Hilferty's approximation).
    """
    quantiles = np.zeros(n_bins)
    more = np.arange(1, n_bins, dtype=np.float64)
    share = 2.0 / (9.0 * more)
    quantiles[1:] = more * (1.0 - share + np.sqrt(share) * quantile) ** 3
    return quantiles
