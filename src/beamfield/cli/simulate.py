"""``beamfield simulate``: a log whose truth is known, for trying calibration and for other programs."""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli.calibrate import add_unpacking_option
from beamfield.cli.progress import StageProgress
from beamfield.cli.provenance import file_hash, provenance
from beamfield.cli.simulate_sonar import add_sonar_options, cause_shares, given_options, physics_of, ring_of
from beamfield.cli.terminal import say
from beamfield.errors import InvalidInputError

if TYPE_CHECKING:
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.models.beam_parameters import BeamParameters
    from beamfield.sensors import RangeFinder, ScanLog
    from beamfield.simulation.dependence import Dependence
    from beamfield.simulation.trajectory import DriveOptions

DESCRIPTION = """
Drive a simulated robot through an office (or a map of your own) and write what its range finder measures: map.yaml and
map.pgm, the log, the true poses (truth.tum) and what is true (truth.json); all of them or none. A laser's readings
are drawn from the beam model. Those of a ring of sonars (--sensor sonar) come from walls that mirror sound: pulses are
lost or come back late, and sensors hear each other.
"""

# Names in the output folder.
MAP, CARMEN, BAG, POSES, TRUTH = "map.yaml", "log.carmen", "bag", "truth.tum", "truth.json"
FORMATS: Mapping[str, tuple[str, ...]] = {"carmen": (CARMEN,), "mcap": (BAG,), "both": (CARMEN, BAG)}
MAX_BEAMS = 10_000
LASER_MAX_RANGE = 12.0
LASER_OPTIONS: tuple[tuple[str, float, str], ...] = (
    ("z-hit", 0.82, "weight of hits"),
    ("z-short", 0.09, "weight of unexpected objects"),
    ("z-max", 0.03, "weight of missing returns"),
    ("z-rand", 0.06, "weight of random readings"),
    ("sigma-hit", 0.04, "noise of hits, metres"),
    ("lambda-short", 0.5, "rate of unexpected objects, 1/metre"),
    ("range-offset", 0.0, "hits beyond the expected range, metres"),
    ("sigma-slope", 0.0, "growth of the noise with the expected range"),
)


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = subparsers.add_parser("simulate", help="write a log and a map with known truth", description=DESCRIPTION)
    parser.add_argument("out", type=Path, metavar="OUT_DIR", help="folder to make; must not hold anything yet")
    parser.add_argument("--format", choices=tuple(FORMATS), default="carmen",
                        help="CARMEN text, a ROS 2 bag, or both (default: %(default)s)")  # fmt: skip
    parser.add_argument("--seed", type=int, default=1, help="of the office, the drive and the readings (default: 1)")
    parser.add_argument("--overwrite", action="store_true", help="replace files that OUT_DIR holds already")
    parser.add_argument("--threads", type=int, help="processors to use (default: all)")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    _add_world_options(parser)
    _add_sensor_options(parser)
    parser.set_defaults(run=run)


def _add_world_options(parser: argparse.ArgumentParser) -> None:
    world = parser.add_argument_group("world and drive")
    world.add_argument("--map", type=Path, metavar="MAP", help="drive through this map instead of an office")
    add_unpacking_option(world)
    world.add_argument("--width", type=float, default=40.0, metavar="M", help="of the office (default: %(default)g)")
    world.add_argument("--height", type=float, default=24.0, metavar="M", help="of the office (default: %(default)g)")
    world.add_argument("--resolution", type=float, default=0.05, metavar="M", help="of the map (default: %(default)g)")
    world.add_argument("--duration", type=float, default=180.0, metavar="S", help="of the log (default: %(default)g)")
    world.add_argument("--scan-rate", type=float, default=10.0, metavar="HZ", help="scans per second (default: 10)")
    world.add_argument("--speed", type=float, default=1.0, metavar="M/S", help="of the robot (default: %(default)g)")
    world.add_argument("--robot-radius", type=float, default=0.25, metavar="M",
                       help="least distance to walls (default: %(default)g)")  # fmt: skip


def _add_sensor_options(parser: argparse.ArgumentParser) -> None:
    sensor = parser.add_argument_group("sensor")
    sensor.add_argument("--sensor", choices=("laser", "sonar"), default="laser",
                        help="a laser scanner or a ring of sonars (default: %(default)s)")  # fmt: skip
    sensor.add_argument("--beams", type=int, default=180, metavar="K", help="beams of a scan (default: 180)")
    sensor.add_argument("--fov-deg", type=float, default=270.0, metavar="DEG", help="first to last beam (default: 270)")
    sensor.add_argument("--max-range", type=float, metavar="M",
                        help="no return from here on (default: 12; sonar: 5)")  # fmt: skip
    sensor.add_argument("--mount-x", type=float, default=0.1, metavar="M",
                        help="sensor in front of the centre (default: %(default)g)")  # fmt: skip
    truth = parser.add_argument_group("true parameters of the beam model (the four weights must sum to 1)")
    for name, value, meaning in LASER_OPTIONS:
        truth.add_argument(f"--{name}", type=float, default=value, metavar="V", help=f"{meaning} (default: {value:g})")
    burst = parser.add_argument_group(
        "dependence: errors in bursts, while each beam alone keeps the model's distribution"
    )
    burst.add_argument("--dependence-deg", type=float, default=0.0, metavar="DEG", help="reach over beams (default: 0)")
    burst.add_argument("--dependence-s", type=float, default=0.0, metavar="S", help="reach over time (default: 0)")
    add_sonar_options(parser)


def run(arguments: argparse.Namespace) -> int:
    """Parse, simulate, write."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.io.files.atomic import atomic_folder, check_folder_writable

    check_folder_writable(arguments.out)
    _require_empty(arguments.out, overwrite=arguments.overwrite)
    if arguments.seed < 0:
        raise InvalidInputError(f"--seed: expected a number >= 0, got {arguments.seed}")
    _require_options_of_the_sensor(arguments)
    simulate = _simulate_sonar if arguments.sensor == "sonar" else _simulate_laser
    with StageProgress(quiet=arguments.quiet) as progress:
        progress("making the map", 0, 1)
        grid = _world(arguments)
        log, known = simulate(arguments, grid, lambda done, total: progress("measuring", done, total))
        progress("writing", 0, 1)
        sensor = log.only_sensor()
        with atomic_folder(arguments.out) as folder:
            names = _write_data(folder, grid, log, FORMATS[arguments.format])
            truth = {
                **_provenance(arguments),
                **known,
                "scans": len(sensor),
                "files": {name: file_hash(folder / name) for name in names},
            }
            (folder / TRUTH).write_text(json.dumps(truth, indent=2) + "\n", encoding="utf-8")
    what = "sonars" if arguments.sensor == "sonar" else "beams"
    say(f"simulated {len(sensor)} scans of {sensor.finder.n_beams} {what} in {arguments.duration:g} s")
    say(f"wrote {', '.join([*names, TRUTH])} into {arguments.out}")
    return 0


def _simulate_laser(
    arguments: argparse.Namespace, grid: OccupancyGrid, progress: Callable[[int, int], None]
) -> tuple[ScanLog, dict[str, Any]]:
    """Return the log, and what is known about its truth."""
    from beamfield.simulation.log import simulate_log

    parameters, dependence, drive = _parameters(arguments), _dependence(arguments), _drive(arguments)
    log = simulate_log(
        grid,
        _finder(arguments),
        parameters,
        duration=arguments.duration,
        scan_rate=arguments.scan_rate,
        seed=arguments.seed,
        drive=drive,
        dependence=dependence,
        progress=progress,
    )
    return log, {"parameters": asdict(parameters), "dependence": asdict(dependence), "drive": asdict(drive)}


def _simulate_sonar(
    arguments: argparse.Namespace, grid: OccupancyGrid, progress: Callable[[int, int], None]
) -> tuple[ScanLog, dict[str, Any]]:
    """Return the log, and what is known about its truth."""
    from beamfield.simulation.sonar_log import simulate_sonar_log

    physics, drive = physics_of(arguments), _drive(arguments)
    log, readings = simulate_sonar_log(
        grid,
        ring_of(arguments),
        physics,
        duration=arguments.duration,
        scan_rate=arguments.scan_rate,
        seed=arguments.seed,
        drive=drive,
        progress=progress,
    )
    return log, {"physics": asdict(physics), "causes": cause_shares(readings), "drive": asdict(drive)}


def _require_options_of_the_sensor(arguments: argparse.Namespace) -> None:
    """Refuse options that would change nothing."""
    if arguments.sensor == "laser":
        if given := given_options(arguments):
            raise InvalidInputError(f"{given[0]}: is an option of --sensor sonar")
        return
    laser = {"beams": 180, "fov_deg": 270.0, "mount_x": 0.1, "dependence_deg": 0.0, "dependence_s": 0.0}
    laser |= {name.replace("-", "_"): value for name, value, _ in LASER_OPTIONS}
    for name, value in laser.items():
        if getattr(arguments, name) != value:
            raise InvalidInputError(f"--{name.replace('_', '-')}: is no option of --sensor sonar")
    if arguments.format != "carmen":
        raise InvalidInputError("--format: a ring of sonars is written as CARMEN text; a LaserScan has one origin")


def _require_empty(folder: Path, *, overwrite: bool) -> None:
    """Refuse a folder in which an older log would stay beside a truth that is not its own."""
    if not overwrite and folder.is_dir() and any(folder.iterdir()):
        raise InvalidInputError(f"{folder}: the folder is not empty; choose another, or replace files with --overwrite")


def _parameters(arguments: argparse.Namespace) -> BeamParameters:
    from beamfield.models.beam_parameters import BeamParameters

    return BeamParameters(
        z_hit=arguments.z_hit,
        z_short=arguments.z_short,
        z_max=arguments.z_max,
        z_rand=arguments.z_rand,
        sigma_hit=arguments.sigma_hit,
        lambda_short=arguments.lambda_short,
        range_offset=arguments.range_offset,
        sigma_slope=arguments.sigma_slope,
    )


def _finder(arguments: argparse.Namespace) -> RangeFinder:
    import numpy as np

    from beamfield.sensors import RangeFinder

    if not 1 <= arguments.beams <= MAX_BEAMS:
        raise InvalidInputError(f"--beams: expected 1 to {MAX_BEAMS}, got {arguments.beams}")
    if not 0.0 < arguments.fov_deg <= 360.0:
        raise InvalidInputError(f"--fov-deg: expected more than 0 and at most 360 degrees, got {arguments.fov_deg:g}")
    half = math.radians(arguments.fov_deg) / 2
    # Over a full turn the first and the last beam would be the same.
    bearings = np.linspace(-half, half, arguments.beams, endpoint=arguments.fov_deg < 360.0)
    max_range = LASER_MAX_RANGE if arguments.max_range is None else arguments.max_range
    return RangeFinder.from_bearings(bearings, max_range, mount=(arguments.mount_x, 0.0, 0.0))


def _drive(arguments: argparse.Namespace) -> DriveOptions:
    from beamfield.simulation.trajectory import DriveOptions

    return DriveOptions(robot_radius=arguments.robot_radius, speed=arguments.speed)


def _dependence(arguments: argparse.Namespace) -> Dependence:
    from beamfield.simulation.dependence import Dependence

    return Dependence(angle=math.radians(arguments.dependence_deg), time=arguments.dependence_s)


def _world(arguments: argparse.Namespace) -> OccupancyGrid:
    from beamfield.io.read_map import read_map
    from beamfield.simulation.floor_plan import draw_floor_plan

    if arguments.map is not None:
        return read_map(arguments.map)
    return draw_floor_plan(
        seed=arguments.seed, width=arguments.width, height=arguments.height, resolution=arguments.resolution
    )


def _write_data(folder: Path, grid: OccupancyGrid, log: ScanLog, logs: tuple[str, ...]) -> list[str]:
    """Write map, log and poses; return the names written."""
    from beamfield.io.bags.writer import write_bag
    from beamfield.io.logs.carmen import write_carmen
    from beamfield.io.maps.ros_map import write_map
    from beamfield.io.trajectory import write_tum
    from beamfield.sensors import Track

    # Rays ask only for the category of a cell, so a map of one's own loses nothing that matters here.
    write_map(grid, folder / MAP, mode="trinary")
    if CARMEN in logs:
        write_carmen(folder / CARMEN, log)
    if BAG in logs:
        write_bag(folder / BAG, log)
    sensor = log.only_sensor()
    write_tum(folder / POSES, Track(sensor.stamps, sensor.poses))
    return [MAP, Path(MAP).with_suffix(".pgm").name, *logs, POSES]


def _provenance(arguments: argparse.Namespace) -> dict[str, Any]:
    from beamfield.io.maps.ros_map import image_path

    inputs = []
    if arguments.map is not None:
        inputs.append(("map", arguments.map))
        if arguments.map.suffix in (".yaml", ".yml"):
            inputs.append(("map image", image_path(arguments.map)))
    silent = {"out", "map", "run", "quiet", "threads", "seed", "overwrite"}
    given = {name: value for name, value in sorted(vars(arguments).items()) if name not in silent}
    return provenance(inputs, given, arguments.seed)
