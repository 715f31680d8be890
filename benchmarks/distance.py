"""Time the distance to the nearest obstacle on maps up to 10,813 x 6,743 cells, beside SciPy's transform.

Run: python benchmarks/distance.py
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from scipy import ndimage

from beam_model import office
from beamfield.maps.distance import distance_to_obstacles
from beamfield.maps.occupancy import OccupancyGrid
from tables import print_table

# The largest is a warehouse that users of AMCL wait 13 s for (nav2, issue 4941).
SHAPES = ((1000, 1000), (4000, 4000), (6743, 10813))


def run() -> list[dict[str, Any]]:
    """Return one row per map: cells, seconds, seconds by SciPy."""
    rng = np.random.default_rng(7)
    rooms = office(rng).occupied
    rows = []
    for n_rows, n_cols in SHAPES:
        tiles = -(-n_rows // 1000), -(-n_cols // 1000)
        occupied = np.tile(rooms, tiles)[:n_rows, :n_cols]
        rows.append(row("rooms", occupied))
    alone = np.zeros(SHAPES[-1], np.bool_)
    alone[0, 0] = True
    rows.append(row("one obstacle", alone))
    return rows


def row(what: str, occupied: np.ndarray) -> dict[str, Any]:
    """Return one line of the table, checked: both give the same distances."""
    grid = OccupancyGrid(occupied.astype(np.float32), 0.05)
    seconds, distance = least(lambda: distance_to_obstacles(grid))
    seconds_scipy, expected = least(lambda: ndimage.distance_transform_edt(~occupied), repeats=1)
    assert np.allclose(distance, 0.05 * expected, rtol=2**-22, atol=0.0)
    return {
        "map": what,
        "rows x columns": f"{occupied.shape[0]} x {occupied.shape[1]}",
        "seconds": round(seconds, 3),
        "seconds, SciPy": round(seconds_scipy, 3),
    }


def least(call: Callable[[], np.ndarray], repeats: int = 5) -> tuple[float, np.ndarray]:
    """Return the least time of a call, the first one apart because it loads the library, and the result."""
    result = call()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        call()
        times.append(time.perf_counter() - start)
    return min(times), result


def main() -> None:
    """Print the rows as a Markdown table."""
    print_table(run())


if __name__ == "__main__":
    main()
