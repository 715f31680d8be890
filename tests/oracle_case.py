"""The inputs that other programs had, and what they returned."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Self

import numpy as np

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder


@dataclass(frozen=True)
class OracleCase:
    """A map, poses and a scan of one folder of the oracle; `values` are the models' parameters by name."""

    folder: Path
    grid: OccupancyGrid
    poses: np.ndarray
    bearings: np.ndarray
    ranges: np.ndarray
    ranges_special: np.ndarray
    values: dict[str, float]

    @classmethod
    def read(cls, folder: Path) -> Self:
        inputs = _read(folder, "inputs")
        cells = np.reshape(inputs["map.data"], (int(inputs["map.height"]), int(inputs["map.width"])))
        return cls(
            folder,
            OccupancyGrid.from_ros(cells, float(inputs["map.resolution"]), [*inputs["map.origin"], 0.0]),
            *(np.array(inputs[name], dtype=np.float64) for name in ("poses", "bearings", "ranges", "ranges_special")),
            {name.removeprefix("params."): float(v) for name, v in inputs.items() if name.startswith("params.")},
        )

    def answers(self, program: str) -> dict[str, Any]:
        """What a program returned; "book" is the chapter's formulas."""
        return _read(self.folder, program)

    @property
    def max_range(self) -> float:
        return self.values["max_range"]

    @property
    def finder(self) -> RangeFinder:
        return RangeFinder.from_bearings(self.bearings, self.max_range)

    @property
    def beam_parameters(self) -> BeamParameters:
        names = ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short")
        return BeamParameters(**{name: self.values[name] for name in names})


def _read(folder: Path, name: str) -> dict[str, Any]:
    """Return a file's arrays by name, as "map.data" where names are nested."""
    if (folder / f"{name}.npz").exists():
        with np.load(folder / f"{name}.npz") as file:
            return dict(file)
    flat = {}
    for key, value in json.loads((folder / f"{name}.json").read_text()).items():
        parts = {f"{key}.{k}": v for k, v in value.items()} if isinstance(value, dict) else {key: value}
        flat |= {k: v if isinstance(v, str) else np.array(v, dtype=np.float64) for k, v in parts.items()}
    return flat
