"""Expected ranges of cones, exactly: what a sonar with an opening angle sees of an occupancy grid."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, checked, keep, restore
from beamfield.geometry import FloatArray, as_poses, compose, pose_rows, transform_points
from beamfield.kernels import cone as kernels
from beamfield.kernels.threads import run_in_blocks
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import IntArray, RayCaster, frame_of
from beamfield.sensors import RangeFinder
from beamfield.short_repr import short_repr

# What a cone costs beside a ray, to decide whether threads pay.
RAYS_PER_CONE = 20


@dataclass(frozen=True, eq=False)
class ConeCaster:
    """Finds the nearest obstacle in a cone, exactly: the expected range z* of a sonar (6.3.1).

    The range of a cone is the shortest range of all beams within half the opening angle to either side of its axis, at
    most the longest range. That is the distance to the nearest visible point of an occupied cell in the cone: the foot
    of a perpendicular on a wall, the corner of a cell, or a point on one of the cone's edges.

    - Each beam follows the conventions of `RayCaster`: cells are the floor of their coordinates, space off the map is
      free, an apex in an occupied cell has range 0.
    - A cone without width is a ray, with the same bits.
    - At the edges of the cone the ray caster's rules for corners hold. A cell that reaches less than 1e-9 cells into
      the cone there is not seen.

    Adding an obstacle never lengthens a cone's range, and neither does opening the cone further.

    Parameters
    ----------
    grid
        The map.
    unknown
        Whether cones see through unknown cells ("free") or end at them ("occupied").

    Raises
    ------
    InvalidInputError
        If `unknown` is neither of the two, or the map has 2^29 cells or more.

    Notes
    -----
    Ranges are those of plane geometry within float64's rounding; nothing is sampled. The edges are rays; the inside is
    searched row by row of a map of bits (see `kernels/cone.py`). Beside the tables of the ray caster it takes 9
    bits for 8 cells. A caster never changes; any number of threads may use one.

    References
    ----------
    Probabilistic Robotics, sections 6.1 and 6.3, and 6.3.1 for cones in feature-based maps.

    Examples
    --------
    A wall half a metre beside the cone's axis: the beam misses it, a cone of 60 degrees sees it.

    >>> grid = OccupancyGrid([[0.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0]], resolution=0.5)
    >>> narrow = RangeFinder.from_bearings([0.0], max_range=5.0)
    >>> wide = RangeFinder.from_bearings([0.0], max_range=5.0, opening_angle=np.radians(60.0))
    >>> caster = ConeCaster(grid)
    >>> [caster.expected_ranges([0.5, 0.75, 0.0], finder).round(3).tolist() for finder in (narrow, wide)]
    [[5.0], [1.031]]
    """

    grid: OccupancyGrid
    unknown: Literal["free", "occupied"] = field(default="free", kw_only=True)
    _rays: RayCaster = field(init=False, repr=False)
    _bits: kernels.Bits = field(init=False, repr=False)
    _bands: kernels.Bits = field(init=False, repr=False)

    __repr__ = short_repr
    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        rows, cols = self.grid.shape
        bits = np.empty((rows, (cols + 31) // 32), np.uint32)
        bands = np.empty((-(-rows // kernels.BAND), bits.shape[1]), np.uint32)
        kernels.pack_rows(self.grid.occupied if self.unknown == "free" else ~self.grid.free, bits, bands)
        keep(self, _rays=RayCaster(self.grid, unknown=self.unknown), _bits=bits, _bands=bands)

    @property
    def table_bytes(self) -> int:
        """Memory of the tables: those of the ray caster and 9 bits for 8 cells."""
        return self._rays.table_bytes + self._bits.nbytes + self._bands.nbytes

    @checked
    def expected_ranges(self, poses: ArrayLike, finder: RangeFinder) -> FloatArray:
        """Return the expected range z* of every cone of a sensor at every pose.

        Parameters
        ----------
        poses
            (..., 3) robot poses in the map frame, metres and radians.
        finder
            The sensor: each cone has its apex and axis at its own mount, all have the same `opening_angle` (full
            width); 0 gives the ranges of rays.

        Returns
        -------
        (..., k) metres in [0, finder.max_range]; max_range where nothing is nearer.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        robots = as_poses(poses)
        if finder.opening_angle == 0.0:
            return self._rays.expected_ranges(robots, finder)
        k = finder.n_beams
        edges = self._rays.expected_ranges(robots, _edges(finder))
        ranges: FloatArray = np.minimum(edges[..., :k], edges[..., k:])
        rows = pose_rows(robots)
        self._shorten(rows, finder, ranges.reshape(len(rows), k), np.empty((0, 0, 2)), np.empty((0, 0, 2), np.int32))
        return ranges

    def expected_points(self, poses: ArrayLike, finder: RangeFinder) -> tuple[FloatArray, IntArray]:
        """Return where the nearest obstacle in each cone is; parameters as for `expected_ranges`.

        Returns
        -------
        points
            (..., k, 2) the nearest points in the map frame, metres; NaN where nothing is nearer than max_range.
        cells
            (..., k, 2) row and column of the cells they belong to; -1 for none. Where cells touch, one of them.
        """
        robots = as_poses(poses)
        rows = pose_rows(robots)
        ranges, points, cells = self._points_on_edges(rows, finder)
        if finder.opening_angle > 0.0:
            self._shorten(rows, finder, ranges, points, cells)
        in_map = self.grid.to_map(points)
        in_map[cells[..., 0] < 0] = np.nan
        shape = (*robots.shape[:-1], finder.n_beams, 2)
        return in_map.reshape(shape), cells.reshape(shape)

    def _shorten(self, rows: FloatArray, finder: RangeFinder, *found: NDArray[Any]) -> None:
        """Shorten ranges, and move their points and cells, to what lies between the edges of the cones."""
        frame, resolution, cones = frame_of(self.grid), self.grid.resolution, _cones(finder, self.grid.resolution)
        bitmap = kernels.Bitmap(self._bits, self._bands, self.grid.shape[1])

        def work(a: int, b: int) -> None:
            kernels.shorten_to_cells(rows[a:b], frame, resolution, cones, bitmap, *(part[a:b] for part in found))

        run_in_blocks(work, len(rows), work_per_row=finder.n_beams * RAYS_PER_CONE)

    def _points_on_edges(self, poses: FloatArray, finder: RangeFinder) -> tuple[FloatArray, FloatArray, IntArray]:
        """Return ranges (n, k), points (n, k, 2) in cells and their cells, of the edge of each cone that ends first."""
        k, n_edges = finder.n_beams, 1 if finder.opening_angle == 0.0 else 2
        edges = finder if n_edges == 1 else _edges(finder)
        lengths = self._rays.expected_ranges(poses, edges).reshape(-1, n_edges, k)
        hits = self._rays.expected_hits(poses, edges).reshape(-1, n_edges, k, 2)
        rays = compose(poses[:, None, None], edges.mounts.reshape(n_edges, k, 3))
        shorter = lengths.argmin(axis=1)[:, None, :]
        ranges = np.take_along_axis(lengths, shorter, axis=1)[:, 0]
        cells = np.take_along_axis(hits, shorter[..., None], axis=1)[:, 0]
        rays = np.take_along_axis(rays, shorter[..., None], axis=1)[:, 0]
        ends = transform_points(rays, np.stack([ranges, np.zeros_like(ranges)], axis=-1))
        return ranges, self.grid.to_cells(ends), cells

    def cast(self, origins: ArrayLike, opening_angle: float, max_range: float) -> FloatArray:
        """Return the range of single cones.

        Parameters
        ----------
        origins
            (..., 3) apex and axis of each cone in the map frame, metres and radians.
        opening_angle
            Full width of the cones, in [0, pi) radians.
        max_range
            Longest range in metres.

        Returns
        -------
        (...) metres in [0, max_range].

        Raises
        ------
        InvalidInputError
            If the origins are not finite (..., 3), or an option is out of its range.
        """
        finder = RangeFinder(np.zeros((1, 3)), max_range, opening_angle=opening_angle)
        return np.asarray(self.expected_ranges(as_poses(origins, "origins"), finder)[..., 0])


@checked
def make_caster(
    grid: OccupancyGrid, finder: RangeFinder, *, unknown: Literal["free", "occupied"] = "free"
) -> RayCaster | ConeCaster:
    """Return what finds the expected ranges of a sensor: cones if it has an opening angle, else rays."""
    return RayCaster(grid, unknown=unknown) if finder.opening_angle == 0.0 else ConeCaster(grid, unknown=unknown)


def _edges(finder: RangeFinder) -> RangeFinder:
    """Return a finder with 2 k beams: the right edges of all cones, then the left ones."""
    half = np.array([0.0, 0.0, finder.opening_angle / 2.0])
    return replace(finder, mounts=np.concatenate([finder.mounts - half, finder.mounts + half]), opening_angle=0.0)


def _cones(finder: RangeFinder, resolution: float) -> kernels.Cones:
    """Return the cones as the kernel wants them."""
    x, y, theta = finder.mounts.T
    right, left = theta - finder.opening_angle / 2.0, theta + finder.opening_angle / 2.0
    return kernels.Cones(x / resolution, y / resolution, np.cos(right), np.sin(right), np.cos(left), np.sin(left))
