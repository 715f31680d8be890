"""Fixtures for all tests."""

from __future__ import annotations

import gc
import os
import shutil
from collections.abc import Iterator
from functools import cache, lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pytest
from hypothesis import settings

from beamfield.cli import main as command_line
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation import trajectory
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from tests.oracle_case import OracleCase
from tests.quick_bags import compiled_once

matplotlib.use("Agg")

# No test times anything: on a loaded machine, the default deadline of 200 ms an example fails tests that are right.
settings.register_profile("untimed", deadline=None)
settings.load_profile("untimed")

SHARED = Path(os.environ.get("BEAMFIELD_SHARED", Path(__file__).resolve().parents[2] / "shared"))


# Collecting the tests makes thousands of objects and no garbage: the collector need not look at them.
gc.disable()


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()
    # Nor need it look so often at what tests make, nearly all of which goes without it.
    gc.set_threshold(50_000, 20, 20)


@pytest.fixture(scope="session", autouse=True)
def bags_are_quick() -> Iterator[None]:
    """Let rosbags compile each of its messages once instead of in every bag."""
    if find_spec("rosbags") is None:
        yield
        return
    with compiled_once():
        yield


@pytest.fixture(scope="session", autouse=True)
def made_once() -> Iterator[None]:
    """Build the parser of all commands once for all that are run, and prepare each map once for all drives in it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(command_line, "build_parser", cache(command_line.build_parser))
        patch.setattr(trajectory, "_FreeSpace", lru_cache(maxsize=30)(trajectory._FreeSpace))
        yield


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


@pytest.fixture(scope="session", params=["tiny", "building"])
def oracle_case(request: pytest.FixtureRequest, oracle: Path) -> OracleCase:
    """A small map drawn by hand, and one of a building, with all that other programs were given."""
    return OracleCase.read(oracle / request.param)


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    """Chromium, driven by Playwright; tests that need it skip without either."""
    sync_api = pytest.importorskip("playwright.sync_api")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if chromium is None:
        pytest.skip("no Chromium is installed, so no page is tested in it")
    with sync_api.sync_playwright() as playwright:
        # Containers often run as root, where Chromium's own sandbox does not start.
        arguments = ["--no-sandbox"] if hasattr(os, "geteuid") and os.geteuid() == 0 else []
        started = playwright.chromium.launch(executable_path=chromium, args=arguments)
        yield started
        started.close()


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(20260101)


# A small simulated log whose truth is known, shared by the tests of the main job.
TRUTH = BeamParameters(0.80, 0.10, 0.03, 0.07, 0.05, 0.6)


@pytest.fixture(scope="session")
def office() -> OccupancyGrid:
    return draw_floor_plan(seed=3)


@pytest.fixture(scope="session")
def black_office(office: OccupancyGrid) -> OccupancyGrid:
    """The office on a larger sheet, painted black where it is not free."""
    margin = 100
    cells = np.pad(np.where(office.free, 0.0, 1.0), margin, constant_values=1.0)
    return OccupancyGrid(cells, office.resolution, [*(office.origin[:2] - margin * office.resolution), 0.0])


@pytest.fixture(scope="session")
def drive(office: OccupancyGrid) -> SensorLog:
    finder = RangeFinder.from_bearings(np.linspace(-np.pi / 2, np.pi / 2, 61), 10.0, name="laser")
    return simulate_log(office, finder, TRUTH, duration=120.0, scan_rate=4.0, seed=5).only_sensor()


@pytest.fixture(scope="session")
def truth() -> BeamParameters:
    return TRUTH
