"""What a user sees while a command works."""

from __future__ import annotations

import io
import re
import threading
import time

import pytest

from beamfield.cli import progress
from beamfield.cli.progress import StageProgress


class Terminal(io.StringIO):
    """A stream that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def a_terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    """Put a terminal in place of stderr; in the test itself, as pytest changes streams after its fixtures."""
    stream = Terminal()
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setattr(progress, "TICK_S", 0.01)
    # tqdm asks the real terminal for its size, and hides bars in one without rows.
    monkeypatch.setenv("TQDM_NCOLS", "120")
    return stream


def wait_for(words: str, stream: Terminal, times: int = 1) -> bool:
    """Return whether the words appear so often within seconds; they take a few hundredths."""
    end = time.monotonic() + 5.0
    while stream.getvalue().count(words) < times and time.monotonic() < end:
        time.sleep(0.01)
    return stream.getvalue().count(words) >= times


def test_a_stage_without_counts_shows_the_time_and_no_empty_bar(monkeypatch):
    terminal = a_terminal(monkeypatch)
    with StageProgress() as show:
        show("reading the map", 0, 1)
        assert wait_for("reading the map ... 00:0", terminal, times=5)
    assert "%" not in terminal.getvalue()
    assert "?" not in terminal.getvalue()


def test_a_stage_that_waits_says_for_what_until_it_counts(monkeypatch):
    terminal = a_terminal(monkeypatch)
    monkeypatch.setattr(progress, "PATIENCE_S", 0.0)
    with StageProgress() as show:
        show("casting rays", 0, 4)
        assert wait_for(f"casting rays ({progress.PATIENCE}):   0%", terminal)
        before = len(terminal.getvalue())
        show("casting rays", 3, 4)
        assert wait_for("casting rays:  75%", terminal)
        assert progress.PATIENCE not in terminal.getvalue()[before:].split("75%")[-1]


def test_no_thread_is_left_behind(monkeypatch):
    a_terminal(monkeypatch)
    with StageProgress() as show:
        show("one", 0, 1)
        show("two", 0, 3)
        assert running() == 1
    assert running() == 0


def running() -> int:
    """Return how many clocks tick; tqdm and the kernels have threads of their own."""
    return sum(thread.name == "progress" for thread in threading.enumerate())


def test_elsewhere_there_is_one_line_per_stage(capsys):
    with StageProgress() as show:
        for stage in ("one", "two"):
            for done in range(3):
                show(stage, done, 2)
    with StageProgress(quiet=True) as show:
        show("three", 0, 1)
    assert capsys.readouterr().err == "one ...\ntwo ...\n"


def test_verbose_numbers_the_stages_and_times_them(capsys):
    with StageProgress(verbose=True) as show:
        for stage in ("one", "two"):
            show(stage, 0, 2)
            show(stage, 1, 2)
    said = [re.sub(r"\d+\.\d s", "0.0 s", line) for line in capsys.readouterr().err.splitlines()]
    assert said == ["1. one ...", "1. took 0.0 s", "2. two ...", "2. took 0.0 s"]
