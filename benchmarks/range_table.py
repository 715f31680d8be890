"""Pre-cached ranges (6.3.4) beside exact and plain casting, in one process: ``python benchmarks/range_table.py``.

Map, poses and the plain traversal are those of `benchmarks/raycast.py`. Times are CPU time of the one thread that
works, the least of runs in which the methods take turns, so that other programs count as little as possible.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.kernels.threads import set_threads
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.range_table import RangeTable
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, Scan

if __package__:
    from benchmarks.measure import Call, take_turns
    from benchmarks.raycast import FIELD_OF_VIEW, MAX_RANGE, N_BEAMS, RESOLUTION, building, cases, textbook
    from benchmarks.tables import print_table
else:
    from measure import Call, take_turns
    from raycast import FIELD_OF_VIEW, MAX_RANGE, N_BEAMS, RESOLUTION, building, cases, textbook
    from tables import print_table

# Side of the squares in metres, and headings.
TABLES = ((0.3, 90), (0.15, 180), (0.1, 360))
PARAMETERS = BeamParameters(z_hit=0.8, z_short=0.08, z_max=0.02, z_rand=0.1, sigma_hit=0.1, lambda_short=0.4)


def run(repeats: int = 7) -> tuple[list[dict[str, Any]], list[dict[str, Any]]]:
    """Return rows on speed and rows on tables.

    Parameters
    ----------
    repeats
        Runs of each method; the least time counts.
    """
    rng = np.random.default_rng(1)
    occupied = building(rng)
    grid = OccupancyGrid(occupied.astype(np.float32), RESOLUTION)
    caster = RayCaster(grid)
    tables, about = {}, []
    for resolution, headings in TABLES:
        began = time.thread_time()
        table = RangeTable.build(grid, max_range=MAX_RANGE, resolution=resolution, headings=headings)
        seconds, name, error = time.thread_time() - began, f"{resolution:g} m, {360 / headings:g} deg", table.error
        tables[name] = table
        about.append(
            {
                "table": name,
                "MB": round(table.table_bytes / 1e6, 1),
                "build [s]": round(seconds, 2),
                "error, median [m]": round(error.median, 4),
                "95% [m]": round(error.percentile_95, 3),
                "99% [m]": round(error.percentile_99, 2),
                "largest [m]": round(error.largest, 2),
                "off by > a cell": f"{error.share_off_by_a_cell:.1%}",
            }
        )
    fan = RangeFinder.from_bearings(np.linspace(-FIELD_OF_VIEW / 2, FIELD_OF_VIEW / 2, N_BEAMS), MAX_RANGE)
    ahead = RangeFinder.from_bearings([0.0], MAX_RANGE)
    rows = []
    for pattern, poses in cases(occupied, rng).items():
        finder = ahead if pattern == "random" else fan
        calls: dict[str, Call] = {"plain": textbook(occupied, poses, finder)}
        for name, source in {"exact": caster, **tables}.items():
            calls[name] = casting(source, poses, finder)
        rows.append({"what": f"casting, {pattern}", **nanoseconds(calls, len(poses) * finder.n_beams, repeats)})
        if finder is fan:
            scan = Scan(caster.expected_ranges(poses[0], fan), fan)
            models = {"exact": BeamModel(grid, PARAMETERS, caster=caster)}
            models |= {name: BeamModel(grid, PARAMETERS, caster=table) for name, table in tables.items()}
            calls = {name: lambda m=m, z=scan, p=poses: m.log_likelihood(z, p) for name, m in models.items()}  # type: ignore[misc]
            rows.append({"what": f"beam model, {pattern}", **nanoseconds(calls, poses.shape[0] * N_BEAMS, repeats)})
    return rows, about


def casting(source: RayCaster | RangeTable, poses: FloatArray, finder: RangeFinder) -> Callable[[], object]:
    """Return the call that casts the beams of a finder at all poses, or single rays."""
    if finder.n_beams == 1:
        return lambda: source.cast(poses, finder.max_range)
    return lambda: source.expected_ranges(poses, finder)


def nanoseconds(calls: dict[str, Call], n: int, rounds: int) -> dict[str, float]:
    """Return the least nanoseconds per ray of each call."""
    return {name: round(float(seconds.min()) / n * 1e9, 1) for name, seconds in take_turns(calls, rounds).items()}


def main() -> None:
    """Print the rows as Markdown tables."""
    # Compile what builds and reads a table.
    RangeTable.build(OccupancyGrid(np.zeros((9, 9)), 0.1))
    speed, about = run()
    print_table(speed, columns=["what", "plain", "exact", *(row["table"] for row in about)])
    print()
    print_table(about)


if __name__ == "__main__":
    set_threads(1)
    main()
