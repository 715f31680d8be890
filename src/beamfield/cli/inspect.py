"""``beamfield inspect``: what is in a log or a map, in words, as JSON, and as a picture."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.cli.calibrate import add_log_options, log_options
from beamfield.cli.formats import LOG_FORMATS, MAP_FORMATS
from beamfield.cli.provenance import file_name
from beamfield.cli.terminal import say, say_json
from beamfield.cli.wording import in_options
from beamfield.errors import BeamfieldError, FormatError, InvalidInputError

if TYPE_CHECKING:
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.sensors import ScanLog

DESCRIPTION = """
Say what is in a log (sensors, beams, ranges, what counted as no return, odometry, reference poses) or in a map (size,
place, free, occupied and unknown cells). With --out it is drawn too: the map; or the path, the scans seen from it, one
scan, and the histogram of the ranges.
"""

PICTURES = (".png", ".svg", ".pdf")
_BAGS = (".bag", ".mcap", ".db3")


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = subparsers.add_parser("inspect", help="say and draw what is in a log or a map", description=DESCRIPTION)
    parser.add_argument(
        "path", type=Path, metavar="LOG|MAP",
        help=f"a map: {MAP_FORMATS}; or a log: {LOG_FORMATS}",
    )  # fmt: skip
    parser.add_argument("--out", type=Path, metavar="FILE", help=f"draw it into this file ({', '.join(PICTURES)})")
    parser.add_argument("--json", action="store_true", help="print JSON (metres, radians, seconds)")
    parser.add_argument("--map", type=Path, metavar="MAP", help="draw the log over this map (needs reference poses)")
    parser.add_argument("--poses", type=Path, metavar="FILE", help="reference poses for the log: TUM or CSV file")
    parser.add_argument(
        "--map-topic", metavar="TOPIC", help="in a bag: look at the map on this topic, not at the scans"
    )
    add_log_options(parser, several=True)
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Read the file, print what is in it, draw it."""
    _check(arguments)
    content = _read(arguments)
    facts = {"source": file_name(arguments.path), **_facts(content, arguments.path)}
    grid = None if arguments.map is None else _read_background(content, arguments)
    # The picture first: if it fails, nothing was said either.
    if arguments.out is not None:
        _write_picture(content, grid, arguments)
    if arguments.json:
        say_json(facts)
    else:
        say(_text(facts, arguments))
    return 0


def _check(arguments: argparse.Namespace) -> None:
    out = arguments.out
    if out is not None and out.suffix.lower() not in PICTURES:
        raise InvalidInputError(f"--out: expected a name ending in {', '.join(PICTURES)}, got {out.name!r}")
    if arguments.map is not None and out is None:
        raise InvalidInputError("--map: the map is only drawn, so give --out too")


def _read(arguments: argparse.Namespace) -> OccupancyGrid | ScanLog:
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.io.read_log import read_log
    from beamfield.io.read_map import read_map
    from beamfield.io.trajectory import attach_poses, read_trajectory

    path: Path = arguments.path
    if arguments.map_topic is not None or _is_map(path):
        for option in ("map", "poses"):
            if getattr(arguments, option) is not None:
                raise InvalidInputError(f"--{option}: goes with a log, and {path} is read as a map")
        return read_map(path, topic=arguments.map_topic)
    if path.suffix == ".mat" and path.is_file():
        raise FormatError(path, "no log of scans; sightings of landmarks are for beamfield calibrate-landmarks")
    try:
        log = read_log(path, **log_options(arguments))
    except FormatError as error:
        return _map_of_bag(path, error)
    if arguments.poses is not None:
        log = attach_poses(log, read_trajectory(arguments.poses))
    return log


def _is_map(path: Path) -> bool:
    from beamfield.io.files.text_lines import read_lines

    if path.is_dir():
        return False
    if path.suffix in (".yaml", ".yml", ".pgm", ".png", ".bmp"):
        return True
    if path.suffix == ".dat" or path.name.endswith(".dat.gz"):
        # CoreSLAM's logs have this ending too.
        _, text = next(iter(read_lines(path)), (1, ""))
        return text.startswith(("robot_specifications", "global_map"))
    return False


def _map_of_bag(path: Path, no_log: FormatError) -> OccupancyGrid:
    """Return the map of a bag that holds no scans; if there is none either, say why it is no log."""
    from beamfield.io.read_map import read_map

    if not (path.is_dir() or path.suffix in _BAGS):
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


def _read_background(content: OccupancyGrid | ScanLog, arguments: argparse.Namespace) -> OccupancyGrid:
    from beamfield.io.read_map import read_map
    from beamfield.sensors import ScanLog

    if isinstance(content, ScanLog) and not any(sensor.has_poses for sensor in content.sensors.values()):
        raise InvalidInputError(f"--map: {arguments.path} has no reference poses to draw on a map; give --poses FILE")
    return read_map(arguments.map)


def _facts(content: OccupancyGrid | ScanLog, path: Path) -> dict[str, Any]:
    from beamfield.cli.inspect_summary import log_facts, map_facts
    from beamfield.io.maps.ros_map import ros_map_notes
    from beamfield.sensors import ScanLog

    if isinstance(content, ScanLog):
        return log_facts(content)
    return map_facts(content, ros_map_notes(path) if path.suffix in (".yaml", ".yml") else ())


def _write_picture(content: OccupancyGrid | ScanLog, grid: OccupancyGrid | None, arguments: argparse.Namespace) -> None:
    from beamfield.cli.inspect_picture import log_picture, map_picture
    from beamfield.io.files.atomic import atomic_file
    from beamfield.sensors import ScanLog

    # Two dollar signs in a name would make a formula of what is between them.
    title = file_name(arguments.path).replace("$", r"\$")
    figure = log_picture(content, title, grid) if isinstance(content, ScanLog) else map_picture(content, title)
    with atomic_file(arguments.out) as part:
        figure.savefig(part, dpi=150, facecolor="white")


def _text(facts: dict[str, Any], arguments: argparse.Namespace) -> str:
    from beamfield.cli.inspect_summary import log_text, map_text

    text = in_options(map_text(facts) if facts["kind"] == "map" else log_text(facts))
    if arguments.out is not None:
        return f"{facts['source']}: {text}\n\nwrote {arguments.out}"
    return f"{facts['source']}: {text}\n\nto see it, add --out {facts['source'].split('.')[0] or 'log'}.png"
