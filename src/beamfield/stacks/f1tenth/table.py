"""The sensor model of MIT's racecar and F1TENTH, a table by pixels, emulated."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import ClassVar, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import keep
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import Scan
from beamfield.stacks.emulation.emulator import RayEvidence, RayModel
from beamfield.stacks.emulation.parameter_checks import check_choice
from beamfield.stacks.emulation.stack_map import message_resolution
from beamfield.stacks.emulation.stack_rays import exact_ranges
from beamfield.stacks.f1tenth.parameters import F1tenthParameters

# Cells of which the message says more than 10 (percent) stop rays; unknown ones do not.
OCCUPIED_FROM = 0.105
# A table is square: so many pixels on each side are refused, as they would take gigabytes.
MOST_PIXELS = 20_000


@dataclass(frozen=True, eq=False)
class F1tenthTable(RayModel[F1tenthParameters]):
    """``w = (prod T[r, d])^(1 / squash_factor)``: T is looked up with the reading r and the expected range d in pixels.

    The table's side is N + 1 pixels, N = int(max_range / resolution), which with the resolution of the map's message
    (single precision) is 199 for 10 m and 0.05 m. Before each column (one d) is divided by its sum,

        T[r, d] = z_hit N(r; d, sigma_hit^2) + 2 z_short (d - r) / d [r < d] + z_max [r = N] + z_rand / N [r < N]

    Ranges are cut down to whole pixels, and those beyond max_range to N. Every angle_step-th beam counts; what comes
    back as +inf is as max_range. NaN counts nothing here; what the program's conversion of NaN to an integer gives
    depends on the machine.

    Parameters
    ----------
    grid
        The map. Cells above 10 percent stop rays, unknown cells do not.
    parameters
        The stack's own. range_method and theta_discretization change nothing here.
    map_mode
        "trinary" if the map is read by its own thresholds (occupied cells stop rays), "raw" if the message has its
        probabilities in percent.

    Notes
    -----
    Rays are exact. Those of range_libc are not, each method in its own way; to imitate one, put its ranges into the
    evidence: ``dataclasses.replace(evidence, expected_ranges=...)``.

    The program multiplies probabilities and squashes afterwards, and 180 beams underflow to 0. Sums of logarithms do
    not.
    """

    stack: ClassVar[str] = "f1tenth"
    model: ClassVar[str] = "table"
    evidence_settings: ClassVar[tuple[str, ...]] = ("angle_step", "max_range")
    fitted_parameters: ClassVar[tuple[str, ...]] = ("z_short", "z_max", "z_rand", "z_hit", "sigma_hit", "squash_factor")

    grid: OccupancyGrid
    parameters: F1tenthParameters
    map_mode: str = field(default="trinary", kw_only=True)
    _caster: RayCaster = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_choice(self, "map_mode", ("trinary", "raw"))
        stops = self.grid.occupied
        if self.map_mode == "raw":
            stops = np.nan_to_num(self.grid.probability, nan=0.0) > OCCUPIED_FROM
        resolution = message_resolution(self.grid.resolution)
        seen = OccupancyGrid(stops.astype(np.float32), resolution, self.grid.origin)
        keep(self, _caster=RayCaster(seen))
        pixels(self.parameters.max_range, resolution)

    def with_parameters(self, parameters: F1tenthParameters) -> Self:
        """Return the model with other parameters and the same map, options and tables."""
        pixels(parameters.max_range, self._caster.grid.resolution)
        return super().with_parameters(parameters)

    def evidence(self, z: Scan, poses: ArrayLike) -> RayEvidence:
        """Return readings and expected ranges, metres; see `StackModel.evidence`."""
        robot = as_poses(poses).reshape(-1, 3)
        limit = self.parameters.max_range
        beams = np.arange(0, len(z.ranges), self.parameters.angle_step)
        beams = beams[~np.isnan(z.ranges[beams])]
        ranges = np.clip(z.ranges[beams], 0.0, limit)
        expected = exact_ranges(self._caster, self._caster.grid, robot, z.finder.mounts[beams], limit, off_map=limit)
        return RayEvidence(beams, limit, ranges, expected, settings=self._settings())

    def beam_log_values(self, evidence: RayEvidence, parameters: F1tenthParameters | None = None) -> FloatArray:
        """Return log T of each beam that counts, before squashing, (n, k)."""
        values = self._parameters_for(evidence, parameters)
        resolution = self._caster.grid.resolution
        table = _log_table(values, resolution)
        n = len(table) - 1
        readings = _whole_pixels(evidence.ranges, resolution, n)
        return np.asarray(table[readings, _whole_pixels(evidence.expected_ranges, resolution, n)])

    def log_weights(self, evidence: RayEvidence, parameters: F1tenthParameters | None = None) -> FloatArray:
        """Return the sum of log T divided by squash_factor, (n,); see `StackModel.log_weights`."""
        values = self._parameters_for(evidence, parameters)
        return np.asarray(self.beam_log_values(evidence, values).sum(axis=1) / values.squash_factor)


@lru_cache(maxsize=1)
def _log_table(parameters: F1tenthParameters, resolution: float) -> FloatArray:
    """Return log T, which a filter asks for at every scan."""
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(sensor_table(parameters, resolution)))


def sensor_table(parameters: F1tenthParameters, resolution: float) -> FloatArray:
    """Return T[r, d], (N + 1, N + 1): the probability of a reading of r pixels where d are expected."""
    n = pixels(parameters.max_range, resolution)
    r, d = np.arange(n + 1.0)[:, None], np.arange(n + 1.0)
    table = np.exp(-0.5 * ((r - d) / parameters.sigma_hit) ** 2)
    table *= parameters.z_hit / (parameters.sigma_hit * math.sqrt(2.0 * math.pi))
    table += np.where(r < d, 2.0 * parameters.z_short * (d - r) / np.maximum(d, 1.0), 0.0)
    table[:-1] += parameters.z_rand / n
    table[-1] += parameters.z_max
    total = table.sum(axis=0)
    # All factors 0, or no hit within reach of a column: nothing is likelier than anything else.
    return np.asarray(np.where(total > 0.0, table / np.where(total > 0.0, total, 1.0), 1.0 / (n + 1)))


def pixels(max_range: float, resolution: float) -> int:
    """Return N, the whole number of pixels in the longest range.

    Raises
    ------
    InvalidInputError
        If there are none, or too many for a table.
    """
    n = math.floor(max_range / resolution)
    if not 1 <= n <= MOST_PIXELS:
        raise InvalidInputError(
            f"max_range: expected 1 to {MOST_PIXELS} cells of the map ({resolution:g} m), got {max_range:g} m"
        )
    return n


def _whole_pixels(metres: FloatArray, resolution: float, n: int) -> NDArray[np.int64]:
    """Return ranges in pixels cut down to whole ones, by division in single precision as in the program."""
    ratio = metres.astype(np.float32) / np.float32(resolution)
    return np.asarray(np.clip(np.floor(ratio), 0, n), np.int64)
