"""Run a kernel over slices of its rows in several threads, with the same bits for any number of them."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from itertools import pairwise

from beamfield.kernels.processors import keep_off, n_processors, processor_in_use

# Below this many units of work (rays, beams) handing a slice to another thread costs more than it saves.
MIN_WORK_PER_THREAD = 12_000

Work = Callable[[int, int], object]


def run_in_slices(work: Work, n_rows: int, *, threads: int | None = None, work_per_row: int = 1) -> None:
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
        Number of threads; None uses as many as pay, at most one per processor that this process may use. Threads that
        are busy with another call are not waited for: the others share the rows.
    work_per_row
        Units of work in a row, to decide whether threads pay.
    """
    threads = threads_that_pay(n_rows, threads=threads, work_per_row=work_per_row)
    helpers = _borrow(threads - 1)
    if not helpers:
        work(0, n_rows)
        return
    parts = len(helpers) + 1
    own, *others = pairwise(n_rows * i // parts for i in range(parts + 1))
    here = processor_in_use()
    for helper, (start, stop) in zip(helpers, others, strict=True):
        helper.keep_off(here)
        helper.begin(work, start, stop)
    try:
        work(*own)
    finally:
        # Waited for even after an error: the slices write into the caller's arrays.
        errors = [helper.wait() for helper in helpers]
        _idle.extend(helpers)
    for error in errors:
        if error is not None:
            raise error


def threads_that_pay(
    n_rows: int, *, threads: int | None, work_per_row: int, work_per_thread: int = MIN_WORK_PER_THREAD
) -> int:
    """Return the number of threads for so many rows, at least 1: `run_in_slices` says what the arguments mean."""
    if threads is None:
        threads = min(n_processors(), 1 + n_rows * work_per_row // work_per_thread)
    return max(1, min(threads, n_rows))


class _Helper(threading.Thread):
    """A thread that waits for slices.

    Two locks hand a slice over and back in 12 microseconds; the queue and the future of an executor take 30 to 50, as
    long as a whole call of a likelihood field.
    """

    def __init__(self) -> None:
        super().__init__(name="beamfield", daemon=True)
        self._begun, self._done = threading.Lock(), threading.Lock()
        self._begun.acquire()
        self._done.acquire()
        self._slice: tuple[Work, int, int] | None = None
        self._kept_off = -1
        self._error: BaseException | None = None
        self.start()

    def run(self) -> None:
        while True:
            self._begun.acquire()
            if self._slice is not None:
                work, start, stop = self._slice
                try:
                    work(start, stop)
                except BaseException as error:
                    self._error = error
                # A thread that sleeps must not keep the caller's arrays alive.
                del work
            self._slice = None
            self._done.release()

    def keep_off(self, processor: int) -> None:
        """Keep the thread off the processor that the calling thread runs on."""
        if processor != self._kept_off and keep_off(self.native_id, processor):
            self._kept_off = processor

    def begin(self, work: Work, start: int, stop: int) -> None:
        """Let the thread work on a slice."""
        self._slice = work, start, stop
        self._begun.release()

    def wait(self) -> BaseException | None:
        """Return the slice's error, if any, as soon as it is done."""
        self._done.acquire()
        error, self._error = self._error, None
        return error


# Threads without work, kept between calls. Lists are popped and extended by one thread at a time.
_idle: list[_Helper] = []
_n_started = 0
_start_lock = threading.Lock()


def _borrow(n: int) -> list[_Helper]:
    """Return up to n idle threads, no more than there are processors beside the calling thread's."""
    global _n_started
    helpers: list[_Helper] = []
    while len(helpers) < n:
        try:
            helpers.append(_idle.pop())
            continue
        except IndexError:
            pass
        with _start_lock:
            if _n_started >= max(1, n_processors() - 1):
                break
            _n_started += 1
        helpers.append(_Helper())
    return helpers


def _forget_threads() -> None:
    """Start anew in a forked process: it inherits the list, but none of the threads, and a lock that may be held."""
    global _n_started, _start_lock
    _idle.clear()
    _n_started, _start_lock = 0, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_threads)
