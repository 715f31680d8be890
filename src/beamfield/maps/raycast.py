"""Expected ranges by exact ray casting in an occupancy grid: the z* of section 6.3."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any, Literal
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, checked, keep, require, restore
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses, pose_rows
from beamfield.kernels import raycast as kernels
from beamfield.kernels.beam import BeamView
from beamfield.kernels.device import require_device
from beamfield.kernels.exact_rays import Terrain, one_beam, trace_fan
from beamfield.kernels.free_rectangles import free_rectangles
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder
from beamfield.short_repr import short_repr

IntArray = NDArray[np.int32]
# The tables are addressed with 32-bit indices.
MAX_TABLE_CELLS = 2**31 - 1
# Tables up to so many bytes stay as long as their map: whoever tries several models on it needs them again and again.
KEPT_BYTES = 2**26
_KEPT: WeakKeyDictionary[OccupancyGrid, dict[bool, NDArray[np.uint16]]] = WeakKeyDictionary()


@dataclass(frozen=True, eq=False)
class RayCaster:
    """Casts rays in an occupancy grid, exactly.

    The range of a ray is the distance along it to where it enters the first occupied cell, at most the longest range.

    - A ray that starts in an occupied cell has range 0. The cell of a start is the floor of its coordinates.
    - Space off the map is free: a ray may start there and enter the map later.
    - A ray through the corner of four cells goes to the cell diagonally behind the corner. It is blocked if that cell
      is occupied, or if both cells beside the corner are; one of them alone does not block it. No ray slips between
      two occupied cells that touch at a corner.
    - A ray along the border of two rows (or columns) of cells is in the upper (right) one, by the rule of the floor.
    - Coordinates within 1e-9 cells of a border are on it, crossings within 1e-9 cells of each other along the ray are
      at a corner, and direction components below 1e-12 are 0. These tolerances lie far above float64's rounding, so
      that rays through corners and along borders do not depend on the map's origin; they change no range by more than
      about 1e-9 cells.

    Adding an obstacle never lengthens a ray. Ranges equal those of a cell-by-cell traversal in float64.

    Parameters
    ----------
    grid
        The map.
    unknown
        Whether rays pass through unknown cells ("free") or stop at them ("occupied").
    device
        Where `expected_ranges` and `cast` follow rays: "cpu", or "cuda", a GPU, with the same ranges
        (docs/raycasting.md). Cells are found on the CPU.

    Raises
    ------
    InvalidInputError
        If `unknown` is neither of the two, the map has 2^29 cells or more, or device is "cuda" and there is no GPU, or
        one with too little free memory.
    MissingDependencyError
        If device is "cuda" and numba-cuda is not installed.

    Notes
    -----
    Construction builds four tables of two bytes per cell (see `table_bytes`), or takes those of another caster: up to
    64 MiB are kept as long as the map. A caster never changes; any number of threads may use one. It pickles together
    with its tables.

    References
    ----------
    Probabilistic Robotics, section 6.3.1 and Table 6.1, line 4: z* by ray casting.

    Examples
    --------
    >>> grid = OccupancyGrid([[0.0, 0.0, 0.0, 1.0]], resolution=0.5)
    >>> RayCaster(grid).cast([0.25, 0.25, 0.0], max_range=10.0).tolist()
    1.25
    """

    grid: OccupancyGrid
    unknown: Literal["free", "occupied"] = field(default="free", kw_only=True)
    device: Literal["cpu", "cuda"] = field(default="cpu", kw_only=True)
    _rectangles: NDArray[np.uint16] = field(init=False, repr=False)
    _on_device: Any = field(init=False, repr=False)
    _frame: tuple[float, float, float] = field(init=False, repr=False)
    _cells: tuple[NDArray[np.uint16], int, int, float] = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        require(self.unknown in ("free", "occupied"), "unknown", "'free' or 'occupied'", self.unknown)
        require_device(self.device)
        keep(self, _rectangles=_rectangles_of(self.grid, self.unknown))
        self._prepare()

    @property
    def table_bytes(self) -> int:
        """Memory of the tables: eight bytes per cell, and a frame of one cell around the map."""
        return self._rectangles.nbytes

    @property
    def stops(self) -> NDArray[np.uint16]:
        """(rows + 2, cols + 2) 0 in cells that stop rays and in a frame around the map, anything else elsewhere."""
        stops: NDArray[np.uint16] = self._rectangles[0]
        return stops

    @checked
    def expected_ranges(self, poses: ArrayLike, finder: RangeFinder) -> FloatArray:
        """Return the expected range z* of every beam of a sensor at every pose.

        Parameters
        ----------
        poses
            (..., 3) robot poses in the map frame, metres and radians.
        finder
            The sensor; each beam starts at its own mount (x, y, theta)_k,sens in the robot frame, as in (6.32).

        Returns
        -------
        (..., k) metres in [0, finder.max_range]; max_range where nothing is hit before it.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).

        Examples
        --------
        >>> grid = OccupancyGrid([[0.0, 0.0, 0.0, 1.0]], resolution=0.5)
        >>> finder = RangeFinder.from_bearings([0.0, np.pi], max_range=10.0)
        >>> RayCaster(grid).expected_ranges([0.25, 0.25, 0.0], finder).tolist()
        [1.25, 10.0]
        """
        robots, k = as_poses(poses), finder.n_beams
        ranges: FloatArray = np.empty((*robots.shape[:-1], k))
        rows, results = pose_rows(robots), ranges.reshape(-1)
        frame, terrain = self._frame, self._terrain(finder.max_range)
        fan, same_mount = _fan(finder, self.grid.resolution)
        if self.device == "cuda":
            self._cast_on_device(rows, fan, terrain, results)
            return ranges

        def work(start: int, stop: int) -> None:
            part = results[start * k : stop * k]
            kernels.cast_fan(rows[start:stop], frame, fan, same_mount, terrain, part)

        run_in_blocks(work, len(rows), work_per_row=k)
        return ranges

    @checked
    def expected_hits(self, poses: ArrayLike, finder: RangeFinder) -> IntArray:
        """Return which cell every beam hits.

        Parameters
        ----------
        poses, finder
            As for `expected_ranges`.

        Returns
        -------
        (..., k, 2) row and column; -1 where nothing is hit before max_range. For a ray that is blocked at a corner, one
        of the two cells that block it.

        Raises
        ------
        InvalidInputError
            As for `expected_ranges`.
        """
        robots, k = as_poses(poses), finder.n_beams
        cells = np.empty((*robots.shape[:-1], k, 2), np.int32)
        rows, results = pose_rows(robots), cells.reshape(-1, 2)
        frame, terrain = self._frame, self._terrain(finder.max_range)
        fan, _ = _fan(finder, self.grid.resolution)

        def work(start: int, stop: int) -> None:
            part = results[start * k : stop * k]
            trace_fan(rows[start:stop], frame, fan, terrain, np.empty(len(part)), part, False)

        run_in_blocks(work, len(rows), work_per_row=k)
        return cells

    @checked
    def cast(self, origins: ArrayLike, max_range: float) -> FloatArray:
        """Return the range of single rays.

        Parameters
        ----------
        origins
            (..., 3) start and direction of each ray in the map frame, metres and radians.
        max_range
            Longest range in metres.

        Returns
        -------
        (...) metres in [0, max_range].

        Raises
        ------
        InvalidInputError
            If the origins are not finite (..., 3), or max_range is not positive and finite.
        """
        rays = as_poses(origins, "origins")
        ranges: FloatArray = np.empty(rays.shape[:-1])
        rows, results = pose_rows(rays), ranges.reshape(-1)
        frame, terrain, ahead = self._frame, self._terrain(max_range), one_beam()
        if self.device == "cuda":
            self._cast_on_device(rows, ahead, terrain, results)
            return ranges

        def work(start: int, stop: int) -> None:
            kernels.cast_fan(rows[start:stop], frame, ahead, True, terrain, results[start:stop])

        run_in_blocks(work, len(rows))
        return ranges

    @checked
    def cast_hits(self, origins: ArrayLike, max_range: float) -> IntArray:
        """Return which cell each single ray hits.

        Parameters
        ----------
        origins, max_range
            As for `cast`.

        Returns
        -------
        (..., 2) row and column; -1 where nothing is hit before max_range.

        Raises
        ------
        InvalidInputError
            As for `cast`.
        """
        rays = as_poses(origins, "origins")
        cells = np.empty((*rays.shape[:-1], 2), np.int32)
        rows, results = pose_rows(rays), cells.reshape(-1, 2)
        frame, terrain, ahead = self._frame, self._terrain(max_range), one_beam()

        def work(start: int, stop: int) -> None:
            part = results[start:stop]
            trace_fan(rows[start:stop], frame, ahead, terrain, np.empty(len(part)), part, False)

        run_in_blocks(work, len(rows))
        return cells

    def fill_sums_on_device(
        self, poses: FloatArray, finder: RangeFinder, ranges: FloatArray, view: BeamView, out: FloatArray
    ) -> None:
        """Fill in a beam model's sums over beams at poses; device "cuda" only, where expected ranges then stay.

        Parameters
        ----------
        poses
            (n, 3) robot poses, metres and radians.
        finder
            The sensor, of k beams.
        ranges
            (k,) readings in metres, counted from `view.min_range`.
        view
            Parameters of the mixture (6.12), as kernels take them.
        out
            (n,) nats, overwritten.
        """
        from beamfield.kernels import cuda_raycast

        fan, _ = _fan(finder, self.grid.resolution)
        terrain = self._terrain(finder.max_range)._replace(table=self._on_device)
        frame = self._frame
        cuda_raycast.fill_scan_log_likelihood(pose_rows(poses), frame, fan, terrain, ranges, view, out)

    def _cast_on_device(self, rows: FloatArray, fan: FloatArray, terrain: Terrain, results: FloatArray) -> None:
        from beamfield.kernels import cuda_raycast

        terrain = terrain._replace(table=self._on_device)
        cuda_raycast.cast_fan(rows, self._frame, fan, terrain, results)

    def _prepare(self) -> None:
        """Keep what follows from the other fields, in the form that kernels take."""
        table, (rows, cols) = self._rectangles.reshape(-1), self.grid.shape
        on_device = None
        if self.device == "cuda":
            from beamfield.kernels.cuda_target import upload

            on_device = upload(table)
        keep(self, _on_device=on_device, _frame=frame_of(self.grid), _cells=(table, rows, cols, self.grid.resolution))

    def __getstate__(self) -> dict[str, Any]:
        """Leave out what follows from the rest."""
        return {name: value for name, value in self.__dict__.items() if name not in ("_on_device", "_frame", "_cells")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        restore(self, state)
        require_device(self.device)
        self._prepare()

    def _terrain(self, max_range: float) -> Terrain:
        require(0.0 < max_range < np.inf, "max_range", "a positive finite number of metres", max_range)
        longest = float(max_range)
        return Terrain(*self._cells, longest, longest / self._cells[3])


def frame_of(grid: OccupancyGrid) -> tuple[float, float, float]:
    """Return a map's origin as kernels take it: x and y in metres, yaw in radians."""
    x, y, yaw = grid.origin.tolist()
    return x, y, yaw


def _rectangles_of(grid: OccupancyGrid, unknown: str) -> NDArray[np.uint16]:
    """Return a map's tables, those made before if they are small."""
    through = unknown == "free" or not grid.unknown.any()
    kept = _KEPT.setdefault(grid, {})
    if through in kept:
        return kept[through]
    rows, cols = grid.shape
    shape = (4, rows + 2, cols + 2)
    if np.prod(shape, dtype=np.float64) > MAX_TABLE_CELLS:
        raise InvalidInputError(f"grid: expected fewer than 2^29 cells, got {rows} x {cols}")
    rectangles = np.empty(shape, np.uint16)
    free_rectangles(grid.occupied if through else ~grid.free, rectangles)
    if rectangles.nbytes <= KEPT_BYTES:
        kept[through] = rectangles
    return rectangles


# A finder never changes and is itself alone, so it may be the key. What stays in memory are a few fans.
@lru_cache(maxsize=16)
def _fan(finder: RangeFinder, resolution: float) -> tuple[FloatArray, bool]:
    """Return the beams as the kernel wants them, x, y in cells, cos, sin, and whether all start at one point."""
    places, theta, k = finder.mounts[:, :2], finder.mounts[:, 2], finder.n_beams
    fan = np.zeros((4, k + 8))
    np.divide(places.T, resolution, out=fan[:2, :k])
    np.cos(theta, out=fan[2, :k])
    np.sin(theta, out=fan[3, :k])
    return fan, bool((places == places[:1]).all())
