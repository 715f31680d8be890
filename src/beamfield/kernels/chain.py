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
    pivot = np.empty((3, 3))
    solution[:] = right
    for i in range(n):
        pivot[:] = diagonal[i]
        if i > 0:
            pivot -= upper[i - 1].T @ cross[i - 1]
            solution[i] -= cross[i - 1].T @ solution[i - 1]
            pivot[:] = 0.5 * (pivot + pivot.T)
        if not invert_3x3(pivot, covariance[i]):
            return False
        if i < n - 1:
            cross[i] = covariance[i] @ upper[i]
    for i in range(n - 1, -1, -1):
        solution[i] = covariance[i] @ solution[i]
        if i < n - 1:
            solution[i] -= cross[i] @ solution[i + 1]
            gain = cross[i].copy()
            cross[i] = -(gain @ covariance[i + 1])
            covariance[i] -= cross[i] @ gain.T
            covariance[i] = 0.5 * (covariance[i] + covariance[i].T)
    return True
