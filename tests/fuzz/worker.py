"""One process that reads many inputs and reports on them; the present input lies in a folder, should it hang or die."""

from __future__ import annotations

import gc
import importlib
import itertools
import os
import random
import resource
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from tests.fuzz.case import Case
from tests.fuzz.memory import PeakMemory, address_space
from tests.fuzz.mutate import mutated
from tests.fuzz.outcome import Outcome, keep, observe
from tests.fuzz.target import Target
from tests.quick_bags import compiled_once

# Beyond what the examples need; a reader that asks for more gets a MemoryError before the machine suffers.
SPARE_BYTES = 2 * 2**30
# Inputs that went a way of their own are mutated on, unless they are large, which is slow; so are more than these.
MOST_IN_POOL = 400
BATCH_SECONDS = 0.4
KEPT_PER_PLACE = 3


@dataclass
class Batch:
    """What came of some inputs of one target."""

    target: str
    counts: Counter[str] = field(default_factory=Counter)
    slowest: float = 0.0
    largest: int = 0
    cpu: float = 0.0
    faults: list[tuple[str, str, str]] = field(default_factory=list)


class Stream:
    """The inputs of one target in a fixed order: valid examples, then what mutation makes of them.

    Inputs that end where none ended before are mutated on, so that the stream gets deeper with time.
    """

    def __init__(self, target: Target, seed: str) -> None:
        self.target = target
        self.rng = random.Random(f"{seed}/{target.name}")
        self.seed = seed
        self.examples = target.seeds()
        self.pool = list(self.examples)
        self._largest = max(case.n_bytes for case in self.examples)
        self.number = 0
        self.ended_there: Counter[str] = Counter()

    def inputs(self) -> Iterator[Case]:
        yield from self.examples
        while True:
            yield mutated(self.pool, self.rng)

    def learn(self, case: Case, outcome: Outcome) -> None:
        """Keep the input for mutation if it went a way that few inputs went."""
        self.number += 1
        way = _way(outcome)
        self.ended_there[way] += 1
        rare = self.ended_there[way] == 1 or (outcome.kind == "ok" and self.rng.random() < 0.01)
        small = case.n_bytes <= 4 * self._largest
        if rare and small and not outcome.is_fault and len(self.pool) < MOST_IN_POOL:
            self.pool.append(case)


def read_inputs(stream: Stream, inputs: Iterator[Case], folder: Path, memory: PeakMemory | None, faults: Path,
                *, n: int | None = None, seconds: float = 0.0) -> Batch:  # fmt: skip
    """Read n inputs of a stream, or as many as take so much CPU time; keep those that are faulty."""
    batch = Batch(stream.target.name)
    start = time.process_time()
    while (n is None or sum(batch.counts.values()) < n) and (n is not None or time.process_time() - start < seconds):
        case = next(inputs)
        outcome = observe(stream.target, case, folder, memory)
        stream.learn(case, outcome)
        batch.counts[outcome.kind] += 1
        batch.slowest = max(batch.slowest, outcome.seconds)
        batch.largest = max(batch.largest, outcome.n_bytes)
        if outcome.is_fault:
            _keep(stream, case, outcome, faults, batch)
    batch.cpu = time.process_time() - start
    return batch


def _way(outcome: Outcome) -> str:
    return f"{outcome.kind} {outcome.place}"


def _keep(stream: Stream, case: Case, outcome: Outcome, faults: Path, batch: Batch) -> None:
    kept = ""
    if stream.ended_there[_way(outcome)] <= KEPT_PER_PLACE:
        origin = f"input {stream.number} of {stream.target.name}, seed {stream.seed}, process {os.getpid()}"
        kept = str(keep(outcome, stream.target.name, case, faults, origin))
    batch.faults.append((_way(outcome), outcome.text.strip().splitlines()[-1][:300], kept))


@dataclass(frozen=True)
class Task:
    """What a worker is to do.

    Parameters
    ----------
    names
        Targets to read in turn.
    seed
        What all inputs follow from.
    faults
        Where faulty inputs are kept.
    catalogue
        The module that has the targets by name.
    """

    names: tuple[str, ...]
    seed: str
    faults: Path
    catalogue: str = "tests.fuzz.targets"

    def targets(self) -> list[Target]:
        by_name: dict[str, Target] = importlib.import_module(self.catalogue).BY_NAME
        return [by_name[name] for name in self.names]


def work(connection: Connection, started: Any, task: Task, folder: Path) -> None:
    """Read inputs of some targets in turn until nobody listens; the entry of a worker process.

    Parameters
    ----------
    connection
        Takes a `Batch` after each; a text first says which target begins.
    started
        Shared number: the CPU time at which the present input began.
    task
        What to read.
    folder
        For the files of the present input.
    """
    with compiled_once():
        _work(connection, started, task, folder)


def _work(connection: Connection, started: Any, task: Task, folder: Path) -> None:
    scratch = folder / "scratch"
    scratch.mkdir(parents=True, exist_ok=True)
    tempfile.tempdir = str(scratch)
    streams = [Stream(target, task.seed) for target in task.targets()]
    inputs = {stream.target.name: stream.inputs() for stream in streams}
    for stream in streams:
        _begin(connection, started, stream)
        # Imports and compilation of what is needed later come before anything is measured.
        for case in stream.examples:
            observe(stream.target, case, folder / "case")
    _limit_memory()
    gc.disable()
    memory = PeakMemory()
    for stream in itertools.cycle(streams):
        _begin(connection, started, stream)
        open_before = _n_open()
        batch = read_inputs(stream, _timed(inputs[stream.target.name], started), folder / "case", memory, task.faults,
                            seconds=BATCH_SECONDS * stream.target.weight)  # fmt: skip
        gc.collect()
        if _n_open() > open_before:
            batch.faults.append(("descriptors", f"{_n_open() - open_before} files more are open than before", ""))
        if left := sorted(path.name for path in scratch.iterdir()):
            batch.faults.append(("temporary files", ", ".join(left)[:300], ""))
        try:
            connection.send(batch)
        except (BrokenPipeError, OSError):
            return


def _begin(connection: Connection, started: Any, stream: Stream) -> None:
    started.value = time.process_time()
    connection.send(stream.target.name)


def _timed(inputs: Iterator[Case], started: Any) -> Iterator[Case]:
    for case in inputs:
        started.value = time.process_time()
        yield case


def _limit_memory() -> None:
    used = address_space()
    if used:
        resource.setrlimit(resource.RLIMIT_AS, (used + SPARE_BYTES, resource.RLIM_INFINITY))


def _n_open() -> int:
    try:
        return len(list(Path("/proc/self/fd").iterdir()))
    except OSError:
        return 0
