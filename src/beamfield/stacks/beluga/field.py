"""Beluga's likelihood_field and likelihood_field_prob, emulated."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.sensors import Scan
from beamfield.stacks.amcl.grid_models import SCAN_SETTINGS, GridField, field_values
from beamfield.stacks.beluga.parameters import BelugaParameters
from beamfield.stacks.beluga.scan import beluga_beams, boundaries
from beamfield.stacks.emulation.beam_selection import even_beams
from beamfield.stacks.emulation.emulator import OFF_MAP, UNKNOWN, FieldEvidence, ScanEnds
from beamfield.stacks.emulation.field_table import BELUGA_BRUSHFIRE, FieldTable, end_points, field_table
from beamfield.stacks.emulation.parameter_checks import NO_RETURNS, check_choice
from beamfield.stacks.emulation.stack_map import read_as_stack


@dataclass(frozen=True, eq=False)
class BelugaField(GridField[BelugaParameters]):
    """``w = 1 + sum p^3`` with ``p = z_hit N(d; 0, sigma_hit^2) + z_rand / laser_max_range`` for each beam.

    d is the distance from the end point to the nearest obstacle, cut off at laser_likelihood_max_dist, and that maximum
    in a map without obstacles. Off the map p is 1 / laser_max_range, and so it is with model_unknown_space in unknown
    cells, unless a hit at the maximum distance is worth more. NaN and readings outside the limits are dropped
    after max_beams have been selected; a reading of exactly the longest range is a hit.

    Parameters
    ----------
    grid
        The map.
    parameters
        The stack's own.
    distance
        "exact" distances, or those of the program's "brushfire", which are too long in places.
    no_return
        What the robot's driver reports for a missing return: "inf" as in REP 117, which is dropped, or the sensor's
        longest range, "range_max", which is a hit there unless laser_max_range is less. Readers of logs turn both into
        +inf.
    map_mode
        How the map server turns the map into a message; see `read_as_stack`.

    Notes
    -----
    Unknown space enters the program's field as the distance at which p is 1 / laser_max_range, cut off like any other
    distance. With z_hit 0 there is no such distance, and the program computes NaN; here p is 1 / laser_max_range or
    more then, too. With the brushfire p has single precision, as in the program's table; with exact distances it is
    left smooth in the parameters.
    """

    stack: ClassVar[str] = "beluga"
    evidence_settings: ClassVar[tuple[str, ...]] = (*SCAN_SETTINGS, "only_obstacle_boundaries")
    beam_rule = staticmethod(even_beams)
    # Whether the node hands model_unknown_space and only_obstacle_boundaries to this model.
    has_map_options: ClassVar[bool] = True

    no_return: str = field(default="inf", kw_only=True)

    def _make_table(self) -> FieldTable:
        check_choice(self, "no_return", NO_RETURNS)
        seen = read_as_stack(self.grid, self.map_mode)
        only_boundaries = self.has_map_options and self.parameters.only_obstacle_boundaries
        obstacles = boundaries(seen) if only_boundaries else seen.occupied
        table = field_table(seen, obstacles, self.distance, BELUGA_BRUSHFIRE, self.parameters.laser_likelihood_max_dist)
        if only_boundaries:
            # The inside of thick walls is as unknown space (Beluga's pull request 541).
            table = table._replace(unknown=table.unknown | (seen.occupied & ~obstacles))
        return table

    def scan_ends(self, z: Scan) -> ScanEnds:
        """Return the end points that the program looks up; see `FieldModel.scan_ends`."""
        beams, ranges = beluga_beams(z, self.parameters, self.no_return)
        return ScanEnds(beams, self.parameters.laser_max_range, end_points(z.finder.mounts[beams], ranges))

    def beam_values(self, evidence: FieldEvidence, parameters: BelugaParameters | None = None) -> FloatArray:
        """Return p of each beam that counts, (n, k)."""
        values = self._parameters_for(evidence, parameters)
        uniform, farthest = 1.0 / evidence.max_range, values.laser_likelihood_max_dist
        p = _mixture(np.minimum(evidence.distances, farthest, dtype=np.float64), values, evidence.max_range)
        p[evidence.places == OFF_MAP] = uniform
        if self.has_map_options and values.model_unknown_space:
            # The nearer of two distances, so the greater of two values.
            p[evidence.places == UNKNOWN] = max(uniform, *_mixture(np.array([farthest]), values, evidence.max_range))
        return p.astype(np.float32).astype(np.float64) if self.distance == "brushfire" else p

    def _table_settings(self) -> tuple[str, ...]:
        return (*super()._table_settings(), *(("only_obstacle_boundaries",) if self.has_map_options else ()))


@dataclass(frozen=True, eq=False)
class BelugaFieldProb(BelugaField):
    """``w = exp(sum log p)`` with the p of `BelugaField`.

    The node hands neither model_unknown_space nor only_obstacle_boundaries to this model: unknown cells are as free
    ones, and all occupied cells count.

    Parameters
    ----------
    grid, parameters, distance, no_return, map_mode
        As for `BelugaField`.

    Notes
    -----
    The program's weights underflow to 0 where the logarithms here do not.
    """

    model: ClassVar[str] = "likelihood_field_prob"
    evidence_settings: ClassVar[tuple[str, ...]] = SCAN_SETTINGS
    has_map_options: ClassVar[bool] = False
    is_product: ClassVar[bool] = True


def _mixture(distances: FloatArray, values: BelugaParameters, max_range: float) -> FloatArray:
    """Return z_hit N(d; 0, sigma_hit^2) + z_rand / max_range for each distance; overwrites the distances."""
    height = values.z_hit / (values.sigma_hit * math.sqrt(2.0 * math.pi))
    return field_values(distances, values.sigma_hit, height, values.z_rand / max_range)
