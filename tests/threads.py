"""Run small calls in several threads, which would not pay."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from unittest.mock import patch

from beamfield.kernels import threads


@contextmanager
def forced_threads(n: int | None) -> Iterator[None]:
    """Have every call of `run_in_blocks` use n threads, however little there is to do and however busy the machine."""
    with (
        patch.object(threads, "WORK_PER_THREAD", 1e-9),
        patch.object(threads, "n_idle", lambda: 64),
        threads.set_threads(n),
    ):
        yield
