"""Where a fleet's work is done: by a Dask cluster, by processes of this machine, or here."""

from __future__ import annotations

import logging
import signal
import socket
import threading
import uuid
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from multiprocessing import resource_tracker
from typing import Any, Generic, NamedTuple, TypeVar
from urllib.parse import urlsplit

from beamfield.arguments import as_count
from beamfield.errors import BeamfieldError, InvalidInputError, needs
from beamfield.fleet.folder import without_secrets
from beamfield.kernels.processors import n_processors
from beamfield.kernels.threads import set_threads

Item = TypeVar("Item")
Result = TypeVar("Result")
# Called with items done and items in all.
Progress = Callable[[int, int], None]
# A task that was on so many workers when they died is what kills them.
MOST_DEATHS = 3
# Items are combined in about so many tasks: enough to share them out, and each costs the scheduler a millisecond.
TASKS = 256
# How long a scheduler may take to answer, seconds.
ANSWER_S = 10.0


class WorkersLostError(BeamfieldError):
    """A task was given up, because all workers that took it died."""


class Engine:
    """Applies functions to many items, with the same results wherever that happens.

    Parameters
    ----------
    scheduler
        "serial" in this process; "processes" of this machine, a Dask LocalCluster; or the address of a Dask scheduler.
        None: processes if there is more than one processor.
    workers
        Number of processes; None: one per processor. A scheduler's are its own.

    Raises
    ------
    InvalidInputError
        If workers < 1, or given for a scheduler that has its own.
    MissingDependencyError
        If Dask is needed and not installed.
    OSError
        If no scheduler answers at the address.

    Notes
    -----
    A context manager; at its end, processes that it started are gone. They speak TLS with keys made for the occasion,
    so that no other user of the machine can send them work. Each of them computes with one thread. A script that uses
    processes needs ``if __name__ == "__main__":``, as always with processes in Python.

    Examples
    --------
    >>> with Engine("serial") as engine:
    ...     engine.reduce(abs, [-1, 2, -3], max)
    3
    """

    def __init__(self, scheduler: str | None = None, workers: int | None = None) -> None:
        if workers is not None:
            as_count(workers, "workers", least=1)
        if scheduler is None:
            scheduler = "processes" if (workers or n_processors()) > 1 else "serial"
        if workers is not None and scheduler not in ("serial", "processes"):
            raise InvalidInputError("workers: a scheduler has workers of its own; give one of the two")
        self.cluster: Any = None
        self._client: Any = None
        if scheduler == "serial":
            return
        distributed = _require_distributed()
        if scheduler != "processes":
            _require_answer(scheduler)
        try:
            with _interrupts_wait():
                if scheduler == "processes":
                    self.cluster = _local_cluster(distributed, workers or n_processors())
                self._client = distributed.Client(self.cluster or scheduler, set_as_default=False)
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Engine:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the processes that this engine started."""
        if self._client is not None:
            self._client.close()
        if self.cluster is not None:
            self.cluster.close()

    def map(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        *,
        lost: Callable[[Item], Result] | None = None,
        progress: Progress | None = None,
    ) -> list[Result]:
        """Return function(item) of each item, in their order.

        Parameters
        ----------
        function
            Of a module, so that workers can import it; or a `functools.partial` of one.
        items
            What it is applied to; they and the results are sent between processes.
        lost
            What stands for the result of an item whose workers die; None: an error ends the work.
        progress
            Called with items done and in all.

        Raises
        ------
        WorkersLostError
            If all workers that took an item died.
        """
        results = dict(self._results(function, items, lost, progress))
        return [results[i] for i in range(len(items))]

    def reduce(
        self, function: Callable[[Item], Result], items: Sequence[Item], combine: Callable[[Result, Result], Result]
    ) -> Result:
        """Return the results of all items combined in a fixed order: neighbours first, then neighbouring pairs.

        The bits are the same for any number of workers, in whatever order results arrive.

        Parameters
        ----------
        function, items
            As for `map`; at least one item.
        combine
            Takes the results of neighbours, the earlier first; it is called in this process.

        Raises
        ------
        InvalidInputError
            If there is no item.
        WorkersLostError
            As for `map`.
        """
        if not items:
            raise InvalidInputError("items: expected at least one")
        size = 1
        while len(items) > size * TASKS and self._client is not None:
            size *= 2
        # Blocks begin at multiples of a power of two: a worker adds up a branch of the one tree, whatever their size.
        blocks = [_Block(function, combine, items[start : start + size]) for start in range(0, len(items), size)]
        total = _Tree(combine, len(blocks))
        for index, result in self._results(_reduce_block, blocks):
            total.add(index, result)
        return total.value()

    def _results(
        self,
        function: Callable[[Item], Result],
        items: Sequence[Item],
        lost: Callable[[Item], Result] | None = None,
        progress: Progress | None = None,
    ) -> Iterator[tuple[int, Result]]:
        """Yield the index and the result of each item, as they come."""
        if self._client is None:
            found: Iterator[tuple[int, Result]] = ((i, function(item)) for i, item in enumerate(items))
        else:
            found = self._from_workers(function, items, lost)
        for done, (index, result) in enumerate(found):
            yield index, result
            if progress is not None:
                progress(done + 1, len(items))

    def _from_workers(
        self, function: Callable[[Item], Result], items: Sequence[Item], lost: Callable[[Item], Result] | None
    ) -> Iterator[tuple[int, Result]]:
        distributed = _require_distributed()
        indices = {f"beamfield-{uuid.uuid4().hex}": i for i in range(len(items))}
        died: list[int] = []
        for name, result, error in self._outcomes(function, {name: items[i] for name, i in indices.items()}):
            if isinstance(error, distributed.KilledWorker):
                died.append(indices[name])
                continue
            if error is not None:
                raise error
            yield indices[name], result
        # What waited on a worker that another task killed is blamed with it: each once more, and alone.
        for i in died:
            ((_, result, error),) = self._outcomes(function, {f"beamfield-{uuid.uuid4().hex}": items[i]})
            if isinstance(error, distributed.KilledWorker):
                result = _lost(items[i], lost, error)
            elif error is not None:
                raise error
            yield i, result

    def _outcomes(
        self, function: Callable[[Item], Result], items: Mapping[str, Item]
    ) -> Iterator[tuple[str, Any, Exception | None]]:
        """Yield the name of each task and its result or its error, as they come."""
        futures = self._client.map(
            _with_one_thread, [function] * len(items), list(items.values()), key=list(items), pure=False,
            batch_size=1000,
        )  # fmt: skip
        arriving = _require_distributed().as_completed(futures, loop=self._client.loop)
        del futures
        for batch in arriving.batches():
            # One question for all of them: each alone takes milliseconds. Those that failed are None here.
            results = self._client.gather({future.key: future for future in batch}, errors="skip")
            for future in batch:
                finished = future.status == "finished"
                yield future.key, results[future.key], None if finished else future.exception()
                future.release()


class _Block(NamedTuple):
    """Items that one task takes together."""

    function: Callable[[Any], Any]
    combine: Callable[[Any, Any], Any]
    items: Sequence[Any]


def _reduce_block(block: _Block) -> Any:
    total = _Tree(block.combine, len(block.items))
    for index, item in enumerate(block.items):
        total.add(index, block.function(item))
    return total.value()


class _Tree(Generic[Result]):
    """Combines results pairwise by their index, each pair as soon as both are there."""

    def __init__(self, combine: Callable[[Result, Result], Result], n: int) -> None:
        self._combine = combine
        self._n = n
        # By level and index.
        self._waiting: dict[tuple[int, int], Result] = {}

    def add(self, index: int, value: Result) -> None:
        level, size = 0, self._n
        while size > 1:
            other = index ^ 1
            if other < size:
                if (level, other) not in self._waiting:
                    break
                neighbour = self._waiting.pop((level, other))
                value = self._combine(value, neighbour) if index < other else self._combine(neighbour, value)
            level, index, size = level + 1, index // 2, (size + 1) // 2
        self._waiting[level, index] = value

    def value(self) -> Result:
        (value,) = self._waiting.values()
        return value


def _with_one_thread(function: Callable[[Item], Result], item: Item) -> Result:
    """Apply a function in a worker: there is a worker for every processor."""
    set_threads(1)
    return function(item)


def _lost(item: Item, lost: Callable[[Item], Result] | None, error: Exception) -> Result:
    """Return what stands for an item whose workers died, or raise."""
    if lost is None:
        raise WorkersLostError(
            f"all workers that took a task died, {MOST_DEATHS} of them while it was alone: of too little memory, most "
            "often"
        ) from error
    return lost(item)


def _require_answer(scheduler: str) -> None:
    """Raise if nothing listens at an address: Dask itself would say so after minutes."""
    try:
        parts = urlsplit(scheduler)
        host, port = parts.hostname, parts.port
    except ValueError:
        host = port = None
    if host is None or port is None:
        got = without_secrets(scheduler)
        raise InvalidInputError(f"scheduler: expected serial, processes or an address as tcp://host:8786, got {got!r}")
    try:
        socket.create_connection((host, port), timeout=ANSWER_S).close()
    except OSError as error:
        raise OSError(error.errno, f"no Dask scheduler answers: {error.strerror or error}", f"{host}:{port}") from error


@contextmanager
def _interrupts_wait() -> Iterator[None]:
    """Let Ctrl-C wait until the block has ended, and processes that are started there not see it at all.

    A terminal sends it to all processes: those that were still importing printed a traceback each. They end when the
    engine is closed.
    """
    # Windows has no mask; Python interrupts the main thread alone, and not where another program handles signals.
    is_main = threading.current_thread() is threading.main_thread()
    if not hasattr(signal, "pthread_sigmask") or not is_main or signal.getsignal(signal.SIGINT) is None:
        yield
        return
    # Blocked for the processes, which inherit that; another thread of this one may still take the signal.
    came: list[int] = []
    handler = signal.signal(signal.SIGINT, lambda number, _: came.append(number))
    # Started with the first process otherwise, and lets interrupts through to the thread that did.
    resource_tracker.ensure_running()
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
        signal.signal(signal.SIGINT, handler)
        if came:
            signal.raise_signal(signal.SIGINT)


def _local_cluster(distributed: Any, workers: int) -> Any:
    import dask

    settings = {
        "distributed.scheduler.allowed-failures": MOST_DEATHS - 1,
        # Pages about the work, which any user of the machine could read.
        "distributed.scheduler.http.routes": [],
        "distributed.worker.http.routes": [],
    }
    with dask.config.set(settings):
        return distributed.LocalCluster(
            n_workers=workers, threads_per_worker=1, processes=True, security=True, silence_logs=logging.CRITICAL,
            # Any port, for two scans at once.
            dashboard_address=None, scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
        )  # fmt: skip


def _require_distributed() -> Any:
    with needs("distributed", "fleet", "work on several processors"):
        import distributed
    return distributed
