"""Run a kernel over slices of its rows in several threads, with the same bits for any number of them."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

# Below this many units of work (rays, beams) starting a thread costs more than it saves.
MIN_WORK_PER_THREAD = 20_000


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
        threads = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
        threads = min(threads, 1 + n_rows * work_per_row // MIN_WORK_PER_THREAD)
    threads = max(1, min(threads, n_rows))
    if threads == 1:
        work(0, n_rows)
        return
    bounds = [n_rows * i // threads for i in range(threads + 1)]
    with ThreadPoolExecutor(threads) as pool:
        for future in [pool.submit(work, a, b) for a, b in pairwise(bounds)]:
            future.result()
