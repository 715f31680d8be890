"""Bins of beams so narrow in their expected range that all normalisers are polynomials there: see `intrinsics`."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

# Most beams in a bin: the scratch arrays of a pass over it stay in the first-level cache.
BIN_BEAMS = 1024
# Beyond this many standard deviations from 0 and z_max the cut of a hit changes no bit (1 - Phi(9) = 1e-19).
EDGE_SIGMAS = 9.0
# Support of p_short when z* is shorter, metres; the same as in kernels/beam.py.
SHORTEST_SUPPORT = 1e-6

# Terms of the polynomials in a bin, and where on [-1, 1] they are held to the functions.
TERMS = 8
NODES = np.cos(np.pi * (np.arange(TERMS) + 0.5) / TERMS)
# Row k: Chebyshev polynomials T_m at node k.
_CHEBYSHEV = np.cos(np.outer(np.pi * (np.arange(TERMS) + 0.5) / TERMS, np.arange(TERMS)))
# Values at the nodes times this: coefficients of 1, t, t^2 ...
POWERS = np.linalg.inv(np.vander(NODES, TERMS, increasing=True)).T.copy()
# Chebyshev moments times this: weights at the nodes.
NODE_WEIGHTS = np.ascontiguousarray((_CHEBYSHEV * np.where(np.arange(TERMS) == 0, 1.0, 2.0) / TERMS).T)


class Mixture(NamedTuple):
    """The model's parameters; variance of a hit v + q (origin + z*)^2, range offset b, rate lambda of shorts.

    Ranges, `max_range` too, are counted from `origin`.
    """

    max_range: float
    w_hit: float
    w_short: float
    w_rand: float
    v: float
    q: float
    b: float
    rate: float
    origin: float = 0.0


class Bins(NamedTuple):
    """Cuts of the sorted beams: first, last + 1, centre and half width in z*, whether a hit's cut matters."""

    starts: IntArray
    stops: IntArray
    centres: FloatArray
    half_widths: FloatArray
    edge: BoolArray


@kernel
def cut_into_bins(expected: FloatArray, mixture: Mixture, bins: Bins) -> int:
    """Cut beams sorted by `expected` into bins where all normalisers are polynomials to rounding; returns their number.

    A Chebyshev interpolant with 8 nodes over a half width h errs by about (2 a)^-8, a the distance to the nearest
    singularity over h: x / (1 - e^-x) has its at 2 pi i, 1 / v at i sigma / sqrt(q); log C is entire and sigma / 12 is
    narrow enough. If `bins` is too short for all of them, the number tells how long it must be.
    """
    max_range, v, q, b, rate = mixture.max_range, mixture.v, mixture.q, mixture.b, mixture.rate
    farthest = mixture.origin + max_range
    n = expected.size
    n_bins = 0
    i = 0
    while i < n:
        low = expected[i]
        distance = mixture.origin + low
        s = math.sqrt(v + q * distance * distance)
        width = 0.05 * max_range
        if rate > 0.0 and rate * low < 40.0:
            width = min(width, 0.5 / rate)
        if q > 0.0:
            width = min(width, 0.08 * math.sqrt(distance * distance + v / q))
        upper = max_range - b - EDGE_SIGMAS * math.sqrt(v + q * farthest * farthest)
        is_edge = low + b < EDGE_SIGMAS * s or low >= upper
        if is_edge:
            width = min(width, s / 6.0)
        elif low + width > upper:
            width = upper - low
        high = low + width
        if low < SHORTEST_SUPPORT:  # where the shorts' support has a kink
            high = min(high, SHORTEST_SUPPORT)
        stop = min(i + BIN_BEAMS, n)
        if expected[stop - 1] > high:  # the last beam of the bin is the last not beyond `high`
            below, above = i, stop - 1
            while above - below > 1:
                middle = (below + above) // 2
                if expected[middle] > high:
                    above = middle
                else:
                    below = middle
            stop = above
        if n_bins < bins.starts.size:
            bins.starts[n_bins] = i
            bins.stops[n_bins] = stop
            bins.centres[n_bins] = 0.5 * (expected[i] + expected[stop - 1])
            bins.half_widths[n_bins] = max(0.5 * (expected[stop - 1] - expected[i]), 1e-9 * max_range)
            bins.edge[n_bins] = is_edge
        n_bins += 1
        i = stop
    return n_bins
