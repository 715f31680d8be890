"""Which processors this process may use, and where its threads run."""

from __future__ import annotations

import ctypes
import os
from collections.abc import Callable
from contextlib import suppress


def n_processors() -> int:
    """Return the number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def keep_off(thread: int | None, processor: int) -> bool:
    """Keep a thread, by its native id, off the processor that the calling thread runs on; return whether it is.

    Linux likes to wake a thread where its waker runs, and on machines whose processors share no cache it does so even
    if others are idle: both then share one processor, and two threads take as long as one.
    """
    if processor < 0 or thread is None:
        return False
    others = os.sched_getaffinity(0) - {processor}
    if others:
        # A processor that has been taken away meanwhile is no reason to fail.
        with suppress(OSError):
            os.sched_setaffinity(thread, others)
    return True


def _processor_lookup() -> Callable[[], int]:
    if hasattr(os, "sched_setaffinity"):
        try:
            lookup = ctypes.CDLL(None).sched_getcpu
        except (OSError, AttributeError):
            return lambda: -1
        lookup.argtypes, lookup.restype = [], ctypes.c_int
        return lookup
    return lambda: -1


processor_in_use = _processor_lookup()
"""Return the number of the processor that the calling thread runs on; -1 where that is not known."""
