"""Build a map from a log with poses.

Build an occupancy map from the scans of a log and their reference poses, and write it as a map_server map: a YAML file
and a PGM picture of the same name, both or none. Poses are taken as they are: a log of a SLAM system, or with --poses a
trajectory; wheel odometry alone (--odometry) bends a map. With --map, the poses of a log that has none are fitted to
that map first, and the new one is drawn in its frame: what has changed, or finer cells.

for example:

  beamfield map run.log --out map.yaml
  beamfield map run.bag --poses slam.tum --resolution 0.1
  beamfield map run.bag --map old.yaml --out new.yaml
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from beamfield.cli import inputs, options
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command, not_negative, positive
from beamfield.errors import InvalidInputError, TooLittleDataError, about_file

if TYPE_CHECKING:
    from beamfield.cli.progress import StageProgress
    from beamfield.localization.fitted_poses import FittedPoses
    from beamfield.maps.mapping import InverseSensorModel
    from beamfield.sensors import SensorLog


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "map", __doc__)
    parser.add_argument("log", type=Path, metavar="LOG", help=options.LOG_FORMATS)
    options.add_out(parser, "beamfield_map.yaml", metavar="MAP.yaml", what="map to write, beside its .pgm")
    options.add_map(parser, what="a map to which the poses of a log without any are fitted")
    options.add_poses(parser, fitted=True)
    parser.add_argument("--odometry", action="store_true", help="use the log's odometry as poses")
    parser.add_argument("--resolution", type=positive, default=0.05, metavar="M", help="side of a cell (default: 0.05)")
    parser.add_argument("--mode", choices=("trinary", "raw"), default="trinary",
                        help="write free, occupied and unknown, or whole percents (default: trinary)")  # fmt: skip
    options.add_log(parser)
    model = parser.add_argument_group("what a reading says about cells")
    model.add_argument("--hit", type=float, default=0.7, metavar="P",
                       help="probability of the cell where it ends (default: 0.7)")  # fmt: skip
    model.add_argument("--passed", type=float, default=0.4, metavar="P",
                       help="probability of the cells before (default: 0.4)")  # fmt: skip
    model.add_argument("--longest-hit", type=positive, metavar="M",
                       help="longer readings only clear cells, up to there (default: no limit)")  # fmt: skip
    model.add_argument("--clear-without-return", type=not_negative, default=0.0, metavar="M",
                       help="how far readings without return clear cells (default: not at all)")  # fmt: skip


def run(arguments: argparse.Namespace) -> Outcome:
    """Parse, read, build, write."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.cli.fitted_poses import NAME, as_document
    from beamfield.cli.inspect_summary import map_facts, map_text
    from beamfield.io.maps.ros_map_writer import write_map
    from beamfield.maps.mapping import build_map, share_of_hits_in_obstacles

    _check(arguments)
    model = _inverse_model(arguments)
    out: Path = arguments.out
    with options.progress(arguments) as progress:
        progress("reading the log", 0, 1)
        sensor, notes = inputs.read_sensor(arguments)
        sensor, fitted, more = _posed(sensor, arguments, progress)
        with about_file(arguments.log):
            grid = build_map(
                sensor,
                resolution=arguments.resolution,
                inverse_model=model,
                progress=lambda done, total: progress("building the map", done, total),
            )
        if not grid.occupied.any():
            raise TooLittleDataError(f"{arguments.log}: {len(sensor)} scans mark no cell as occupied; no map written")
        progress("writing", 0, 1)
        write_map(grid, out, mode=arguments.mode)
    facts = map_facts(grid)
    share = share_of_hits_in_obstacles(grid, sensor)
    text = f"{map_text(facts)}\nsharpness: {100.0 * share:.1f}% of the hits end within one cell of an occupied one"
    picture = out.with_suffix(".pgm")
    document = {
        **facts, "notes": [*notes, *more, *facts["notes"]], "scans": len(sensor),
        "share_of_hits_in_obstacles": share, NAME: as_document(fitted),
    }  # fmt: skip
    return Outcome(f"wrote {out} and {picture.name}", text, document, (*notes, *more), [out, picture])


def _check(arguments: argparse.Namespace) -> None:
    from beamfield.io.files.atomic import check_writable

    if arguments.out.suffix not in (".yaml", ".yml"):
        raise InvalidInputError(f"--out: expected a name ending in .yaml or .yml, got {arguments.out.name!r}")
    for written in (arguments.out, arguments.out.with_suffix(".pgm")):
        check_writable(written)
    if arguments.odometry and arguments.poses is not None:
        raise InvalidInputError("--odometry: poses come from --poses already; give one of the two")
    if arguments.odometry and arguments.map is not None:
        raise InvalidInputError("--odometry: poses are fitted to --map already; give one of the two")
    if arguments.start is not None and arguments.map is None:
        raise InvalidInputError("--start: is for poses that are fitted to a map; give --map")


def _posed(
    sensor: SensorLog, arguments: argparse.Namespace, progress: StageProgress
) -> tuple[SensorLog, FittedPoses | None, tuple[str, ...]]:
    """Return the log with poses: its own, its odometry, or those fitted to a map, what was fitted, and notes."""
    from beamfield.cli.fitted_poses import posed_as_asked

    if arguments.map is None:
        return inputs.require_poses(sensor, arguments), None, ()
    log, fitted, found = posed_as_asked(sensor, inputs.read_walls(arguments), arguments, progress)
    return log, fitted, tuple(finding.full_text for finding in found)


def _inverse_model(arguments: argparse.Namespace) -> InverseSensorModel:
    from beamfield.maps.mapping import InverseSensorModel

    standard = InverseSensorModel()
    return InverseSensorModel(
        hit=arguments.hit,
        passed=arguments.passed,
        lowest=min(standard.lowest, arguments.passed),
        highest=max(standard.highest, arguments.hit),
        clear_without_return=arguments.clear_without_return,
        longest_hit=arguments.longest_hit,
    )
