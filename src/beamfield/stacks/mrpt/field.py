"""MRPT's likelihood field LF_Thrun, emulated."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import keep
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, compose
from beamfield.maps.distance import distance_to_obstacles
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import Scan
from beamfield.stacks.emulation.beam_selection import Indices
from beamfield.stacks.emulation.emulator import OFF_MAP, UNKNOWN, FieldEvidence, FieldModel, ScanEnds
from beamfield.stacks.emulation.field_table import FieldTable, end_points
from beamfield.stacks.emulation.parameter_checks import check_choice
from beamfield.stacks.emulation.stack_map import MapMode
from beamfield.stacks.mrpt.parameters import MrptFieldParameters
from beamfield.stacks.mrpt.scan import mrpt_grid, scan_points, thinned_out

Precision = Literal["double", "single"]


@dataclass(frozen=True, eq=False)
class MrptField(FieldModel[MrptFieldParameters]):
    """``w = prod p`` with ``p = LF_zHit exp(-d^2 / 2 LF_stdHit^2) + LF_zRandom / LF_maxRange`` for each point.

    d is the distance from the cell of the end point to the nearest occupied cell, cut off at LF_maxCorrsDistance, and
    that maximum off the map. Unknown cells are as free ones. LF_useSquareDist puts d^4 for d^2 (not off the map),
    LF_alternateAverageMethod the mean of p for the product.

    The map's last row and column are off it, while a point less than a cell below its first row or column falls into
    that. Readings become points before LF_decimation thins them out; see `scan_points`.

    Parameters
    ----------
    grid
        The map.
    parameters
        MRPT's own.
    precision
        "double", or "single" to round as the program does (about 1e-7 per point).
    least_spacing
        Points nearer to the last one than this are left out, metres; None as in the program, half a cell. 0 keeps all.
    map_mode
        How the map server turns the map into a message; see `read_as_stack`.

    Examples
    --------
    >>> import numpy as np
    >>> from beamfield.sensors import RangeFinder
    >>> wall = OccupancyGrid.from_ros([[0, 0, 0, 0, 100, 0], [0] * 6], resolution=0.5)
    >>> model = MrptField(wall, MrptFieldParameters())
    >>> scan = Scan([1.0], RangeFinder.from_bearings([0.0], max_range=5.0))
    >>> np.exp(model.log_likelihood(scan, [[1.2, 0.2, 0.0], [0.2, 0.2, 0.0]])).round(4).tolist()
    [0.9506, 0.6586]
    """

    stack: ClassVar[str] = "mrpt"
    is_product: ClassVar[bool] = True
    model: ClassVar[str] = "LF_Thrun"
    evidence_settings: ClassVar[tuple[str, ...]] = ("LF_decimation",)
    fitted_parameters: ClassVar[tuple[str, ...]] = ("LF_zHit", "LF_zRandom", "LF_stdHit")

    grid: OccupancyGrid
    parameters: MrptFieldParameters
    precision: Precision = field(default="double", kw_only=True)
    least_spacing: float | None = field(default=None, kw_only=True)
    map_mode: MapMode = field(default="trinary", kw_only=True)
    _table: FieldTable = field(init=False, repr=False)

    def __post_init__(self) -> None:
        check_choice(self, "precision", ("double", "single"))
        if self.least_spacing is not None and not 0.0 <= self.least_spacing < np.inf:
            raise InvalidInputError(f"least_spacing: expected a number >= 0 or None, got {self.least_spacing!r}")
        keep(self, _table=_table(mrpt_grid(self.grid, self.map_mode)))

    def scan_ends(self, z: Scan) -> ScanEnds:
        """Return the end points that the program looks up; see `FieldModel.scan_ends`."""
        spacing = self._table.grid.resolution / 2.0 if self.least_spacing is None else self.least_spacing
        beams = thinned_out(scan_points(z, spacing), self.parameters.LF_decimation)
        return ScanEnds(beams, self.parameters.LF_maxRange, end_points(z.finder.mounts[beams], z.ranges[beams]))

    def beam_values(self, evidence: FieldEvidence, parameters: MrptFieldParameters | None = None) -> FloatArray:
        """Return p of each point that counts, (n, k)."""
        values = self._parameters_for(evidence, parameters)
        off_map = evidence.places == OFF_MAP
        if self.precision == "single":
            return _single_values(evidence.distances, off_map, values, self.grid.resolution)
        squares: FloatArray = np.minimum(evidence.distances, values.LF_maxCorrsDistance, dtype=np.float64)
        squares *= squares
        if values.LF_useSquareDist:
            squares *= np.where(off_map, 1.0, squares)
        p = np.exp(-0.5 / values.LF_stdHit**2 * squares)
        p *= values.LF_zHit
        p += values.LF_zRandom / values.LF_maxRange
        return np.asarray(p)

    def beam_terms(self, evidence: FieldEvidence, parameters: MrptFieldParameters | None = None) -> FloatArray:
        """Return log p of each point that counts, (n, k), or p if the weight is their mean."""
        values = self._parameters_for(evidence, parameters)
        averages = values.LF_alternateAverageMethod
        return self.beam_values(evidence, values) if averages else super().beam_terms(evidence, values)

    def log_of_sums(
        self, sums: FloatArray, n_beams: int | NDArray[np.int64], parameters: MrptFieldParameters
    ) -> FloatArray:
        """Return the sums of log p, or the logarithm of the mean of p; 0 without points. See `FieldModel`."""
        if not parameters.LF_alternateAverageMethod:
            return sums
        with np.errstate(divide="ignore"):
            return np.asarray(np.where(np.asarray(n_beams) > 0, np.log(sums / np.maximum(n_beams, 1)), 0.0))

    def _evidence_of(
        self, beams: Indices, max_range: float, distances: NDArray[np.floating[Any]], places: NDArray[np.int8]
    ) -> FieldEvidence:
        # The table calls "unknown" what is on the map and does not count.
        places[places == UNKNOWN] = OFF_MAP
        distances[places == OFF_MAP] = np.inf
        return super()._evidence_of(beams, max_range, distances, places)


def _table(seen: OccupancyGrid) -> FieldTable:
    """Return distances with the first row and column twice; marks cells that do not count as "unknown"."""
    obstacles = OccupancyGrid(seen.occupied.astype(np.float32), seen.resolution)
    distance = np.pad(distance_to_obstacles(obstacles), ((1, 0), (1, 0)), "edge")
    last = np.zeros(seen.shape, np.bool_)
    last[-1] = last[:, -1] = True
    last = np.pad(last, ((1, 0), (1, 0)), "edge")
    corner = compose(seen.origin, [-seen.resolution, -seen.resolution, 0.0])
    return FieldTable(OccupancyGrid(np.zeros(distance.shape, np.float32), seen.resolution, corner), distance, last)


def _single_values(
    distances: NDArray[np.floating[Any]], off_map: NDArray[np.bool_], values: MrptFieldParameters, resolution: float
) -> FloatArray:
    """Return p with the roundings of the program: everything in single precision but off the map."""
    cells = np.round(np.square(np.where(off_map, 0.0, distances).astype(np.float64) / resolution))
    limit = np.float32(values.LF_maxCorrsDistance) ** 2
    squares = np.minimum((cells * float(np.float32(resolution)) ** 2).astype(np.float32), limit)
    if values.LF_useSquareDist:
        squares = squares * squares
    rate = np.float32(-0.5) / np.float32(values.LF_stdHit) ** 2
    hit, random = np.float32(values.LF_zHit), np.float32(values.LF_zRandom) / np.float32(values.LF_maxRange)
    # NumPy's own exponential of single precision is not rounded correctly.
    p = random + hit * np.exp((rate * squares).astype(np.float64)).astype(np.float32)
    nowhere = float(random) + float(hit) * np.exp(float(rate) * float(limit))
    return np.where(off_map, nowhere, p.astype(np.float64))
