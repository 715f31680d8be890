"""Jobs for threads that wait awake: every row once, whoever comes late, whoever calls, however often."""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numba
import numpy as np
import pytest

from beamfield.kernels import crew
from beamfield.kernels.atomic import add, load, pointer, replace, store

pytestmark = pytest.mark.skipif(not crew.is_possible(), reason="kernels are interpreted")


def _count_rows(job, start, stop):
    words = numba.carray(job, (3,))
    rows = numba.carray(pointer(words[0]), (words[1],), np.int64)
    for i in range(start, stop):
        rows[i] += words[2]


@functools.cache
def count_rows():
    return numba.cfunc("void(CPointer(int64), int64, int64)")(_count_rows)


def counted(n_rows, block, threads, amount=1):
    rows = np.zeros(n_rows, np.int64)
    job = np.array([rows.ctypes.data, n_rows, amount], np.int64)
    crew.run_together(count_rows().address, job, n_rows, block, threads=threads)
    return rows


@pytest.fixture
def processors(monkeypatch):
    """Four processors, whatever the machine has, and a board without threads."""
    monkeypatch.setattr(crew, "n_processors", lambda: 4)
    monkeypatch.setattr(crew, "_board", crew._Board())


@pytest.mark.parametrize("threads", [1, 2, 4, 9])
@pytest.mark.parametrize(("n_rows", "block"), [(0, 5), (1, 5), (5, 5), (6, 5), (1000, 7), (1000, 2000)])
@pytest.mark.usefixtures("processors")
def test_every_row_is_worked_on_once(n_rows, block, threads):
    for _ in range(20):
        assert (counted(n_rows, block, threads) == 1).all()


@pytest.mark.usefixtures("processors")
def test_thousands_of_jobs_follow_each_other_without_mixing():
    rng = np.random.default_rng(3)
    for amount in range(1, 5000):
        n_rows, block, threads = rng.integers(1, 60), rng.integers(1, 9), rng.integers(1, 5)
        assert (counted(int(n_rows), int(block), int(threads), amount) == amount).all()


def test_more_rows_than_blocks_can_be_numbered_become_larger_blocks():
    assert (counted(crew.BLOCKS + 10, 1, 2) == 1).all()


@pytest.mark.usefixtures("processors")
def test_callers_at_once_do_not_mix_their_jobs():
    with ThreadPoolExecutor(4) as pool:
        for amount, rows in enumerate(pool.map(lambda amount: counted(2000, 10, 3, amount), range(500))):
            assert (rows == amount).all()


@pytest.mark.usefixtures("processors")
def test_threads_sleep_when_nothing_comes_and_wake_again():
    counted(100, 1, 4)
    board = crew._board
    assert len(board._helpers) == 3
    deadline = time.monotonic() + 30.0
    while not all(helper.asleep for helper in board._helpers):
        assert time.monotonic() < deadline
        time.sleep(0.001)
    assert (counted(1000, 1, 4) == 1).all()


class Interrupt(Exception):
    """What a signal's handler raises, as Ctrl-C does."""


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers on this system")
@pytest.mark.usefixtures("processors")
def test_a_signal_at_any_moment_leaves_the_threads_at_work():
    def raise_interrupt(*_):
        raise Interrupt

    counted(100, 1, 3)
    before = signal.signal(signal.SIGALRM, raise_interrupt)
    rng = np.random.default_rng(6)
    rows, job = np.zeros(100, np.int64), np.zeros(3, np.int64)
    job[:] = rows.ctypes.data, 100, 1
    try:
        for _ in range(2000):
            # Not within numba's cfunc or a test's own arrays: only while the call is under way.
            with contextlib.suppress(Interrupt):
                signal.setitimer(signal.ITIMER_REAL, rng.uniform(1e-6, 6e-5))
                crew.run_together(count_rows().address, job, 100, 1, threads=3)
                signal.setitimer(signal.ITIMER_REAL, 0.0)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert load_word(crew._board.words, crew.TAKEN) == 0
    assert_others_share_the_work()


@numba.njit
def load_word(words, i):
    return load(words, i)


@pytest.mark.usefixtures("processors")
def test_others_do_share_the_work():
    assert_others_share_the_work()


def assert_others_share_the_work():
    def meet(job, _start, _stop):
        words = numba.carray(job, (2,))
        inside = numba.carray(pointer(words[0]), (2,), np.int64)
        add(inside, 0, 1)
        for _ in range(words[1]):
            if load(inside, 0) >= 2:
                store(inside, 1, 1)
                break
        add(inside, 0, -1)

    compiled = numba.cfunc("void(CPointer(int64), int64, int64)")(meet)
    inside = np.zeros(2, np.int64)
    for _ in range(100):
        crew.run_together(compiled.address, np.array([inside.ctypes.data, 10**7], np.int64), 2, 1, threads=2)
        if inside[1]:
            return
    pytest.fail("no two threads were ever at work at once")


def test_on_one_processor_the_caller_works_alone(monkeypatch):
    monkeypatch.setattr(crew, "n_processors", lambda: 1)
    monkeypatch.setattr(crew, "_board", crew._Board())
    assert (counted(100, 3, 8) == 1).all()
    assert crew._board._helpers == []


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_forked_process_has_threads_of_its_own():
    counted(100, 1, 2)
    child = os.fork()
    if child == 0:
        os._exit(0 if (counted(100, 1, 2) == 1).all() else 1)
    for _ in range(300):
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            break
        threading.Event().wait(0.1)
    else:
        os.kill(child, 9)
        os.waitpid(child, 0)
        pytest.fail("the forked process waits for threads that it does not have")
    assert status == 0


def test_atomic_words_are_one_for_all_threads():
    @numba.njit(nogil=True)
    def count(words, n):
        for _ in range(n):
            add(words, 0, 1)
            while True:
                old = load(words, 1)
                if replace(words, 1, old, old + 1):
                    break

    words = np.zeros(2, np.int64)
    count(words, 0)
    threads = [threading.Thread(target=count, args=(words, 100_000)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert words.tolist() == [400_000, 400_000]
    assert not numba.njit(lambda words: replace(words, 0, 1, 2))(words)
