"""The options that commands share, spelt once, and what is read by them."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from beamfield.cli.parser import count, index, not_negative, positive
from beamfield.cli.progress import StageProgress
from beamfield.errors import BeamfieldError, FormatError, InvalidInputError, about_file

if TYPE_CHECKING:
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.maps.range_table import RangeTable
    from beamfield.models.beam_parameters import BeamParameters, SavedBeamModel
    from beamfield.models.field_parameters import SavedLikelihoodField
    from beamfield.sensors import RangeFinder, ScanLog, SensorLog

# Not `SUPPORTED` of `beamfield.io.read_log`: that loads the numerical libraries, and --help is to answer at once.
LOG_FORMATS = (
    "CARMEN, Wean Hall, GMapping, g2o or CoreSLAM text, plain or .gz; a folder with measurement.txt and poses.txt; "
    "ROS 1 .bag; ROS 2 folder, .db3 or .mcap"
)
MAP_FORMATS = "map_server .yaml, Wean .dat, or a bag"
PICTURES = (".png", ".svg", ".pdf")
# A new folder of such a name is a misunderstanding.
FILES = (*PICTURES, ".gif", ".html", ".tum", ".csv", ".json", ".yaml", ".yml", ".mcap", ".bag", ".log", ".txt", ".gz")
# No range sensor of a robot reaches so many metres: millimetres do.
MOST_REACH = 1000.0


def add_out(parser: argparse.ArgumentParser, default: str | None, *, metavar: str, what: str) -> None:
    """Add --out; a command that is there to write has a default, one that answers a question has none."""
    stated = "" if default is None else " (default: %(default)s)"
    kind = _folder if metavar == "DIR" else Path
    parser.add_argument("-o", "--out", type=kind, default=default and Path(default), metavar=metavar,
                        help=f"{what}; files of the same name are replaced{stated}")  # fmt: skip


def add_map(parser: argparse.ArgumentParser, *, required: bool = False, what: str = "") -> None:
    """Add --map and --map-topic."""
    parser.add_argument(
        "--map", type=Path, required=required, metavar="MAP", help=f"{what or 'the map'}: {MAP_FORMATS}"
    )
    parser.add_argument("--map-topic", metavar="TOPIC", help="topic of the map in a bag (default: the only one)")


def add_poses(parser: argparse.ArgumentParser, *, fitted: bool = False) -> None:
    """Add --poses, and --start if they can be fitted to a map."""
    otherwise = ", or else fitted to the map" if fitted else ""
    parser.add_argument("--poses", type=Path, metavar="FILE",
                        help=f"reference poses: TUM or CSV file (default: those in the log{otherwise})")  # fmt: skip
    if fitted:
        add_start(parser, "for a log without reference poses, ")


def add_start(parser: argparse._ActionsContainer, when: str = "") -> None:
    """Add --start."""
    said = f"{when}where the log begins, to about 2 m and 45 degrees (default: searched)"
    parser.add_argument("--start", type=float, nargs=3, metavar=("X", "Y", "DEG"), help=said)


def start_of(arguments: argparse.Namespace) -> tuple[float, float, float] | None:
    """Return --start in metres and radians."""
    if arguments.start is None:
        return None
    x, y, degrees = arguments.start
    if not all(map(math.isfinite, arguments.start)):
        raise InvalidInputError("--start: expected finite numbers")
    return x, y, math.radians(degrees)


def add_params(parser: argparse.ArgumentParser, what: str) -> None:
    """Add --params."""
    parser.add_argument("--params", type=Path, metavar="FILE", help=what)


def add_range_table(parser: argparse._ActionsContainer) -> None:
    """Add --range-table."""
    parser.add_argument("--range-table", type=Path, metavar="FILE",
                        help="look expected ranges up in this table of beamfield precompute, with --model beam "
                        "(default: cast rays, which is exact)")  # fmt: skip


def add_seed(parser: argparse._ActionsContainer, default: int = 0) -> None:
    """Add --seed."""
    parser.add_argument("--seed", type=index, default=default, metavar="N",
                        help="seed of every random choice (default: %(default)s)")  # fmt: skip


def add_threads(parser: argparse.ArgumentParser) -> None:
    """Add --threads."""
    parser.add_argument("--threads", type=count, metavar="N", help="processors to use (default: all)")


def add_mount(parser: argparse._ActionsContainer, what: str, default: tuple[float, ...] | None = None) -> None:
    """Add --mount."""
    parser.add_argument("--mount", type=float, nargs=3, default=default, metavar=("X", "Y", "YAW"),
                        help=f"the sensor's pose on the robot, metres and degrees{what}")  # fmt: skip


def add_log(parser: argparse.ArgumentParser, *, several: bool = False) -> None:
    """Add the options that say how a log is read, of several sensors or of one."""
    group = parser.add_argument_group("reading the log")
    repeatable = "; repeatable" if several else ""
    group.add_argument("--sensor", action="append", metavar="NAME",
                       help=f"scan topic or sensor{repeatable} (default: the only one)")  # fmt: skip
    group.add_argument("--poses-topic", metavar="TOPIC", help="topic of the reference poses in the bag "
                       "(default: tf from the map, or a topic named as truth)")  # fmt: skip
    group.add_argument("--map-frame", metavar="FRAME", help="name of the map frame in tf (default: map)")
    group.add_argument("--base-frame", metavar="FRAME",
                       help="name of the robot's frame in tf (default: base_link or base_footprint)")  # fmt: skip
    add_mount(group, ", for a bag without /tf_static")
    group.add_argument("--no-return", type=_no_return, default="detect", metavar="detect|none|V[,V...]",
                       help="values (metres) that mean 'no return' besides +inf (default: detect)")  # fmt: skip
    group.add_argument("--max-range", type=_reach, metavar="M", help="the sensor's limit, if the log is wrong about it")
    group.add_argument("--min-range", type=not_negative, metavar="M",
                       help="shortest range that counts (default: as the log says)")  # fmt: skip
    group.add_argument("--mask", type=_sector, action="append", default=[], metavar="DEG:DEG",
                       help="bearings, counter-clockwise, whose readings do not count, as --mask=-170:-155; "
                       "repeatable")  # fmt: skip
    group.add_argument("--opening-angle", type=_opening_angle, metavar="DEG",
                       help="full width of a sonar's cones, if the log does not say it; 0: beams")  # fmt: skip
    group.add_argument("--stamps", choices=("file", "order"), default="file",
                       help="text logs: the file's stamps, or scans one second apart (default: file)")  # fmt: skip
    group.add_argument("--lone-poses", choices=("reference", "odometry"), default="reference",
                       help="text logs with one pose per scan: what it is (default: reference)")  # fmt: skip
    add_unpacking(group)


def add_unpacking(group: argparse._ActionsContainer) -> None:
    """Add --max-unpacked, which is for all files that a command reads."""
    group.add_argument("--max-unpacked", type=positive, metavar="GB",
                       help="gigabytes that a bag may unpack to (default: 500 times its size, 1 a chunk)")  # fmt: skip


def progress(arguments: argparse.Namespace) -> StageProgress:
    """Return the progress that the command line asks for."""
    return StageProgress(quiet=arguments.quiet, verbose=arguments.verbose)


def mount(arguments: argparse.Namespace) -> tuple[float, float, float]:
    """Return --mount in metres and radians."""
    x, y, yaw = arguments.mount
    return x, y, math.radians(yaw)


def check_output(path: Path | None, option: str, *endings: str) -> None:
    """Refuse now a file that could not be written after the work, or by its name's ending is no such file."""
    from beamfield.io.files.atomic import check_writable

    if path is None:
        return
    if path.suffix.lower() not in endings:
        *most, last = endings
        known = f"{', '.join(most)} or {last}" if most else last
        raise InvalidInputError(f"--{option}: expected a name ending in {known}, got {path.name!r}")
    check_writable(path)


def refuse(arguments: argparse.Namespace, names: Iterable[str], why: str) -> None:
    """Refuse options, by their names in the arguments, that were given and mean nothing here."""
    for name in names:
        if getattr(arguments, name) not in (None, False):
            raise InvalidInputError(f"--{name.replace('_', '-')}: {why}")


def read_grid(arguments: argparse.Namespace) -> OccupancyGrid:
    """Read --map, and say if it seems to be the log."""
    from beamfield.cli.inspect_summary import map_notes
    from beamfield.io.read_map import read_map

    try:
        grid = read_map(arguments.map, topic=arguments.map_topic)
    except FormatError as error:
        if parameters := parameters_instead_of("map", arguments.map):
            raise parameters from None
        log = getattr(arguments, "log", None)
        if log is None or (looks_like_a_map(arguments.map) and not looks_like_a_map(log)):
            raise
        raise BeamfieldError(f"{error}; did you swap LOG and --map?") from error
    keep_for_errors(arguments, arguments.map, map_notes(grid))
    return grid


def keep_for_errors(arguments: argparse.Namespace, path: Path, notes: Iterable[str]) -> None:
    """Keep notes on a file that was read, to be shown if the command ends in an error and has no result to say them."""
    arguments.noticed = getattr(arguments, "noticed", [])
    # In place: a command may work with a copy of its arguments.
    arguments.noticed.extend(f"{path.name}: {note}" for note in notes)


def read_walls(arguments: argparse.Namespace) -> OccupancyGrid:
    """Read --map, which must have something for rays to meet."""
    grid = read_grid(arguments)
    if not grid.occupied.any():
        raise FormatError(arguments.map, "the map has no occupied cell: no ray has an expected range")
    return grid


def read_range_table(arguments: argparse.Namespace, grid: OccupancyGrid, finder: RangeFinder) -> RangeTable | None:
    """Read --range-table; None without."""
    from beamfield.io.maps.range_table_file import read_range_table

    if arguments.range_table is None:
        return None
    if arguments.model != "beam" or finder.opening_angle > 0.0:
        raise InvalidInputError("--range-table: only rays are looked up in it, with --model beam and no sonar")
    table = read_range_table(arguments.range_table, grid)
    table.check_reach(finder.max_range)
    return table


def read_field_or_beam_model(path: Path) -> SavedLikelihoodField | SavedBeamModel:
    """Read --params of a likelihood field: a likelihood_field.yaml, or a beam_model.yaml in its place."""
    from beamfield.io.files.yaml_file import read_yaml
    from beamfield.io.parameters.beam_model_file import read_beam_model
    from beamfield.io.parameters.likelihood_field_file import is_likelihood_field, read_likelihood_field

    # A file that is neither is refused as what the model asks for first.
    is_beam_model = not is_likelihood_field(path) and "beam_model" in read_yaml(path).values
    return read_beam_model(path) if is_beam_model else read_likelihood_field(path)


def left_out_of_a_field(beam: BeamParameters, path: Path) -> list[str]:
    """Return notes on what the beam model in a file has that a likelihood field with its parameters cannot have."""
    from beamfield.models.beam_parameters import EXTENSIONS

    return [
        f"{path} has {name} {getattr(beam, name):.4g}, which a likelihood field cannot have; it is left out. The "
        "likelihood_field.yaml of beamfield calibrate is learned without."
        for name in EXTENSIONS
        if getattr(beam, name) != 0.0
    ]


def read_scans(arguments: argparse.Namespace, path: Path | None = None, poses: Path | None = None) -> ScanLog:
    """Read a log, and its reference poses if they are in a file; LOG and --poses if no other is named."""
    from beamfield.io.read_log import read_log
    from beamfield.io.trajectory import attach_poses, read_trajectory

    log_path, poses = (arguments.log, arguments.poses) if path is None else (path, poses)
    if looks_like_a_map(log_path):
        if parameters := parameters_instead_of("log", log_path):
            raise parameters
        swapped = "; did you swap LOG and --map?" if getattr(arguments, "map", None) is not None else ""
        raise FormatError(log_path, f"expected a log, this is a map{swapped}")
    log = read_log(
        log_path,
        sensor_topic=arguments.sensor,
        poses_topic=arguments.poses_topic,
        map_frame=arguments.map_frame,
        base_frame=arguments.base_frame,
        mount=None if arguments.mount is None else mount(arguments),
        no_return=arguments.no_return,
        max_range=arguments.max_range,
        min_range=arguments.min_range,
        opening_angle=radians(arguments.opening_angle),
        mask=[_radians_of(sector) for sector in arguments.mask],
        stamps=arguments.stamps,
        lone_poses=arguments.lone_poses,
    )
    keep_for_errors(arguments, log_path, log.notes)
    if poses is None:
        return log
    track = read_trajectory(poses)
    with about_file(poses):
        return attach_poses(log, track)


def read_sensor(
    arguments: argparse.Namespace, path: Path | None = None, poses: Path | None = None
) -> tuple[SensorLog, tuple[str, ...]]:
    """Read the one sensor of a log, and what was noticed on the way."""
    log = read_log_of_one_sensor(arguments, path, poses)
    return log.only_sensor(), log.notes


def read_log_of_one_sensor(
    arguments: argparse.Namespace, path: Path | None = None, poses: Path | None = None
) -> ScanLog:
    """Read a log of which one sensor was chosen, or that has only one."""
    if arguments.sensor and len(arguments.sensor) > 1:
        raise InvalidInputError(f"--sensor: expected one, got {', '.join(arguments.sensor)}")
    log = read_scans(arguments, path, poses)
    if not arguments.sensor:
        require_one_sensor(log, path or arguments.log)
    chosen = log.only_sensor(arguments.sensor[0] if arguments.sensor else None)
    return replace(log, sensors={name: sensor for name, sensor in log.sensors.items() if sensor is chosen})


def require_one_sensor(log: ScanLog, path: Path) -> None:
    """Refuse a log of several sensors, of which none was chosen."""
    if len(log.sensors) != 1:
        known = ", ".join(map(repr, log.sensors)) or "none"
        raise FormatError(path, f"expected one sensor, the log has {known}: choose with --sensor")


def read_map_and_sensor(
    arguments: argparse.Namespace, progress: StageProgress
) -> tuple[OccupancyGrid, SensorLog, tuple[str, ...]]:
    """Read --map, which must have something for rays to meet, and the one sensor of LOG; and what was noticed."""
    progress("reading the map", 0, 1)
    grid = read_walls(arguments)
    progress("reading the log", 0, 1)
    return grid, *read_sensor(arguments)


def require_poses(sensor: SensorLog, arguments: argparse.Namespace) -> SensorLog:
    """Return the sensor of LOG with reference poses, or with --odometry that in their place."""
    if arguments.odometry:
        if not sensor.has_odometry:
            raise FormatError(arguments.log, "--odometry: the log has none")
        return sensor.with_poses(sensor.odometry)
    if not sensor.has_poses:
        drift = ", or --odometry to take the odometry for them" if sensor.has_odometry else ""
        is_fitted = sensor.has_odometry and sensor.finder.opening_angle == 0.0
        fitted = "a map with --map, to which they are then fitted, or " if is_fitted else ""
        raise FormatError(
            arguments.log, f"no scan has a reference pose; give {fitted}a TUM or CSV file with --poses{drift}"
        )
    return sensor


def require_odometry(sensor: SensorLog, path: Path) -> None:
    """Refuse a log of which no scan has odometry, for a filter."""
    if sensor.has_odometry:
        return
    what = (
        "if its poses are the odometry (a text log with one pose per scan), pass --lone-poses odometry"
        if sensor.has_poses
        else "record it as nav_msgs/Odometry, or on /tf from odom to base_link"
    )
    raise FormatError(path, f"no scan has odometry, which moves the particles; {what}")


def looks_like_a_map(path: Path) -> bool:
    """Return whether a file's name, or the first line of a .dat, is a map's."""
    from beamfield.io.files.text_lines import read_lines

    if path.is_dir():
        return False
    if path.suffix == ".dat" or path.name.endswith(".dat.gz"):
        # CoreSLAM's logs have this ending too.
        _, text = next(iter(read_lines(path)), (1, ""))
        return text.startswith(("robot_specifications", "global_map"))
    return path.suffix in (".yaml", ".yml", ".pgm", ".png", ".bmp")


def parameters_instead_of(expected: str, path: Path) -> FormatError | None:
    """Return what a YAML file is instead of a map or a log: parameters, or metadata; None if it is neither."""
    from beamfield.io.files.yaml_file import read_yaml
    from beamfield.stacks.files.other_files import is_beam_model
    from beamfield.stacks.files.parameter_file import read_stack_file

    try:
        if is_beam_model(path):
            return FormatError(path, f"this is a beam model of beamfield, not a {expected}")
        if path.suffix == ".yaml" and "rosbag2_bagfile_information" in read_yaml(path).values:
            return FormatError(path, "this is the metadata of a ROS 2 bag: give its folder")
        stack = read_stack_file(path, unknown_model="default").stack
    except (BeamfieldError, OSError):
        return None
    return FormatError(
        path, f"this is a parameter file of {stack}, not a {expected}: use `beamfield doctor {path.name}`"
    )


def _folder(text: str) -> Path:
    path = Path(text)
    if path.suffix.lower() in FILES and not path.exists():
        raise argparse.ArgumentTypeError(f"expected a folder to write files into, got {path.name!r}")
    return path


def _no_return(text: str) -> str | tuple[float, ...]:
    try:
        return text if text in ("detect", "none") else tuple(float(word) for word in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"expected detect, none or numbers, got {text!r}") from None


def _sector(text: str) -> str:
    """Check a sector; what was typed is recorded."""
    try:
        holds = all(math.isfinite(value) for value in _radians_of(text))
    except ValueError:
        holds = False
    if not holds:
        raise argparse.ArgumentTypeError(f"expected DEG:DEG, got {text!r}")
    return text


def _radians_of(sector: str) -> tuple[float, float]:
    first, last = (math.radians(float(word)) for word in sector.split(":"))
    return first, last


def _reach(text: str) -> float:
    metres = positive(text)
    if metres > MOST_REACH:
        raise argparse.ArgumentTypeError(f"expected metres, at most {MOST_REACH:g}, got {text!r}")
    return metres


def _opening_angle(text: str) -> float:
    degrees = not_negative(text)
    if degrees >= 180.0:
        raise argparse.ArgumentTypeError(f"expected an angle below 180 degrees, got {text!r}")
    return degrees


def radians(degrees: float | None) -> float | None:
    """Return an angle of the command line as the library takes it."""
    return None if degrees is None else math.radians(degrees)
