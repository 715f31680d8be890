"""Ray casting beside plain cell traversal, in one process: `python benchmarks/raycast.py` prints the table.

The map is a building of our own making, 1200 x 1200 cells at 5 cm; rays are 10 m at most. The baseline is the
incremental traversal as the textbooks give it (Amanatides and Woo, 1987), cell by cell, compiled by Numba with the same
flags. A second one is tuned by hand: linear cell index, a frame of occupied cells instead of bounds checks, the fan's
directions rotated instead of one cosine per beam, in float32 and in float64, the faster of which counts. The limit of
the processor is limit.cpp: fans over the same tables by hand, without their guarantees. All figures are medians of the
thread's processor time in runs in which the methods take turns, so that a busy machine slows all of them alike.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from beamfield.kernels.jit import kernel
from beamfield.kernels.threads import set_threads
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder

if __package__:
    from benchmarks import limit
    from benchmarks.measure import Call, take_turns
    from benchmarks.tables import print_table
else:
    import limit
    from measure import Call, take_turns
    from tables import print_table

RESOLUTION = 0.05
MAX_RANGE = 10.0
N_BEAMS = 60
FIELD_OF_VIEW = np.radians(270.0)
# A run takes tens of milliseconds: long enough that starting threads and filling caches do not count.
N_RAYS = 2_400_000


def run(repeats: int = 7) -> list[dict[str, Any]]:
    """Measure; one dictionary per row of the table.

    Parameters
    ----------
    repeats
        Runs of each method; the median counts.
    """
    rng = np.random.default_rng(1)
    occupied = building(rng)
    grid = OccupancyGrid(occupied.astype(np.float32), RESOLUTION)
    caster = RayCaster(grid)
    finder = RangeFinder.from_bearings(np.linspace(-FIELD_OF_VIEW / 2, FIELD_OF_VIEW / 2, N_BEAMS), MAX_RANGE)
    single = RangeFinder.from_bearings([0.0], MAX_RANGE)
    rows = []
    for name, poses in cases(occupied, rng).items():
        if name == "random":
            sensor = single
            cast: Call = partial(caster.cast, poses, MAX_RANGE)
        else:
            sensor = finder
            cast = partial(caster.expected_ranges, poses, finder)
        calls = {"ours": cast}
        calls["plain"] = textbook(occupied, poses, sensor)
        calls["plain32"] = plain(occupied, poses, sensor, np.float32)
        calls["plain64"] = plain(occupied, poses, sensor, np.float64)
        by_hand = limit.cast(caster, poses, finder) if sensor is finder else None
        if by_hand is not None:
            calls["limit"] = by_hand
        seconds = medians(calls, repeats)
        ns = {key: value / (len(poses) * sensor.n_beams) * 1e9 for key, value in seconds.items()}
        tuned = min(ns["plain32"], ns["plain64"])
        error = np.abs(np.asarray(calls["ours"]()).ravel() - np.asarray(calls["plain64"]()).ravel() * RESOLUTION)
        rows.append(
            {
                "case": name,
                "plain [ns/ray]": ns["plain"],
                "plain, tuned [ns/ray]": tuned,
                "RayCaster [ns/ray]": ns["ours"],
                "times plain": ns["plain"] / ns["ours"],
                "times tuned": tuned / ns["ours"],
                "of the limit": limit.ratio(ns["ours"], ns.get("limit")) if sensor is finder else "",
                "share off by > 1e-9 m": float(np.mean(error > 1e-9)),
            }
        )
    builds = medians(
        {"tables": lambda: RayCaster(grid), "transform": lambda: distance_transform_edt(~occupied)}, repeats
    )
    rows.append(
        {
            "case": "build",
            "RayCaster [ms]": builds["tables"] * 1e3,
            "scipy distance_transform_edt [ms]": builds["transform"] * 1e3,
            "ratio": builds["transform"] / builds["tables"],
            "tables [MB]": caster.table_bytes / 1e6,
        }
    )
    return rows


def main() -> None:
    """Print the table in Markdown."""
    rows = run()
    for block in ([r for r in rows if r["case"] != "build"], [r for r in rows if r["case"] == "build"]):
        print_table(block, digits=3)
        print()


def building(rng: np.random.Generator, size: int = 1200) -> NDArray[np.bool_]:
    """Return the occupied cells of an office floor: corridors, rooms with doors, furniture, clutter."""
    occupied = np.zeros((size, size), bool)
    corridor, wall = 44, 3
    bands = np.linspace(0, size, 5).astype(int)
    for low, high in pairwise(bands):
        # Every band: a corridor along x with rooms of random width on both sides of it.
        middle = (low + high) // 2
        for side, (near, far) in enumerate(((middle - corridor // 2, low), (middle + corridor // 2, high))):
            bottom, top = (far, near) if side == 0 else (near, far)
            occupied[near - (wall if side == 0 else 0) : near + (0 if side == 0 else wall)] = True
            occupied[max(far - 2, 0) : far + 2] = True
            left = 0
            while left < size:
                width = int(rng.integers(70, 180))
                occupied[bottom:top, left : left + wall] = True
                right = min(left + width, size)
                if right - left > 40:
                    door = int(rng.integers(left + 8, right - 28))
                    occupied[near - wall : near + wall, door : door + 20] = False
                    _furnish(occupied[bottom + 4 : top - 4, left + 4 : right - 2], rng)
                left += width
    for cross in (size // 3, 2 * size // 3):
        occupied[4 : size - 4, cross : cross + corridor] = False
    clutter = rng.integers(0, size, (700, 2))
    occupied[clutter[:, 0], clutter[:, 1]] = True
    occupied[:3], occupied[-3:], occupied[:, :3], occupied[:, -3:] = True, True, True, True
    return occupied


def _furnish(room: NDArray[np.bool_], rng: np.random.Generator) -> None:
    """Put shelves along a wall, and tables and chairs (seen as their legs) into a room, in place."""
    height, width = room.shape
    if height < 40 or width < 40:
        return
    shelf = int(rng.integers(10, height - 10))
    room[height - shelf :, :8] = True
    for _ in range(int(rng.integers(1, 5))):
        row, col = int(rng.integers(10, height - 30)), int(rng.integers(12, width - 26))
        for a, b in ((0, 0), (0, 22), (14, 0), (14, 22)):
            room[row + a : row + a + 2, col + b : col + b + 2] = True
    for row, col in zip(rng.integers(6, height - 8, 4), rng.integers(12, width - 8, 4), strict=True):
        room[row : row + 5, col : col + 5] |= rng.random((5, 5)) < 0.4


def cases(occupied: NDArray[np.bool_], rng: np.random.Generator) -> dict[str, NDArray[np.float64]]:
    """Return poses (n, 3) in metres: around 10 places, over all free space, and one per ray."""
    free = np.argwhere(~occupied)

    def anywhere(n: int) -> NDArray[np.float64]:
        cells = free[rng.integers(0, len(free), n)]
        xy = (cells[:, ::-1] + rng.random((n, 2))) * RESOLUTION
        return np.column_stack([xy, rng.uniform(-np.pi, np.pi, n)])

    n = N_RAYS // N_BEAMS
    clear = distance_transform_edt(~occupied)
    places = []
    while len(places) < 10:
        place = anywhere(1)[0]
        col, row = (place[:2] / RESOLUTION).astype(int)
        if clear[row, col] > 8:
            places.append(place)
    clustered = np.repeat(places, n // 10, axis=0) + rng.normal(0, [0.1, 0.1, 0.1], (n, 3))
    return {"clustered": clustered, "spread": anywhere(n), "random": anywhere(N_RAYS)}


def medians(calls: dict[str, Call], rounds: int) -> dict[str, float]:
    """Return the median processor seconds of each call."""
    return {name: float(np.median(seconds)) for name, seconds in take_turns(calls, rounds).items()}


def textbook(
    occupied: NDArray[np.bool_], poses: NDArray[np.float64], finder: RangeFinder
) -> Callable[[], NDArray[np.float64]]:
    """Return a call of the plain traversal on poses in metres; it gives ranges in cells."""
    out = np.empty((len(poses), finder.n_beams))
    bearings = np.array(finder.bearings)

    def call() -> NDArray[np.float64]:
        textbook_traversal(poses, bearings, occupied, 1.0 / RESOLUTION, MAX_RANGE / RESOLUTION, out)
        return out

    return call


@kernel
def textbook_traversal(poses, bearings, occupied, cells_per_metre, max_cells, out):
    """Step from cell to cell until one is occupied."""
    rows, cols = occupied.shape
    for n in range(poses.shape[0]):
        x, y = poses[n, 0] * cells_per_metre, poses[n, 1] * cells_per_metre
        for k in range(bearings.shape[0]):
            dx, dy = np.cos(poses[n, 2] + bearings[k]), np.sin(poses[n, 2] + bearings[k])
            col, row = int(np.floor(x)), int(np.floor(y))
            step_col, step_row = 1 if dx > 0.0 else -1, 1 if dy > 0.0 else -1
            t_col = (col + (1 if dx > 0.0 else 0) - x) / dx
            t_row = (row + (1 if dy > 0.0 else 0) - y) / dy
            per_col, per_row = abs(1.0 / dx), abs(1.0 / dy)
            t = 0.0
            while t < max_cells:
                if row < 0 or col < 0 or row >= rows or col >= cols:
                    t = max_cells
                    break
                if occupied[row, col]:
                    break
                if t_col < t_row:
                    t = t_col
                    t_col += per_col
                    col += step_col
                else:
                    t = t_row
                    t_row += per_row
                    row += step_row
            out[n, k] = min(t, max_cells)


def plain(
    occupied: NDArray[np.bool_], poses: NDArray[np.float64], finder: RangeFinder, dtype: type
) -> Callable[[], NDArray[Any]]:
    """Return a call of the baseline on poses in metres; it gives ranges in cells."""
    framed = np.ones((occupied.shape[0] + 2, occupied.shape[1] + 2), np.uint8)
    framed[1:-1, 1:-1] = occupied
    fan = finder.mounts[:, 2]
    fan_c, fan_s = np.cos(fan).astype(dtype), np.sin(fan).astype(dtype)
    out = np.empty((len(poses), len(fan)), dtype)

    def call() -> NDArray[Any]:
        xy = (poses[:, :2] / RESOLUTION + 1.0).astype(dtype)
        c, s = np.cos(poses[:, 2]).astype(dtype), np.sin(poses[:, 2]).astype(dtype)
        plain_traversal(xy, c, s, fan_c, fan_s, framed, dtype(MAX_RANGE / RESOLUTION), out)
        return out

    return call


@kernel
def plain_traversal(xy, pose_c, pose_s, fan_c, fan_s, framed, max_cells, out):
    """Step from cell to cell until one is occupied."""
    width = framed.shape[1]
    flat = framed.reshape(-1)
    zero = max_cells - max_cells
    one = max_cells / max_cells
    for n in range(xy.shape[0]):
        x, y = xy[n, 0], xy[n, 1]
        col, row = np.int64(x), np.int64(y)
        start = row * width + col
        fx, fy = x - np.floor(x), y - np.floor(y)
        for k in range(fan_c.shape[0]):
            c = pose_c[n] * fan_c[k] - pose_s[n] * fan_s[k]
            s = pose_s[n] * fan_c[k] + pose_c[n] * fan_s[k]
            per_col, per_row = abs(one / c), abs(one / s)
            t_col = (one - fx if c > zero else fx) * per_col
            t_row = (one - fy if s > zero else fy) * per_row
            step_col = 1 if c > zero else -1
            step_row = width if s > zero else -width
            cell = start
            t = zero
            while flat[cell] == 0 and t < max_cells:
                if t_col < t_row:
                    t = t_col
                    t_col += per_col
                    cell += step_col
                else:
                    t = t_row
                    t_row += per_row
                    cell += step_row
            out[n, k] = min(t, max_cells)


if __name__ == "__main__":
    set_threads(1)
    main()
