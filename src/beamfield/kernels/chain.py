"""Least squares on a chain: a symmetric block-tridiagonal system of poses, solved with the marginals of its inverse.

Blocks are 3 x 3. With diagonal blocks D_i and blocks U_i between i and i + 1, block elimination forwards gives
S_i = D_i - U_{i-1}' S_{i-1}^-1 U_{i-1}; going back, the inverse's blocks on and beside the diagonal follow as in a
Rauch-Tung-Striebel smoother.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel

Floats = NDArray[np.float64]


@kernel
def invert_3x3(a: Floats, out: Floats) -> bool:
    """Fill out with the inverse of a symmetric matrix; False if it is not positive definite."""
    c00 = a[1, 1] * a[2, 2] - a[1, 2] * a[1, 2]
    c01 = a[0, 2] * a[1, 2] - a[0, 1] * a[2, 2]
    c02 = a[0, 1] * a[1, 2] - a[0, 2] * a[1, 1]
    determinant = a[0, 0] * c00 + a[0, 1] * c01 + a[0, 2] * c02
    if not (determinant > 0.0 and c00 > 0.0 and a[2, 2] > 0.0):
        return False
    out[0, 0] = c00 / determinant
    out[0, 1] = out[1, 0] = c01 / determinant
    out[0, 2] = out[2, 0] = c02 / determinant
    out[1, 1] = (a[0, 0] * a[2, 2] - a[0, 2] * a[0, 2]) / determinant
    out[1, 2] = out[2, 1] = (a[0, 1] * a[0, 2] - a[0, 0] * a[1, 2]) / determinant
    out[2, 2] = (a[0, 0] * a[1, 1] - a[0, 1] * a[0, 1]) / determinant
    return True


@kernel
def solve_chain(diagonal: Floats, upper: Floats, right: Floats, solution: Floats, covariance: Floats, cross: Floats
                ) -> bool:  # fmt: skip
    """Solve A x = b for a block-tridiagonal A, and fill in the blocks of A^-1 on and beside its diagonal.

    Parameters
    ----------
    diagonal
        (n, 3, 3) symmetric blocks.
    upper
        (n - 1, 3, 3) blocks right of the diagonal.
    right
        (n, 3, m) right-hand sides.
    solution
        (n, 3, m) overwritten.
    covariance
        (n, 3, 3) overwritten with the inverse's diagonal blocks.
    cross
        (n - 1, 3, 3) overwritten with the inverse's blocks right of the diagonal.

    Returns
    -------
    Whether the matrix is positive definite; if not, the results mean nothing.
    """
    n = diagonal.shape[0]
    # Inverses of the pivots stand in `covariance` until the way back, S_i^-1 U_i in `cross`.
    pivot, gain, old = np.empty((3, 3)), np.empty((3, 3)), np.empty((3, right.shape[2]))
    for i in range(n):
        _copy(diagonal[i], pivot)
        _copy(right[i], solution[i])
        if i > 0:
            _add_product(-1.0, upper[i - 1].T, cross[i - 1], pivot)
            _add_product(-1.0, cross[i - 1].T, solution[i - 1], solution[i])
            _make_symmetric(pivot)
        if not invert_3x3(pivot, covariance[i]):
            return False
        if i < n - 1:
            cross[i] = 0.0
            _add_product(1.0, covariance[i], upper[i], cross[i])
    for i in range(n - 1, -1, -1):
        _copy(solution[i], old)
        solution[i] = 0.0
        _add_product(1.0, covariance[i], old, solution[i])
        if i < n - 1:
            _add_product(-1.0, cross[i], solution[i + 1], solution[i])
            _copy(cross[i], gain)
            cross[i] = 0.0
            _add_product(-1.0, gain, covariance[i + 1], cross[i])
            _add_product(-1.0, cross[i], gain.T, covariance[i])
            _make_symmetric(covariance[i])
    return True


# Loops: Numba takes seconds to compile matrix products and assignments of arrays to slices.


@kernel
def _copy(a: Floats, out: Floats) -> None:
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = a[i, j]


@kernel
def _add_product(sign: float, a: Floats, b: Floats, out: Floats) -> None:
    """Add to out the product of sign, a (3, 3) and b (3, m)."""
    for i in range(3):
        for j in range(out.shape[1]):
            out[i, j] += sign * (a[i, 0] * b[0, j] + a[i, 1] * b[1, j] + a[i, 2] * b[2, j])


@kernel
def _make_symmetric(a: Floats) -> None:
    for i in range(3):
        for j in range(i):
            a[i, j] = a[j, i] = 0.5 * (a[i, j] + a[j, i])
