"""Show what a log, a map or a file of poses contains.

Show what a log contains (sensors, beams, ranges, what counted as no return, odometry, reference poses), a map (size,
place, free, occupied and unknown cells) or a file of poses (time, path, extent). With --out it is drawn too: the map;
or the path, the scans seen from it, one scan, and the histogram of the ranges.

for example:

  beamfield inspect run.bag
  beamfield inspect run.bag --map map.yaml --out run.png
"""

from __future__ import annotations

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli import inputs, options
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command
from beamfield.cli.provenance import file_name
from beamfield.cli.wording import in_options
from beamfield.errors import BeamfieldError, FormatError, InvalidInputError

if TYPE_CHECKING:
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.sensors import ScanLog, Track

    Content = OccupancyGrid | ScanLog | Track


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "inspect", __doc__)
    formats = f"a map: {options.MAP_FORMATS}; poses: TUM or CSV; or a log: {options.LOG_FORMATS}"
    parser.add_argument("log", type=Path, metavar="LOG|MAP|POSES", help=formats)
    options.add_out(parser, None, metavar="FILE", what=f"draw it into this file ({', '.join(options.PICTURES)})")
    options.add_map(parser, what="draw the log, which needs reference poses, over this map")
    options.add_poses(parser)
    options.add_log(parser, several=True)


def run(arguments: argparse.Namespace) -> Outcome:
    """Read the file, draw it, say what is in it."""
    options.check_output(arguments.out, "out", *options.PICTURES)
    if arguments.out is None and arguments.map is not None:
        raise InvalidInputError("--map: the map is only drawn, so give --out too")
    with options.progress(arguments) as progress:
        progress("reading", 0, 1)
        content = _read(arguments)
        facts = {"source": file_name(arguments.log), **_facts(content, arguments.log)}
        grid = None if arguments.map is None else _read_background(content, arguments)
        if arguments.out is not None:
            progress("drawing", 0, 1)
            _write_picture(content, grid, arguments)
    text = f"{facts['source']}: {_text(facts)}"
    if arguments.out is not None:
        return Outcome(f"wrote {arguments.out}", text, facts, wrote=[arguments.out])
    source = facts["source"]
    # What follows the last point of a folder's name is no ending.
    stem = source if arguments.log.is_dir() else Path(source.removesuffix(".gz")).stem
    # A map's own picture may have this name.
    picture = f"{stem}_drawn.png" if Path(f"{stem}.png").exists() else f"{stem}.png"
    hint = f"to see it, add --out {shlex.quote(picture)}"
    return Outcome(hint, text, facts, brief=text.splitlines()[0])


def _read(arguments: argparse.Namespace) -> Content:
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.io.read_map import read_map

    path: Path = arguments.log
    if inputs.looks_like_a_map(path) or (arguments.map_topic is not None and arguments.map is None):
        options.refuse(arguments, ("map", "poses"), f"goes with a log, and {path} is read as a map")
        options.refuse_reading(arguments, f"says how a log is read, and {path} is read as a map")
        try:
            return read_map(path, topic=arguments.map_topic)
        except FormatError as error:
            raise (inputs.parameters_instead_of("map", path) or error) from None
    try:
        return inputs.read_scans(arguments)
    except FormatError as error:
        return _poses(path, arguments) or _map_of_bag(path, error)


def _poses(path: Path, arguments: argparse.Namespace) -> Track | None:
    """Return the poses of a file that is a table of them; None if it is none."""
    from beamfield.io.trajectory import is_pose_table, read_trajectory

    try:
        # A table of poses by its name has been looked at as a log in vain: the reader of poses says what it expects.
        if path.is_dir() or not (is_pose_table(path) or path.suffix in (".csv", ".tum")):
            return None
    except FormatError:  # binary
        return None
    if arguments.poses is not None:
        raise InvalidInputError(f"--poses: goes with a log, and {path} is read as poses")
    options.refuse_reading(arguments, f"says how a log is read, and {path} is read as poses")
    return read_trajectory(path)


def _map_of_bag(path: Path, no_log: FormatError) -> OccupancyGrid:
    """Return the map of a bag that holds no scans; if there is none either, say why it is no log."""
    from beamfield.io.files.bag_storage import BAG_SUFFIXES
    from beamfield.io.read_map import read_map

    if not (path.is_dir() or path.suffix in BAG_SUFFIXES):
        raise no_log
    from beamfield.io.bags.bag_file import BagFile
    from beamfield.io.bags.map_topic import OCCUPANCY_GRID

    try:
        with BagFile(path) as bag:
            has_map = bool(bag.of_type(OCCUPANCY_GRID))
    except BeamfieldError:
        has_map = False
    if not has_map:
        raise no_log from None
    return read_map(path)


def _read_background(content: Content, arguments: argparse.Namespace) -> OccupancyGrid:
    from beamfield.sensors import ScanLog

    if isinstance(content, ScanLog) and not any(sensor.has_poses for sensor in content.sensors.values()):
        raise FormatError(arguments.log, "no scan has a reference pose to draw it on a map; give --poses FILE")
    return inputs.read_grid(arguments)


def _facts(content: Content, path: Path) -> dict[str, Any]:
    from beamfield.cli.inspect_summary import log_facts, map_facts, poses_facts
    from beamfield.io.maps.ros_map import ros_map_notes
    from beamfield.sensors import ScanLog, Track

    if isinstance(content, ScanLog):
        return log_facts(content)
    if isinstance(content, Track):
        return poses_facts(content)
    return map_facts(content, ros_map_notes(path) if path.suffix in (".yaml", ".yml") else ())


def _write_picture(content: Content, grid: OccupancyGrid | None, arguments: argparse.Namespace) -> None:
    from beamfield.cli.inspect_picture import log_picture, map_picture, poses_picture
    from beamfield.io.files.atomic import atomic_file
    from beamfield.sensors import ScanLog, Track

    # Two dollar signs in a name would make a formula of what is between them.
    title = file_name(arguments.log).replace("$", r"\$")
    if isinstance(content, ScanLog):
        figure = log_picture(content, title, grid)
    elif isinstance(content, Track):
        figure = poses_picture(content, title, grid)
    else:
        figure = map_picture(content, title)
    with atomic_file(arguments.out) as part:
        figure.savefig(part, dpi=150, facecolor="white")


def _text(facts: dict[str, Any]) -> str:
    from beamfield.cli.inspect_summary import log_text, map_text, poses_text

    text = {"map": map_text, "log": log_text, "poses": poses_text}[facts["kind"]]
    return in_options(text(facts))
