"""``beamfield map``: an occupancy map from a log with poses."""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from typing import TYPE_CHECKING

from beamfield.cli.calibrate import add_log_options, log_options
from beamfield.cli.formats import LOG_FORMATS
from beamfield.cli.progress import StageProgress
from beamfield.cli.terminal import say
from beamfield.cli.wording import in_options
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.printable import printable

if TYPE_CHECKING:
    from beamfield.maps.mapping import InverseSensorModel
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.sensors import ScanLog, SensorLog

DESCRIPTION = """
Build an occupancy map from the scans of a log and their reference poses, and write it as a map_server map: a YAML file
and a PGM picture of the same name, both or none. Poses are taken as they are: a log of a SLAM system, or with --poses a
trajectory; wheel odometry alone (--odometry) bends a map.
"""


def add_parser(subparsers: argparse._SubParsersAction[argparse.ArgumentParser]) -> None:
    """Register the command."""
    parser = subparsers.add_parser("map", help="build a map from a log with poses", description=DESCRIPTION)
    parser.add_argument("log", type=Path, metavar="LOG", help=LOG_FORMATS)
    parser.add_argument("--out", type=Path, required=True, metavar="MAP.yaml", help="map to write")
    parser.add_argument("--overwrite", action="store_true", help="replace a map that is there")
    parser.add_argument("--poses", type=Path, metavar="FILE", help="reference poses: TUM or CSV file")
    parser.add_argument("--odometry", action="store_true", help="use the log's odometry as poses")
    parser.add_argument("--resolution", type=float, default=0.05, metavar="M", help="side of a cell (default: 0.05)")
    parser.add_argument("--mode", choices=("trinary", "raw"), default="trinary",
                        help="write free, occupied and unknown, or whole percents (default: trinary)")  # fmt: skip
    parser.add_argument("--quiet", action="store_true", help="no progress")
    add_log_options(parser)
    model = parser.add_argument_group("what a reading says about cells")
    model.add_argument("--hit", type=float, default=0.7, metavar="P",
                       help="probability of the cell where it ends (default: 0.7)")  # fmt: skip
    model.add_argument("--passed", type=float, default=0.4, metavar="P",
                       help="probability of the cells before (default: 0.4)")  # fmt: skip
    model.add_argument("--longest-hit", type=float, metavar="M",
                       help="longer readings only clear cells, up to there (default: no limit)")  # fmt: skip
    model.add_argument("--clear-without-return", type=float, default=0.0, metavar="M",
                       help="how far readings without return clear cells (default: not at all)")  # fmt: skip
    parser.set_defaults(run=run)


def run(arguments: argparse.Namespace) -> int:
    """Parse, read, build, write."""
    # The numerical libraries load here, so that --help answers at once.
    from beamfield.io.maps.ros_map import write_map
    from beamfield.io.read_log import read_log
    from beamfield.io.trajectory import attach_poses, read_trajectory
    from beamfield.maps.mapping import build_map

    _check(arguments)
    model = _inverse_model(arguments)
    with StageProgress(quiet=arguments.quiet) as progress:
        progress("reading the log", 0, 1)
        log = read_log(arguments.log, **log_options(arguments))
        if arguments.poses is not None:
            log = attach_poses(log, read_trajectory(arguments.poses))
        sensor = _sensor(log, arguments)
        try:
            grid = build_map(
                sensor,
                resolution=arguments.resolution,
                inverse_model=model,
                progress=lambda done, total: progress("building the map", done, total),
            )
        except InvalidInputError as error:
            raise InvalidInputError(f"{arguments.log}: {error}") from error
        if not grid.occupied.any():
            raise TooLittleDataError(f"{arguments.log}: {len(sensor)} scans mark no cell as occupied; no map written")
        progress("writing", 0, 1)
        write_map(grid, arguments.out, mode=arguments.mode)
    for note in log.notes:
        say(f"note: {printable(in_options(note))}")
    say(_summary(grid, sensor))
    say(f"wrote {arguments.out} and {arguments.out.with_suffix('.pgm').name}")
    return 0


def _check(arguments: argparse.Namespace) -> None:
    from beamfield.io.files.atomic import check_writable

    out: Path = arguments.out
    if out.suffix not in (".yaml", ".yml"):
        raise InvalidInputError(f"--out: expected a name ending in .yaml or .yml, got {out.name!r}")
    if not arguments.overwrite:
        for path in (out, out.with_suffix(".pgm")):
            if path.exists():
                raise InvalidInputError(
                    f"{path}: is there already; choose another name, or replace it with --overwrite"
                )
    check_writable(out)
    if not 0.0 < arguments.resolution < math.inf:
        raise InvalidInputError(f"--resolution: expected a positive number of metres, got {arguments.resolution}")
    if arguments.odometry and arguments.poses is not None:
        raise InvalidInputError("--odometry: poses come from --poses already; give one of the two")
    if arguments.sensor and len(arguments.sensor) > 1:
        raise InvalidInputError(f"--sensor: expected one for a map, got {', '.join(arguments.sensor)}")


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


def _sensor(log: ScanLog, arguments: argparse.Namespace) -> SensorLog:
    """Return the sensor with the poses that were asked for."""
    sensor = log.only_sensor(arguments.sensor[0] if arguments.sensor else None)
    if arguments.odometry:
        if not sensor.has_odometry:
            raise TooLittleDataError(f"{arguments.log}: --odometry: the log has none")
        return sensor.with_poses(sensor.odometry)
    if not sensor.has_poses:
        hint = "; give --poses, or --odometry to draw with the wheels' odometry" if sensor.has_odometry else ""
        raise TooLittleDataError(f"{arguments.log}: no scan has a reference pose{hint or '; give --poses'}")
    return sensor


def _summary(grid: OccupancyGrid, sensor: SensorLog) -> str:
    """Return extent, counts and sharpness in words."""
    import numpy as np

    from beamfield.maps.mapping import share_of_hits_in_obstacles

    rows, cols = grid.shape
    seen = int(np.count_nonzero(~np.isnan(grid.probability)))
    free, occupied = int(np.count_nonzero(grid.free)), int(np.count_nonzero(grid.occupied))
    posed = int(np.isfinite(sensor.poses).all(axis=1).sum())
    x, y = grid.origin[:2]
    share = share_of_hits_in_obstacles(grid, sensor)
    undecided, unseen = seen - free - occupied, rows * cols - seen
    extent = f"{cols * grid.resolution:.2f} m x {rows * grid.resolution:.2f} m"
    size = f"{rows} x {cols} cells of {grid.resolution:g} m"
    return (
        f"map of {posed} scans: {extent}, {size}, lower left corner at ({x:.2f}, {y:.2f})\n"
        f"cells: {free} free, {occupied} occupied, {undecided} undecided, {unseen} not seen\n"
        f"sharpness: {100.0 * share:.1f} % of the hits end within one cell of an occupied one"
    )
