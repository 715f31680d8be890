"""``beamfield calibrate``: from a log and a map to calibrated parameters and a report."""

from __future__ import annotations

import argparse
import json
import math
import shutil
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli.calibrate_field import learn_field
from beamfield.cli.calibrate_stack import StackResult, add_stack_options, fit_for_stack, read_stack_request, write_patch
from beamfield.cli.formats import LOG_FORMATS, MAP_FORMATS
from beamfield.cli.progress import StageProgress
from beamfield.cli.provenance import provenance
from beamfield.cli.terminal import complain, say
from beamfield.cli.wording import in_options
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.printable import printable

if TYPE_CHECKING:
    from beamfield.calibration.calibrate import CalibrationOptions
    from beamfield.calibration.cross_fit import CrossFitMaps
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.sensors import ScanLog, SensorLog
    from beamfield.stacks.files.parameter_file import StackFile

DESCRIPTION = """
Learn the parameters of the beam model (z_hit, z_short, z_max, z_rand, sigma_hit, lambda_short) from a log with
reference poses and a map, and with --map those of the likelihood field. Prints tables and writes beam_model.yaml,
likelihood_field.yaml, calibration.json and report.html into the output folder, whole or not at all.
"""
ODOMETRY_NOTE = "reference poses: the odometry of the log, as asked for; its drift counts as noise of the sensor"


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = subparsers.add_parser(
        "calibrate", help="learn a sensor model from a log and a map", description=DESCRIPTION
    )
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_FORMATS)
    parser.add_argument("--map", type=Path, metavar="MAP",
                        help=f"{MAP_FORMATS}; without it, maps drawn from the log")  # fmt: skip
    parser.add_argument("--resolution", type=float, metavar="M", help="side of a cell of drawn maps (default: 0.05)")
    parser.add_argument("--poses", type=Path, metavar="FILE", help="reference poses: TUM or CSV file")
    parser.add_argument("--odometry", action="store_true",
                        help="without --map: the log's odometry as reference poses; drift counts as noise")  # fmt: skip
    parser.add_argument("--out", type=Path, default=Path("beamfield_calibration"), metavar="DIR",
                        help="output folder (default: %(default)s)")  # fmt: skip
    add_log_options(parser, several=True)
    model = parser.add_argument_group("model")
    model.add_argument("--unknown", choices=("skip", "free", "occupied"), default="skip",
                       help="rays that enter unknown cells: leave them out, pass, or stop (default: skip)")  # fmt: skip
    model.add_argument("--range-offset", choices=("auto", "on", "off"), default="auto",
                       help="hits beside the expected range (default: if held-out likelihood asks)")  # fmt: skip
    model.add_argument("--sigma-slope", choices=("auto", "on", "off"), default="auto",
                       help="sigma grows with range (default: if held-out likelihood asks)")  # fmt: skip
    model.add_argument("--hold", action="append", default=[], metavar="NAME=VALUE", help="hold a parameter; repeatable")
    model.add_argument(
        "--block",
        type=float,
        metavar="S",
        help="length of fit and held-out blocks (default: 20, or a twelfth of a shorter log)",
    )
    model.add_argument("--reference-error", type=float, default=0.04, metavar="M",
                       help="likelihood field and --stack: how wrong the reference poses may be, standard deviation "
                       "per axis, and a quarter of it in radians (default: 0.04)")  # fmt: skip
    model.add_argument("--seed", type=int, default=0, help="seed of every random choice (default: 0)")
    model.add_argument("--no-refine", action="store_true", help="do not refine reference poses to see their error")
    choice = parser.add_argument_group("scans that are used")
    choice.add_argument(
        "--min-travel", type=float, metavar="M", help="least motion since the last scan used (default: 0.02)"
    )
    choice.add_argument("--min-turn-deg", type=float, metavar="DEG", help="or least turn (default: 1.15)")
    choice.add_argument(
        "--max-turn-rate-deg", type=float, metavar="DEG/S", help="drop scans in faster turns (default: 86)"
    )
    add_stack_options(parser)
    parser.add_argument("--threads", type=int, help="processors to use (default: all)")
    parser.add_argument("--quiet", action="store_true", help="no progress")
    parser.set_defaults(run=run)


def add_log_options(parser: argparse.ArgumentParser, *, several: bool = False) -> None:
    """Add the options that say how a log is read, of several sensors or of one."""
    group = parser.add_argument_group("reading the log")
    group.add_argument(
        "--sensor",
        action="append",
        metavar="NAME",
        help=f"scan topic or sensor{'; repeatable' if several else ''} (default: the only one)",
    )
    group.add_argument(
        "--poses-topic",
        metavar="TOPIC",
        help="topic of the reference poses in the bag (default: tf from the map, or a topic named as truth)",
    )
    group.add_argument("--map-frame", metavar="FRAME", help="name of the map frame in tf (default: map)")
    group.add_argument("--base-frame", metavar="FRAME",
                       help="name of the robot's frame in tf (default: base_link or base_footprint)")  # fmt: skip
    group.add_argument(
        "--mount",
        type=float,
        nargs=3,
        metavar=("X", "Y", "YAW_DEG"),
        help="the sensor's pose on the robot, metres and degrees, for a bag without /tf_static",
    )
    group.add_argument("--no-return", default="detect", metavar="detect|none|V[,V...]",
                       help="values (metres) that mean 'no return' besides +inf (default: detect)")  # fmt: skip
    group.add_argument("--max-range", type=float, metavar="M", help="the sensor's limit, if the log is wrong about it")
    group.add_argument(
        "--min-range", type=float, metavar="M", help="shortest range that counts (default: as the log says)"
    )
    group.add_argument("--mask", action="append", default=[], metavar="DEG:DEG",
                       help="bearings whose readings do not count, as --mask=-170:-155; repeatable")  # fmt: skip
    group.add_argument("--opening-angle", type=float, metavar="DEG",
                       help="full width of the sensor's cones, if the log does not say it; 0: beams")  # fmt: skip
    group.add_argument(
        "--stamps",
        choices=("file", "order"),
        default="file",
        help="text logs: the file's stamps, or scans numbered one second apart (default: file)",
    )
    group.add_argument("--lone-poses", choices=("reference", "odometry"), default="reference",
                       help="text logs with one pose per scan: what it is (default: reference)")  # fmt: skip
    add_unpacking_option(group)


def add_unpacking_option(group: argparse._ActionsContainer) -> None:
    """Add the option that says how much a bag may unpack to; it is for all files that a command reads."""
    group.add_argument("--max-unpacked", type=float, metavar="GB",
                       help="gigabytes that a bag may unpack to (default: 500 times its size, 1 a chunk)")  # fmt: skip


def log_options(arguments: argparse.Namespace) -> dict[str, Any]:
    """Return the keyword arguments of `read_log` that the command line asks for."""
    given: str = arguments.no_return
    no_return: str | tuple[float, ...] = given
    if given not in ("detect", "none"):
        try:
            no_return = tuple(float(word) for word in given.split(","))
        except ValueError:
            raise InvalidInputError(f"--no-return: expected detect, none or numbers, got {given!r}") from None
    return {
        "sensor_topic": arguments.sensor,
        "poses_topic": arguments.poses_topic,
        "map_frame": arguments.map_frame,
        "base_frame": arguments.base_frame,
        "mount": None if arguments.mount is None else (*arguments.mount[:2], math.radians(arguments.mount[2])),
        "no_return": no_return,
        "max_range": arguments.max_range,
        "min_range": arguments.min_range,
        "opening_angle": _radians(arguments.opening_angle),
        "mask": [_sector(text) for text in arguments.mask],
        "stamps": arguments.stamps,
        "lone_poses": arguments.lone_poses,
    }


def _sector(text: str) -> tuple[float, float]:
    try:
        first, last = (math.radians(float(word)) for word in text.split(":"))
    except ValueError:
        first = last = math.nan
    if not (math.isfinite(first) and math.isfinite(last)):
        raise InvalidInputError(f"--mask: expected DEG:DEG, got {text!r}")
    return first, last


def run(arguments: argparse.Namespace) -> int:
    """Parse, read, calibrate, write."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.io.files.atomic import atomic_folder, check_folder_writable
    from beamfield.io.read_log import read_log
    from beamfield.io.read_map import read_map
    from beamfield.io.trajectory import attach_poses, read_trajectory

    if arguments.odometry and (arguments.map is not None or arguments.poses is not None):
        raise InvalidInputError("--odometry: only without --map and --poses: odometry is not in the map's frame")
    check_folder_writable(arguments.out)
    options = _options(arguments)
    patched = read_stack_request(arguments)
    outputs: dict[str, dict[str, str]] = {}
    text: list[str] = []
    converged = True
    with StageProgress(quiet=arguments.quiet) as progress:
        grid = None
        if arguments.map is not None:
            if arguments.resolution is not None:
                raise InvalidInputError("--resolution: is for maps drawn from the log, but --map gives one")
            progress("reading the map", 0, 1)
            grid = read_map(arguments.map)
            if not grid.occupied.any():
                raise InvalidInputError(f"{arguments.map}: the map has no occupied cell: no ray has an expected range")
        progress("reading the log", 0, 1)
        log = read_log(arguments.log, **log_options(arguments))
        if arguments.poses is not None:
            log = attach_poses(log, read_trajectory(arguments.poses))
        notes = (*map(in_options, log.notes), *([ODOMETRY_NOTE] if arguments.odometry else []))
        origin = _provenance(arguments)
        chosen = _chosen_sensors(log, arguments)
        if patched is not None and len(chosen) > 1:
            raise InvalidInputError(
                "--patch: one file cannot hold the parameters of several sensors; choose one with --sensor"
            )
        for name, logged in chosen.items():
            sensor = _with_poses(logged, arguments)
            files, table, good, stack = _calibrate_sensor(
                arguments, sensor, grid, options, origin, notes, progress, patched
            )
            # Several sensors: a folder each.
            outputs[_folder_name(name) if len(chosen) > 1 else "."] = files
            text.append((f"== {printable(name)}\n" if len(chosen) > 1 else "") + table)
            converged &= good
    with atomic_folder(arguments.out) as folder:
        for place, files in outputs.items():
            (folder / place).mkdir(exist_ok=True)
            for file_name, content in files.items():
                (folder / place / file_name).write_text(content, encoding="utf-8")
    for note in notes:
        say(f"note: {printable(note)}")
    say("\n\n".join(text))
    say(f"\nwrote {', '.join(next(iter(outputs.values())))} into {arguments.out}")
    if patched is not None and stack is not None:
        say(write_patch(patched, stack))
    if not converged:
        complain("beamfield: warning: the fit did not converge")
        return 3
    return 0


def _options(arguments: argparse.Namespace) -> CalibrationOptions:
    from beamfield.calibration.calibrate import CalibrationOptions
    from beamfield.calibration.selection import SelectionOptions

    given = {
        "min_travel": arguments.min_travel,
        "min_turn": _radians(arguments.min_turn_deg),
        "max_turn_rate": _radians(arguments.max_turn_rate_deg),
    }
    return CalibrationOptions(
        selection=SelectionOptions(**{name: value for name, value in given.items() if value is not None}),
        unknown=arguments.unknown,
        block_s=arguments.block,
        range_offset=arguments.range_offset,
        sigma_slope=arguments.sigma_slope,
        hold=_held(arguments.hold),
        refine=not arguments.no_refine,
        seed=arguments.seed,
    )


def _radians(degrees: float | None) -> float | None:
    return None if degrees is None else math.radians(degrees)


def _held(words: list[str]) -> dict[str, float]:
    held = {}
    for word in words:
        name, _, value = word.partition("=")
        try:
            held[name] = float(value)
        except ValueError:
            raise InvalidInputError(f"--hold: expected NAME=NUMBER, got {word!r}") from None
    return held


def _provenance(arguments: argparse.Namespace) -> dict[str, Any]:
    from beamfield.io.maps.ros_map import image_path

    inputs = [("log", arguments.log)]
    if arguments.map is not None:
        inputs.append(("map", arguments.map))
        if arguments.map.suffix in (".yaml", ".yml"):
            inputs.append(("map image", image_path(arguments.map)))
    if arguments.poses is not None:
        inputs.append(("poses", arguments.poses))
    if arguments.patch is not None:
        inputs.append(("parameters", arguments.patch))
    files = {"log", "map", "poses", "patch", "out", "run", "quiet", "threads", "seed"}
    given = {name: value for name, value in sorted(vars(arguments).items()) if name not in files}
    return provenance(inputs, given, arguments.seed)


def _chosen_sensors(log: ScanLog, arguments: argparse.Namespace) -> Mapping[str, SensorLog]:
    """Return the sensors to calibrate: those asked for, or the only one."""
    if arguments.sensor:
        return {name: log.only_sensor(name) for name in arguments.sensor}
    if len(log.sensors) != 1:
        known = ", ".join(repr(name) for name in log.sensors)
        raise InvalidInputError(f"{arguments.log}: has several sensors, choose with --sensor: {known}")
    return log.sensors


def _with_poses(sensor: SensorLog, arguments: argparse.Namespace) -> SensorLog:
    """Return the sensor with the poses that were asked for."""
    if arguments.odometry:
        if not sensor.has_odometry:
            raise TooLittleDataError(f"{arguments.log}: --odometry: the log has none")
        return sensor.with_poses(sensor.odometry)
    if not sensor.has_poses:
        wheels = arguments.map is None and sensor.has_odometry
        hint = "--poses, or --odometry to trust the wheels" if wheels else "a TUM or CSV file with --poses"
        raise InvalidInputError(f"{arguments.log}: no scan has a reference pose; give {hint}")
    return sensor


def _folder_name(sensor: str) -> str:
    return "".join(c if c.isalnum() or c in "-_." else "_" for c in sensor.strip("/")) or "sensor"


def _calibrate_sensor(
    arguments: argparse.Namespace,
    sensor: SensorLog,
    grid: OccupancyGrid | None,
    options: CalibrationOptions,
    origin: dict[str, Any],
    notes: tuple[str, ...],
    progress: StageProgress,
    patched: StackFile | None,
) -> tuple[dict[str, str], str, bool, StackResult | None]:
    """Calibrate one sensor; return files to write, the table to print, whether the fit converged, and the stack's."""
    from beamfield.calibration.calibrate import calibrate
    from beamfield.calibration.cross_fit import build_cross_fit_maps
    from beamfield.io.parameters.beam_model_file import beam_model_text
    from beamfield.report.as_json import calibration_as_dict
    from beamfield.report.html import render_report
    from beamfield.report.results import calibration_summary

    try:
        maps: OccupancyGrid | CrossFitMaps
        if grid is None:
            maps = build_cross_fit_maps(sensor, resolution=arguments.resolution or 0.05, progress=progress)
        else:
            maps = grid
        result = calibrate(sensor, maps, options, progress=progress)
        field = None if grid is None else learn_field(arguments, sensor, grid, result, origin, progress)
        if field is not None:
            result = replace(result, findings=(*result.findings, *field.findings))
        stack = None
        if arguments.stack is not None and grid is not None:
            stack = fit_for_stack(arguments, sensor, grid, result, patched, progress)
    except (InvalidInputError, TooLittleDataError) as error:
        raise type(error)(f"{arguments.log}: {error}") from error
    progress("writing the report", 0, 1)
    document = {"provenance": origin, "notes": list(notes), **calibration_as_dict(result)}
    if field is not None:
        document["likelihood_field"] = field.document
    if stack is not None:
        document["stack"] = stack.document
    files = {
        "beam_model.yaml": beam_model_text(
            result.parameters, sensor.finder, intervals=result.intervals.intervals, provenance=origin
        ),
        "calibration.json": json.dumps(document, indent=1, allow_nan=False) + "\n",
        "report.html": render_report(
            result,
            maps,
            sensor,
            {**origin, "notes": notes},
            sections=[part.section for part in (field, stack) if part is not None],
        ),
    }
    if field is not None:
        files |= field.files
    if stack is not None:
        files[stack.file_name] = stack.file_text
    # Lines are broken for a terminal only: in a file or a pipe, one line is one parameter or warning.
    width = shutil.get_terminal_size().columns if sys.stdout.isatty() else None
    table = calibration_summary(result, width=width, wording=in_options)
    table = "\n\n".join([table, *(part.table for part in (field, stack) if part is not None)])
    return files, table, result.converged, stack
