"""The pool of threads: every row once, errors come through, calls from anywhere, and how many threads there are."""

from __future__ import annotations

import contextlib
import functools
import os
import signal
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.kernels import processors, threads
from beamfield.kernels.processors import cpu_quota, n_idle, n_processors
from beamfield.kernels.threads import blocks, n_threads, run_in_blocks, set_threads
from tests.threads import forced_threads


@pytest.mark.parametrize("n", [None, 1, 2, 3, 7, 100])
@pytest.mark.parametrize("n_rows", [0, 1, 2, 50])
def test_every_row_is_worked_on_once(n_rows, n):
    count = np.zeros(n_rows, np.int64)

    def work(start, stop):
        count[start:stop] += 1

    with forced_threads(n):
        run_in_blocks(work, n_rows)
    assert (count == 1).all()


@pytest.mark.parametrize(("n_rows", "n", "least"), [(1, 2, 1), (10, 2, 0), (1000, 2, 70), (1001, 3, 1), (9999, 64, 10)])
def test_blocks_cover_the_rows_and_get_smaller(n_rows, n, least):
    parts = blocks(n_rows, n, least)
    assert [start for start, _ in parts] == [0, *(stop for _, stop in parts[:-1])]
    assert parts[-1][1] == n_rows
    sizes = [stop - start for start, stop in parts]
    assert max(sizes) <= max(n_rows / (2 * n), 1.5 * least, 1)
    assert all(later <= earlier for earlier, later in pairwise(sizes[:-1]))
    assert min(sizes[:-1], default=least) >= least


def test_several_threads_are_at_work_at_once():
    meeting = threading.Barrier(3)
    with forced_threads(3):
        run_in_blocks(lambda _a, _b: meeting.wait(30.0), 3)


@pytest.mark.usefixtures("fresh_pool")
def test_where_the_system_has_no_more_threads_those_that_are_there_work(monkeypatch):
    def refuse(*_):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr("_thread.start_new_thread", refuse)
    rows = np.zeros(100, int)
    with forced_threads(10**6):
        run_in_blocks(lambda start, stop: np.add.at(rows, np.arange(start, stop), 1), len(rows))
    assert (rows == 1).all()
    assert threads._jobs.empty()


def test_a_caller_whose_helpers_do_not_come_does_all_the_work(monkeypatch):
    monkeypatch.setattr(threads, "_call_for_help", lambda _job, _n: None)
    rows = []
    with forced_threads(4):
        run_in_blocks(lambda a, b: rows.extend(range(a, b)), 100)
    assert rows == list(range(100))


@pytest.mark.parametrize("in_caller", [True, False])
def test_an_error_comes_through_after_the_blocks_that_are_begun(in_caller):
    caller, meeting, done = threading.get_ident(), threading.Barrier(2), []

    def work(start, stop):
        meeting.wait(30.0)
        if (threading.get_ident() == caller) == in_caller:
            raise KeyError(start)
        time.sleep(0.05)
        done.append((start, stop))

    with forced_threads(2), pytest.raises(KeyError):
        run_in_blocks(work, 100)
    assert len(done) == 1


def test_within_a_block_further_calls_run_on_its_thread():
    total, mixed = np.zeros(64), []

    def outer(start, stop):
        here = threading.get_ident()

        def inner(a, b):
            total[start + a : start + b] += 1.0
            mixed.append(threading.get_ident() != here)

        run_in_blocks(inner, stop - start)

    with forced_threads(4):
        run_in_blocks(outer, 64)
        assert (total == 1.0).all()
        assert not any(mixed)
        # The caller is free again.
        meeting = threading.Barrier(2)
        run_in_blocks(lambda _a, _b: meeting.wait(30.0), 2)


def test_many_callers_share_the_threads():
    def call(_):
        rows = np.zeros(100)

        def work(start, stop):
            rows[start:stop] += np.arange(start, stop)

        run_in_blocks(work, 100)
        return rows.sum()

    with forced_threads(6), ThreadPoolExecutor(8) as pool:
        assert set(pool.map(call, range(300))) == {4950.0}


@pytest.fixture
def fresh_pool(monkeypatch):
    """A pool without threads."""
    monkeypatch.setattr(threads, "_jobs", threads.SimpleQueue())
    monkeypatch.setattr(threads, "_n_helpers", 0)


@pytest.mark.usefixtures("fresh_pool")
def test_threads_are_kept_between_calls_and_do_not_keep_arrays_alive():
    seen = set()
    with forced_threads(3):
        for _ in range(20):
            run_in_blocks(lambda _a, _b: seen.add(threading.get_ident()), 9)
    assert len(seen) <= 3
    assert threads._n_helpers == 2
    assert threads._jobs.qsize() <= 2


class Interrupt(Exception):
    """What a signal's handler raises, as Ctrl-C does."""


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers on this system")
@pytest.mark.usefixtures("fresh_pool")
def test_signals_at_any_moment_leave_the_threads_at_work():
    armed = False

    def raise_interrupt(*_):
        if armed:
            raise Interrupt

    before = signal.signal(signal.SIGALRM, raise_interrupt)
    rng = np.random.default_rng(6)
    n_interrupted = 0
    try:
        with forced_threads(3):
            # The faster the machine, the fewer signals come in time.
            for attempt in range(100_000):
                if attempt >= 1500 and n_interrupted > 100:
                    break
                try:
                    armed = True
                    signal.setitimer(signal.ITIMER_REAL, rng.uniform(1e-6, 3e-4))
                    run_in_blocks(lambda _a, _b: sum(range(200)), 12)
                    armed = False  # a signal that is under way now must not end the test
                    signal.setitimer(signal.ITIMER_REAL, 0.0)
                except Interrupt:
                    n_interrupted += 1
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    assert n_interrupted > 100
    with forced_threads(3):
        meeting = threading.Barrier(3)
        run_in_blocks(lambda _a, _b: meeting.wait(30.0), 3)


@pytest.mark.skipif(not hasattr(signal, "setitimer"), reason="no timers on this system")
@pytest.mark.usefixtures("fresh_pool")
def test_a_wait_that_a_signal_ends_loses_no_thread():
    caller, begun, go_on, seen = threading.get_ident(), threading.Event(), threading.Event(), set()

    def work(_start, _stop):
        if threading.get_ident() == caller:
            begun.wait(30.0)
        else:
            seen.add(threading.get_ident())
            begun.set()
            go_on.wait(30.0)

    def raise_interrupt(*_):
        raise Interrupt

    before = signal.signal(signal.SIGALRM, raise_interrupt)
    try:
        with forced_threads(2):
            # Not before: a signal on the way in would leave what is patched as it is.
            signal.setitimer(signal.ITIMER_REAL, 0.2)
            with pytest.raises(Interrupt):
                run_in_blocks(work, 20)
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
    go_on.set()
    meeting = threading.Barrier(2)
    with forced_threads(2):
        run_in_blocks(lambda _a, _b: (seen.add(threading.get_ident()), meeting.wait(30.0)), 2)
    assert len(seen - {caller}) == 1


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
@pytest.mark.filterwarnings("ignore:.*fork:DeprecationWarning")
def test_a_forked_process_has_threads_of_its_own():
    with forced_threads(2):
        run_in_blocks(lambda _a, _b: None, 4)
        child = os.fork()
        if child == 0:
            meeting = threading.Barrier(2)
            with contextlib.suppress(BaseException):
                run_in_blocks(lambda _a, _b: meeting.wait(20.0), 2)
                os._exit(0)
            os._exit(1)
    for _ in range(300):
        pid, status = os.waitpid(child, os.WNOHANG)
        if pid:
            break
        time.sleep(0.1)
    else:
        os.kill(child, 9)
        os.waitpid(child, 0)
        pytest.fail("the forked process waits for threads that it does not have")
    assert status == 0


# --- how many ---------------------------------------------------------------------------------------------------------


def parts_of(n_rows, work_per_row):
    parts = []
    run_in_blocks(lambda a, b: parts.append((a, b)), n_rows, work_per_row=work_per_row)
    return sorted(parts)


def test_little_work_stays_with_the_caller(monkeypatch):
    monkeypatch.setattr(threads, "n_idle", lambda: 64)
    with set_threads(8):
        assert parts_of(1000, 1) == [(0, 1000)]
        assert len(parts_of(1000, 2.1 * threads.WORK_PER_THREAD / 1000)) > 1


def test_on_a_busy_machine_only_long_work_is_shared(monkeypatch):
    monkeypatch.setattr(threads, "n_idle", lambda: 0)
    with set_threads(2):
        assert len(parts_of(1000, 0.9 * threads.SHORT_WORK / 1000)) == 1
        assert len(parts_of(1000, 1.1 * threads.SHORT_WORK / 1000)) > 1


@pytest.mark.parametrize(("text", "idle"), [("0.5 0.4 0.3 3/99 7\n", 5), ("0.5 0.4 0.3 20/99 7\n", 0), ("?", 8)])
def test_idle_processors_are_those_that_run_no_thread(monkeypatch, tmp_path, text, idle):
    file = os.open(tmp_path / "loadavg", os.O_RDWR | os.O_CREAT)
    os.write(file, text.encode())
    monkeypatch.setattr(processors, "_load_file", functools.cache(lambda: file))
    monkeypatch.setattr(os, "cpu_count", lambda: 8)
    assert n_idle() == idle
    os.close(file)
    assert n_idle() == 8


def test_where_the_system_tells_no_load_all_processors_count_as_idle(monkeypatch, tmp_path):
    monkeypatch.setattr(processors, "LOAD", str(tmp_path / "nothing"))
    processors._load_file.cache_clear()
    assert n_idle() == os.cpu_count()


def test_the_setting_comes_before_the_environment_and_that_before_the_machine(monkeypatch):
    monkeypatch.setattr(threads, "n_processors", lambda: 5)
    monkeypatch.delenv("BEAMFIELD_THREADS", raising=False)
    with set_threads(None):
        assert n_threads() == 5
        monkeypatch.setenv("BEAMFIELD_THREADS", "3")
        assert n_threads() == 5
    with set_threads(None):
        assert n_threads() == 3
        with set_threads(7) as nothing:
            assert nothing is None
            assert n_threads() == 7
        assert n_threads() == 3
        assert repr(set_threads(9)) == "<beamfield uses up to 9 threads>"
        assert n_threads() == 9
    monkeypatch.undo()
    set_threads(None)


@pytest.mark.parametrize("n", [0, -1, 1.5, True, "2"])
def test_a_number_of_threads_that_is_none_is_refused(n):
    before = n_threads()
    with pytest.raises(InvalidInputError, match="n: expected a whole number of threads, at least 1, or None, got"):
        set_threads(n)
    assert n_threads() == before


@pytest.mark.parametrize("text", ["0", "", "two", "-1", "2.0"])
def test_a_bad_environment_variable_is_named(monkeypatch, text):
    monkeypatch.setenv("BEAMFIELD_THREADS", text)
    with set_threads(None), pytest.raises(InvalidInputError, match="BEAMFIELD_THREADS: expected a whole number"):
        n_threads()
    monkeypatch.undo()
    set_threads(None)


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="processes cannot be placed on this system")
def test_processors_that_the_process_may_not_use_do_not_count():
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, {min(allowed)})
    try:
        assert n_processors() == 1
    finally:
        os.sched_setaffinity(0, allowed)


def write(path, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)


@pytest.mark.parametrize(
    ("memberships", "files", "expected"),
    [
        # Version 2, in a container's own name space, and with a limit further up.
        ("0::/\n", {"cpu.max": "150000 100000\n"}, 1.5),
        ("0::/a/b\n", {"a/cpu.max": "200000 100000\n", "a/b/cpu.max": "max 100000\n"}, 2.0),
        ("0::/a/b\n", {"a/cpu.max": "400000 100000\n", "a/b/cpu.max": "50000 100000\n"}, 0.5),
        # Version 1; a container is shown its own group at the root.
        (
            "5:cpu,cpuacct:/a\n0::/\n",
            {"cpu,cpuacct/a/cpu.cfs_quota_us": "300000\n", "cpu,cpuacct/a/cpu.cfs_period_us": "100000\n"},
            3.0,
        ),
        ("3:cpu:/docker/7\n", {"cpu/cpu.cfs_quota_us": "50000\n", "cpu/cpu.cfs_period_us": "25000\n"}, 2.0),
        ("3:cpu:/\n", {"cpu/cpu.cfs_quota_us": "-1\n", "cpu/cpu.cfs_period_us": "100000\n"}, np.inf),
        # Others' limits, none, and what cannot be read.
        ("4:cpuset:/a\n", {"cpu/a/cpu.cfs_quota_us": "1\n", "cpu/a/cpu.cfs_period_us": "1\n"}, np.inf),
        ("0::/\n", {"cpu.max": "max 100000\n"}, np.inf),
        ("0::/\n", {"cpu.max": "many\n"}, np.inf),
        ("nonsense\n", {}, np.inf),
        ("", {}, np.inf),
    ],
)
def test_the_quota_of_control_groups_counts(tmp_path, memberships, files, expected):
    write(tmp_path / "proc", memberships)
    for name, text in files.items():
        write(tmp_path / "groups" / name, text)
    assert cpu_quota(tmp_path / "proc", tmp_path / "groups") == expected


@pytest.mark.parametrize(("quota", "n"), [(0.5, 1), (1.9, 1), (2.0, 2), (np.inf, 4)])
def test_a_quota_limits_the_processors(monkeypatch, quota, n):
    monkeypatch.setattr(processors, "_quota", lambda: quota)
    monkeypatch.setattr(os, "sched_getaffinity", lambda _pid: set(range(4)), raising=False)
    assert n_processors() == n


def test_without_control_groups_there_is_no_quota(tmp_path):
    assert cpu_quota(tmp_path / "none", tmp_path) == np.inf
