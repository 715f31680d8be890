"""Find what is wrong with a parameter file.

Examine the measurement model in a parameter file of nav2, ROS 1 amcl, Beluga, MRPT or F1TENTH: what is wrong, why it
matters and what to do, worst first. With --map and --log it looks at what the robot really sees, and replays the
program's filter on the log: does it lose the robot? Exit code 1 on errors and warnings, 0 on advice.

for example:

  beamfield doctor nav2_params.yaml
  beamfield doctor nav2_params.yaml --map map.yaml --log run.bag
"""

from __future__ import annotations

import argparse
import shutil
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli import inputs, options
from beamfield.cli.fitted_poses import posed_as_asked
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command
from beamfield.cli.progress import StageProgress
from beamfield.cli.wording import in_options
from beamfield.errors import FormatError, InvalidInputError, TooLittleDataError
from beamfield.localization.robot_faults import OF_THE_ROBOT
from beamfield.printable import printable

if TYPE_CHECKING:
    from beamfield.finding import Finding
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.sensors import SensorLog
    from beamfield.stacks.doctor.subject import MapFile
    from beamfield.stacks.files.parameter_file import StackFile


# What is said of the motion noise is said of the fault where the odometry, the laser's mount or a clock is wrong.
MOTION_NOISE = ("motion-noise-narrow", "motion-noise-wide")
# At fitted poses these say why readings disagree with the map.
WHY_THE_MAP_DISAGREES = {"map-out-of-date", "scan-parts-disagree"}
# A fault of some builds of nav2, which files do not tell apart.
ONLY_IF_LOST = "distance-queue-uninitialised"


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "doctor", __doc__)
    parser.add_argument("params", type=Path, metavar="PARAMS", help="YAML, ROS 1 launch file or MRPT ini")
    options.add_whose_files(parser, model=True)
    options.add_map(parser)
    parser.add_argument("--log", type=Path, metavar="LOG", help=f"a log of the robot's scans: {options.LOG_FORMATS}")
    options.add_poses(parser, fitted=True)
    options.add_log(parser)


def run(arguments: argparse.Namespace) -> Outcome:
    """Read and examine."""
    from beamfield.finding import worst_first
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
    if arguments.log is None:
        options.refuse_reading(arguments, "says how a log is read, but there is no --log")
    if arguments.start is not None and (arguments.log is None or arguments.map is None):
        raise InvalidInputError("--start: is for poses of a --log that are fitted to a --map")
    with options.progress(arguments) as progress:
        progress("reading", 0, 1)
        of_poses: tuple[Finding, ...] = ()
        grid, map_file = (None, None) if arguments.map is None else _read_map(arguments)
        log = None
        frames: tuple[str, ...] = ()
        notes = (file.uncertainty,) if file.uncertainty else ()
        if arguments.log is not None:
            whole = inputs.read_log_of_one_sensor(arguments)
            log, frames, notes = whole.only_sensor(), whole.frames, (*notes, *whole.notes)
        if log is not None and grid is not None:
            log, of_poses, more = _posed(log, grid, arguments, progress)
            notes = (*notes, *more)
        progress("examining", 0, 1)
        found = examine(file, grid=grid, map_file=map_file, log=log, frames=frames)
        if log is not None and grid is not None and not any(item.severity == "error" for item in found):
            replay, more = _replayed(file, grid, log, progress)
            found, notes = (*replay, *found), (*notes, *more)
    hidden = {item.name for item in of_poses}
    if "own-poses-lost" not in hidden:
        hidden.add(ONLY_IF_LOST)
    if hidden & set(OF_THE_ROBOT):
        hidden.update(MOTION_NOISE)
    if hidden & WHY_THE_MAP_DISAGREES:
        hidden.update(("map-disagrees", "map-disagrees-in-part"))
    # The robot's own faults come first: no value of a parameter mends them.
    found = worst_first((*of_poses, *(item for item in found if item.name not in hidden)))
    code = 1 if any(item.severity != "info" for item in found) else 0
    return Outcome(_counts(found), _as_text(file, found), _as_document(file, found), notes, code=code)


def _posed(
    log: SensorLog, grid: OccupancyGrid, arguments: argparse.Namespace, progress: StageProgress
) -> tuple[SensorLog, tuple[Finding, ...], tuple[str, ...]]:
    """Return the log with poses, its own or fitted to the map, what is wrong with them, and notes.

    If none can be fitted it is the log as it was, and a note says why; without poses if most readings refute its own.
    """
    import numpy as np

    try:
        log, _, found = posed_as_asked(log, grid, arguments, progress)
    except (FormatError, TooLittleDataError) as error:
        return log, (), (f"{error}; tests at the scans' poses are left out",)
    infos = [finding.full_text for finding in found if finding.severity == "info"]
    if arguments.poses is None and any(one.name == "map-disagrees" for one in found):
        log = log.with_poses(np.full((len(log), 3), np.nan))
        infos.append("most readings disagree with the map at the log's poses; tests at them are left out")
    return log, tuple(finding for finding in found if finding.severity != "info"), tuple(infos)


def _replayed(
    file: StackFile, grid: OccupancyGrid, log: SensorLog, progress: StageProgress
) -> tuple[tuple[Finding, ...], tuple[str, ...]]:
    """Return what the program's filter makes of the log, or why not; nothing without odometry or poses."""
    from beamfield.stacks.doctor.replayed import replayed

    if not (log.has_odometry and log.has_poses):
        return (), ()
    try:
        return (replayed(file, grid, log, progress=progress),), ()
    except (FormatError, TooLittleDataError) as error:
        return (), (f"{error}; the filter was not replayed",)


def _read_map(arguments: argparse.Namespace) -> tuple[OccupancyGrid, MapFile]:
    from beamfield.io.files.yaml_file import read_yaml
    from beamfield.io.maps.ros_map import between_share, ros_map_notes
    from beamfield.stacks.doctor.subject import MapFile

    path, grid = arguments.map, inputs.read_grid(arguments)
    if path.suffix not in (".yaml", ".yml"):
        return grid, MapFile(path.name)
    mode = str(read_yaml(path).values.get("mode", "trinary"))
    return grid, MapFile(path.name, mode, tuple(ros_map_notes(path)), between_share(path) if mode == "trinary" else 0.0)


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
            lines += textwrap.wrap(
                in_options(text), width, initial_indent=f"  {label + ':':6}", subsequent_indent=" " * 8
            )
    return "\n".join(lines)


def _counts(found: tuple[Finding, ...]) -> str:
    counts = {kind: sum(item.severity == kind for item in found) for kind in ("error", "warning", "info")}
    summary = ", ".join(f"{n} {kind}{'s' if n != 1 and kind != 'info' else ''}" for kind, n in counts.items() if n)
    return summary or "nothing found"


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
