"""Correspondences of features (6.6.3), whatever they are features of: by their ids, and summed over all."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]

# Terms of a sum below exp(-45) = 3e-20 of the largest change no bit of it, unless there are thousands of them.
NEGLIGIBLE = -45.0


@kernel
def sort_by_id(ids: Indices, map_ids: Indices, order: Indices, unknown_id: int, out: Indices) -> tuple[int, int, int]:
    """Say what the ids of features are ids of.

    Parameters
    ----------
    ids
        (k,) ids of the map, `unknown_id`, or negative otherwise for features of nothing in the map.
    map_ids, order
        (N,) the map's ids, and the indices that sort them.
    unknown_id
        Negative.
    out
        (4, k) overwritten from the left: features with an id, the indices of these ids, features whose correspondence
        is unknown, and features of nothing.

    Returns
    -------
    How many of them have an id, are unknown, and of nothing; the first is -1 - i if feature i has an id that the map
    has not.
    """
    known, unknown, spurious = 0, 0, 0
    for i in range(ids.size):
        if ids[i] == unknown_id:
            out[2, unknown] = i
            unknown += 1
        elif ids[i] < 0:
            out[3, spurious] = i
            spurious += 1
        else:
            below, above = 0, map_ids.size - 1
            while below < above:
                middle = (below + above) // 2
                if map_ids[order[middle]] < ids[i]:
                    below = middle + 1
                else:
                    above = middle
            if map_ids[order[below]] != ids[i]:
                return -1 - i, unknown, spurious
            out[0, known], out[1, known] = i, order[below]
            known += 1
    return known, unknown, spurious


@kernel
def fill_sums(values: Floats, log_landmark: float, log_spurious: Floats, out: Floats) -> None:
    """Sum over correspondences: values (n, k, N) of `fill_candidates`, log_spurious (k,), out (n, k)."""
    for i in range(values.shape[0]):
        for k in range(values.shape[1]):
            best = log_spurious[k]
            for j in range(values.shape[2]):
                best = max(best, values[i, k, j] + log_landmark)
            if best == -math.inf:
                out[i, k] = best
                continue
            total = math.exp(log_spurious[k] - best)
            for j in range(values.shape[2]):
                below = values[i, k, j] + log_landmark - best
                if below > NEGLIGIBLE:
                    total += math.exp(below)
            out[i, k] = best + math.log(total)
