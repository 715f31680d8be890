"""``beamfield doctor``: what is wrong with a localisation's parameter file."""

from __future__ import annotations

import argparse
import shutil
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli.calibrate import add_log_options, log_options
from beamfield.cli.formats import LOG_FORMATS, MAP_FORMATS
from beamfield.cli.terminal import say, say_json
from beamfield.errors import InvalidInputError
from beamfield.printable import printable

if TYPE_CHECKING:
    from beamfield.finding import Finding
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.sensors import SensorLog
    from beamfield.stacks.doctor.subject import MapFile
    from beamfield.stacks.files.parameter_file import StackFile

DESCRIPTION = """
Examine the measurement model in a parameter file of nav2, ROS 1 amcl, Beluga, MRPT or F1TENTH: what is wrong, why it
matters and what to do, worst first. With --map and --log it looks at what the robot really sees. Exit code 1 on errors
and warnings, 0 on advice.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = subparsers.add_parser("doctor", help="what is wrong with a parameter file", description=DESCRIPTION)
    parser.add_argument("params", type=Path, metavar="PARAMS", help="YAML, ROS 1 launch file or MRPT ini")
    add_file_options(parser)
    parser.add_argument("--map", type=Path, metavar="MAP", help=f"the map: {MAP_FORMATS}")
    parser.add_argument("--log", type=Path, metavar="LOG", help=f"a log of the robot's scans: {LOG_FORMATS}")
    parser.add_argument("--poses", type=Path, metavar="FILE",
                        help="reference poses for the log: TUM or CSV (default: those in the log)")  # fmt: skip
    add_log_options(parser)
    parser.add_argument("--json", action="store_true", help="print machine-readable JSON")
    parser.set_defaults(run=run)


def add_file_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that say whose parameter file it is."""
    group = parser.add_argument_group("the parameter file")
    group.add_argument("--stack", metavar="NAME", help="nav2, ros1, beluga, mrpt or f1tenth (default: find out)")
    group.add_argument("--model", metavar="NAME", help="measurement model (default: as the file says)")
    group.add_argument(
        "--section", metavar="LABEL", help="which section, if several have such parameters; its line will do"
    )


def run(arguments: argparse.Namespace) -> int:
    """Read, examine, print."""
    from beamfield.stacks.doctor.examine import examine
    from beamfield.stacks.files.parameter_file import read_stack_file

    file = read_stack_file(
        arguments.params,
        stack=arguments.stack,
        model=arguments.model,
        section=arguments.section,
        unknown_model="default",
    )
    if arguments.poses is not None and arguments.log is None:
        raise InvalidInputError("--poses: are poses of a log's scans, but there is no --log")
    grid, map_file = (None, None) if arguments.map is None else _read_map(arguments.map)
    log = None if arguments.log is None else _read_log(arguments)
    found = examine(file, grid=grid, map_file=map_file, log=log)
    if arguments.json:
        say_json(_as_document(file, found))
    else:
        say(_as_text(file, found))
    return 1 if any(item.severity != "info" for item in found) else 0


def _read_map(path: Path) -> tuple[OccupancyGrid, MapFile]:
    from beamfield.io.files.yaml_file import read_yaml
    from beamfield.io.maps.ros_map import between_share, ros_map_notes
    from beamfield.io.read_map import read_map
    from beamfield.stacks.doctor.subject import MapFile

    grid = read_map(path)
    yaw = float(grid.origin[2])
    if path.suffix not in (".yaml", ".yml"):
        return grid, MapFile(path.name, yaw=yaw)
    mode = str(read_yaml(path).values.get("mode", "trinary"))
    return grid, MapFile(
        path.name, mode, yaw, tuple(ros_map_notes(path)), between_share(path) if mode == "trinary" else 0.0
    )


def _read_log(arguments: argparse.Namespace) -> SensorLog:
    from beamfield.io.read_log import read_log
    from beamfield.io.trajectory import attach_poses, read_trajectory

    log = read_log(arguments.log, **log_options(arguments))
    if arguments.poses is not None:
        log = attach_poses(log, read_trajectory(arguments.poses))
    if arguments.sensor and len(arguments.sensor) > 1:
        raise InvalidInputError(f"--sensor: the doctor looks at one sensor, got {len(arguments.sensor)}")
    return log.only_sensor(arguments.sensor[0] if arguments.sensor else None)


def _as_text(file: StackFile, found: tuple[Finding, ...]) -> str:
    width = min(shutil.get_terminal_size((100, 24)).columns, 120)
    section = f", section {printable(file.section.label)}" if file.section.label else ""
    lines = [f"{file.section.path}: {file.stack}, {file.model}{section}"]
    for item in found:
        where = f" (line {item.line})" if item.line is not None else ""
        lines.append("")
        head = f"{item.severity}: {item.name}{where}"
        lines.append(head)
        for label, text in (("seen", item.text), ("why", item.why), ("do", item.do)):
            lines += textwrap.wrap(text, width, initial_indent=f"  {label + ':':6}", subsequent_indent=" " * 8)
    counts = {kind: sum(item.severity == kind for item in found) for kind in ("error", "warning", "info")}
    summary = ", ".join(f"{n} {kind}{'s' if n != 1 and kind != 'info' else ''}" for kind, n in counts.items() if n)
    return "\n".join([*lines, "", summary or "nothing found"])


def _as_document(file: StackFile, found: tuple[Finding, ...]) -> dict[str, Any]:
    return {
        "file": file.section.path.name,
        "stack": file.stack,
        "stack_is_certain": file.stack_is_certain,
        "model": file.model,
        "section": file.section.label,
        "findings": [
            {
                "name": item.name, "severity": item.severity, "parameter": item.parameter or None, "line": item.line,
                "seen": item.text, "why": item.why, "remedy": item.do, "values": dict(item.values),
            }
            for item in found
        ],
    }  # fmt: skip
