"""Precompute the ranges that beams expect in a map.

Cast rays from every place of a map in all directions and write their ranges as a table, which localize and likelihood
look up with --range-table instead of casting rays: quicker for very many poses, and less exact. A table that is there
already is kept, unless the map or the options have changed.

for example:

  beamfield precompute map.yaml --out map.ranges
  beamfield precompute map.yaml --resolution 0.1 --headings 360 --max-range 20
"""

from __future__ import annotations

import argparse
import time
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli import inputs, options
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command, count, positive
from beamfield.errors import FormatError

if TYPE_CHECKING:
    from beamfield.maps.range_table import RangeTable


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "precompute", __doc__)
    parser.add_argument("map", type=Path, metavar="MAP", help=f"the map: {options.MAP_FORMATS}")
    parser.add_argument("--map-topic", metavar="TOPIC", help="topic of the map in a bag (default: the only one)")
    options.add_out(parser, "beamfield.ranges", metavar="FILE", what="table to write")
    parser.add_argument("--max-range", type=positive, metavar="M",
                        help="longest max_range of the sensors that use it (default: any)")  # fmt: skip
    parser.add_argument("--resolution", type=positive, default=0.15, metavar="M",
                        help="side of the squares that share their ranges (default: 0.15)")  # fmt: skip
    parser.add_argument("--headings", type=count, default=180, metavar="N",
                        help="directions of the circle (default: 180, one every 2 degrees)")  # fmt: skip
    parser.add_argument("--max-size", type=positive, default=4.0, metavar="GB",
                        help="refuse a larger table (default: 4)")  # fmt: skip
    options.add_threads(parser)


def run(arguments: argparse.Namespace) -> Outcome:
    """Read, say how large it will be, build, write."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.io.files.atomic import check_writable
    from beamfield.io.maps.range_table_file import table_in_file
    from beamfield.maps.range_table_plan import RangeTablePlan

    check_writable(arguments.out)
    built = False
    with options.progress(arguments) as progress:
        progress("reading the map", 0, 1)
        grid = inputs.read_walls(arguments)
        if not grid.free.any():
            raise FormatError(arguments.map, "the map has no free cell, so no pose has ranges to store")
        plan = RangeTablePlan(grid, arguments.max_range, arguments.resolution, arguments.headings)
        plan.check_size(arguments.max_size)

        def watch(done: int, total: int) -> None:
            nonlocal built
            built = True
            progress(f"casting rays for a table of {plan.n_bytes / 1e6:,.1f} MB", done, total)

        began = time.perf_counter()
        table = table_in_file(arguments.out, plan, watch)
    seconds = time.perf_counter() - began if built else None
    line = f"wrote {arguments.out}" if built else f"{arguments.out} is up to date"
    return Outcome(line, _text(table, seconds), _document(table, seconds), wrote=[arguments.out] if built else [])


def _text(table: RangeTable, seconds: float | None) -> str:
    plan, error = table.plan, table.error
    whole = "across the whole map; --max-range M leaves out what the sensor cannot see"
    ranges = whole if plan.max_range is None else f"up to {plan.max_range:g} m"
    return "\n".join(
        [
            f"table: {plan.n_places:,} places x {plan.headings} headings, {plan.n_bytes / 1e6:,.1f} MB",
            f"ranges: {ranges}",
            "time: it was there already" if seconds is None else f"time: {seconds:.1f} s",
            f"error of {error.n_rays:,} random rays, beside exact casting:",
            f"  median  {error.median:.3f} m",
            f"  95%     {error.percentile_95:.3f} m",
            f"  99%     {error.percentile_99:.3f} m",
            f"  largest {error.largest:.3f} m",
            f"  off by more than a cell of the map: {error.share_off_by_a_cell:.1%} of the rays",
        ]
    )


def _document(table: RangeTable, seconds: float | None) -> dict[str, Any]:
    plan = table.plan
    return {
        "resolution_m": plan.resolution,
        "headings": plan.headings,
        "max_range_m": plan.max_range,
        "places": plan.n_places,
        "bytes": plan.n_bytes,
        "seconds": seconds,
        "error": asdict(table.error),
    }
