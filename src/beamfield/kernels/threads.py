"""Run a kernel over slices of its rows in several threads, with the same bits for any number of them."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import pairwise

# Below this many units of work (rays, beams) starting a thread costs more than it saves.
MIN_WORK_PER_THREAD = 20_000
# What the pool's own threads know: that they belong to it.
_in_pool = threading.local()


def run_in_slices(
    work: Callable[[int, int], object], n_rows: int, *, threads: int | None = None, work_per_row: int = 1
) -> None:
    """Call ``work(start, stop)`` over [0, n_rows), in several threads where that pays.

    Each row is computed by one thread alone, so the number of threads changes no bit of the result. Kernels release the
    GIL; Python threads are used instead of Numba's own because its default threading layer must not be entered twice.

    Parameters
    ----------
    work
        Processes the rows from start to stop; must be free of shared state.
    n_rows
        Number of rows.
    threads
        Number of threads; None uses every processor that this process may use.
    work_per_row
        Units of work in a row, to decide whether threads pay.
    """
    if threads is None:
        threads = min(_n_processors(), 1 + n_rows * work_per_row // MIN_WORK_PER_THREAD)
    threads = max(1, min(threads, n_rows))
    # Work that calls back here from the pool must not wait for the pool.
    if threads == 1 or getattr(_in_pool, "flag", False):
        work(0, n_rows)
        return
    bounds = [n_rows * i // threads for i in range(threads + 1)]
    first, *others = pairwise(bounds)
    futures = [_pool().submit(work, a, b) for a, b in others]
    try:
        work(*first)
    finally:
        # Waited for even after an error: the slices write into the caller's arrays.
        errors = [future.exception() for future in futures]
    for error in errors:
        if error is not None:
            raise error


def _n_processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@lru_cache(maxsize=1)
def _pool() -> ThreadPoolExecutor:
    """Return the threads beside the calling one, kept between calls: starting them takes longer than many a kernel."""
    return ThreadPoolExecutor(
        max(1, _n_processors() - 1), "beamfield", initializer=lambda: setattr(_in_pool, "flag", True)
    )


if hasattr(os, "register_at_fork"):
    # A forked process inherits the pool, but none of its threads.
    os.register_at_fork(after_in_child=_pool.cache_clear)
