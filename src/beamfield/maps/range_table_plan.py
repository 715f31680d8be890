"""What a table of pre-cached ranges will hold, known before it is built."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import as_count, check_fields, check_magnitude, keep
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.kernels import range_table as kernels
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder
from beamfield.short_repr import short_repr

Codes = NDArray[np.uint16]
Progress = Callable[[int, int], None]

LEAST_HEADINGS, MOST_HEADINGS = 8, 3600
# Squares of a table, and codes in it: codes are addressed with 32 bits.
MAX_SQUARES, MAX_CODES = 100_000_000, 2**32 - 1
# Rays in memory at a time while a table is built.
RAYS_PER_BLOCK = 1_000_000


@dataclass(frozen=True, eq=False)
class RangeTablePlan:
    """Where the rays of a table start, how many there are, and how their ranges are stored.

    Parameters
    ----------
    grid
        The map.
    max_range
        Longest range that sensors may have, metres; None: any, as the table reaches over the whole map.
    resolution
        Side of the squares that share their ranges, metres.
    headings
        Number of directions, equally spaced over the circle from the grid's x axis on.
    unknown
        Whether rays pass unknown cells ("free") or stop there ("occupied").

    Raises
    ------
    InvalidInputError
        If a number is out of range, no cell of the map is free, or there are more codes than 32 bits can address.
    """

    grid: OccupancyGrid
    max_range: float | None = None
    resolution: float = 0.15
    headings: int = 180
    unknown: Literal["free", "occupied"] = "free"
    caster: RayCaster = field(init=False, repr=False)
    places: NDArray[np.int32] = field(init=False, repr=False)
    starts: NDArray[np.float32] = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        if self.max_range is not None:
            check_magnitude("max_range", self.max_range)
        check_magnitude("resolution", self.resolution)
        # Other kinds of numbers would be other types to the compiler.
        keep(
            self,
            max_range=None if self.max_range is None else float(self.max_range),
            resolution=float(self.resolution),
            headings=as_count(self.headings, "headings", least=LEAST_HEADINGS, most=MOST_HEADINGS),
        )
        places = np.empty(self._shape(), np.int32)
        starts = np.empty((places.size, 2), np.float32)
        n = kernels.find_places(self.grid.free, self.side, places, starts)
        if n == 0:
            raise InvalidInputError("grid: the map has no free cell, so no pose has ranges to store")
        if n * self.headings > MAX_CODES:
            raise InvalidInputError(
                f"resolution, headings: expected at most {MAX_CODES:,} ranges, got {n:,} places x {self.headings}"
            )
        keep(self, caster=RayCaster(self.grid, unknown=self.unknown), places=places, starts=starts[:n].copy())

    @property
    def side(self) -> float:
        """Side of the squares in cells of the map."""
        return self.resolution / self.grid.resolution

    @property
    def n_places(self) -> int:
        """Number of squares in which something is free."""
        return len(self.starts)

    @property
    def n_bytes(self) -> int:
        """Size of the table: two bytes for each place and heading."""
        return 2 * self.n_places * self.headings

    @property
    def reach(self) -> float:
        """Longest range that is stored, metres: no ray in the map is longer, or starts lie that far apart at most."""
        diagonal = self.grid.resolution * math.hypot(*self.grid.shape)
        return diagonal if self.max_range is None else min(diagonal, self.max_range + 1.5 * self.resolution)

    @property
    def quantum(self) -> float:
        """Ranges are stored as multiples of this, metres."""
        return self.reach / (kernels.NOTHING - 1)

    def start_poses(self, first: int, last: int) -> FloatArray:
        """Return where the rays of places first to last - 1 start, (n, 3): heading 0 of the table, in the map frame."""
        points = self.grid.to_map(self.starts[first:last])
        return np.column_stack([points, np.full(len(points), self.grid.origin[2])])

    def code_blocks(self, progress: Progress | None) -> Iterator[Codes]:
        """Cast the rays and yield their codes (n, headings), some places at a time, which the progress counts."""
        finder = RangeFinder.from_bearings(np.arange(self.headings) * (2.0 * np.pi / self.headings), self.reach)
        step = max(1, RAYS_PER_BLOCK // self.headings)
        for first in range(0, self.n_places, step):
            last = min(first + step, self.n_places)
            ranges = self.caster.expected_ranges(self.start_poses(first, last), finder)
            codes = np.empty(ranges.shape, np.uint16)
            kernels.encode(ranges.reshape(-1), self.quantum, self.reach, codes.reshape(-1))
            yield codes
            if progress is not None:
                progress(last, self.n_places)

    def check_size(self, max_gigabytes: float) -> None:
        """Refuse a table that is larger than it may be, and say what makes it smaller."""
        check_magnitude("max_gigabytes", max_gigabytes)
        if self.n_bytes > max_gigabytes * 1e9:
            raise InvalidInputError(
                f"max_gigabytes: the table takes {self.n_bytes / 1e9:.3g} GB, more than {max_gigabytes:g}; a coarser "
                "resolution or fewer headings make it smaller"
            )

    def __reduce__(self) -> Any:
        # Built again, which takes less time than to send it; and arrays that are unpickled are writeable, which is
        # another type to the compiler.
        return type(self), (self.grid, self.max_range, self.resolution, self.headings, self.unknown)

    def _shape(self) -> tuple[int, int]:
        # The sides of a map are rarely exact multiples in floating point.
        rows, cols = (max(1.0, float(np.ceil(n / self.side - kernels.SLIVER))) for n in self.grid.shape)
        if not rows * cols <= MAX_SQUARES:
            raise InvalidInputError(
                f"resolution: {self.resolution:g} m makes {rows:.0f} x {cols:.0f} squares, more than {MAX_SQUARES:,}"
            )
        return int(rows), int(cols)


def map_key(grid: OccupancyGrid) -> str:
    """Return what tables depend on in a map: a hash of its cells and of their size. Its origin may move."""
    content = hashlib.sha256(repr((grid.shape, grid.resolution)).encode())
    for mask in (grid.occupied, grid.free):
        content.update(np.packbits(mask).data)
    return content.hexdigest()
