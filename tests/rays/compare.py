"""Compare the caster with the exact traversal, and tell rounding from faults."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder
from tests.rays.adversarial import random_fan, random_grid, random_limit, random_rays
from tests.reference.exact_rays import trace_rays

ULP = 2.0**-52
PER_GRID = 5_000
PER_TASK = 500_000
BEAMS = 50
# How many rays beside one are tried until one explains its answer. Where two crossings nearly meet, a corner is one in
# 10,000.
TRIES = (200, 2_000, 20_000, 200_000, 1_000_000)


@dataclass
class Tally:
    """What came out.

    `by_rounding` counts rays whose path is decided within float64's rounding of the start or of the heading: one of the
    exact rays within that rounding has the caster's answer. `worst` is the largest error of a range in units of
    its bound; `worst_cells` in cells, of rays inclined by more than 0.001 to both axes.
    """

    rays: int = 0
    grids: int = 0
    by_rounding: int = 0
    cells: int = 0
    worst: float = 0.0
    worst_cells: float = 0.0
    faults: list[str] = field(default_factory=list)


def run(seed: int, part: int) -> Tally:
    """Return what comes out of one part; the same seed and part give the same rays.

    Here and not in `__main__`, which processes that are not forked, as from Python 3.14 on, cannot import.
    """
    rng, tally = np.random.default_rng([seed, part]), Tally()
    while tally.rays < PER_TASK:
        compare(rng, PER_GRID, tally)
    return tally


def compare(rng: np.random.Generator, n: int, tally: Tally) -> None:
    """Cast n adversarial rays in a random map, both ways, and add what came out to the tally."""
    grid = random_grid(rng)
    rays, limit, caster = random_rays(rng, grid, n), random_limit(rng, grid), RayCaster(grid)
    if rng.random() < 0.5:
        ranges, hits = caster.cast(rays, limit), caster.cast_hits(rays, limit)
        rays = np.column_stack([rays, np.zeros((n, 6))])
    else:
        finder = RangeFinder(random_fan(rng, BEAMS), limit)
        poses = rays[: n // BEAMS]
        ranges = caster.expected_ranges(poses, finder).ravel()
        hits = caster.expected_hits(poses, finder).reshape(-1, 2)
        mounts = np.tile(finder.mounts, (len(poses), 1))
        rays = np.column_stack([np.repeat(poses, BEAMS, axis=0), mounts, np.zeros_like(mounts)])
    wanted, cells, edges, speeds = exact(rays, grid, limit)
    error, bound = np.abs(ranges - wanted), error_bound(rays, grid, wanted, edges, speeds)
    # At a corner between two occupied cells either may be named; an obstacle within the bound of max_range may be seen.
    at_limit = limit - np.minimum(ranges, wanted) <= bound
    other_cell = (hits != cells).any(axis=1) & (edges != 4) & ~at_limit
    wrong = (error > bound) | other_cell
    right = ~wrong
    tally.rays += len(rays)
    tally.grids += 1
    tally.cells += int((right & (cells[:, 0] >= 0)).sum())
    if right.any():
        tally.worst = max(tally.worst, float(np.max(error[right] / np.maximum(bound[right], 1e-300))))
        inclined = right & (speeds > 1e-3).all(axis=1) & (edges < 3)
        tally.worst_cells = max(tally.worst_cells, float(error[inclined].max(initial=0.0) / grid.resolution))
    for i in np.flatnonzero(wrong):
        if _is_rounding(rays[i], grid, limit, float(ranges[i]), hits[i]):
            tally.by_rounding += 1
        else:
            tally.faults.append(
                f"ray {rays[i, :6].tolist()} in {grid.shape} at {grid.resolution!r}, origin {grid.origin.tolist()}, "
                f"max_range {limit!r}: cast {ranges[i]!r} {hits[i].tolist()}, exact {wanted[i]!r} {cells[i].tolist()}"
            )


def exact(rays: np.ndarray, grid: OccupancyGrid, limit: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return ranges, cells, edges and speeds of the exact traversal."""
    n = len(rays)
    ranges, cells, edges, speeds = np.empty(n), np.empty((n, 2), np.int64), np.empty(n, np.int64), np.empty((n, 2))
    trace_rays(rays, grid.occupied, np.array(grid.origin), grid.resolution, limit, ranges, cells, edges, speeds)
    return ranges, cells, edges, speeds


def error_bound(
    rays: np.ndarray, grid: OccupancyGrid, ranges: np.ndarray, edges: np.ndarray, speeds: np.ndarray
) -> np.ndarray:
    """Return what rounding in float64 may change of each range, in metres.

    The start moves by a few units in the last place of its coordinates, of the map's origin and of what lies between,
    the heading by those of itself. Both count along the ray as far as it is inclined to the edge that it crossed.
    """
    start, angle = rounding(rays, grid)
    speed = np.where(edges == 1, speeds[:, 0], np.where(edges == 2, speeds[:, 1], speeds.max(axis=1)))
    # A corner is taken at the later of two crossings that are within 1e-9 cells of each other.
    either = np.where(edges >= 3, 1e-9 * grid.resolution, 0.0)
    return (start + angle * ranges) / np.maximum(speed, 1e-12) + 8 * ULP * ranges + either


def rounding(rays: np.ndarray, grid: OccupancyGrid) -> tuple[np.ndarray, np.ndarray]:
    """Return how far a start (metres) and a heading (radians) may move by rounding in float64."""
    x, y, yaw = np.abs(grid.origin).tolist()
    span = np.abs(rays[:, :2] - [grid.origin[0], grid.origin[1]]).sum(axis=1)
    mount = np.abs(rays[:, 3:5]).sum(axis=1)
    angle = 4 * ULP * (1.0 + np.abs(rays[:, 2]) + yaw)
    # The caster keeps a cell and the offset in it: that rounds by an ulp of a cell.
    return 4 * ULP * (span + x + y + mount + grid.resolution) + angle * mount, angle


def _is_rounding(ray: np.ndarray, grid: OccupancyGrid, limit: float, cast: float, hit: np.ndarray) -> bool:
    """Return whether an exact ray within the rounding of this one has the caster's answer."""
    start, angle = (float(v[0]) for v in rounding(ray[None], grid))
    rng = np.random.default_rng(0)
    for n in TRIES:
        steps = rng.choice([-1.0, 1.0], (n, 3)) * 10 ** rng.uniform(-5, 0, (n, 3))
        moved = np.tile(ray, (len(steps), 1))
        moved[:, 6:] = steps * [start, start, angle]
        ranges, cells, edges, speeds = exact(moved, grid, limit)
        near = np.abs(ranges - cast) <= error_bound(moved, grid, ranges, edges, speeds)
        if (near & ((cells == hit).all(axis=1) | (edges == 4) | (limit - ranges <= 1e-9 * limit))).any():
            return True
    return False
