"""AMCL's beam model: what nav2 and ROS 1 share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import ClassVar, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from beamfield.geometry import FloatArray, as_poses
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import Scan
from beamfield.stacks.amcl.grid_models import GridRays
from beamfield.stacks.amcl.parameters import AsAmcl
from beamfield.stacks.amcl.scan import amcl_grid, amcl_ranges
from beamfield.stacks.emulation.beam_selection import floor_step_beams
from beamfield.stacks.emulation.emulator import RayEvidence
from beamfield.stacks.emulation.stack_rays import AMCL_LINE, bresenham_ranges, exact_ranges, walled

P = TypeVar("P", bound=AsAmcl)


@dataclass(frozen=True, eq=False)
class AmclBeam(GridRays[P], Generic[P]):
    """``w = 1 + sum p^3`` over beams, where p has four terms, none of them normalised.

    For a beam with range z and expected range z*, p is the sum of

    - ``z_hit exp(-(z - z*)^2 / 2 sigma_hit^2)``,
    - ``z_short lambda_short exp(-lambda_short z)`` if z < z*,
    - ``z_max`` if z is exactly range_max,
    - ``z_rand / range_max`` if z < range_max.

    Rays stop at occupied and unknown cells and where they leave the map. Readings
    below the shortest range become range_max; +inf scores 0, so that a driver that reports missing returns as +inf
    (REP 117) never brings z_max in. Readings beyond range_max count as they are in nav2, and as +inf in ROS 1. NaN
    counts nothing in nav2. ROS 1 has no test for it (``tests_nan``): if one of the beams looked at is NaN, all weights
    are, and the filter makes all particles equal, as it does where all weights are 0; so here they are -inf.

    Parameters
    ----------
    grid
        The map.
    parameters
        The stack's own.
    rays
        "bresenham" as the program casts them, between centres of cells; "exact" to the border of the first cell.
    no_return
        What the robot's driver reports for a missing return: "inf" as in REP 117, or the sensor's longest range,
        "range_max", which brings in z_max unless laser_max_range is less. Readers of logs turn both into +inf.
    map_mode
        How the map server turns the map into a message; see `read_as_stack`.
    """

    beam_rule = staticmethod(partial(floor_step_beams, least_step=0))
    # Whether readings beyond range_max are as missing returns.
    beyond_is_missing: ClassVar[bool] = False

    def _read_map(self) -> tuple[OccupancyGrid, OccupancyGrid]:
        seen = amcl_grid(self.grid, self.map_mode)
        return seen, walled(seen)

    def evidence(self, z: Scan, poses: ArrayLike) -> RayEvidence:
        """Return readings and expected ranges; see `StackModel.evidence`."""
        robot = as_poses(poses).reshape(-1, 3)
        parameters = self.parameters.as_amcl()
        ranges, range_max = amcl_ranges(z, parameters)
        if self.no_return == "range_max":
            ranges[ranges == np.inf] = z.finder.max_range
        if self.beyond_is_missing:
            ranges[ranges > range_max] = np.inf
        beams = self.beam_rule(len(ranges), parameters.max_beams)
        # +inf has p = 0 and adds nothing to the sum.
        beams = beams[np.isfinite(ranges[beams]) | (np.isnan(ranges[beams]) & (not self.tests_nan))]
        expected = self.expected_ranges(robot, z.finder.mounts[beams], range_max)
        return RayEvidence(beams, range_max, ranges[beams], expected, settings=self._settings())

    def expected_ranges(self, poses: FloatArray, mounts: FloatArray, range_max: float) -> FloatArray:
        """Return expected ranges (n, k) in metres of beams with mounts (k, 3) at poses (n, 3)."""
        if self._caster is None:
            return bresenham_ranges(self._seen, self._cells, poses, mounts, range_max, AMCL_LINE)
        return exact_ranges(self._caster, self._seen, poses, mounts, range_max, off_map=0.0)

    def beam_values(self, evidence: RayEvidence, parameters: P | None = None) -> FloatArray:
        """Return p of each beam that counts, (n, k); NaN where the reading is."""
        values = self._parameters_for(evidence, parameters).as_amcl()
        z, z_star = evidence.ranges, evidence.expected_ranges
        p = z_star - z
        with np.errstate(over="ignore"):
            p *= p
        p *= -0.5 / values.sigma_hit**2
        np.exp(p, out=p)
        p *= values.z_hit
        p += np.where(z < z_star, values.z_short * values.lambda_short * np.exp(-values.lambda_short * z), 0.0)
        p += np.where(z == evidence.max_range, values.z_max, 0.0)
        p += np.where(z < evidence.max_range, values.z_rand / evidence.max_range, 0.0)
        return np.asarray(p)

    def log_weights(self, evidence: RayEvidence, parameters: P | None = None) -> FloatArray:
        """Return log(1 + sum p^3), (n,), or -inf if a reading is NaN; see `StackModel.log_weights`."""
        p = self.beam_values(evidence, parameters)
        if np.isnan(evidence.ranges).any():
            return np.full(len(p), -np.inf)
        return np.asarray(np.log1p((p * p * p).sum(axis=1)))
