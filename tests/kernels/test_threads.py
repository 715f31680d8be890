"""Slices over several threads: every row once, errors come through, calls from anywhere."""

from __future__ import annotations

import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from beamfield.kernels import threads
from beamfield.kernels.threads import run_in_slices


@pytest.mark.parametrize("threads", [None, 1, 2, 3, 7, 100])
@pytest.mark.parametrize("n_rows", [0, 1, 2, 50])
def test_every_row_is_worked_on_once(n_rows, threads):
    count = np.zeros(n_rows, np.int64)

    def work(start, stop):
        count[start:stop] += 1

    run_in_slices(work, n_rows, threads=threads, work_per_row=10**6)
    assert (count == 1).all()


@pytest.mark.parametrize("bad_row", [0, 9])
def test_an_error_in_any_slice_comes_through_after_all_slices_are_done(bad_row):
    done = np.zeros(10, np.bool_)

    def work(start, stop):
        done[start:stop] = True
        if start <= bad_row < stop:
            raise KeyError(bad_row)

    with pytest.raises(KeyError, match=str(bad_row)):
        run_in_slices(work, 10, threads=5)
    assert done.all()


def test_work_may_call_back_without_waiting_for_itself():
    total = np.zeros(64)

    def inner(start, stop):
        total[start:stop] += 1.0

    def outer(start, stop):
        run_in_slices(lambda a, b: inner(start + a, start + b), stop - start, threads=4)

    run_in_slices(outer, 64, threads=8)
    assert (total == 1.0).all()


def test_many_callers_share_the_threads():
    def call(_):
        rows = np.zeros(100)

        def work(start, stop):
            rows[start:stop] += np.arange(start, stop)

        run_in_slices(work, 100, threads=6)
        return rows.sum()

    with ThreadPoolExecutor(8) as pool:
        assert set(pool.map(call, range(100))) == {4950.0}


def test_threads_are_kept_between_calls():
    seen = set()
    for _ in range(20):
        run_in_slices(lambda _a, _b: seen.add(threading.get_ident()), 2, threads=2)
    assert len(seen) <= 1 + max(1, (os.cpu_count() or 1) - 1)


class Interrupt(Exception):
    """What a signal's handler raises, as Ctrl-C does."""


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers on this system")
def test_a_wait_that_a_signal_ends_loses_no_thread(monkeypatch):
    monkeypatch.setattr(threads, "n_processors", lambda: 2)
    monkeypatch.setattr(threads, "_idle", [])
    monkeypatch.setattr(threads, "_n_started", 0)
    caller, go_on, seen = threading.get_ident(), threading.Event(), set()

    def work(_start, _stop):
        if threading.get_ident() != caller:
            seen.add(threading.get_ident())
            go_on.wait(30.0)

    def raise_interrupt(*_):
        raise Interrupt

    before = signal.signal(signal.SIGALRM, raise_interrupt)
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.05)
        with pytest.raises(Interrupt):
            run_in_slices(work, 2, threads=2)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    go_on.set()
    deadline = time.monotonic() + 30.0
    while not threads._idle:
        assert time.monotonic() < deadline
        time.sleep(0.001)
    run_in_slices(work, 2, threads=2)
    assert len(seen) == 1


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_forked_process_has_threads_of_its_own():
    run_in_slices(lambda _a, _b: None, 4, threads=4)
    child = os.fork()
    if child == 0:
        rows = np.zeros(4)

        def work(start, stop):
            rows[start:stop] = 1.0

        run_in_slices(work, 4, threads=4)
        os._exit(0 if rows.all() else 1)
    for _ in range(100):
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            break
        threading.Event().wait(0.1)
    else:
        os.kill(child, 9)
        os.waitpid(child, 0)
        pytest.fail("the forked process waits for threads that it does not have")
    assert status == 0


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="threads cannot be placed on this system")
@pytest.mark.skipif((os.cpu_count() or 1) < 2, reason="one processor")
def test_helping_threads_keep_off_the_callers_processor():
    allowed = os.sched_getaffinity(0)
    helpers = {}

    def work(_start, _stop):
        me = threading.get_native_id()
        helpers[me] = os.sched_getaffinity(me)

    run_in_slices(work, 2, threads=2)
    helpers.pop(threading.get_native_id())
    assert all(len(allowed - places) == 1 for places in helpers.values())
    assert os.sched_getaffinity(0) == allowed
