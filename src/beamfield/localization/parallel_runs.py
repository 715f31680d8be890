"""Runs of a filter in several processes: a run is a chain of short calls from Python, which threads do not speed up.

Only the command line starts processes: a script whose lines are not guarded by ``if __name__ == "__main__"`` would run
anew in each of them.
"""

from __future__ import annotations

import os
import pickle
import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import cache, partial
from math import inf
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from beamfield.kernels.threads import n_threads, set_threads

if TYPE_CHECKING:
    from concurrent.futures import Future, ProcessPoolExecutor
    from multiprocessing.process import BaseProcess

S = TypeVar("S")
T = TypeVar("T")
Progress = Callable[[int, int], None]
# A run as bytes, asked for when they are needed; None if it cannot be sent.
Content = Callable[[], bytes | None]

# Seconds of runs before processes are started: each takes about as long to import what it needs.
START_AFTER_S = 2.0
# Each takes 100 MB or more.
MOST_PROCESSES = 16
# Of what a run needs. More takes longer to send than it is worth, and as much memory in each process.
MOST_BYTES = 1 << 28


def run_each(
    run: Callable[[S], T],
    items: Sequence[S],
    progress: Progress | None = None,
    keep: Callable[[S, T], None] | None = None,
) -> list[T]:
    """Return ``run(item)`` for each item, in their order; it returns the same in every process.

    `keep` is called with each item and what its run returned, as soon as this process knows it.
    """
    results: list[T] = []
    helpers, n = _helpers if n_threads() > 1 else None, len(items)
    content = cache(partial(_pickled, run))
    while len(results) < n:
        began, left = time.perf_counter(), items[len(results) :]
        shares = [] if helpers is None else helpers.shares(run, content, left)
        every = 1 + len(shares)
        # Alone, one at a time: others may be ready for the next.
        own = _Share(run, left[::every] if shares else left[:1])
        with set_threads(1) if shares else nullcontext():
            for item in own.items:
                if progress is not None:
                    progress(len(results) + every * len(own.results), n)
                own.results.append(run(item))
                if keep is not None:
                    keep(item, own.results[-1])
        for share in shares:
            share.wait()
            if keep is not None:
                for item, result in zip(share.items, share.results, strict=True):
                    keep(item, result)
        dealt = [own, *shares]
        results += [share.results[row] for row in range(len(own.results)) for share in dealt if row < len(share.items)]
        if helpers is not None:
            helpers.add_time(time.perf_counter() - began, content)
    return results


@contextmanager
def parallel_runs() -> Iterator[None]:
    """Let `run_each` use as many processes as `n_threads` says, up to 16, once runs have taken a while."""
    global _helpers
    before, _helpers = _helpers, _Helpers()
    try:
        yield
    finally:
        _helpers.end()
        _helpers = before


@dataclass
class _Share(Generic[S, T]):
    """The runs that a process makes."""

    run: Callable[[S], T]
    items: Sequence[S]
    future: Future[list[T]] | None = None
    results: list[T] = field(default_factory=list)

    def wait(self) -> None:
        """Take another process's results. The runs of one that died are made here."""
        try:
            assert self.future is not None
            self.results = self.future.result()
        except RuntimeError:  # BrokenProcessPool, or the run's own, which comes again
            self.results = [self.run(item) for item in self.items]


class _Helpers:
    """The processes beside this one; none until runs have taken a while."""

    def __init__(self) -> None:
        self._spent = 0.0
        self._pool: ProcessPoolExecutor | None = None
        self._started: list[Future[list[Any]]] = []
        self._others: set[BaseProcess] = set()

    def shares(self, run: Callable[[S], T], content: Content, items: Sequence[S]) -> list[_Share[S, T]]:
        """Give each process that is there its share of the runs: every n-th, from the second on."""
        others = min(len(self._started), len(items) - 1)
        if self._pool is None or others < 1 or not all(one.done() for one in self._started):
            return []
        sent = content()
        if sent is None:
            return []
        dealt = [items[i :: others + 1] for i in range(1, others + 1)]
        try:
            return [_Share(run, some, self._pool.submit(_run_some, sent, some)) for some in dealt]
        except RuntimeError:  # a process has died, and with it the pool: this one goes on alone
            self._started = []
            return []

    def add_time(self, seconds: float, content: Content) -> None:
        """Start processes when runs have taken so long that starting them costs no more."""
        self._spent += seconds
        if self._pool is not None or self._spent < START_AFTER_S:
            return
        sent = content()
        if sent is not None:
            # Imported here, for they take longer to import than the command line.
            import multiprocessing
            from concurrent.futures import ProcessPoolExecutor

            self._others = set(multiprocessing.active_children())
            n = min(n_threads(), MOST_PROCESSES) - 1
            try:
                self._pool = ProcessPoolExecutor(n, multiprocessing.get_context("spawn"), _begin)
            except OSError:  # no memory that processes share, as in some containers
                self._spent = -inf
            else:
                with _deaf_to_ctrl_c():
                    self._started = [self._pool.submit(_run_some, sent, []) for _ in range(n)]

    def end(self) -> None:
        """End the processes, whatever they are at: after Ctrl-C nobody asks for it."""
        if self._pool is not None:
            import multiprocessing

            for child in set(multiprocessing.active_children()) - self._others:
                child.terminate()
            # Waits for the pool's own thread: the end of Python could meet it half closed, and print so.
            self._pool.shutdown(cancel_futures=True)


def _pickled(run: Callable[..., Any]) -> bytes | None:
    """Return a run as bytes; None if it cannot be sent."""
    try:
        content = pickle.dumps(run, pickle.HIGHEST_PROTOCOL)
    except (pickle.PicklingError, AttributeError, TypeError):  # a filter that the caller made up
        return None
    return content if len(content) <= MOST_BYTES else None


@contextmanager
def _deaf_to_ctrl_c() -> Iterator[None]:
    """Begin processes that Ctrl-C does not reach: while they import, they would print where they were; `end` ends them.

    This one hears of it afterwards.
    """
    if not hasattr(signal, "pthread_sigmask"):  # Windows
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _begin() -> None:
    """Prepare a process: it has one thread, ends in silence with Ctrl-C, and does not outlive the one that began it."""
    set_threads(1)
    signal.signal(signal.SIGINT, lambda *_: os._exit(130))
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    import multiprocessing

    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)


def _run_some(content: bytes, items: Sequence[Any]) -> list[Any]:
    run = pickle.loads(content)
    return [run(item) for item in items]


_helpers: _Helpers | None = None
