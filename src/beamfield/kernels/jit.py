"""The one decorator that owns Numba's compiler flags."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

import numba
import numpy as np

F = TypeVar("F", bound=Callable[..., Any])


def integer(value: int) -> int:
    """Return a constant that kernels may pass on: Numba compiles a callee anew for every plain int that it is given."""
    return cast(int, np.intp(value))


def kernel(function: F) -> F:
    """Compile a kernel: cached on disk, without the GIL, IEEE results for divisions by zero."""
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy")(function))


def inlined_kernel(function: F) -> F:
    """Compile a scalar function into its callers, so that their loops can be vectorised however long it is."""
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy", forceinline=True)(function))


def fast_kernel(function: F) -> F:
    """Compile a kernel that may reorder sums and assumes finite numbers.

    Only for loops that no NaN or infinity can reach; each use comes with a test against `kernel`'s result.
    """
    return cast(F, numba.njit(cache=True, nogil=True, error_model="numpy", fastmath=True)(function))
