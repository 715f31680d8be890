"""What is fuzzed; apart from the readers, so that a worker process imports only those that it reads with."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.fuzz.case import Case


@dataclass(frozen=True)
class Target:
    """A reader under test.

    Parameters
    ----------
    name
        For tables and folders.
    seeds
        Makes its valid examples.
    read
        Reads what it is given, and returns a result or raises.
    check
        Asserts that the result is sane.
    writes
        Whether it may leave files beside its input.
    weight
        Its share of a long run's time, 1 for most.
    """

    name: str
    seeds: Callable[[], list[Case]]
    read: Callable[[Path], Any]
    check: Callable[[Any], None]
    writes: bool = False
    weight: float = 1.0
