"""Fixtures for all tests."""

from __future__ import annotations

import os
from pathlib import Path

import matplotlib
import numpy as np
import pytest

matplotlib.use("Agg")

SHARED = Path(os.environ.get("BEAMFIELD_SHARED", Path(__file__).resolve().parents[2] / "shared"))


@pytest.fixture(scope="session")
def shared() -> Path:
    """Folder with real logs and other programs' results, beside the checkout; tests that need it skip without it."""
    if not SHARED.is_dir():
        pytest.skip("the folder shared/ with real data is not beside this checkout")
    return SHARED


@pytest.fixture(scope="session")
def data(shared: Path) -> Path:
    """Real logs and maps."""
    return shared / "data"


@pytest.fixture(scope="session")
def oracle(shared: Path) -> Path:
    """What other programs return on the same input."""
    return shared / "oracle"


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20260101)
