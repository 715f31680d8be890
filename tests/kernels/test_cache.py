"""Kernels where Numba has no folder for its cache."""

from __future__ import annotations

import pytest
from numba.core import caching

from beamfield.kernels.jit import is_on_disk, kernel


def double(x: float) -> float:
    """Return twice x."""
    return 2.0 * x


def test_a_kernel_is_compiled_for_this_process_where_no_folder_can_be_written(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(caching.CompileResultCacheImpl, "_locator_classes", [])
    compiled = kernel(double)
    assert compiled(1.5) == 3.0
    assert not is_on_disk(compiled)
