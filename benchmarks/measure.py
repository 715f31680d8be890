"""How benchmarks measure: on one thread, by its processor time, calls that are compared take turns."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

# A turn repeats a call until it has lasted about so long: clock and loop then count for nothing.
TURN_SECONDS = 0.01
ROUNDS = 11

Call = Callable[[], Any]


@dataclass(frozen=True)
class Case:
    """One line of the table: our call, what it is held against, and how far its result is from the baseline's."""

    name: str
    ours: Call
    baseline: Call
    against: str
    """What the baseline is."""
    n: float = 1.0
    """What the time of a call is divided by."""
    unit: str = "ns"
    limit: Call | None = None
    accuracy: str = ""


def take_turns(calls: Mapping[str, Call], rounds: int = ROUNDS) -> dict[str, NDArray[np.float64]]:
    """Return the processor seconds of each call in each round, after one that compiles."""
    repeats = {name: _repeats(call) for name, call in calls.items()}
    seconds = {name: np.empty(rounds) for name in calls}
    for i in range(rounds):
        for name, call in calls.items():
            start = time.thread_time()
            for _ in range(repeats[name]):
                call()
            seconds[name][i] = (time.thread_time() - start) / repeats[name]
    return seconds


def least_seconds(call: Call) -> float:
    """Return the least processor seconds of a call on one thread."""
    return float(take_turns({"": call})[""].min())


def median_seconds(call: Call, rounds: int = ROUNDS) -> float:
    """Return the median processor seconds of a call on one thread."""
    return float(np.median(take_turns({"": call}, rounds)[""]))


def least_elapsed(call: Call, repeats: int) -> float:
    """Return the least seconds of a call by the clock, for one that works on several threads, or on a GPU."""
    call()
    seconds = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - start)
    return min(seconds)


def _repeats(call: Call) -> int:
    call()
    start = time.thread_time()
    call()
    return max(1, int(TURN_SECONDS / max(time.thread_time() - start, 1e-6)))
