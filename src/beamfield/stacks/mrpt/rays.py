"""MRPT's ray-casting model rayTracing, emulated."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import ndimage

from beamfield.arguments import keep
from beamfield.geometry import FloatArray, as_poses, compose
from beamfield.kernels.marching import OCCUPIED, UNKNOWN, march
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder, Scan
from beamfield.stacks.emulation.emulator import RayEvidence, RayModel
from beamfield.stacks.emulation.parameter_checks import check_choice
from beamfield.stacks.emulation.stack_map import MapMode
from beamfield.stacks.emulation.stack_rays import WORK_PER_RAY
from beamfield.stacks.mrpt.parameters import MrptRayParameters
from beamfield.stacks.mrpt.scan import mrpt_grid, valid_readings

MrptRayChoice = Literal["marching", "exact"]
# Rays take steps of so many cells, in numbers of 2^BITS parts of a cell; there are max_range / resolution of them, so
# that rays end at this share of max_range.
STEP, BITS = 0.8, 10
# With the distance filter differences count no more than this, metres.
MOST = 2.0
RANDOM, HIT = 0.1, 0.9


@dataclass(frozen=True, eq=False)
class MrptRays(RayModel[MrptRayParameters]):
    """``log w = 1 + sum log p`` with ``p = 0.1 / max_range + 0.9 exp(-min(|z - z*|, 2)^2 / 2 rayTracing_stdHit^2)``.

    max_range is the sensor's. A ray that comes to its end, 0.8 max_range, expects that range; one that meets an unknown
    cell or leaves the map expects max_range. Every rayTracing_decimation-th beam is looked at, and counts if its
    reading is valid: neither NaN nor outside the sensor's limits.

    Parameters
    ----------
    grid
        The map.
    parameters
        MRPT's own.
    rays
        "marching" in steps of 0.8 cells as the program does, which find obstacles up to a step late or miss their
        corners; "exact" to the border of the first cell.
    map_mode
        How the map server turns the map into a message; see `read_as_stack`.
    """

    stack: ClassVar[str] = "mrpt"
    model: ClassVar[str] = "rayTracing"
    evidence_settings: ClassVar[tuple[str, ...]] = ("rayTracing_decimation",)
    fitted_parameters: ClassVar[tuple[str, ...]] = ("rayTracing_stdHit",)

    grid: OccupancyGrid
    parameters: MrptRayParameters
    rays: MrptRayChoice = field(default="marching", kw_only=True)
    map_mode: MapMode = field(default="trinary", kw_only=True)
    _seen: OccupancyGrid = field(init=False, repr=False)
    _cells: NDArray[np.int16] = field(init=False, repr=False)
    _casters: tuple[RayCaster, RayCaster] | None = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_choice(self, "rays", ("marching", "exact"))
        seen = mrpt_grid(self.grid, self.map_mode)
        casters = None
        if self.rays == "exact":
            casters = RayCaster(seen, unknown="occupied"), RayCaster(seen, unknown="free")
        keep(self, _seen=seen, _cells=steps_at_once(seen), _casters=casters)

    def evidence(self, z: Scan, poses: ArrayLike) -> RayEvidence:
        """Return readings and expected ranges; see `StackModel.evidence`."""
        robot = as_poses(poses).reshape(-1, 3)
        beams = np.arange(0, len(z.ranges), self.parameters.rayTracing_decimation)
        beams = beams[valid_readings(z)[beams]]
        limit = z.finder.max_range
        expected = self.expected_ranges(robot, z.finder.mounts[beams], limit)
        return RayEvidence(beams, limit, z.ranges[beams], expected, settings=self._settings())

    def expected_ranges(self, poses: FloatArray, mounts: FloatArray, max_range: float) -> FloatArray:
        """Return expected ranges (n, k) in metres of beams with mounts (k, 3) at poses (n, 3)."""
        if self._casters is None:
            return self._march(poses, mounts, max_range)
        finder = RangeFinder(mounts, max_range)
        stopped, hit = (caster.expected_ranges(poses, finder) for caster in self._casters)
        end = STEP * max_range
        within = np.ones(self._seen.shape, np.bool_)
        sensors = compose(poses[:, None], mounts)
        along = end * np.stack([np.cos(sensors[..., 2]), np.sin(sensors[..., 2])], axis=-1)
        starts_inside = self._seen.look_up(within, sensors[..., :2])
        ends_inside = self._seen.look_up(within, sensors[..., :2] + along)
        # Maps are convex: a ray with both ends on the map does not leave it.
        ranges = np.where(ends_inside, end, max_range)
        ranges = np.where(stopped < end, np.where(stopped < hit, max_range, stopped), ranges)
        return np.asarray(np.where(starts_inside, ranges, max_range))

    def beam_log_values(self, evidence: RayEvidence, parameters: MrptRayParameters | None = None) -> FloatArray:
        """Return log p of each beam that counts, (n, k)."""
        values = self._parameters_for(evidence, parameters)
        error = np.abs(evidence.ranges - evidence.expected_ranges)
        if values.rayTracing_useDistanceFilter:
            error = np.minimum(error, MOST)
        p = np.exp(-0.5 * (error / values.rayTracing_stdHit) ** 2)
        return np.asarray(np.log(RANDOM / evidence.max_range + HIT * p))

    def log_weights(self, evidence: RayEvidence, parameters: MrptRayParameters | None = None) -> FloatArray:
        """Return 1 + sum log p, (n,); see `StackModel.log_weights`."""
        return np.asarray(1.0 + self.beam_log_values(evidence, parameters).sum(axis=1))

    def _march(self, poses: FloatArray, mounts: FloatArray, max_range: float) -> FloatArray:
        ranges: FloatArray = np.empty((len(poses), len(mounts)))
        rows = np.require(poses, requirements=["C", "W"])
        starts, bearings = np.array(mounts[:, :2].T, order="C"), np.array(mounts[:, 2])
        x, y, _ = self._seen.origin.tolist()
        resolution = self._seen.resolution
        n_steps = round(max_range / resolution)

        def work(a: int, b: int) -> None:
            march(rows[a:b], (x, y), resolution, starts, bearings, STEP, BITS, n_steps, self._cells, ranges[a:b])

        run_in_blocks(work, len(rows), work_per_row=WORK_PER_RAY * len(mounts))
        # In single precision, as in the program.
        metres = (ranges * float(np.float32(resolution))).astype(np.float32)
        return np.where(ranges < 0.0, max_range, metres.astype(np.float64))


def steps_at_once(grid: OccupancyGrid) -> NDArray[np.int16]:
    """Return what `march` knows of each cell (rows, cols)."""
    # By k steps a ray gets no further than ceil(STEP k) cells to any side, and the cells nearer than this are free.
    clear = ndimage.distance_transform_cdt(np.pad(grid.free, 1), metric="chessboard")[1:-1, 1:-1]
    steps = np.minimum(np.floor((clear - 1) / STEP) + 1, np.iinfo(np.int16).max)
    return np.where(grid.free, steps, np.where(grid.occupied, OCCUPIED, UNKNOWN)).astype(np.int16)
