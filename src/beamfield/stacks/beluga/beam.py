"""Beluga's beam model, emulated."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import ArrayLike

from beamfield.geometry import FloatArray, as_poses
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import Scan
from beamfield.stacks.amcl.grid_models import GridRays
from beamfield.stacks.beluga.parameters import BelugaParameters
from beamfield.stacks.beluga.scan import beluga_beams
from beamfield.stacks.emulation.beam_selection import even_beams
from beamfield.stacks.emulation.emulator import RayEvidence
from beamfield.stacks.emulation.field_table import end_points
from beamfield.stacks.emulation.stack_map import read_as_stack
from beamfield.stacks.emulation.stack_rays import BELUGA_LINE, bresenham_ranges, exact_ranges


@dataclass(frozen=True, eq=False)
class BelugaBeam(GridRays[BelugaParameters]):
    """``w = sum p^3`` over beams, where p is the chapter's mixture (Table 6.1) with z_max taken for a density.

    For a beam with range z and expected range z*, p is the sum of

    - ``z_hit eta N(z; z*, sigma_hit^2)``, eta the normaliser on [0, laser_max_range];
    - ``z_short eta lambda_short exp(-lambda_short z)`` if z < z*, eta the normaliser on [0, z*];
    - ``z_max`` if z >= laser_max_range;
    - ``z_rand / laser_max_range`` if z < laser_max_range.

    The program turns readings into end points and knows only these: z is the distance of the end point from the
    robot's centre, and rays are cast from there, wherever the sensor sits. They stop at every cell that is not free,
    those of unknown cells included, and meet nothing beyond the map's edge (z* = laser_max_range).

    Parameters
    ----------
    grid
        The map.
    parameters
        The stack's own.
    rays
        "bresenham" as the program casts them, between centres of cells; "exact" to the border of the first cell.
    no_return, map_mode
        As for `BelugaField`.
    """

    stack: ClassVar[str] = "beluga"
    beam_rule = staticmethod(even_beams)

    def _read_map(self) -> tuple[OccupancyGrid, OccupancyGrid]:
        seen = read_as_stack(self.grid, self.map_mode)
        return seen, seen

    def evidence(self, z: Scan, poses: ArrayLike) -> RayEvidence:
        """Return readings and expected ranges from the robot's centre; see `StackModel.evidence`."""
        robot = as_poses(poses).reshape(-1, 3)
        beams, ranges = beluga_beams(z, self.parameters, self.no_return)
        x, y = end_points(z.finder.mounts[beams], ranges)
        mounts = np.column_stack([np.zeros_like(x), np.zeros_like(x), np.arctan2(y, x)])
        max_range = self.parameters.laser_max_range
        expected = self.expected_ranges(robot, mounts, max_range)
        return RayEvidence(beams, max_range, np.hypot(x, y), expected, settings=self._settings())

    def expected_ranges(self, poses: FloatArray, mounts: FloatArray, max_range: float) -> FloatArray:
        """Return expected ranges (n, k) in metres of beams with mounts (k, 3) at poses (n, 3)."""
        if self._caster is None:
            ranges = bresenham_ranges(self._seen, self._cells, poses, mounts, max_range, BELUGA_LINE)
            return np.minimum(ranges, max_range, out=ranges)
        return exact_ranges(self._caster, self._seen, poses, mounts, max_range, off_map=max_range)

    def beam_values(self, evidence: RayEvidence, parameters: BelugaParameters | None = None) -> FloatArray:
        """Return p of each beam that counts, (n, k)."""
        values = self._parameters_for(evidence, parameters)
        z, z_star, limit = evidence.ranges, evidence.expected_ranges, evidence.max_range
        width = math.sqrt(2.0) * values.sigma_hit
        # Here, because it takes longer to load than all else that other models need.
        from scipy.special import erf

        inside = 0.5 * (erf((limit - z_star) / width) + erf(z_star / width))
        p = np.exp(-(((z - z_star) / width) ** 2))
        p *= values.z_hit / (values.sigma_hit * math.sqrt(2.0 * math.pi)) / inside
        rate = values.lambda_short
        if rate > 0.0:
            short = z < z_star
            # z* = 0 has no shorter readings.
            normaliser = -np.expm1(-rate * np.where(short, z_star, 1.0))
            p += np.where(short, values.z_short * rate * np.exp(-rate * z) / normaliser, 0.0)
        p += np.where(z >= limit, values.z_max, values.z_rand / limit)
        return np.asarray(p)

    def log_weights(self, evidence: RayEvidence, parameters: BelugaParameters | None = None) -> FloatArray:
        """Return log(sum p^3), (n,); -inf without any beam. See `StackModel.log_weights`."""
        p = self.beam_values(evidence, parameters)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log((p * p * p).sum(axis=1)))
