"""The files that the shared options name: maps, logs and parameters, read and checked alike by all commands."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from beamfield.cli import options
from beamfield.cli.progress import StageProgress
from beamfield.errors import BeamfieldError, FormatError, InvalidInputError, about_file

if TYPE_CHECKING:
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.maps.range_table import RangeTable
    from beamfield.models.beam_parameters import BeamParameters, SavedBeamModel
    from beamfield.models.field_parameters import SavedLikelihoodField
    from beamfield.sensors import RangeFinder, ScanLog, SensorLog

# What calibrate writes above a map that only a program that reads it half a cell off sees rightly.
OF_MOVED_MAP = "for amcl alone:"
_LONGEST_LINE = 1000


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
        raise FormatError(arguments.map, "the map has no occupied cell: check occupied_thresh, negate and the picture")
    return grid


def is_moved_map(path: Path) -> bool:
    """Whether this is the file of a map that calibration wrote for amcl alone."""
    if path.suffix not in (".yaml", ".yml") or not path.is_file():
        return False
    with path.open("rb") as stream:
        return OF_MOVED_MAP.encode() in stream.readline(_LONGEST_LINE)


def refuse_moved_map(path: Path | None) -> None:
    """Refuse a map for amcl alone where the true one is wanted: all poses would be half a cell off."""
    if path is not None and is_moved_map(path):
        raise FormatError(
            path,
            "this is the map that beamfield calibrate wrote for amcl alone, and wrong for everything else: give the "
            "map that it was made from",
        )


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


def read_own_beam_model(path: Path) -> SavedBeamModel:
    """Read --params of a beam model: a beam_model.yaml."""
    from beamfield.io.parameters.beam_model_file import read_beam_model

    with _not_of_another_program(path, "a beam_model.yaml"):
        return read_beam_model(path)


def model_of(arguments: argparse.Namespace, usual: str) -> str:
    """Return the model that --model names; without it the one that --params holds, or else the usual one."""
    from beamfield.stacks.files.other_files import own_model

    if arguments.model is not None or arguments.params is None:
        return arguments.model or usual
    return {"likelihood_field": "likelihood_field", "beam_model": "beam"}.get(own_model(arguments.params), usual)


def read_field_or_beam_model(path: Path) -> SavedLikelihoodField | SavedBeamModel:
    """Read --params of a likelihood field: a likelihood_field.yaml, or a beam_model.yaml in its place."""
    from beamfield.io.parameters.beam_model_file import read_beam_model
    from beamfield.io.parameters.likelihood_field_file import read_likelihood_field
    from beamfield.stacks.files.other_files import own_model

    with _not_of_another_program(path, "a likelihood_field.yaml or beam_model.yaml"):
        # A file that is neither is refused as what the model asks for first.
        return read_beam_model(path) if own_model(path) == "beam_model" else read_likelihood_field(path)


@contextmanager
def _not_of_another_program(path: Path, expected: str) -> Iterator[None]:
    """Say of a file that is not one of ours, but one of nav2 or another program, which commands take it."""
    from beamfield.stacks.files.parameter_file import read_stack_file
    from beamfield.stacks.registry import STACKS

    try:
        yield
    except FormatError as error:
        try:
            possible = read_stack_file(path, unknown_model="default").possible
        except FormatError:
            raise error from None
        programs = " or ".join(STACKS[name].title for name in possible)
        raise FormatError(
            path,
            f"this is a parameter file of {programs}, which beamfield explore, localize and evaluate take; expected "
            f"{expected} of beamfield calibrate",
        ) from None


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
        mount=None if arguments.mount is None else options.mount(arguments),
        no_return=arguments.no_return,
        max_range=arguments.max_range,
        min_range=arguments.min_range,
        opening_angle=options.radians(arguments.opening_angle),
        mask=[options.sector_radians(sector) for sector in arguments.mask],
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
    from beamfield.stacks.files.other_files import own_model
    from beamfield.stacks.files.parameter_file import read_stack_file

    try:
        if own_model(path) == "beam_model":
            return FormatError(path, f"this is a beam model of beamfield, not a {expected}")
        if path.suffix == ".yaml" and "rosbag2_bagfile_information" in read_yaml(path).values:
            return FormatError(path, "this is the metadata of a ROS 2 bag: give its folder")
        stack = read_stack_file(path, unknown_model="default").stack
    except (BeamfieldError, OSError):
        return None
    return FormatError(
        path, f"this is a parameter file of {stack}, not a {expected}: use `beamfield doctor {path.name}`"
    )
