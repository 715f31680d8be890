"""Write the logs of a simulated fleet, with planted faults.

Robots drive once a day through the map of their site. Writes maps, logs as robots record them (scans and odometry, no
poses), manifest.yaml, which lists them for scan and report, and truth.json: which robots have a dirty lens, a turned
mount, a range bias or wrong wheels, since when and how much, and which site has changed since its map was drawn. All
files are written, or none. The same seed gives the same fleet, whatever the number of workers.

for example:

  beamfield fleet simulate --out fleet
  beamfield fleet simulate --out small --robots 6 --sites 2 --days 4 --duration 60
"""

from __future__ import annotations

import argparse
from typing import Any

from beamfield.cli import options
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command, count, positive
from beamfield.cli.terminal import complain

OPTIONS: tuple[tuple[str, Any, Any, str, str], ...] = (
    ("robots", count, 24, "N", "robots, spread over the sites"),
    ("sites", count, 3, "N", "buildings; the last one changes after half of the days"),
    ("days", count, 14, "N", "days with one drive of each robot"),
    ("duration", positive, 180.0, "S", "length of a drive"),
    ("scan-rate", positive, 4.0, "HZ", "scans per second"),
    ("beams", count, 90, "N", "beams of a scan, over 270 degrees"),
    ("width", positive, 30.0, "M", "of each building"),
    ("height", positive, 22.0, "M", "of each building"),
)


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "simulate", __doc__)
    options.add_out(parser, "beamfield_simulated_fleet", metavar="DIR", what="output folder")
    options.add_seed(parser, 1)
    for name, kind, default, metavar, what in OPTIONS:
        parser.add_argument(f"--{name}", type=kind, default=default, metavar=metavar,
                            help=f"{what} (default: {default:g})")  # fmt: skip
    parser.add_argument("--workers", type=count, metavar="N", help="how many processes (default: one per processor)")
    parser.set_defaults(command="fleet simulate")


def run(arguments: argparse.Namespace) -> Outcome:
    """Plan, simulate, write."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.fleet.engine import Engine
    from beamfield.fleet.simulated import FleetSize, plan_fleet
    from beamfield.fleet.simulated_files import MANIFEST, TRUTH, write_fleet
    from beamfield.io.files.atomic import atomic_folder, check_folder_writable

    check_folder_writable(arguments.out)
    names = [name.replace("-", "_") for name, *_ in OPTIONS]
    size = FleetSize(**{name: getattr(arguments, name) for name in names})
    if not arguments.quiet:
        complain(f"note: {size.drives} drives make logs of about {size.bytes / 1e6:.3g} MB")
    plan = plan_fleet(size, seed=arguments.seed)
    with (
        options.progress(arguments) as progress,
        Engine(workers=arguments.workers) as engine,
        atomic_folder(arguments.out) as folder,
    ):
        truth = write_fleet(folder, plan, engine, progress=lambda done, total: progress("simulating", done, total))
    faulty = sum(robot.fault is not None for robot in plan.robots)
    return Outcome(
        f"wrote {MANIFEST}, {TRUTH}, maps and {size.drives} logs into {arguments.out}",
        f"simulated {size.robots} robots ({faulty} with a fault) at {size.sites} sites for {size.days} days",
        truth,
        wrote=[arguments.out],
    )
