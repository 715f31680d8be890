"""Mutual exclusion within one observation: no two features belong to one map feature."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray


def assign_exclusively(each: FloatArray, none: FloatArray, values: FloatArray, chosen: NDArray[np.int64]) -> None:
    """Fill in the best correspondences of which no two share a landmark.

    `each` (n, k, N) is the log value of each feature given each landmark, `none` (k,) that given no landmark. The
    results (n, k) are log values, and indices of landmarks, N for none; -inf and N + 1 for all k features of a row that
    has no such correspondence.
    """
    from scipy.optimize import linear_sum_assignment  # takes a third of a second to import, for every command

    k, n_landmarks = each.shape[1:]
    # Every feature has its own way of being spurious, so that they do not compete for it.
    table = np.full((k, n_landmarks + k), -np.inf)
    table[np.arange(k), n_landmarks + np.arange(k)] = none
    for i in range(len(each)):
        table[:, :n_landmarks] = each[i]
        try:
            _, columns = linear_sum_assignment(table, maximize=True)
        except ValueError:  # SciPy's word for: every assignment has a -inf
            values[i], chosen[i] = -np.inf, n_landmarks + 1
            continue
        values[i] = table[np.arange(k), columns]
        chosen[i] = np.minimum(columns, n_landmarks)
