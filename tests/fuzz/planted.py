"""Readers with known faults, to see that each kind of fault is found."""

from __future__ import annotations

import os
import time
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from beamfield.errors import InvalidInputError
from tests.fuzz.case import Case, one_file
from tests.fuzz.target import Target


def _example() -> list[Case]:
    return [one_file("a.txt", "1 2 3\n")]


def _is_example(path: Path) -> bool:
    return path.read_bytes() == b"1 2 3\n"


def _raises(path: Path) -> Any:
    if not _is_example(path):
        raise KeyError("planted")


def _warns(path: Path) -> Any:
    if not _is_example(path):
        warnings.warn("planted", RuntimeWarning, stacklevel=1)


def _speaks_in_lines(path: Path) -> Any:
    if not _is_example(path):
        error = InvalidInputError("")
        error.args = ("planted\nin two lines",)
        raise error


def _leaves_a_file(path: Path) -> Any:
    if not _is_example(path):
        path.with_name("left.tmp").write_text("planted")


def _is_slow(path: Path) -> Any:
    stop = time.process_time() + (0.0 if _is_example(path) else 1.1)
    while time.process_time() < stop:
        pass


def _is_large(path: Path) -> Any:
    return None if _is_example(path) else np.ones(64 * 2**20, dtype=np.uint8).sum()


def _asks_for_too_much(path: Path) -> Any:
    return None if _is_example(path) else bytes(2**36)


def _dies(path: Path) -> Any:
    if not _is_example(path):
        os.abort()


def _hangs(path: Path) -> Any:
    while not _is_example(path):
        pass


def _returns_nonsense(path: Path) -> Any:
    return _is_example(path)


def _nothing(_result: Any) -> None:
    pass


def _true(result: Any) -> None:
    assert result


READERS = {
    "exception": _raises, "warning": _warns, "message": _speaks_in_lines, "leftover": _leaves_a_file, "slow": _is_slow,
    "memory": _is_large, "too much": _asks_for_too_much, "crash": _dies, "hang": _hangs,
}  # fmt: skip
BY_NAME = {name: Target(name, _example, read, _nothing) for name, read in READERS.items()}
BY_NAME["result"] = Target("result", _example, _returns_nonsense, _true)
BY_NAME["good"] = Target("good", _example, lambda path: path.read_bytes(), _nothing)
