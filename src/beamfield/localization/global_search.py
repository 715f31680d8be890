"""Finding the best pose of a scan in a large window, with a guarantee."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, check_magnitude, checked, keep
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses, transform_points
from beamfield.kernels import global_search as kernels
from beamfield.kernels.threads import run_in_blocks
from beamfield.localization.search_window import SNAP, SearchLattice, SearchWindow
from beamfield.maps.distance import distance_to_obstacles
from beamfield.maps.end_points import hit_points
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import Scan
from beamfield.short_repr import short_repr

# Field values are stored as whole multiples of 1 / STEPS.
STEPS = 255
# Blocks in the first round of the search; each round has twice as many.
FIRST_ROUND = 16


class Candidate(NamedTuple):
    """A pose (3,), metres and radians, and its score in [0, 1]."""

    pose: FloatArray
    score: float


class SearchResult(NamedTuple):
    """What a search found.

    Parameters
    ----------
    best
        The candidate with the highest score. If none has a score above 0: the centre of the window, with score 0.
    runner_up
        The best candidate outside the neighbourhood of the best one: if its score comes close, the scan fits two
        places. None if none outside has a score above 0.
    found
        Whether any candidate has a score above 0; it does not if the window lies off the map, the map has no obstacle
        near it, or the scan has no hit.
    n_points
        Points that were scored: end points of the scan's hits, or occupied cells of the local map.
    n_candidates
        Poses in the window.
    n_scored
        Poses and blocks of poses whose score was computed, for both results.
    """

    best: Candidate
    runner_up: Candidate | None
    found: bool
    n_points: int
    n_candidates: int
    n_scored: int

    def summary(self) -> str:
        """Return the best pose and its runner-up with their scores, in up to two lines."""
        if not self.found:
            return "no pose in the window has an end point near an obstacle"
        places = {"best": self.best, "runner-up": self.runner_up}
        lines = []
        for name, place in places.items():
            if place is not None:
                x, y, theta = place.pose
                lines.append(f"{name:<9} {x:.3f} m, {y:.3f} m, {np.degrees(theta):.2f} deg, score {place.score:.3f}")
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class GlobalSearch:
    """Finds the best pose of a scan or local map in a window, as surely as trying every pose, and much faster.

    The score of a pose is the mean, over the end points of the scan's hits, of the field exp(-d^2 / (2 sigma^2)) in the
    cell where the end point falls, with d the distance of the cell's centre to that of the nearest occupied cell; 0 off
    the map. It is the hit term of a likelihood field (6.33), averaged instead of multiplied, so that one wrong reading
    costs one share and a bound exists. Free space and missing returns do not count: judge the results with a full model
    where that matters.

    Candidates are the poses centre + (i s, j s) along the grid's axes with s the resolution, at headings centre + k
    times the step. Blocks of candidates are bounded from a pyramid of maxima and searched best first; a block is left
    out only if no candidate in it can beat the best one known. So the result is the best of all candidates, for the
    field rounded to multiples of 1/255; of equal ones the first by heading, row and column.

    Parameters
    ----------
    grid
        The map.
    sigma
        Width of the field in metres. At half a step of the heading, far end points should still lie within it:
        10 m x 0.5 degrees are 0.09 m.
    angle_step
        Step of the heading in radians; made a little smaller where all headings are searched and it does not divide
        2 pi.

    Raises
    ------
    InvalidInputError
        If sigma or the step is not positive and finite, or sigma is longer than the map: all poses would score alike.

    References
    ----------
    Olson, "Real-time correlative scan matching" (2009); Hess, Kohler, Rapp and Andor, "Real-time loop closure in 2D
    LIDAR SLAM" (2016), for branch and bound on a pyramid of maxima. Probabilistic Robotics, 6.4 and 6.5.

    Examples
    --------
    >>> from beamfield.sensors import RangeFinder
    >>> walls = np.zeros((60, 80))
    >>> walls[[0, -1]] = walls[:, [0, -1]] = walls[20, :30] = 100
    >>> grid = OccupancyGrid.from_ros(walls, resolution=0.1)
    >>> from beamfield.maps.raycast import RayCaster
    >>> finder = RangeFinder.from_bearings(np.linspace(-2, 2, 90), max_range=10.0)
    >>> z = RayCaster(grid).expected_ranges([2.0, 4.0, 1.0], finder)
    >>> found = GlobalSearch(grid).search(Scan(z, finder), SearchWindow([4.0, 3.0, 0.0], 8.0, 6.0))
    >>> found.best.pose.round(1).tolist()
    [2.0, 4.0, 1.0]
    """

    grid: OccupancyGrid
    sigma: float = field(default=0.1, kw_only=True)
    angle_step: float = field(default=float(np.radians(1.0)), kw_only=True)
    _field: NDArray[np.uint8] = field(init=False, repr=False)

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("sigma", "angle_step"):
            check_magnitude(name, getattr(self, name))
        longest = max(self.grid.shape) * self.grid.resolution
        if self.sigma > longest:
            raise InvalidInputError(f"sigma: expected at most the map's longer side, {longest:g} m, got {self.sigma}")
        keep(self, _field=_field(self.grid, self.sigma))

    @checked
    def search(
        self, z: Scan | OccupancyGrid, window: SearchWindow, *, apart: tuple[float, float] = (1.0, np.radians(30.0))
    ) -> SearchResult:
        """Find the best pose and the best one elsewhere.

        Parameters
        ----------
        z
            A scan, or a local map in the robot's frame.
        window
            Where to search.
        apart
            The runner-up is farther than this from the best pose: in metres, or in radians of the heading.

        Returns
        -------
        The best pose and the runner-up. Without points, or where no candidate scores more than 0, nothing is found: the
        best pose is then the window's centre with score 0, and there is no runner-up.

        Raises
        ------
        InvalidInputError
            If `apart` is not two numbers >= 0.
        """
        if len(apart) != 2 or not all(0.0 <= value < np.inf for value in apart):
            raise InvalidInputError(f"apart: expected metres and radians >= 0, got {apart}")
        points = _points(z)
        lattice = SearchLattice.of(self.grid, window, self.angle_step)
        if len(points) == 0:
            return SearchResult(Candidate(window.center, 0.0), None, False, 0, lattice.n_candidates, 0)
        problem = self._prepare(points, lattice)
        score, key, n_scored = problem.solve(None)
        n_scored += problem.bounds.size
        if score <= 0:
            return SearchResult(Candidate(window.center, 0.0), None, False, len(points), lattice.n_candidates, n_scored)
        best = Candidate(lattice.pose(key), score / (STEPS * len(points)))
        hole = lattice.neighbourhood(key, *apart)
        score, key, more = problem.solve(hole)
        runner_up = Candidate(lattice.pose(key), score / (STEPS * len(points))) if score > 0 else None
        return SearchResult(best, runner_up, True, len(points), lattice.n_candidates, n_scored + more)

    def score(self, z: Scan | OccupancyGrid, poses: ArrayLike) -> FloatArray:
        """Return the score at any poses, on the lattice or off it.

        Parameters
        ----------
        z
            A scan, or a local map in the robot's frame.
        poses
            (..., 3) robot poses, metres and radians.

        Returns
        -------
        (...) in [0, 1]; 0 for a measurement without points.

        Raises
        ------
        InvalidInputError
            If the poses are not finite (..., 3).
        """
        robots = as_poses(poses)
        points = _points(z)
        if len(points) == 0:
            return np.zeros(robots.shape[:-1])
        cells = self.grid.to_cells(transform_points(robots[..., None, :], points))
        col, row = np.moveaxis(np.floor(cells + SNAP), -1, 0)
        inside = (col >= 0) & (row >= 0) & (col < self.grid.shape[1]) & (row < self.grid.shape[0])
        values = self._field[np.where(inside, row, 0).astype(np.int64), np.where(inside, col, 0).astype(np.int64)]
        return np.asarray(np.where(inside, values, 0).mean(axis=-1, dtype=np.float64) / STEPS)

    def _prepare(self, points: FloatArray, lattice: SearchLattice) -> _Problem:
        """Cut out the part of the field that matters and build its pyramid."""
        lattice.check_size(len(points))
        cells = lattice.first_cells(points)
        low = cells.min(axis=(0, 2))
        high = cells.max(axis=(0, 2)) + np.array([lattice.n_rows - 1, lattice.n_cols - 1])
        low, high = np.clip(low, 0, self.grid.shape), np.clip(high + 1, 0, self.grid.shape)
        part = np.ascontiguousarray(self._field[low[0] : high[0], low[1] : high[1]])
        side = 1 << (lattice.levels - 1)
        # Whole blocks, and one more on each side: what lies off the field is 0.
        tall, wide = (side * (-(-n // side) + 2) for n in part.shape)
        pyramid = np.empty((lattice.levels, tall, wide), np.uint8)
        kernels.fill_pyramid(part, pyramid)
        # Far points are off the field wherever they are.
        relative = np.clip(cells - low[:, None] + side, -(2**30), 2**30).astype(np.int32)
        return _Problem.of(relative, pyramid, lattice)


class _Problem(NamedTuple):
    """One search: points, pyramid, and bounds of the coarsest blocks."""

    points: NDArray[np.int32]
    pyramid: NDArray[np.uint8]
    lattice: SearchLattice
    bounds: NDArray[np.int64]

    @classmethod
    def of(cls, points: NDArray[np.int32], pyramid: NDArray[np.uint8], lattice: SearchLattice) -> _Problem:
        levels, tall, wide = pyramid.shape
        side = 1 << (levels - 1)
        top = pyramid[-1].reshape(tall // side, side, wide // side, side)
        top = np.ascontiguousarray(top.transpose(1, 3, 0, 2))
        shape = len(points), -(-lattice.n_rows // side), -(-lattice.n_cols // side)
        bounds = np.empty(shape, np.int64)
        run_in_blocks(
            lambda a, b: kernels.fill_coarse_bounds(points[a:b], top, bounds[a:b]),
            len(points),
            work_per_row=0.02 * shape[1] * shape[2] * points.shape[2],
        )
        return cls(points, pyramid, lattice, bounds)

    def solve(self, hole: NDArray[np.int64] | None) -> tuple[int, int, int]:
        """Return score and key of the best candidate outside the hole, 0 and -1 if there is none, and the sums taken.

        What it learns about the bounds is kept: call it without a hole first, then with one.
        """
        excluded = np.zeros(4 + len(self.points), np.int64) if hole is None else hole
        flat = self.bounds.reshape(-1)
        # The likeliest block of each heading first: what these hold rules most of the others out.
        per_heading = self.bounds.reshape(len(self.points), -1)
        likely = per_heading.argmax(axis=1) + per_heading.shape[1] * np.arange(len(per_heading))
        found = self._search(likely, excluded, (0, -1, 0))
        return self._search(np.flatnonzero(flat >= max(found[0], 1)), excluded, found)

    def _search(self, blocks: NDArray[np.int64], excluded: NDArray[np.int64], found: tuple[int, int, int]
                ) -> tuple[int, int, int]:  # fmt: skip
        """Return score and key of the best of what was found before and of these blocks, and the sums taken."""
        best, best_key, taken = found
        bounds, n_points = self.bounds.reshape(-1), self.points.shape[2]
        # Bytes, as they are sorted in no time; within one of them, blocks come in any order.
        rank = (STEPS - bounds[blocks] // n_points).astype(np.uint8)
        blocks = blocks[np.argsort(rank, kind="stable")]
        done, size = 0, FIRST_ROUND
        while done < len(blocks) and bounds[blocks[done]] + n_points > best:
            now = blocks[done : done + size]
            out = np.empty((len(now), 3), np.int64)
            run_in_blocks(
                lambda a, b, now=now, out=out, best=best, key=best_key: kernels.search_blocks(  # type: ignore[misc]
                    now[a:b], self.bounds, self.points, self.pyramid, self.lattice.n_rows, self.lattice.n_cols,
                    excluded, best, key, out[a:b],
                ),
                len(now),
                work_per_row=n_points,
            )  # fmt: skip
            taken += int(out[:, 2].sum())
            score = int(out[:, 0].max())
            if score > 0 and score >= best:
                key = int(out[out[:, 0] == score, 1].min())
                best, best_key = score, key if score > best else min(key, best_key)
            done, size = done + size, 2 * size
        return best, best_key, taken


def _field(grid: OccupancyGrid, sigma: float) -> NDArray[np.uint8]:
    """Return (rows, cols) exp(-d^2 / (2 sigma^2)) in steps of 1 / STEPS; all 0 for a map without obstacles."""
    # Beyond 3.5 sigma the field rounds to 0; there, and in a map without obstacles, the distance does not matter.
    distance = distance_to_obstacles(grid, max_distance=4.0 * sigma)
    return np.asarray(np.round(STEPS * np.exp(-0.5 * (distance / sigma) ** 2)).astype(np.uint8))


def _points(z: Scan | OccupancyGrid) -> FloatArray:
    """Return (p, 2) what is scored, in the robot frame: end points of hits, or centres of occupied cells."""
    if isinstance(z, Scan):
        return hit_points(z.ranges, z.finder)
    rows, cols = np.nonzero(z.occupied)
    return z.to_map(np.column_stack([cols, rows]) + 0.5)
