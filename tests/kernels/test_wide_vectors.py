"""`wide_vectors`: what a kernel that calls it asks of LLVM, and that it changes nothing else."""

from __future__ import annotations

import os

import numba
import pytest

from beamfield.kernels.jit import wide_vectors


def double(x: float) -> float:
    """Return twice x."""
    wide_vectors()
    return 2.0 * x


def triple(x: float) -> float:
    """Return three times x."""
    return 3.0 * x


def test_it_does_nothing_where_nothing_is_compiled():
    assert double(1.5) == 3.0


@pytest.mark.skipif(os.environ.get("NUMBA_DISABLE_JIT") == "1", reason="nothing is compiled")
@pytest.mark.parametrize(("function", "wide"), [(double, True), (triple, False)])
def test_the_kernel_that_calls_it_is_compiled_for_wide_vectors(function, wide):
    compiled = numba.njit(function)
    assert compiled(1.5) == function(1.5)
    (code,) = compiled.inspect_llvm().values()
    assert ('"prefer-vector-width"="512"' in code) == wide
