"""AMCL's likelihood_field: formula and look-ups that nav2 and ROS 1 share."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, ClassVar, Generic, Self, TypeVar

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import Scan
from beamfield.stacks.amcl.parameters import AmclParameters, AsAmcl
from beamfield.stacks.amcl.scan import amcl_grid, amcl_ranges, range_limits
from beamfield.stacks.emulation.beam_selection import Indices, floor_step_beams
from beamfield.stacks.emulation.emulator import OFF_MAP, FieldEvidence, FieldModel, ScanEnds
from beamfield.stacks.emulation.field_table import (
    AMCL_BRUSHFIRE,
    DistanceChoice,
    FieldTable,
    end_points,
    field_table,
    reach_in_cells,
)
from beamfield.stacks.emulation.stack_map import MapMode

P = TypeVar("P", bound=AsAmcl)


@dataclass(frozen=True, eq=False)
class AmclField(FieldModel[P], Generic[P]):
    """``w = 1 + sum p^3`` with ``p = z_hit exp(-d^2 / 2 sigma_hit^2) + z_rand / range_max`` for each beam.

    d is the distance from the beam's end point to the nearest obstacle, and laser_likelihood_max_dist off the map and
    where no obstacle is within int(laser_likelihood_max_dist / resolution) whole cells. Readings of range_max and more,
    too short ones (which the node turns into range_max) and NaN count nothing. Unknown cells are as free ones.

    Parameters
    ----------
    grid
        The map.
    parameters
        The stack's own.
    distance
        "exact" distances, or those of the program's "brushfire", which are too long in places.
    map_mode
        How the map server turns the map into a message; see `read_as_stack`.
    """

    model: ClassVar[str] = "likelihood_field"
    evidence_settings: ClassVar[tuple[str, ...]] = ("max_beams", "laser_max_range", "laser_min_range")
    fitted_parameters: ClassVar[tuple[str, ...]] = ("z_hit", "z_rand", "sigma_hit")
    beam_rule = staticmethod(partial(floor_step_beams, least_step=1))

    grid: OccupancyGrid
    parameters: P
    distance: DistanceChoice = field(default="exact", kw_only=True)
    map_mode: MapMode = field(default="trinary", kw_only=True)
    _table: FieldTable = field(init=False, repr=False)

    def __post_init__(self) -> None:
        seen = amcl_grid(self.grid, self.map_mode)
        farthest = self.parameters.as_amcl().laser_likelihood_max_dist
        object.__setattr__(self, "_table", field_table(seen, seen.occupied, self.distance, AMCL_BRUSHFIRE, farthest))

    def with_parameters(self, parameters: P) -> Self:
        """Return the model with other parameters; a brushfire burns anew if its end changes."""
        end, end_before = (p.as_amcl().laser_likelihood_max_dist for p in (parameters, self.parameters))
        if self.distance == "brushfire" and end != end_before:
            return replace(self, parameters=parameters)
        return super().with_parameters(parameters)

    def selected_beams(self, n_beams: int) -> Indices:
        """Return the indices of the beams that the program looks at in a scan of n_beams."""
        return self.beam_rule(n_beams, self.parameters.as_amcl().max_beams)

    def scan_ends(self, z: Scan) -> ScanEnds:
        """Return the end points that the program looks up; see `FieldModel.scan_ends`."""
        parameters = self.parameters.as_amcl()
        _, range_max = range_limits(z.finder, parameters)
        ranges = amcl_ranges(z, parameters)
        beams = self.selected_beams(len(ranges))
        beams = beams[ranges[beams] < range_max]
        return ScanEnds(beams, range_max, end_points(z.finder.mounts[beams], ranges[beams]))

    def beam_values(self, evidence: FieldEvidence, parameters: P | None = None) -> FloatArray:
        """Return p of each beam that counts, (n, k)."""
        values = self._parameters_for(evidence, parameters).as_amcl()
        p = self._cut_distances(evidence, values)
        p *= p
        p *= -0.5 / values.sigma_hit**2
        np.exp(p, out=p)
        p *= values.z_hit
        p += values.z_rand / evidence.max_range
        return p

    def _cut_distances(self, evidence: FieldEvidence, values: AmclParameters) -> FloatArray:
        """Return the distances (n, k) that the program looks up, metres."""
        limit, resolution = values.laser_likelihood_max_dist, self._table.grid.resolution
        # Distances are whole numbers of cells, squared: none is near this one.
        beyond = resolution * math.sqrt(reach_in_cells(limit, resolution) ** 2 + 0.5)
        d = evidence.distances.astype(np.float64)
        # Cells hold single precision.
        d[d > beyond] = np.float32(limit)
        d[evidence.places == OFF_MAP] = limit
        return d

    def _settings(self) -> dict[str, Any]:
        settings = super()._settings()
        if self.distance == "brushfire":
            settings["laser_likelihood_max_dist"] = self.parameters.as_amcl().laser_likelihood_max_dist
        return settings
