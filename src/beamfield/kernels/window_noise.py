"""The likelihood of normal residuals whose covariance is a known one plus levels times known ones."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel

Floats = NDArray[np.float64]


@kernel
def negative_log_likelihood(
    residuals: Floats, reference: Floats, units: Floats, levels: Floats, gradient: Floats, information: Floats
) -> float:
    """Return the sum over windows, without its constant; fill in its gradient and Fisher information in the levels.

    Parameters
    ----------
    residuals
        (w, 3).
    reference
        (w, 3, 3) the known covariance.
    units
        (w, k, 3, 3) what level 1 of each kind of noise adds to it.
    levels, gradient
        (k,).
    information
        (k, k) the Hessian's mean over residuals, which is positive semi-definite.
    """
    n, k = units.shape[0], levels.size
    total = 0.0
    gradient[:] = 0.0
    information[:] = 0.0
    parts = np.empty((k, 3, 3))  # the inverse covariance times each unit
    for w in range(n):
        a, b, c = reference[w, 0, 0], reference[w, 0, 1], reference[w, 0, 2]
        d, e, f = reference[w, 1, 1], reference[w, 1, 2], reference[w, 2, 2]
        for i in range(k):
            unit, level = units[w, i], levels[i]
            a += level * unit[0, 0]
            b += level * unit[0, 1]
            c += level * unit[0, 2]
            d += level * unit[1, 1]
            e += level * unit[1, 2]
            f += level * unit[2, 2]
        # The inverse of a symmetric matrix by its cofactors.
        aa, bb, cc = d * f - e * e, c * e - b * f, b * e - c * d
        determinant = a * aa + b * bb + c * cc
        aa, bb, cc = aa / determinant, bb / determinant, cc / determinant
        dd, ee = (a * f - c * c) / determinant, (b * c - a * e) / determinant
        ff = (a * d - b * b) / determinant
        x, y, z = residuals[w, 0], residuals[w, 1], residuals[w, 2]
        u, v, t = aa * x + bb * y + cc * z, bb * x + dd * y + ee * z, cc * x + ee * y + ff * z
        total += math.log(determinant) + x * u + y * v + z * t
        for i in range(k):
            unit = units[w, i]
            for m in range(3):
                p, q, r = unit[0, m], unit[1, m], unit[2, m]
                parts[i, 0, m] = aa * p + bb * q + cc * r
                parts[i, 1, m] = bb * p + dd * q + ee * r
                parts[i, 2, m] = cc * p + ee * q + ff * r
            for j in range(i + 1):
                trace = 0.0
                for m in range(3):
                    for o in range(3):
                        trace += parts[i, m, o] * parts[j, o, m]
                information[i, j] += 0.5 * trace
            gradient[i] += 0.5 * (
                unit[0, 0] * (aa - u * u)
                + unit[1, 1] * (dd - v * v)
                + unit[2, 2] * (ff - t * t)
                + 2.0 * (unit[0, 1] * (bb - u * v) + unit[0, 2] * (cc - u * t) + unit[1, 2] * (ee - v * t))
            )
    for i in range(k):
        for j in range(i):
            information[j, i] = information[i, j]
    return 0.5 * total
