"""What other programs returned, and the inputs they had."""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import pytest

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, Scan
from beamfield.stacks.beluga.parameters import BelugaParameters
from beamfield.stacks.nav2.parameters import Nav2Parameters

# Where the oracle's "offset sensor" sits; not part of its inputs, but its answers agree with no other place.
OFFSET_MOUNT = (0.1, -0.05, 0.3)


@dataclass(frozen=True)
class OracleCase:
    grid: OccupancyGrid
    poses: np.ndarray
    bearings: np.ndarray
    ranges: np.ndarray
    ranges_special: np.ndarray
    values: dict
    nav2: dict
    beluga: dict
    mrpt: dict
    rangelibc: dict

    @property
    def nav2_parameters(self) -> Nav2Parameters:
        return Nav2Parameters(**self._common())

    @property
    def beluga_parameters(self) -> BelugaParameters:
        """With the sensor's longest range, as the oracle had it, and the options of the map switched off."""
        return BelugaParameters(
            **self._common(), laser_max_range=self.values["max_range"], only_obstacle_boundaries=False
        )

    def _common(self) -> dict:
        v = self.values
        names = ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short")
        numbers = {name: v[name] for name in names}
        return numbers | {"laser_likelihood_max_dist": v["max_occ_dist"], "max_beams": len(self.bearings)}

    def scan(self, kind: str = "") -> Scan:
        """The scan of the oracle's arrays that begin with `kind`."""
        mount = OFFSET_MOUNT if kind == "offset_sensor_" else (0.0, 0.0, 0.0)
        finder = RangeFinder.from_bearings(self.bearings, self.values["max_range"], mount=mount)
        if kind.startswith("special_"):
            # The oracle called libraries, past the nodes that treat 0 as too short: a range just above 0 gets through.
            return Scan(np.where(self.ranges_special == 0.0, 1e-12, self.ranges_special), finder)
        return Scan(self.ranges, finder)


@pytest.fixture
def past_the_message(monkeypatch):
    """Resolutions as they are: whoever compiled the programs gave them the map past the message's single precision."""
    for module in ("emulation.stack_map", "f1tenth.table"):
        monkeypatch.setattr(f"beamfield.stacks.{module}.message_resolution", float)


@pytest.fixture(scope="session", params=["tiny", "building"])
def case(request, oracle) -> OracleCase:
    read = _read_json if request.param == "tiny" else _read_arrays
    inputs, *answers = (
        read(oracle / request.param, name) for name in ("inputs", "nav2", "beluga", "mrpt", "rangelibc")
    )
    cells = np.reshape(inputs["map.data"], (int(inputs["map.height"]), int(inputs["map.width"])))
    origin = [*inputs["map.origin"], 0.0]
    return OracleCase(
        OccupancyGrid.from_ros(cells, float(inputs["map.resolution"]), origin),
        *(np.array(inputs[name], dtype=np.float64) for name in ("poses", "bearings", "ranges", "ranges_special")),
        {name.removeprefix("params."): float(v) for name, v in inputs.items() if name.startswith("params.")},
        *answers,
    )


def _read_json(folder, name):
    flat = {}
    for key, value in json.loads((folder / f"{name}.json").read_text()).items():
        parts = {f"{key}.{k}": v for k, v in value.items()} if isinstance(value, dict) else {key: value}
        flat |= {k: v if isinstance(v, str) else np.array(v, dtype=np.float64) for k, v in parts.items()}
    return flat


def _read_arrays(folder, name):
    with np.load(folder / f"{name}.npz") as file:
        return dict(file)
