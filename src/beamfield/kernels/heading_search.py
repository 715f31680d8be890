"""The best heading at each of many places from one fan of rays per place and a table per beam."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel

Floats = NDArray[np.float64]

# Places that are worked on together, so that a beam's table stays in the nearest cache for all of them.
PLACES = 32


@kernel
def fill_heading_scores(
    ranges: Floats, index: NDArray[np.int64], tables: NDArray[np.float32], step: float, out: Floats
) -> None:
    """Fill out (n, h) with the sum over beams of each beam's table at the range of its ray.

    Parameters
    ----------
    ranges
        (n, r) metres in [0, (m - 1) step]: the rays of each place.
    index
        (k, h) which ray stands for beam k at heading h.
    tables
        (k, m) a value for each expected range i step of beam k; between them it is interpolated.
    step
        Metres.
    out
        Overwritten.
    """
    n, n_rays = ranges.shape
    n_beams, n_headings = index.shape
    last = tables.shape[1] - 2
    node = np.empty((PLACES, n_rays), np.int32)
    beyond = np.empty((PLACES, n_rays), np.float32)
    for start in range(0, n, PLACES):
        stop = min(start + PLACES, n)
        for i in range(start, stop):
            for r in range(n_rays):
                at = ranges[i, r] / step
                node[i - start, r] = min(int(at), last)
                beyond[i - start, r] = at - node[i - start, r]
            out[i, :] = 0.0
        for k in range(n_beams):
            table, rays = tables[k], index[k]
            for i in range(stop - start):
                for h in range(n_headings):
                    r = rays[h]
                    a = node[i, r]
                    low = table[a]
                    out[start + i, h] += low + beyond[i, r] * (table[a + 1] - low)
