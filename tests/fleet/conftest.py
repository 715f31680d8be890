"""Tests of the fleet need its extra; a small fleet for all of them."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest

from beamfield.localization import trajectory_start
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog
from tests.fleet.small_fleet import write_small_fleet

collect_ignore_glob: list[str] = []
if any(find_spec(name) is None for name in ("distributed", "fsspec", "pyarrow")):
    collect_ignore_glob.append("test_*.py")


@pytest.fixture(scope="package", autouse=True)
def few_places() -> Iterator[None]:
    """Search for trajectories from few places: from where is tested elsewhere."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(trajectory_start, "PLACES", 2)
        yield


@pytest.fixture(scope="session")
def scanned(tmp_path_factory, drive: SensorLog, office: OccupancyGrid) -> Any:
    """What scanning a small fleet has done: `FleetScan`. Logs, fleet.csv and catalogue lie in one folder."""
    from beamfield.fleet.engine import Engine
    from beamfield.fleet.scan import scan_fleet

    folder = tmp_path_factory.mktemp("fleet")
    write_small_fleet(folder, drive, office)
    with Engine("serial") as engine:
        return scan_fleet(folder / "fleet.csv", str(folder / "catalogue"), engine)


@pytest.fixture(scope="session")
def world(scanned: Any) -> Path:
    """The folder of the small fleet, to be read."""
    return Path(scanned.catalogue.folder.path()).parent
