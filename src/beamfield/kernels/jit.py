"""The decorators that own Numba's compiler flags, and its cache on disk."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np

F = TypeVar("F", bound=Callable[..., Any])

# The file whose functions kernels of other files compile in.
_SHARED = Path(__file__).with_name("elementary.py").stat()
SHARED_STAMP = _SHARED.st_mtime, _SHARED.st_size


# The flag by which products and sums become one instruction.
FUSED = {"contract"}


def integer(value: int) -> int:
    """Return a constant that kernels may pass on: Numba compiles a callee anew for every plain int that it is given."""
    return cast(int, np.intp(value))


def kernel(function: F) -> F:
    """Compile a kernel: cached on disk, without the GIL, IEEE results for divisions by zero."""
    return _compiled(function)


def inlined_kernel(function: F) -> F:
    """Compile a scalar function into its callers, so that their loops can be vectorised however long it is."""
    return _compiled(function, forceinline=True)


def fast_kernel(function: F) -> F:
    """Compile a kernel that may reorder sums and assumes finite numbers.

    Only for loops that no NaN or infinity can reach; each use comes with a test against `kernel`'s result.
    """
    return _compiled(function, fastmath=True)


def inlined_fast_kernel(function: F) -> F:
    """Compile a scalar function into its callers, as `fast_kernel` would compile them."""
    return _compiled(function, fastmath=True, forceinline=True)


def fused_kernel(function: F) -> F:
    """Compile a kernel that may round a product and a sum with it once instead of twice; NaN and infinity stay.

    A loop's last rounds, which are not vectorised, could come out otherwise: give it whole vectors.
    """
    return _compiled(function, fastmath=FUSED)


def inlined_fused_kernel(function: F) -> F:
    """Compile a scalar function into its callers, with fused products and sums."""
    return _compiled(function, fastmath=FUSED, forceinline=True)


def shared(function: F, *, fast: bool | set[str] = False, inline: bool = True) -> F:
    """Compile an elementary function for kernels of any file.

    Its flags are its own: without a word about `fastmath`, Numba would take them from the caller that comes first. It
    is on disk only within its callers.
    """
    return cast(F, numba.njit(nogil=True, error_model="numpy", forceinline=inline, fastmath=fast)(function))


def _compiled(function: F, **flags: Any) -> F:
    dispatcher = numba.njit(cache=True, nogil=True, error_model="numpy", **flags)(function)
    # Numba drops what it has on disk when the kernel's own file changes, but knows nothing of the one it shares.
    file = getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)
    if file is not None:
        file._source_stamp = (file._source_stamp, SHARED_STAMP)
    return cast(F, dispatcher)
