"""Numba's CUDA target: the CPU kernels' own Python source compiled for it, and tables in its memory.

Loaded only after `require_device("cuda")`. In Numba's CUDA simulator the same source runs as Python.
"""

from __future__ import annotations

import operator
from collections.abc import Callable
from functools import cache, partial
from math import prod
from types import FunctionType, ModuleType
from typing import Any

import numpy as np
from numba import cuda
from numba.core.dispatcher import Dispatcher
from numpy.typing import NDArray

from beamfield.errors import InvalidInputError
from beamfield.kernels.device import IN_SIMULATOR
from beamfield.kernels.threads import run_in_blocks

THREADS_PER_BLOCK = 128
# The system hands out memory by pages; the first touch of one is worth so many units of work.
PAGE_BYTES, WORK_PER_PAGE = 4096, 35.0
# Numba warns the user of fewer; blocks without work end at once.
LEAST_BLOCKS = 1 if IN_SIMULATOR else 128

if IN_SIMULATOR:
    product: Callable[[float, float], float] = operator.mul
else:
    from numba.cuda import libdevice

    # A product that is rounded on its own, as on the CPU: the compiler would fuse `a * b + c`.
    product = libdevice.dmul_rn


@cache
def on_device(kernel: Any) -> Any:
    """Return a CPU kernel, and whatever it calls, compiled for the GPU from the same source.

    The one change is `np.floor`, which Numba does not have there: it becomes the GPU's own.
    """
    source = kernel.py_func
    known = source.__globals__
    names = {name: _on_device_too(known[name]) for name in source.__code__.co_names if name in known}
    copy = FunctionType(source.__code__, names, source.__name__, source.__defaults__)
    return copy if IN_SIMULATOR else cuda.jit(device=True)(copy)


def upload(table: NDArray[Any]) -> Any:
    """Return a table in the GPU's memory.

    Raises
    ------
    InvalidInputError
        If there is too little of it.
    """
    return _in_memory(partial(cuda.to_device, table), f"{table.nbytes} bytes of free memory")


def allocate(*shape: int) -> Any:
    """Return an array of float64 in the GPU's memory, not filled.

    Raises
    ------
    InvalidInputError
        If there is too little of it.
    """
    return _in_memory(partial(cuda.device_array, shape, np.float64), f"{8 * prod(shape)} bytes of free memory")


def _in_memory(call: Callable[[], Any], needed: str) -> Any:
    try:
        return call()
    except Exception as error:  # of numba-cuda or of cuda-core
        if "OUT_OF_MEMORY" not in str(error):
            raise
        free = cuda.current_context().get_memory_info().free
        raise InvalidInputError(f"device: expected {needed} on the GPU, got {free} bytes") from error


def download(source: Any, out: NDArray[Any]) -> None:
    """Copy a flat array from the GPU's memory into out (n,), once it has been computed.

    Mostly out is new, and to touch its pages for the first time takes one thread four times as long as the copy itself:
    many threads do, while the GPU computes.
    """
    first_of_pages = out[:: PAGE_BYTES // out.itemsize]
    run_in_blocks(partial(_touch, first_of_pages), first_of_pages.size, work_per_row=WORK_PER_PAGE)
    source.copy_to_host(out)


def _touch(pages: NDArray[Any], start: int, stop: int) -> None:
    pages[start:stop] = 0


def launch(kernel: Any, n: int, *args: Any) -> None:
    """Run a kernel in n threads or more."""
    if n > 0:
        launch_blocks(kernel, (n + THREADS_PER_BLOCK - 1) // THREADS_PER_BLOCK, THREADS_PER_BLOCK, 0, *args)


def launch_blocks(kernel: Any, n: int, threads: int, shared_bytes: int, *args: Any) -> None:
    """Run a kernel in n blocks or more, each of so many threads that share memory.

    Raises
    ------
    InvalidInputError
        If there is too little memory for the variables of as many threads as the GPU runs at a time.
    """
    call = partial(kernel[max(n, LEAST_BLOCKS), threads, 0, shared_bytes], *args)
    _in_memory(call, "free memory for the variables of its threads")


def _on_device_too(value: Any) -> Any:
    """Return what a kernel's global name stands for on the device."""
    if value is np and not IN_SIMULATOR:
        return _numpy_on_device()
    return on_device(value) if isinstance(value, Dispatcher) else value


@cache
def _numpy_on_device() -> ModuleType:
    module = ModuleType("numpy_on_device")
    module.__dict__.update({name: value for name, value in vars(np).items() if not name.startswith("__")})
    module.__dict__["floor"] = libdevice.floor
    return module
