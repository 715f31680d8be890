"""Write a log and a map with known truth.

Drive a simulated robot through an office (or a map of your own) and write what its range finder measures: map.yaml and
map.pgm, the log, the true poses (truth.tum) and what is true (truth.json); all of them or none. Readings are drawn
from the beam model. The log holds the true poses as well, unless --odometry-only makes it one as a robot records it. A
ring of sonars (--sonar) has cones instead of beams, and walls that mirror sound lose its pulses.

for example:

  beamfield simulate --out world --duration 60 --odometry-only
  beamfield simulate --out world --sonar --ring 16
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli import inputs, options
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command, count, not_negative, positive
from beamfield.cli.provenance import provenance
from beamfield.cli.simulate_sonar import (
    RING_OPTIONS,
    Value,
    add_sonar_options,
    add_values,
    given_options,
    ring_of,
    values_of,
)
from beamfield.errors import InvalidInputError
from beamfield.io.files.content_hash import file_hash

if TYPE_CHECKING:
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.sensors import RangeFinder, ScanLog


# Names in the output folder.
MAP, CARMEN, BAG, POSES, TRUTH = "map.yaml", "log.carmen", "bag", "truth.tum", "truth.json"
FORMATS: Mapping[str, tuple[str, ...]] = {"carmen": (CARMEN,), "mcap": (BAG,), "both": (CARMEN, BAG)}
LASER_MAX_RANGE = 12.0
OFFICE: tuple[Value, ...] = (
    ("width", 40.0, "M", "of the office"),
    ("height", 24.0, "M", "of the office"),
    ("resolution", 0.05, "M", "of the office's map"),
)
DRIVE: tuple[Value, ...] = (
    ("duration", 180.0, "S", "of the log"),
    ("scan-rate", 10.0, "HZ", "scans per second"),
    ("speed", 1.0, "M/S", "of the robot"),
    ("robot-radius", 0.25, "M", "least distance to walls"),
)
TRUE_PARAMETERS: tuple[Value, ...] = (
    ("z-hit", 0.82, "V", "weight of hits"),
    ("z-short", 0.09, "V", "weight of unexpected objects"),
    ("z-max", 0.03, "V", "weight of missing returns"),
    ("z-rand", 0.06, "V", "weight of random readings"),
    ("sigma-hit", 0.04, "V", "noise of hits, metres"),
    ("lambda-short", 0.5, "V", "rate of unexpected objects, 1/metre"),
    ("range-offset", 0.0, "V", "hits beyond the expected range, metres"),
    ("sigma-slope", 0.0, "V", "growth of the noise with the expected range"),
)
DEPENDENCE: tuple[Value, ...] = (
    ("dependence-angle", 0.0, "DEG", "reach over beams"),
    ("dependence-time", 0.0, "S", "reach over time"),
)
# What else a laser has and a ring of sonars has not.
LASER: dict[str, Any] = {"beams": 180, "fov": 270.0, "mount": (0.1, 0.0, 0.0)}


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "simulate", __doc__)
    options.add_out(parser, "beamfield_simulation", metavar="DIR", what="output folder")
    parser.add_argument("--format", choices=tuple(FORMATS), default="carmen",
                        help="CARMEN text, a ROS 2 bag, or both (default: %(default)s)")  # fmt: skip
    parser.add_argument("--odometry-only", action="store_true",
                        help="no true poses in the log (read CARMEN with --lone-poses odometry)")  # fmt: skip
    options.add_seed(parser, 1)
    options.add_threads(parser)
    options.add_map(parser, what="drive through this map instead of an office")
    options.add_unpacking(parser)
    add_values(parser.add_argument_group("world and drive"), OFFICE + DRIVE, positive)
    sensor = parser.add_argument_group("sensor")
    sensor.add_argument("--sonar", action="store_true", help="a ring of sonars instead of a laser scanner")
    sensor.add_argument("--beams", type=count, default=180, metavar="N", help="beams of a scan (default: 180)")
    sensor.add_argument("--fov", type=_field_of_view, default=270.0, metavar="DEG",
                        help="first to last beam (default: 270)")  # fmt: skip
    sensor.add_argument("--max-range", type=positive, metavar="M",
                        help="no return from here on (default: 12; sonar: 5)")  # fmt: skip
    options.add_mount(sensor, " (default: 0.1 0 0)", LASER["mount"])
    truth = parser.add_argument_group("true parameters of the beam model (the four weights must sum to 1)")
    add_values(truth, TRUE_PARAMETERS)
    burst = parser.add_argument_group(
        "dependence: errors in bursts, while each beam alone keeps the model's distribution"
    )
    add_values(burst, DEPENDENCE, not_negative)
    add_sonar_options(parser)


def _field_of_view(text: str) -> float:
    degrees = positive(text)
    if degrees > 360.0:
        raise argparse.ArgumentTypeError(f"expected at most 360 degrees, got {text!r}")
    return degrees


def run(arguments: argparse.Namespace) -> Outcome:
    """Parse, simulate, write."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.io.files.atomic import atomic_folder, check_folder_writable
    from beamfield.simulation.trajectory import DriveOptions

    check_folder_writable(arguments.out, MAP, Path(MAP).with_suffix(".pgm").name)
    _require_options_that_matter(arguments)
    with options.progress(arguments) as progress:
        progress("making the map", 0, 1)
        grid = _world(arguments)
        drive = DriveOptions(robot_radius=arguments.robot_radius, speed=arguments.speed)
        how = {
            "duration": arguments.duration, "scan_rate": arguments.scan_rate, "seed": arguments.seed, "drive": drive,
            "progress": lambda done, total: progress("measuring", done, total),
        }  # fmt: skip
        log, known = _simulate(arguments, grid, how)
        progress("writing", 0, 1)
        sensor = log.only_sensor()
        with atomic_folder(arguments.out) as folder:
            names = _write_data(folder, grid, log, arguments)
            truth = {
                **provenance(arguments),
                **known,
                "drive": asdict(drive),
                "scans": len(sensor),
                "files": {name: file_hash(folder / name) for name in names},
            }
            (folder / TRUTH).write_text(json.dumps(truth, indent=2) + "\n", encoding="utf-8")
    what = "sonars" if arguments.sonar else "beams"
    return Outcome(
        f"wrote {', '.join([*names, TRUTH])} into {arguments.out}",
        f"simulated {len(sensor)} scans of {sensor.finder.n_beams} {what} in {arguments.duration:g} s",
        truth,
        [f"read {CARMEN} with --lone-poses odometry"] if arguments.odometry_only and CARMEN in names else (),
        [arguments.out],
    )


def _simulate(
    arguments: argparse.Namespace, grid: OccupancyGrid, how: dict[str, Any]
) -> tuple[ScanLog, dict[str, Any]]:
    """Return the log, and what is known about its truth."""
    from beamfield.models.beam_parameters import BeamParameters
    from beamfield.simulation.dependence import Dependence
    from beamfield.simulation.log import simulate_log
    from beamfield.simulation.odometry import OdometryNoise

    parameters = BeamParameters(**values_of(arguments, TRUE_PARAMETERS))
    dependence = Dependence(angle=math.radians(arguments.dependence_angle), time=arguments.dependence_time)
    noise = how["odometry_noise"] = OdometryNoise()
    known: dict[str, Any] = {
        "parameters": asdict(parameters), "dependence": asdict(dependence), "odometry_noise": asdict(noise)
    }  # fmt: skip
    if arguments.sonar:
        known["roughness"] = how["roughness"] = arguments.roughness
    finder = ring_of(arguments) if arguments.sonar else _finder(arguments)
    return simulate_log(grid, finder, parameters, dependence=dependence, **how), known


def _require_options_that_matter(arguments: argparse.Namespace) -> None:
    """Refuse options that would change nothing."""
    if arguments.map is not None and (given := given_options(arguments, OFFICE)):
        raise InvalidInputError(f"{given[0]}: is of the office, and --map drives through another map")
    if not arguments.sonar:
        if given := given_options(arguments, RING_OPTIONS):
            raise InvalidInputError(f"{given[0]}: is an option of --sonar")
        return
    for name, value in LASER.items():
        if getattr(arguments, name) != value:
            raise InvalidInputError(f"--{name.replace('_', '-')}: is no option of --sonar")
    if arguments.format != "carmen":
        raise InvalidInputError("--format: a ring of sonars is written as CARMEN text; a LaserScan has one origin")


def _finder(arguments: argparse.Namespace) -> RangeFinder:
    import numpy as np

    from beamfield.sensors import RangeFinder

    half = math.radians(arguments.fov) / 2
    # Over a full turn the first and the last beam would be the same.
    bearings = np.linspace(-half, half, arguments.beams, endpoint=arguments.fov < 360.0)
    max_range = LASER_MAX_RANGE if arguments.max_range is None else arguments.max_range
    return RangeFinder.from_bearings(bearings, max_range, mount=options.mount(arguments))


def _world(arguments: argparse.Namespace) -> OccupancyGrid:
    from beamfield.simulation.floor_plan import draw_floor_plan

    if arguments.map is not None:
        return inputs.read_walls(arguments)
    return draw_floor_plan(
        seed=arguments.seed, width=arguments.width, height=arguments.height, resolution=arguments.resolution
    )


def _write_data(folder: Path, grid: OccupancyGrid, log: ScanLog, arguments: argparse.Namespace) -> list[str]:
    """Write map, log and poses; return the names written."""
    from dataclasses import replace

    import numpy as np

    from beamfield.io.bags.writer import write_bag
    from beamfield.io.logs.carmen import write_carmen
    from beamfield.io.maps.ros_map_writer import write_map
    from beamfield.io.trajectory import write_tum
    from beamfield.sensors import Track

    # Rays ask only for the category of a cell, so a map of one's own loses nothing that matters here.
    write_map(grid, folder / MAP, mode="trinary")
    sensor, logs = log.only_sensor(), FORMATS[arguments.format]
    if arguments.odometry_only:
        hidden = {name: replace(one, poses=np.full_like(one.poses, np.nan)) for name, one in log.sensors.items()}
        log = replace(log, sensors=hidden)
    if CARMEN in logs:
        write_carmen(folder / CARMEN, log)
    if BAG in logs:
        write_bag(folder / BAG, log)
    write_tum(folder / POSES, Track(sensor.stamps, sensor.poses))
    return [MAP, Path(MAP).with_suffix(".pgm").name, *logs, POSES]
