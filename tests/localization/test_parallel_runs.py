"""Runs in several processes are those of one: in order, whatever dies, and never without being asked for."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import wait
from functools import partial
from multiprocessing import connection

import pytest

from beamfield.cli import main as command_line
from beamfield.cli.main import main
from beamfield.cli.outcome import Outcome
from beamfield.kernels.threads import n_threads, set_threads
from beamfield.localization import parallel_runs
from beamfield.localization.parallel_runs import run_each

SEEDS = list(range(11))


def made(seed: int) -> tuple[int, int, int]:
    return seed, os.getpid(), n_threads()


def fails(seed: int) -> int:
    if seed == 7:
        raise ZeroDivisionError("seed 7")
    return seed


def dies_elsewhere(home: int, seed: int) -> int:
    if os.getpid() != home:
        os.kill(os.getpid(), signal.SIGKILL)
    return seed


@pytest.fixture
def three_processes(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """Two processes beside this one, ready."""
    monkeypatch.setattr(parallel_runs, "START_AFTER_S", 0.0)
    with set_threads(3), parallel_runs.parallel_runs():
        run_each(made, [1])
        assert parallel_runs._helpers is not None
        wait(parallel_runs._helpers._started)
        yield


@pytest.mark.usefixtures("three_processes")
def test_processes_share_the_runs_which_come_in_order():
    for n in (1, 2, 3, 11):
        told: list[tuple[int, int]] = []
        results = run_each(made, SEEDS[:n], lambda done, of, told=told: told.append((done, of)))
        assert [seed for seed, _, _ in results] == SEEDS[:n]
        assert len({pid for _, pid, _ in results}) in ({1} if n == 1 else {2, 3})
        # Each has one thread: all processors are taken.
        assert {threads for _, _, threads in results} == ({3} if n == 1 else {1})
        assert told == [(done, n) for done in range(0, n, min(n, 3))]
        assert n_threads() == 3


@pytest.mark.usefixtures("three_processes")
def test_an_error_of_a_run_is_raised_wherever_it_ran():
    for seeds in ([7, 1], [1, 7], [1, 2, 7]):
        with pytest.raises(ZeroDivisionError, match="seed 7"):
            run_each(fails, seeds)
    assert run_each(fails, SEEDS[:7]) == SEEDS[:7]


@pytest.mark.skipif(sys.platform == "win32", reason="kills are POSIX's")
@pytest.mark.usefixtures("three_processes")
def test_runs_of_a_process_that_dies_are_made_here():
    assert run_each(partial(dies_elsewhere, os.getpid()), SEEDS) == SEEDS
    assert [pid for _, pid, _ in run_each(made, SEEDS)] == [os.getpid()] * 11


@pytest.mark.usefixtures("three_processes")
def test_what_cannot_be_sent_runs_here(monkeypatch):
    assert run_each(lambda seed: (seed, os.getpid()), SEEDS) == [(seed, os.getpid()) for seed in SEEDS]
    monkeypatch.setattr(parallel_runs, "MOST_BYTES", 10)
    assert {pid for _, pid, _ in run_each(made, SEEDS)} == {os.getpid()}


def waits(seed: int) -> int:
    if seed > 1:
        time.sleep(60.0)
    return seed


def test_nobody_waits_for_what_others_are_at_after_an_interrupt(monkeypatch):
    def interrupt(done: int, _: int) -> None:
        if done > 0:
            raise KeyboardInterrupt

    def work() -> None:
        with set_threads(2), parallel_runs.parallel_runs():
            run_each(made, [1])
            assert parallel_runs._helpers is not None
            wait(parallel_runs._helpers._started)
            run_each(waits, [0, 2, 1, 2], interrupt)

    monkeypatch.setattr(parallel_runs, "START_AFTER_S", 0.0)
    before = set(multiprocessing.active_children())
    with pytest.raises(KeyboardInterrupt):
        work()
    # Not join: the pool's own thread may have asked for the child's exit code first.
    left = [child.sentinel for child in set(multiprocessing.active_children()) - before]
    assert not left or set(connection.wait(left, 10.0)) == set(left)


def test_where_no_process_can_be_started_all_run_here(monkeypatch):
    def refuse(*_: object) -> None:
        raise OSError("no semaphores")

    monkeypatch.setattr(parallel_runs, "START_AFTER_S", 0.0)
    monkeypatch.setattr("concurrent.futures.ProcessPoolExecutor", refuse)
    with set_threads(3), parallel_runs.parallel_runs():
        assert {pid for _, pid, _ in run_each(made, SEEDS)} == {os.getpid()}


def test_short_work_one_thread_and_whoever_does_not_ask_start_no_process(monkeypatch):
    with set_threads(3), parallel_runs.parallel_runs():
        run_each(made, SEEDS)
        assert parallel_runs._helpers is not None
        assert parallel_runs._helpers._pool is None
    monkeypatch.setattr(parallel_runs, "START_AFTER_S", 0.0)
    with set_threads(1), parallel_runs.parallel_runs():
        assert {pid for _, pid, _ in run_each(made, SEEDS)} == {os.getpid()}
        assert parallel_runs._helpers._pool is None
    assert parallel_runs._helpers is None
    with set_threads(3):
        assert {pid for _, pid, _ in run_each(made, SEEDS)} == {os.getpid()}


def test_a_command_that_a_script_calls_starts_no_process(monkeypatch):
    seen: list[object] = []

    def run(_: object) -> Outcome:
        seen.append(parallel_runs._helpers)
        return Outcome("figures")

    monkeypatch.setattr("beamfield.cli.figures.run", run)
    # The parser that all tests share knows the function from before.
    monkeypatch.setattr(command_line, "build_parser", command_line.build_parser.__wrapped__)
    assert main(["figures", "--list"]) == 0
    assert seen == [None]


KILLED = """
import os, signal, sys
from concurrent.futures import wait
from beamfield.localization import parallel_runs
from beamfield.kernels.threads import set_threads
if __name__ == "__main__":
    parallel_runs.START_AFTER_S = 0.0
    with set_threads(2), parallel_runs.parallel_runs():
        parallel_runs.run_each(abs, [1])
        print(parallel_runs._helpers._pool.submit(os.getpid).result(), flush=True)
        os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="kills are POSIX's")
def test_processes_end_when_the_one_that_began_them_is_killed(tmp_path):
    (tmp_path / "killed.py").write_text(KILLED)
    # They write to the same pipe: it ends with the last of them.
    done = subprocess.run(
        [sys.executable, tmp_path / "killed.py"], stdout=subprocess.PIPE, text=True, check=False, timeout=60
    )
    assert done.returncode == -signal.SIGKILL
    assert int(done.stdout) > 0


INTERRUPTED = """
import os, signal, sys, time
from beamfield.localization import parallel_runs
from beamfield.kernels.threads import set_threads
if __name__ == "__main__":
    # Shells let processes in the background ignore it.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    parallel_runs.START_AFTER_S = 0.0
    try:
        with set_threads(2), parallel_runs.parallel_runs():
            parallel_runs.run_each(abs, [1])
            time.sleep(0.1)  # the other process still imports
            try:
                os.killpg(0, signal.SIGINT)
                time.sleep(60.0)
            finally:
                time.sleep(1.0)  # busy, as with a run
    except KeyboardInterrupt:
        sys.exit(130)
"""


@pytest.mark.skipif(sys.platform == "win32", reason="groups of processes are POSIX's")
def test_processes_that_start_end_in_silence_with_ctrl_c(tmp_path):
    (tmp_path / "interrupted.py").write_text(INTERRUPTED)
    done = subprocess.run(
        [sys.executable, tmp_path / "interrupted.py"],
        stderr=subprocess.PIPE, text=True, check=False, timeout=60, start_new_session=True,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (130, "")
