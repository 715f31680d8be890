"""Pre-cached expected ranges: the z* of section 6.3.4, looked up in a table over x, y and theta."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import check_fields, checked, keep, require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses, pose_rows
from beamfield.kernels import range_table as kernels
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.range_table_plan import Codes, Progress, RangeTablePlan
from beamfield.maps.raycast import frame_of
from beamfield.sensors import RangeFinder
from beamfield.short_repr import short_repr

# Rays that are compared with exact ones. The seed is fixed: a table has one error.
N_COMPARED = 200_000
# What a look-up costs beside an exact ray, to decide whether threads pay.
RAYS_PER_LOOK_UP = 0.3


@dataclass(frozen=True)
class RangeTableError:
    """How far the ranges of a table are from exact ones, over random poses in free cells and random directions.

    Parameters
    ----------
    median, percentile_95, percentile_99, largest
        Of the absolute error, metres.
    share_off_by_a_cell
        Share of the rays whose error is larger than a cell of the map.
    n_rays
        How many were compared.

    Raises
    ------
    InvalidInputError
        If a number is negative or not finite.
    """

    median: float
    percentile_95: float
    percentile_99: float
    largest: float
    share_off_by_a_cell: float
    n_rays: int

    def __post_init__(self) -> None:
        check_fields(self)
        for name, value in vars(self).items():
            require(0.0 <= value < np.inf, name, "a finite number of at least 0", value)


@dataclass(frozen=True, eq=False)
class RangeTable:
    """Expected ranges from a table over x, y and theta: quicker than `RayCaster` where poses are near each other.

    The map is divided into squares, the circle into headings; the range of each is cast once, from the middle of the
    square. A look-up first reads how far away the point is that a beam meets, then the range in the direction in which
    that point is seen from the middle, interpolated between two headings if they meet one wall, and corrects it by how
    far ahead or behind the beam starts. Along a wall that leaves little of the grid's error; near edges, where a step
    aside shows what is behind, ranges can be off by metres. `error` says how often.

    What the table has no place for is cast exactly: beams that start off the map, or in squares without any free cell.
    Beams that start in an occupied cell have range 0, as everywhere.

    Use it for very many poses in one map: particles, or a likelihood over a building. One pose, or rays that start all
    over a large map, are as quick to cast exactly. Build it with `RangeTable.build`, or `precompute_ranges`, which
    keeps it in a file.

    Parameters
    ----------
    plan
        What it holds.
    codes
        (places, headings) uint16, ranges in quanta of the plan.
    error
        Measured when it was built; None: it is measured now.

    Raises
    ------
    InvalidInputError
        If the codes do not have the plan's shape or are no uint16.

    Notes
    -----
    A table never changes; any number of threads may use one. Pickling copies the codes, of a file too.

    References
    ----------
    Probabilistic Robotics, section 6.3.4: pre-caching the ray casting in a three-dimensional grid, 15 cm and 2 degrees.

    Examples
    --------
    >>> grid = OccupancyGrid([[0.0] * 20 + [1.0]] * 20, resolution=0.1)
    >>> table = RangeTable.build(grid)
    >>> table.cast([0.52, 1.03, 0.3], max_range=5.0).round(2).tolist()
    1.55
    """

    plan: RangeTablePlan
    codes: Codes = field(default=None, repr=False)  # type: ignore[arg-type]  # None is refused with what to do
    error: RangeTableError = field(default=None)  # type: ignore[assignment]  # always there once constructed

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        if self.codes is None:
            raise InvalidInputError("codes: expected an array, got None: RangeTable.build(grid) makes a table")
        shape = (self.plan.n_places, self.plan.headings)
        require(self.codes.shape == shape, "codes", f"shape {shape}", self.codes.shape)
        require(self.codes.dtype == np.uint16, "codes", "uint16", self.codes.dtype)
        # A memory map is an array to the compiler once it is seen as one; a view leaves the caller's array writeable.
        keep(self, codes=np.ascontiguousarray(self.codes).view())
        if self.error is None:
            keep(self, error=_measured_error(self))

    @classmethod
    @checked
    def build(
        cls,
        grid: OccupancyGrid,
        *,
        max_range: float | None = None,
        resolution: float = 0.15,
        headings: int = 180,
        unknown: Literal["free", "occupied"] = "free",
        max_gigabytes: float = 4.0,
        progress: Progress | None = None,
    ) -> RangeTable:
        """Build a table in memory.

        Parameters
        ----------
        grid, max_range, resolution, headings, unknown
            As for `RangeTablePlan`, which says how large a table will be.
        max_gigabytes
            A larger one is refused before it is built.
        progress
            Called with how many places are done, and of how many.

        Raises
        ------
        InvalidInputError
            As for `RangeTablePlan`, or if the table is too large.
        """
        plan = RangeTablePlan(grid, max_range, resolution, headings, unknown)
        plan.check_size(max_gigabytes)
        codes = np.empty((plan.n_places, plan.headings), np.uint16)
        done = 0
        for block in plan.code_blocks(progress):
            codes[done : done + len(block)] = block
            done += len(block)
        return cls(plan, codes)

    @property
    def grid(self) -> OccupancyGrid:
        """The map."""
        return self.plan.grid

    @property
    def unknown(self) -> Literal["free", "occupied"]:
        """Whether rays pass unknown cells or stop there."""
        return self.plan.unknown

    @property
    def table_bytes(self) -> int:
        """Memory of the table, without that of the ray caster for what it has no place for."""
        return self.codes.nbytes + self.plan.places.nbytes + self.plan.starts.nbytes

    def check_reach(self, max_range: float) -> None:
        """Refuse a sensor that sees farther than the table.

        Parameters
        ----------
        max_range
            Of the sensor, metres.

        Raises
        ------
        InvalidInputError
            If it is longer than the max_range that the table was built for.
        """
        longest = self.plan.max_range
        if longest is not None and max_range > longest:
            raise InvalidInputError(
                f"max_range: the range table was built for at most {longest:g} m, got {max_range:g}"
            )

    @checked
    def expected_ranges(self, poses: ArrayLike, finder: RangeFinder) -> FloatArray:
        """Return the expected range z* of every beam of a sensor at every pose.

        Parameters
        ----------
        poses, finder
            As for `RayCaster.expected_ranges`.

        Returns
        -------
        (..., k) metres in [0, finder.max_range]; max_range where nothing is hit before it.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3), or the sensor's max_range is beyond the table's.
        """
        robots, k = as_poses(poses), finder.n_beams
        self.check_reach(finder.max_range)
        ranges: FloatArray = np.empty((*robots.shape[:-1], k))
        if ranges.size == 0:
            return ranges
        rows, results = pose_rows(robots), ranges.reshape(-1, k)
        fan, same_mount = self._fan(finder)
        frame, view, longest = frame_of(self.grid), self._view(), float(finder.max_range)

        def work(start: int, stop: int) -> None:
            part = results[start:stop]
            if kernels.look_up_fan(rows[start:stop], frame, fan, same_mount, view, longest, part.reshape(-1)):
                rest = (part < 0.0).any(axis=1)
                part[rest] = self.plan.caster.expected_ranges(rows[start:stop][rest], finder)

        run_in_blocks(work, len(rows), work_per_row=k * RAYS_PER_LOOK_UP)
        return ranges

    @checked
    def cast(self, origins: ArrayLike, max_range: float) -> FloatArray:
        """Return the range of single rays.

        Parameters
        ----------
        origins, max_range
            As for `RayCaster.cast`.

        Returns
        -------
        (...) metres in [0, max_range].

        Raises
        ------
        InvalidInputError
            If the origins are not finite (..., 3), or max_range is not positive or beyond the table's.
        """
        ahead = RangeFinder.from_bearings([0.0], max_range)
        return self.expected_ranges(as_poses(origins, "origins"), ahead)[..., 0]

    def __reduce__(self) -> Any:
        return type(self), (self.plan, self.codes, self.error)

    def _fan(self, finder: RangeFinder) -> tuple[FloatArray, bool]:
        """Return the beams as the kernel wants them, and whether all start at one point."""
        x, y, theta = finder.mounts.T
        headings = self.plan.headings
        steps = np.mod(theta * (headings / (2.0 * np.pi)), headings)
        # A negative angle may be rounded up to the whole circle.
        steps[steps >= headings] = 0.0
        fan = np.stack([x / self.grid.resolution, y / self.grid.resolution, np.cos(theta), np.sin(theta), steps])
        return fan, bool(np.all(x == x[:1]) and np.all(y == y[:1]))

    def _view(self) -> kernels.Table:
        plan = self.plan
        stops = plan.caster.stops
        codes = self.codes.reshape(-1)
        return kernels.Table(
            codes, plan.places, plan.starts, stops, plan.side, plan.headings, plan.quantum, self.grid.resolution
        )


def _measured_error(table: RangeTable) -> RangeTableError:
    """Compare the table with the exact ranges of random rays."""
    plan, grid, rng = table.plan, table.grid, np.random.default_rng(0)
    squares = np.flatnonzero(plan.places != -1)
    poses = np.empty((0, 3))
    while len(poses) < N_COMPARED:
        # Points of random squares that are in a free cell: uniform over all free cells.
        row, col = np.divmod(rng.choice(squares, N_COMPARED), plan.places.shape[1])
        points = grid.to_map((np.column_stack([col, row]) + rng.random((N_COMPARED, 2))) * plan.side)
        drawn = np.column_stack([points, rng.uniform(-np.pi, np.pi, N_COMPARED)])
        poses = np.concatenate([poses, drawn[grid.look_up(grid.free, points)]])[:N_COMPARED]
    longest = plan.max_range or plan.reach
    error = np.abs(table.cast(poses, longest) - plan.caster.cast(poses, longest))
    median, percentile_95, percentile_99 = (float(value) for value in np.percentile(error, [50, 95, 99]))
    off = float(np.mean(error > grid.resolution))
    return RangeTableError(median, percentile_95, percentile_99, float(error.max()), off, N_COMPARED)
