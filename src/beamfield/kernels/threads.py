"""The one pool of threads: a kernel runs over blocks of its rows, with the same bits for any number of threads."""

from __future__ import annotations

import _thread
import functools
import os
import threading
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from numbers import Integral
from queue import Empty, SimpleQueue

from beamfield.errors import InvalidInputError
from beamfield.kernels.processors import n_idle, n_processors

# Units of work (rays, of 20 ns) that are worth a further thread, which takes 50 us to come.
WORK_PER_THREAD = 8_000
# Calls of less work, 20 ms, ask only as many threads as there are idle processors for help: a thread that has begun a
# block and then has to share its processor may not be back for 5 ms.
SHORT_WORK = 1_000_000
# Where `set_threads` has set nothing.
VARIABLE = "BEAMFIELD_THREADS"

Work = Callable[[int, int], object]


class set_threads:  # noqa: N801  # a function to its callers
    """Set how many threads a call of beamfield may use at most, in the whole process.

    No number of threads changes a bit of any result. Short calls use one thread in any case.

    Parameters
    ----------
    n
        Number of threads, the caller's included; None for the default: the environment variable BEAMFIELD_THREADS or,
        if that is not set, the number of processors that the process may use, by its affinity and the CPU quota of its
        control groups.

    Raises
    ------
    InvalidInputError
        If n is not a whole number of at least 1.

    Notes
    -----
    In a ``with`` statement, the setting before comes back at its end. It is one setting for all threads of the process.
    The default is found out once, when it is first needed; None does so anew.

    Examples
    --------
    >>> setting = set_threads(4)
    >>> with set_threads(1):
    ...     n_threads()
    1
    >>> n_threads()
    4
    >>> setting = set_threads(None)
    """

    def __init__(self, n: int | None) -> None:
        global _most_threads
        if n is not None and (isinstance(n, bool) or not isinstance(n, Integral) or n < 1):
            raise InvalidInputError(f"n: expected a whole number of threads, at least 1, or None, got {n!r}")
        self._before, _most_threads = _most_threads, None if n is None else int(n)
        if n is None:
            _default.cache_clear()

    def __repr__(self) -> str:
        return f"<beamfield uses up to {n_threads()} threads>"

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        global _most_threads
        _most_threads = self._before


def n_threads() -> int:
    """Return how many threads a call may use at most."""
    return _most_threads if _most_threads is not None else _default()


@functools.cache
def _default() -> int:
    text = os.environ.get(VARIABLE)
    if text is None:
        return n_processors()
    if not text.isascii() or not text.isdigit() or int(text) < 1:
        raise InvalidInputError(f"{VARIABLE}: expected a whole number of threads, at least 1, got {text!r}")
    return int(text)


def run_in_blocks(work: Work, n_rows: int, *, work_per_row: float = 1.0) -> None:
    """Call ``work(start, stop)`` over [0, n_rows), by blocks in several threads where that pays.

    Each row is computed by one thread alone, so the number of threads changes no bit of the result. Threads take the
    next block as they come: nobody waits for one that the system keeps from running, and a caller whose helpers do not
    come does all the work itself. Within a block, further calls run on the block's thread.

    Parameters
    ----------
    work
        Processes the rows from start to stop; must be free of shared state, and release the GIL.
    n_rows
        Number of rows.
    work_per_row
        Units of work in a row, to decide whether threads pay.

    Notes
    -----
    After an error (Ctrl-C is one) no further block is begun, and those that others are at are waited for, as they write
    into the caller's arrays. The first error is raised.
    """
    threads = _threads_that_pay(n_rows, n_rows * work_per_row)
    if threads == 1:
        work(0, n_rows)
        return
    job = _Job(work, blocks(n_rows, threads, int(0.5 * WORK_PER_THREAD / work_per_row)))
    try:
        _call_for_help(job, threads - 1)
        job.do_blocks()
    finally:
        job.finish()
    if job.errors:
        raise job.errors[0]


def blocks(n_rows: int, threads: int, least: int) -> list[tuple[int, int]]:
    """Return start and stop of blocks of rows: each is half a thread's share of the rows left, but at least `least`.

    So there are few, as a thread needs the interpreter between two and others may hold it for milliseconds, and the
    last are the smallest, so that all threads end at about the same time.
    """
    result, start = [], 0
    while start < n_rows:
        stop = start + max(1, least, (n_rows - start) // (2 * threads))
        # What is left over is not worth a block of its own.
        stop = n_rows if n_rows - stop < least / 2 else stop
        result.append((start, stop))
        start = stop
    return result


def _threads_that_pay(n_rows: int, work: float) -> int:
    """Return the number of threads for so much work, at least 1."""
    most = min(n_rows, int(work / WORK_PER_THREAD))
    if most < 2 or getattr(_here, "in_block", False):
        return 1
    threads = min(most, n_threads())
    return threads if threads == 1 or work > SHORT_WORK else min(threads, 1 + n_idle())


class _Job:
    """Blocks of rows, and who has come to work on them.

    Lists and deques are changed in single calls of compiled code, which neither other threads nor Ctrl-C divide.
    """

    def __init__(self, work: Work, blocks: list[tuple[int, int]]) -> None:
        self._work, self._blocks = work, deque(blocks)
        self._helpers: list[threading.Lock] = []
        self.errors: list[BaseException] = []

    def do_blocks(self) -> None:
        """Work on blocks until all are taken."""
        try:
            _here.in_block = True
            while True:
                try:
                    start, stop = self._blocks.popleft()
                except IndexError:
                    return
                self._work(start, stop)
        finally:
            _here.in_block = False

    def help(self) -> None:
        """Work on blocks in a thread that is not the caller's."""
        done = threading.Lock()
        done.acquire()
        # Before the first block is taken: whoever finds no block left knows all helpers that may be at one.
        self._helpers.append(done)
        try:
            self.do_blocks()
        except BaseException as error:
            self.errors.append(error)
            self._blocks.clear()
        finally:
            done.release()

    def finish(self) -> None:
        """Let no further block be taken, wait for those that are, and let go of the caller's arrays."""
        self._blocks.clear()
        for done in list(self._helpers):
            done.acquire()
        del self._work


# Jobs that ask for help, once for each thread that may come.
_jobs: SimpleQueue[_Job] = SimpleQueue()
_n_helpers = 0
_starting = threading.Lock()
_most_threads: int | None = None
_here = threading.local()


def _call_for_help(job: _Job, n: int) -> None:
    """Ask so many threads for help, and start those that there are not yet."""
    global _n_helpers
    # Where a container limits threads and no more can be had, those that are there help.
    with suppress(RuntimeError):
        while _n_helpers < n:
            with _starting:
                if _n_helpers < n:
                    # Not threading.Thread: a start of that, ended half way by Ctrl-C, leaves a thread that dies.
                    _thread.start_new_thread(_help_forever, (_jobs,))
                    _n_helpers += 1
    n = min(n, _n_helpers)
    # Calls for help that nobody has answered, because all are at work, are not piled up.
    with suppress(Empty):
        while _jobs.qsize() + n > _n_helpers:
            _jobs.get_nowait()
    for _ in range(n):
        _jobs.put(job)


def _help_forever(jobs: SimpleQueue[_Job]) -> None:
    while True:
        job = jobs.get()
        job.help()
        # A thread that sleeps must not keep the job alive.
        del job


def _start_anew() -> None:
    """Forget the threads in a forked process, which has none of them, and a lock and a queue that may be held."""
    global _jobs, _n_helpers, _starting
    _jobs, _n_helpers, _starting = SimpleQueue(), 0, threading.Lock()
    _default.cache_clear()
    _here.in_block = False


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_start_anew)
