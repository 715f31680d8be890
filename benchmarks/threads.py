"""Compare calls on several threads with the same calls on one: the time that passes, and the processors' time.

Calls take turns in one process, after a pause or without, first as the machine is and then beside processes that only
compute, one of them or one per processor. A row compares all calls of a kind: medians and 90th percentiles of their
times, and the sum of their processors' time.

Run: python benchmarks/threads.py [SECONDS PER ROW]
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from beam_model import N_BEAMS, near, office
from beamfield.kernels.threads import n_threads, set_threads
from beamfield.maps.distance import distance_to_obstacles
from beamfield.maps.raycast import RayCaster
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import Scan
from likelihood_field import MAX_RANGE, PARAMETERS, RangeFinder
from tables import print_table

SECONDS = 4.0
# Between two calls of a filter; 0 calls one after the other.
PAUSES_S = (0.0, 0.02)

Call = Callable[[], object]


def cases() -> dict[str, Call]:
    """Return calls by name."""
    rng = np.random.default_rng(7)
    grid = office(rng)
    finder = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, N_BEAMS, endpoint=False), MAX_RANGE)
    truth = np.array([25.0, 25.0, 0.3])
    caster, field = RayCaster(grid), LikelihoodFieldModel(grid, PARAMETERS)
    bilinear = LikelihoodFieldModel(grid, PARAMETERS, interpolation="bilinear")
    scan = Scan(np.clip(caster.expected_ranges(truth, finder), 0.1, 0.99 * MAX_RANGE), finder)
    calls: dict[str, Call] = {}
    for n in (200, 2_000, 20_000, 200_000):
        calls[f"field, {n:,} poses"] = partial(field.log_likelihood, scan, near(truth, rng, n))
    for n in (2_000, 20_000):
        calls[f"bilinear, {n:,} poses"] = partial(bilinear.log_likelihood, scan, near(truth, rng, n))
    for n in (100, 1_000, 10_000):
        calls[f"rays, {n:,} poses"] = partial(caster.expected_ranges, near(truth, rng, n), finder)
    return calls | {f"distances, {grid.shape[0]} x {grid.shape[1]} cells": partial(distance_to_obstacles, grid)}


def compare(call: Call, threads: int, pause: float, seconds: float) -> dict[str, Any]:
    """Return the ratios of several threads' times to one's."""
    passed: dict[int, list[float]] = {1: [], threads: []}
    used = dict.fromkeys(passed, 0.0)
    call()
    end = time.monotonic() + seconds
    while time.monotonic() < end or len(passed[1]) < 20:
        for n in passed:
            time.sleep(pause)
            with set_threads(n):
                processors, start = time.process_time(), time.perf_counter()
                call()
                passed[n].append(time.perf_counter() - start)
                used[n] += time.process_time() - processors
    one, several = passed[1], passed[threads]
    return {
        "calls": len(one),
        "one thread [ms]": np.median(one) * 1e3,
        "time / one's": np.median(several) / np.median(one),
        "mean": np.mean(several) / np.mean(one),
        "p90": np.percentile(several, 90) / np.percentile(one, 90),
        "processors' time / one's": used[threads] / used[1],
    }


@contextmanager
def neighbours(n: int) -> Iterator[None]:
    """Have so many other processes compute."""
    processes = [multiprocessing.get_context("spawn").Process(target=spin, daemon=True) for _ in range(n)]
    for process in processes:
        process.start()
    time.sleep(1.0 if n else 0.0)
    try:
        yield
    finally:
        for process in processes:
            process.kill()
            process.join()


def spin() -> None:
    while True:
        pass


def load() -> str:
    """Return how many threads of the machine run, this one among them."""
    path = Path("/proc/loadavg")
    return path.read_text().split()[3] if path.exists() else "unknown"


def main() -> None:
    """Print a table for each number of busy neighbours."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else SECONDS
    calls, threads, processors = cases(), n_threads(), os.cpu_count() or 1
    if threads == 1:
        sys.exit("this process may use one processor only: nothing to compare")
    for n in sorted({0, 1, processors}):
        print(f"{threads} threads, {n} busy neighbours; threads that ran before (running/existing): {load()}\n")
        with neighbours(n):
            print_table(
                [
                    {"call": name, "pause [ms]": 1e3 * pause} | compare(call, threads, pause, seconds)
                    for name, call in calls.items()
                    for pause in PAUSES_S
                ],
                digits=3,
            )
        print()


if __name__ == "__main__":
    main()
