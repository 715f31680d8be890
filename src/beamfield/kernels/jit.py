"""The decorators that own Numba's compiler flags, and its cache on disk, or none where none can be written.

A kernel whose name begins with an underscore, or that is `shared`, is compiled for the kernels that call it alone.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numba
import numpy as np
from numba.core import types
from numba.core.dispatcher import Dispatcher
from numba.extending import lower_builtin, type_callable

F = TypeVar("F", bound=Callable[..., Any])


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
    """Compile a function into its callers, as `fast_kernel` would compile them.

    For whatever other kernels call that may reorder sums, and for what calls it. A callee that is not compiled in is
    optimised again within each caller, and otherwise; which copy runs depends on what the process loaded first, and on
    whether it compiled the kernels or read them from the disk: its sums would end in other bits.
    """
    return _compiled(function, fastmath=True, forceinline=True)


def fused_kernel(function: F) -> F:
    """Compile a kernel that may round a product and a sum with it once instead of twice; NaN and infinity stay.

    A loop's last rounds, which are not vectorised, could come out otherwise: give it whole vectors.
    """
    return _compiled(function, fastmath=FUSED)


def inlined_fused_kernel(function: F) -> F:
    """Compile a scalar function into its callers, with fused products and sums."""
    return _compiled(function, fastmath=FUSED, forceinline=True)


def shared(function: F, *, fast: bool | set[str] = False) -> F:
    """Compile a function that kernels of other files call, too, and Python does not."""
    return _without_entry(function, fastmath=fast)


def inlined_shared(function: F, *, fast: bool | set[str] = False) -> F:
    """Compile a function into its callers, kernels of any file, as `inlined_kernel` does."""
    return _without_entry(function, fastmath=fast, forceinline=True)


def wide_vectors() -> None:
    """Let the loops of the kernel that calls this use the widest vectors of the processor.

    LLVM uses half of them on Intel's processors with AVX-512, of which early ones slowed down with more. It does not
    speak for callees that are not inlined.
    """


@type_callable(wide_vectors)
def _type_of_wide_vectors(_: Any) -> Any:
    return lambda: types.none


@lower_builtin(wide_vectors)  # type: ignore[untyped-decorator]
def _allow_wide_vectors(context: Any, builder: Any, _: Any, __: Any) -> Any:
    # Past llvmlite's own `add`, which refuses attributes that it does not know. No matter if that ends one day: it
    # costs speed alone.
    if isinstance(builder.function.attributes, set):
        set.add(builder.function.attributes, '"prefer-vector-width"="512"')
    return context.get_dummy_value()


def _compiled(function: F, **flags: Any) -> F:
    if function.__name__.startswith("_"):
        return _without_entry(function, **flags)
    try:
        dispatcher = _jit(function, cache=True, **flags)
    except RuntimeError:
        # Neither this package's folder nor the home folder can be written, as in many containers.
        dispatcher = _jit(function, **flags)
    # Numba drops what it has on disk when the kernel's own file changes, but knows nothing of those it calls.
    file = getattr(getattr(dispatcher, "_cache", None), "_cache_file", None)
    if file is not None:
        file._source_stamp = (file._source_stamp, *map(_stamp, called_files(function.__module__)))
    return cast(F, dispatcher)


def is_on_disk(function: Callable[..., Any]) -> bool:
    """Return whether a kernel has been compiled by any process since its files changed."""
    file = getattr(getattr(function, "_cache", None), "_cache_file", None)
    return file is not None and bool(file._load_index())


@cache
def called_files(module: str) -> tuple[str, ...]:
    """Return the other files whose kernels those of a module can call, and those that these can call, sorted.

    Kernels are found by the names that the module has imported when its first one is compiled.
    """
    kernels = [value.py_func for value in vars(sys.modules[module]).values() if isinstance(value, Dispatcher)]
    others = {function.__module__: function for function in kernels if function.__module__ != module}
    files = {function.__code__.co_filename for function in others.values()}
    return tuple(sorted(files.union(*map(called_files, others))))


@cache
def _stamp(file: str) -> tuple[float, int]:
    status = Path(file).stat()
    return status.st_mtime, status.st_size


def _without_entry(function: F, **flags: Any) -> F:
    """Compile what kernels alone call, without entry from Python and copy on disk, which take a tenth of the time."""
    dispatcher = _jit(function, no_cpython_wrapper=True, **flags)

    def refuse(*_: object, **__: object) -> None:
        raise TypeError(f"{function.__module__}.{function.__name__}: only kernels may call it")

    # Without these two, a call from Python would jump to address 0.
    dispatcher._insert = lambda *_: None
    dispatcher._compile_for_args = refuse
    return cast(F, dispatcher)


def _jit(function: F, **flags: Any) -> Any:
    # Nothing calls kernels through C pointers. Without a word about fastmath, Numba would take it from the caller that
    # comes first, and results would depend on the order.
    flags = {"nogil": True, "error_model": "numpy", "no_cfunc_wrapper": True, "fastmath": False, **flags}
    return numba.njit(**flags)(function)
