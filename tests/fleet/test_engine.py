"""The same bits wherever a fleet's work is done, and whatever happens to those who do it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import distributed
import numpy as np
import pytest
from benchmarks.fleet_beams import memory_catalogue, memory_shard

from beamfield.errors import InvalidInputError
from beamfield.fleet import learning
from beamfield.fleet.engine import Engine, WorkersLostError
from beamfield.fleet.learning import learn
from beamfield.fleet.scan import FleetScan, scan_fleet
from beamfield.fleet.shard import Shard
from beamfield.kernels.threads import n_threads, set_threads
from beamfield.models.beam_parameters import BeamParameters
from tests.fleet.small_fleet import contents


def draw(seed: int) -> np.ndarray:
    """Sums of these depend on the order in which they are added up."""
    return np.random.default_rng(seed).normal(size=3) * 10.0 ** (seed % 7)


def add(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a + b


def moments_of(shard: Shard) -> np.ndarray:
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
def two_processes() -> Iterator[Engine]:
    with Engine("processes", 2) as engine:
        yield engine


def test_processes_learn_the_same_bits_as_one(two_processes: Engine, monkeypatch):
    rng = np.random.default_rng(3)
    truth = BeamParameters(0.7, 0.1, 0.1, 0.1, 0.05, 0.5, 0.02)
    catalogue = memory_catalogue([memory_shard(rng, truth, day=day, n_scans=20) for day in range(5)])

    def fits(engine: Engine) -> list[str]:
        with monkeypatch.context() as patch:  # workers do not see it
            patch.setattr(learning, "SAMPLE_BEAMS", 1000)
            of_fleet = learn(catalogue, engine).fits
        found = of_fleet + learn(catalogue, engine, by="robot").fits
        return [repr((fit.parameters, fit.log_likelihood, fit.intervals, fit.covariance.tolist())) for fit in found]

    # Where Numba's cache is cold, this process compiles the kernels and the workers read what it wrote.
    with Engine("serial") as engine:
        assert fits(engine) == fits(two_processes)


@pytest.mark.skipif(sys.platform == "win32", reason="kills are POSIX's")
def test_killed_workers_change_no_bit_of_shards_and_sums(
    two_processes: Engine, scanned: FleetScan, world: Path, tmp_path: Path
):
    with Engine("serial") as engine:
        sums = engine.reduce(moments_of, scanned.catalogue.shards() * 3, add)
    kills: list[int] = []

    def kill_one(stage: str, done: int, _: int) -> None:
        """Kill a worker in the middle of the work: after the first result, and before the last."""
        if (stage, done) == ("scanning logs", 1):
            kills.extend(nanny.pid for nanny in list(two_processes.cluster.workers.values())[:1] if nanny.pid)
            os.kill(kills[0], signal.SIGKILL)

    killed = scan_fleet(world / "fleet.csv", str(tmp_path / "killed"), two_processes, progress=kill_one)
    again = two_processes.reduce(moments_of, killed.catalogue.shards() * 3, add)
    many = two_processes.reduce(draw, list(range(1000)), add)
    with pytest.raises(ZeroDivisionError):
        two_processes.map(partial(divmod, 1), [0])
    assert kills
    assert contents(tmp_path / "killed") == contents(world / "catalogue")
    np.testing.assert_array_equal(again[:2], sums[:2])
    assert again[2] == 12.0, "a worker computes with one thread"
    np.testing.assert_array_equal(many, in_pairs(list(map(draw, range(1000)))))


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
        assert engine.map(abs, [-1, -2, -2]) == [1, 2, 2]
        set_threads(None)


INTERRUPTED = """
import os, signal, threading, time
import psutil
from beamfield.fleet.engine import Engine

def interrupt():
    # As a terminal does, as soon as a worker begins to import.
    while not any("spawn_main" in " ".join(one.cmdline()) for one in psutil.Process().children(recursive=True)):
        time.sleep(0.005)
    time.sleep(0.1)
    os.killpg(0, signal.SIGINT)

if __name__ == "__main__":
    # Shells let processes in the background ignore it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    threading.Thread(target=interrupt, daemon=True).start()
    try:
        with Engine("processes", 1) as engine:
            engine.map(time.sleep, [30.0])
    except KeyboardInterrupt:
        print("interrupted")
    print("left", [one.pid for one in psutil.Process().children() if "spawn_main" in " ".join(one.cmdline())])
"""


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="needs POSIX signals")
def test_an_interrupt_while_workers_start_ends_them_without_their_tracebacks(tmp_path):
    (tmp_path / "interrupted.py").write_text(INTERRUPTED)
    done = subprocess.run(
        [sys.executable, tmp_path / "interrupted.py"], capture_output=True, text=True, start_new_session=True,
        timeout=60, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout, done.stderr) == (0, "interrupted\nleft []\n", "")
