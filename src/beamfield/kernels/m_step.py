"""What the M-steps maximise (6.3.3): expected log-likelihoods over the nodes of the bins of `narrow_bins`."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.cuts import HALF_LOG_2PI, log_cut_mass, mean_share
from beamfield.kernels.jit import kernel
from beamfield.kernels.narrow_bins import EDGE_SIGMAS

FloatArray = NDArray[np.float64]


@kernel
def hit_objective(
    nodes: FloatArray, weights: FloatArray, max_range: float, origin: float, v: float, q: float, b: float,
    out: FloatArray,
) -> None:  # fmt: skip
    """Expected log-likelihood of the hits, from the nodes' weights of e_hit, e_hit r and e_hit r^2, shape (3, m).

    ``out`` = value, d/d(v, q, b), and the second derivatives vv qv qq bv bq bb.
    """
    out[:] = 0.0
    for k in range(nodes.size):
        w = weights[0, k]
        z2 = (origin + nodes[k]) * (origin + nodes[k])
        var = v + q * z2
        s = math.sqrt(var)
        mean = nodes[k] + b
        log_c, l_m, l_v, l_mm, l_vm, l_vv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if mean < EDGE_SIGMAS * s or max_range - mean < EDGE_SIGMAS * s:
            log_c, l_m, l_v, l_mm, l_vm, l_vv = log_cut_mass(mean, s, max_range)
        inverse = 1.0 / var
        # In units of sigma: the sums of squares and of errors.
        square = (weights[2, k] - 2.0 * b * weights[1, k] + b * b * w) * inverse
        linear = (weights[1, k] - b * w) * inverse
        first = 0.5 * (square - w) * inverse - w * l_v
        second = (0.5 * w - square) * inverse * inverse - w * l_vv
        cross = -linear * inverse - w * l_vm
        out[0] += -0.5 * square - w * (math.log(s) + HALF_LOG_2PI + log_c)
        out[1] += first
        out[2] += first * z2
        out[3] += linear - w * l_m
        out[4] += second
        out[5] += second * z2
        out[6] += second * z2 * z2
        out[7] += cross
        out[8] += cross * z2
        out[9] += -w * inverse - w * l_mm


@kernel
def short_slopes(nodes: FloatArray, weights: FloatArray, sum_range: float, rate: float) -> tuple[float, float]:
    """Both derivatives in lambda of the expected log-likelihood of the shorts, from node weights."""
    first, second = -sum_range, 0.0
    for k in range(nodes.size):
        share, slope = mean_share(rate * nodes[k])
        first += weights[k] * nodes[k] * share
        second += weights[k] * nodes[k] * nodes[k] * slope
    return first, second
