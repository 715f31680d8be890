"""Run a kernel over slices of its rows in several threads, with the same bits for any number of them."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from contextlib import suppress
from itertools import islice, pairwise
from queue import SimpleQueue

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
    if threads == 1:
        work(0, n_rows)
        return
    helpers: list[_Helper] = []
    slices: list[_Slice] = []
    begun: list[None] = []
    # Ctrl-C may raise between any two lines, but not within a call of compiled code: helpers are taken in one such
    # call, and begin in one, so that it is always known whose they are.
    try:
        _borrow(threads - 1, helpers)
        if not helpers:
            work(0, n_rows)
            return
        parts = len(helpers) + 1
        own, *others = pairwise(n_rows * i // parts for i in range(parts + 1))
        slices += [_Slice(work, start, stop) for start, stop in others]
        here = processor_in_use()
        for helper in helpers:
            helper.keep_off(here)
        begun.extend(map(SimpleQueue.put, [helper.slices for helper in helpers], slices))
        work(*own)
    finally:
        if begun:
            # Waited for even after an error: the slices write into the caller's arrays.
            for part in slices:
                part.done.acquire()
        else:
            _idle.extend(helpers)
    for part in slices:
        if part.error is not None:
            raise part.error


def threads_that_pay(
    n_rows: int, *, threads: int | None, work_per_row: int, work_per_thread: int = MIN_WORK_PER_THREAD
) -> int:
    """Return the number of threads for so many rows, at least 1: `run_in_slices` says what the arguments mean."""
    if threads is None:
        threads = min(n_processors(), 1 + n_rows * work_per_row // work_per_thread)
    return max(1, min(threads, n_rows))


class _Slice:
    """Rows for a helping thread, and what became of them."""

    def __init__(self, work: Work, start: int, stop: int) -> None:
        self._work, self._start, self._stop = work, start, stop
        self.done = threading.Lock()
        self.done.acquire()
        self.error: BaseException | None = None

    def do(self) -> None:
        try:
            self._work(self._start, self._stop)
        except BaseException as error:
            self.error = error


class _Helper(threading.Thread):
    """A thread that waits for slices.

    Not an executor's, whose queue a caller would wait in while others are at work; handing a slice over and back takes
    as long. The thread itself says that it is idle again, as Ctrl-C may end the caller's wait.
    """

    def __init__(self) -> None:
        super().__init__(name="beamfield", daemon=True)
        self.slices: SimpleQueue[_Slice] = SimpleQueue()
        self._kept_off = -1
        self.start()

    def run(self) -> None:
        while True:
            part = self.slices.get()
            part.do()
            done = part.done
            # A thread that sleeps must not keep the caller's arrays alive.
            del part
            _idle.append(self)
            done.release()

    def keep_off(self, processor: int) -> None:
        """Keep the thread off the processor that the calling thread runs on."""
        if processor != self._kept_off and keep_off(self.native_id, processor):
            self._kept_off = processor


# Threads without work, kept between calls. Lists are popped and appended to by one thread at a time.
_idle: list[_Helper] = []
_n_started = 0
_start_lock = threading.Lock()


def _borrow(n: int, helpers: list[_Helper]) -> None:
    """Fill in up to n idle threads, no more than there are processors beside the calling thread's."""
    global _n_started
    while len(helpers) < n:
        with suppress(IndexError):
            helpers.extend(islice(iter(_idle.pop, None), n - len(helpers)))
            return
        with _start_lock:
            if _n_started >= max(1, n_processors() - 1):
                return
            _n_started += 1
        helpers.append(_Helper())


def _forget_threads() -> None:
    """Start anew in a forked process: it inherits the list, but none of the threads, and a lock that may be held."""
    global _n_started, _start_lock
    _idle.clear()
    _n_started, _start_lock = 0, threading.Lock()


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_threads)
