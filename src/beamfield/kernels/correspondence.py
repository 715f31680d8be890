"""The sum over the correspondences of a feature (6.6.3), whatever it is a feature of."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel

Floats = NDArray[np.float64]

# Terms of a sum below exp(-45) = 3e-20 of the largest change no bit of it, unless there are thousands of them.
NEGLIGIBLE = -45.0


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
