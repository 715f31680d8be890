"""The chain's solver against a dense solve."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.kernels.chain import invert_3x3, solve_chain


def random_chain(n: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return blocks of a positive definite block-tridiagonal matrix, and the matrix."""
    factors = rng.normal(size=(n + 1, 4, 6))
    diagonal, upper = 0.1 * np.tile(np.eye(3), (n, 1, 1)), np.zeros((n - 1, 3, 3))
    for i in range(n - 1):
        a, b = factors[i, :, :3], factors[i, :, 3:]
        diagonal[i] += a.T @ a
        diagonal[i + 1] += b.T @ b
        upper[i] = a.T @ b
    whole = np.zeros((3 * n, 3 * n))
    for i in range(n):
        whole[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = diagonal[i]
        if i < n - 1:
            whole[3 * i : 3 * i + 3, 3 * i + 3 : 3 * i + 6] = upper[i]
            whole[3 * i + 3 : 3 * i + 6, 3 * i : 3 * i + 3] = upper[i].T
    return diagonal, upper, whole


@pytest.mark.parametrize("n", [1, 2, 7])
def test_solution_and_marginals_are_those_of_the_dense_inverse(n: int, rng: np.random.Generator):
    diagonal, upper, whole = random_chain(n, rng)
    right = rng.normal(size=(n, 3, 2))
    solution, covariance, cross = np.empty((n, 3, 2)), np.empty((n, 3, 3)), np.empty((n - 1, 3, 3))
    assert solve_chain(diagonal, upper, right, solution, covariance, cross)
    inverse = np.linalg.inv(whole)
    np.testing.assert_allclose(solution.reshape(3 * n, 2), inverse @ right.reshape(3 * n, 2), atol=1e-9)
    for i in range(n):
        np.testing.assert_allclose(covariance[i], inverse[3 * i : 3 * i + 3, 3 * i : 3 * i + 3], atol=1e-9)
        if i < n - 1:
            np.testing.assert_allclose(cross[i], inverse[3 * i : 3 * i + 3, 3 * i + 3 : 3 * i + 6], atol=1e-9)


def test_a_matrix_that_is_not_positive_definite_is_reported():
    out = np.empty((3, 3))
    assert not invert_3x3(np.diag([1.0, -1.0, 1.0]), out)
    assert not invert_3x3(np.zeros((3, 3)), out)
    broken = (np.zeros((2, 3, 3)), np.zeros((1, 3, 3)), np.zeros((2, 3, 1)))
    assert not solve_chain(*broken, np.empty((2, 3, 1)), np.empty((2, 3, 3)), np.empty((1, 3, 3)))
