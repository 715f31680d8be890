"""Compare the time and memory of the distance to the nearest obstacle with SciPy's and OpenCV's transforms.

Whole calls from the map, in turn, so that other programs on the machine slow all of them down; the median of the
ratios. On one thread the processor's time is compared, on two the time that passes. OpenCV is compared only if it is
installed, and is spared the step from cells to metres.

Run: python benchmarks/distance.py [CELLS ...]
"""

from __future__ import annotations

import sys
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

import numpy as np
from scipy import ndimage

from beam_model import office
from beamfield.kernels.threads import set_threads
from beamfield.maps.distance import distance_to_obstacles
from beamfield.maps.occupancy import OccupancyGrid
from tables import print_table

try:
    import cv2
except ImportError:
    cv2 = None

RESOLUTION = 0.05
CELLS = (10**5, 10**6, 10**7, 10**8)
# SciPy needs some 40 bytes a cell.
MOST_CELLS_FOR_SCIPY = 10**7
SECONDS_PER_COMPARISON = 2.0

Call = Callable[[], np.ndarray]


def main() -> None:
    """Print the rows as a Markdown table."""
    sizes = [int(float(text)) for text in sys.argv[1:]] or CELLS
    rows = [row(name, occupied) for n_cells in sizes for name, occupied in maps(n_cells)]
    print_table(rows, columns=list(max(rows, key=len)))


def maps(n_cells: int) -> Iterator[tuple[str, np.ndarray]]:
    """Yield square maps of about so many cells."""
    rng = np.random.default_rng(7)
    side = round(n_cells**0.5)
    empty = np.zeros((side, side), np.bool_)
    tiles = -(-side // 1000)
    yield "rooms with doors and furniture", np.tile(office(rng).occupied, (tiles, tiles))[:side, :side]
    yield "walls every 100 and 137 cells", framed(empty, 100, 137)
    yield "halls of 700 x 900 cells", framed(empty, 700, 900)
    yield "empty room", framed(empty, side - 1, side - 1)
    yield "clutter, 10%", rng.random(empty.shape, np.float32) < 0.1
    yield "clutter, 50%", rng.random(empty.shape, np.float32) < 0.5
    yield "clutter, 0.1%", rng.random(empty.shape, np.float32) < 0.001
    few = empty.copy()
    few.flat[rng.integers(0, few.size, 10)] = True
    yield "ten obstacles", few
    alone = empty.copy()
    alone[side // 2, side // 2] = True
    yield "one obstacle", alone


def framed(empty: np.ndarray, every_row: int, every_col: int) -> np.ndarray:
    """Return a map with walls."""
    occupied = empty.copy()
    occupied[::every_row] = occupied[:, ::every_col] = True
    return occupied


def row(name: str, occupied: np.ndarray) -> dict[str, Any]:
    """Return one line of the table, checked: every cell has SciPy's distance."""
    grid = OccupancyGrid(occupied.astype(np.float32), RESOLUTION)
    ours = partial(distance_to_obstacles, grid)
    result: dict[str, Any] = {"map": name, "cells": f"{occupied.size:.0e}".replace("e+0", "e")}
    result["bytes per cell besides the result"] = f"{peak_bytes(ours) / occupied.size - 4:.1f}"
    with limited(1):
        cut_off = partial(distance_to_obstacles, grid, max_distance=2.0)
        result["max_distance 2 m / none"] = f"{median_ratio(cut_off, ours, 1):.2f}"
    for threads in (1, 2) if cv2 is not None else ():
        with limited(threads):
            ratio = median_ratio(ours, lambda: by_opencv(grid), threads)
        result[f"ours / OpenCV, {threads} thread{'s'[: threads - 1]}"] = f"{ratio:.2f}"
    if occupied.size <= 1.1 * MOST_CELLS_FOR_SCIPY:
        expected = by_scipy(grid).astype(np.float32)
        assert np.array_equal(ours(), expected), f"{name}: not SciPy's distances"
        with limited(1):
            ratio = median_ratio(ours, lambda: by_scipy(grid), 1)
        result["ours / SciPy, 1 thread"] = f"{ratio:.2f}"
    return result


def by_opencv(grid: OccupancyGrid) -> np.ndarray:
    """Return the distances in cells, almost exact."""
    return cv2.distanceTransform((~grid.occupied).view(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)


def by_scipy(grid: OccupancyGrid) -> np.ndarray:
    """Return the distances in metres."""
    return ndimage.distance_transform_edt(~grid.occupied) * RESOLUTION


def median_ratio(ours: Call, other: Call, threads: int) -> float:
    """Return the median of the ratios of times, called in turn; the first calls load and compile."""
    clock = time.process_time if threads == 1 else time.perf_counter
    ours(), other()
    ratios: list[float] = []
    end = time.monotonic() + SECONDS_PER_COMPARISON
    while len(ratios) < 5 or (time.monotonic() < end and len(ratios) < 200):
        start = clock()
        ours()
        middle = clock()
        other()
        ratios.append((middle - start) / (clock() - middle))
    return float(np.median(ratios))


@contextmanager
def limited(threads: int) -> Iterator[None]:
    """Keep beamfield and OpenCV to so many threads."""
    if cv2 is not None:
        cv2.setNumThreads(threads)
    with set_threads(threads):
        yield


def peak_bytes(call: Call) -> int:
    """Return the most memory that a call has in use at a time, its result included."""
    call()
    tracemalloc.start()
    call()
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    return peak


if __name__ == "__main__":
    main()
