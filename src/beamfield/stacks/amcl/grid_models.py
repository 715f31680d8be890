"""What AMCL's models and Beluga's have in common: a field of distances, and rays from cell to cell."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Generic, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import keep
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.stacks.emulation.emulator import FieldModel, RayEvidence, RayModel
from beamfield.stacks.emulation.field_table import DistanceChoice, FieldTable
from beamfield.stacks.emulation.parameter_checks import NO_RETURNS, check_choice
from beamfield.stacks.emulation.stack_map import MapMode
from beamfield.stacks.emulation.stack_rays import RAYS, RayChoice, line_cells

P = TypeVar("P")
# Names of the parameters that decide which beams there are.
SCAN_SETTINGS = ("max_beams", "laser_max_range", "laser_min_range")


@dataclass(frozen=True, eq=False)
class GridField(FieldModel[P], Generic[P]):
    """A likelihood field by distances in the map; parameters as for its members."""

    model: ClassVar[str] = "likelihood_field"
    evidence_settings: ClassVar[tuple[str, ...]] = SCAN_SETTINGS
    fitted_parameters: ClassVar[tuple[str, ...]] = ("z_hit", "z_rand", "sigma_hit")

    grid: OccupancyGrid
    parameters: P
    distance: DistanceChoice = field(default="exact", kw_only=True)
    map_mode: MapMode = field(default="trinary", kw_only=True)
    _table: FieldTable = field(init=False, repr=False)

    def __post_init__(self) -> None:
        keep(self, _table=self._make_table())

    @abstractmethod
    def _make_table(self) -> FieldTable:
        """Return the distances in the map as the program reads it."""

    @property
    def seen(self) -> OccupancyGrid:
        """The map as the program reads it."""
        return self._table.grid

    def with_parameters(self, parameters: P) -> Self:
        """Return the model with other parameters; its distances are made anew if these bear on them."""
        names = self._table_settings()
        if any(getattr(parameters, name) != getattr(self.parameters, name) for name in names):
            return replace(self, parameters=parameters)
        return super().with_parameters(parameters)

    def _table_settings(self) -> tuple[str, ...]:
        """Return the names of the parameters that the distances depend on: where a brushfire ends."""
        return ("laser_likelihood_max_dist",) if self.distance == "brushfire" else ()

    def _settings(self) -> dict[str, Any]:
        return super()._settings() | {name: getattr(self.parameters, name) for name in self._table_settings()}


def field_values(distances: FloatArray, sigma: float, height: float, floor: float) -> FloatArray:
    """Return height exp(-d^2 / 2 sigma^2) + floor for each distance d; overwrites the distances."""
    p = distances
    p *= p
    p *= -0.5 / sigma**2
    np.exp(p, out=p)
    p *= height
    p += floor
    return p


@dataclass(frozen=True, eq=False)
class GridRays(RayModel[P], Generic[P]):
    """A beam model with rays in the map; parameters as for its members."""

    model: ClassVar[str] = "beam"
    evidence_settings: ClassVar[tuple[str, ...]] = SCAN_SETTINGS
    fitted_parameters: ClassVar[tuple[str, ...]] = ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short")

    grid: OccupancyGrid
    parameters: P
    rays: RayChoice = field(default="bresenham", kw_only=True)
    no_return: str = field(default="inf", kw_only=True)
    map_mode: MapMode = field(default="trinary", kw_only=True)
    _seen: OccupancyGrid = field(init=False, repr=False)
    _cells: NDArray[np.uint8] = field(init=False, repr=False)
    _caster: RayCaster | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_choice(self, "rays", RAYS)
        check_choice(self, "no_return", NO_RETURNS)
        seen, walls = self._read_map()
        caster = RayCaster(walls, unknown="occupied") if self.rays == "exact" else None
        keep(self, _seen=seen, _cells=line_cells(seen), _caster=caster)

    @abstractmethod
    def _read_map(self) -> tuple[OccupancyGrid, OccupancyGrid]:
        """Return the map as the program reads it, and one in which exact rays stop where its rays do."""

    @property
    def seen(self) -> OccupancyGrid:
        """The map as the program reads it."""
        return self._seen

    @abstractmethod
    def beam_values(self, evidence: RayEvidence, parameters: P | None = None) -> FloatArray:
        """Return p of each beam that counts, (n, k); NaN where the reading is."""

    def beam_log_values(self, evidence: RayEvidence, parameters: P | None = None) -> FloatArray:
        """Return log p of each beam that counts, (n, k)."""
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(self.beam_values(evidence, parameters)))
