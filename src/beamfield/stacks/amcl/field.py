"""AMCL's likelihood_field: formula and look-ups that nav2 and ROS 1 share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import partial
from typing import Generic, TypeVar

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.sensors import Scan
from beamfield.stacks.amcl.grid_models import GridField, field_values
from beamfield.stacks.amcl.parameters import AmclParameters, AsAmcl
from beamfield.stacks.amcl.scan import amcl_grid, amcl_ranges
from beamfield.stacks.emulation.beam_selection import floor_step_beams
from beamfield.stacks.emulation.emulator import OFF_MAP, FieldEvidence, ScanEnds
from beamfield.stacks.emulation.field_table import AMCL_BRUSHFIRE, FieldTable, end_points, field_table, reach_in_cells

P = TypeVar("P", bound=AsAmcl)


@dataclass(frozen=True, eq=False)
class AmclField(GridField[P], Generic[P]):
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

    beam_rule = staticmethod(partial(floor_step_beams, least_step=1))

    def _make_table(self) -> FieldTable:
        seen = amcl_grid(self.grid, self.map_mode)
        farthest = self.parameters.as_amcl().laser_likelihood_max_dist
        return field_table(seen, seen.occupied, self.distance, AMCL_BRUSHFIRE, farthest)

    def scan_ends(self, z: Scan) -> ScanEnds:
        """Return the end points that the program looks up; see `FieldModel.scan_ends`."""
        parameters = self.parameters.as_amcl()
        ranges, range_max = amcl_ranges(z, parameters)
        beams = self.beam_rule(len(ranges), parameters.max_beams)
        beams = beams[ranges[beams] < range_max]
        return ScanEnds(beams, range_max, end_points(z.finder.mounts[beams], ranges[beams]))

    def beam_values(self, evidence: FieldEvidence, parameters: P | None = None) -> FloatArray:
        """Return p of each beam that counts, (n, k)."""
        values = self._parameters_for(evidence, parameters).as_amcl()
        distances, floor = self._cut_distances(evidence, values), values.z_rand / evidence.max_range
        return field_values(distances, values.sigma_hit, values.z_hit, floor)

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
