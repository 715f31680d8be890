"""The same bits wherever a fleet's work is done, and whatever happens to those who do it."""

from __future__ import annotations

import os
import random
import signal
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import distributed
import numpy as np
import pytest

from beamfield.calibration.intrinsic.likelihood import theta_of
from beamfield.errors import InvalidInputError
from beamfield.fleet import learning
from beamfield.fleet.engine import Engine, WorkersLostError
from beamfield.fleet.learning import GroupFit, learn
from beamfield.fleet.scan import FleetScan, scan_fleet
from beamfield.fleet.shard import Shard
from beamfield.kernels.threads import n_threads, set_threads
from tests.fleet.test_learning import TRUTH, fleet_of

KILLS = 1


def draw(seed: int) -> np.ndarray:
    """Sums of these depend on the order in which they are added up."""
    return np.random.default_rng(seed).normal(size=3) * 10.0 ** (seed % 7)


def add(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a + b


def moments_of(shard: Shard) -> np.ndarray:
    time.sleep(0.1)
    ranges = shard.read(["range"])["range"].astype(np.float64)
    return np.array([ranges.sum(), np.sqrt(ranges).sum(), n_threads()])


def lost(number: int) -> int:
    return -number


def in_pairs(values: list[np.ndarray]) -> np.ndarray:
    while len(values) > 1:
        values = [add(*values[i : i + 2]) if i + 1 < len(values) else values[i] for i in range(0, len(values), 2)]
    return values[0]


@pytest.mark.parametrize("n", [1, 2, 3, 7, 64, 700, 1000])
def test_items_are_combined_in_pairs(n: int):
    with Engine("serial") as engine:
        np.testing.assert_array_equal(engine.reduce(draw, list(range(n)), add), in_pairs(list(map(draw, range(n)))))


def test_progress_counts_items():
    told: list[tuple[int, int]] = []
    with Engine("serial") as engine:
        engine.map(abs, [1, 2, 3], progress=lambda done, n: told.append((done, n)))
    assert told == [(1, 3), (2, 3), (3, 3)]


@pytest.fixture(scope="module")
def processes() -> Iterator[Engine]:
    """An engine of two processes: to start them takes seconds."""
    with Engine("processes", 2) as engine:
        yield engine


def test_two_processes_learn_the_same_as_one(processes: Engine, monkeypatch):
    catalogue = fleet_of(TRUTH, n_shards=7, n_scans=20)

    def fits(engine: Engine) -> tuple[GroupFit, ...]:
        with monkeypatch.context() as patch:  # workers do not see it
            patch.setattr(learning, "SAMPLE_BEAMS", 1000)
            of_fleet = learn(catalogue, engine).fits
        return of_fleet + learn(catalogue, engine, by="robot").fits

    with Engine("serial") as serial:
        here, there = fits(serial), fits(processes)
    # To the bit where all kernels come from Numba's cache: a process that compiles them may round otherwise.
    for one, other in zip(here, there, strict=True):
        np.testing.assert_allclose(theta_of(one.parameters), theta_of(other.parameters), rtol=1e-12, atol=1e-14)
        assert one.log_likelihood == pytest.approx(other.log_likelihood, rel=1e-13)
        assert one.intervals.intervals.keys() == other.intervals.intervals.keys()
        for name, interval in one.intervals.intervals.items():
            assert other.intervals.intervals[name] == pytest.approx(interval, rel=1e-9)
        np.testing.assert_allclose(one.covariance, other.covariance, rtol=1e-9, atol=1e-16)


@pytest.mark.skipif(sys.platform == "win32", reason="kills are POSIX's")
def test_a_killed_worker_changes_no_bit_of_shards_and_sums(
    scanned: FleetScan, world: Path, processes: Engine, tmp_path: Path
):
    with Engine("serial") as engine:
        sums = engine.reduce(moments_of, scanned.catalogue.shards() * 3, add)
    kills: list[int] = []
    done = threading.Event()

    def kill_now_and_then(engine: Engine) -> None:
        chance = random.Random(5)
        while len(kills) < KILLS and not done.wait(chance.uniform(0.1, 0.7)):
            pids = [nanny.pid for nanny in engine.cluster.workers.values() if nanny.pid]
            if pids:
                kills.append(chance.choice(pids))
                os.kill(kills[-1], signal.SIGKILL)

    killer = threading.Thread(target=kill_now_and_then, args=(processes,))
    killer.start()
    try:
        killed = scan_fleet(world / "fleet.csv", str(tmp_path / "killed"), processes)
        again = processes.reduce(moments_of, killed.catalogue.shards() * 3, add)
    finally:
        done.set()
        killer.join()
    many = processes.reduce(draw, list(range(1000)), add)
    with pytest.raises(ZeroDivisionError):
        processes.map(divmod_by_zero, [1])
    assert kills
    assert contents(tmp_path / "killed") == contents(world / "catalogue")
    np.testing.assert_array_equal(again[:2], sums[:2])
    assert again[2] == 12.0, "a worker computes with one thread"
    np.testing.assert_array_equal(many, in_pairs(list(map(draw, range(1000)))))


def divmod_by_zero(number: int) -> tuple[int, int]:
    return divmod(number, 0)


class KilledByThree(Engine):
    """An engine whose workers die of the item 3, and of what is beside it."""

    def _outcomes(self, function, items):
        died = distributed.KilledWorker("task", None, 2)
        for name, item in items.items():
            yield (name, None, died) if 3 in items.values() else (name, function(item), None)


def test_only_what_kills_workers_alone_is_lost():
    engine = KilledByThree("serial")
    engine._client = "some"
    assert engine.map(abs, [-1, -2, 3, -4, 3], lost=lost) == [1, 2, -3, 4, -3]
    with pytest.raises(WorkersLostError, match="too little memory"):
        engine.map(abs, [1, 3])


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_what_is_no_scheduler_is_said_at_once():
    for address in ("rubbish", "tcp://host", "tcp://host:port"):
        with pytest.raises(InvalidInputError, match="expected serial, processes or an address as tcp://host:8786"):
            Engine(address)
    with pytest.raises(OSError, match="no Dask scheduler answers"):
        Engine("tcp://127.0.0.1:1")
    with pytest.raises(InvalidInputError, match="a scheduler has workers of its own"):
        Engine("tcp://127.0.0.1:1", workers=2)
    with Engine("serial") as engine, pytest.raises(InvalidInputError, match="expected at least one"):
        engine.reduce(abs, [], max)


def test_a_scheduler_of_ones_own_is_asked_at_its_address():
    cluster = distributed.LocalCluster(
        n_workers=1, threads_per_worker=2, processes=False, protocol="tcp", dashboard_address=None, silence_logs=50,
        scheduler_kwargs={"dashboard_address": "127.0.0.1:0"},
    )  # fmt: skip
    # Its workers are threads of this process.
    with cluster, set_threads(None), Engine(cluster.scheduler_address) as engine:
        np.testing.assert_array_equal(engine.reduce(draw, list(range(300)), add), in_pairs(list(map(draw, range(300)))))
        assert engine.map(abs, [-1, -2, -2], key=str) == [1, 2, 2]
        set_threads(None)
