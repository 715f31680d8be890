"""The readers, what each must return, and where its examples come from."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from beamfield.fleet.manifest import read_manifest
from beamfield.fleet.run_record import record_from_json
from beamfield.io.bags.fiducial_detections import read_camera, read_camera_images, read_fiducials
from beamfield.io.bags.reader import read_bag_map
from beamfield.io.filter_run import read_run
from beamfield.io.landmarks.landmark_files import read_landmarks
from beamfield.io.landmarks.line_files import read_line_map
from beamfield.io.landmarks.sightings import read_sightings
from beamfield.io.maps.range_table_file import read_range_table
from beamfield.io.maps.ros_map import between_share, ros_map_notes
from beamfield.io.parameters.beam_model_file import read_beam_model
from beamfield.io.parameters.landmark_model_file import read_landmark_model
from beamfield.io.parameters.likelihood_field_file import read_likelihood_field
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.io.trajectory import read_trajectory
from beamfield.stacks.files.filter_file import read_filter_settings
from beamfield.stacks.files.parameter_file import read_stack_file
from beamfield.stacks.files.typed_values import checked_values
from tests.fuzz import sane
from tests.fuzz.commands import calibrate_and_patch, check_patch, run_command, translate_and_patch
from tests.fuzz.seeds import bags, fleets, landmarks, logs, maps, parameters
from tests.fuzz.target import Target

# What a user may say about a log, besides nothing. Which of them is used follows from the input, so that reading an
# input again is the same again.
LOG_OPTIONS: tuple[dict[str, Any], ...] = (
    {}, {}, {}, {}, {"lone_poses": "odometry"}, {"stamps": "order"}, {"no_return": "none"}, {"no_return": (0.0, 81.91)},
    {"max_range": 15.0, "min_range": 0.2}, {"opening_angle": 0.3}, {"sensor_topic": "FLASER"},
)  # fmt: skip
BAG_OPTIONS: tuple[dict[str, Any], ...] = (
    {}, {}, {}, {}, {"sensor_topic": "/scan"}, {"poses_topic": "/odom"}, {"map_frame": "odom"}, {"base_frame": "laser"},
    {"mount": (0.1, 0.0, 3.0)}, {"max_range": 5.0}, {"no_return": "none"},
)  # fmt: skip


def _with_options(read: Callable[..., Any], choices: tuple[dict[str, Any], ...]) -> Callable[[Path], Any]:
    def read_it(path: Path) -> Any:
        content = path.read_bytes() if path.is_file() else b""
        return read(path, **choices[zlib.crc32(content) % len(choices)])

    return read_it


def _map_and_notes(path: Path) -> Any:
    grid = read_map(path)
    ros_map_notes(path)
    between_share(path)
    return grid


def _range_table(path: Path) -> Any:
    return read_range_table(path, maps.TABULATED)


def _sightings(path: Path) -> Any:
    return read_landmarks(path.parent / "l.csv"), read_sightings(path)


def _parameters(path: Path) -> Any:
    file = read_stack_file(path)
    read_filter_settings(file)
    return file, checked_values(file)


def _command(*words: str) -> Callable[[Path], Any]:
    return lambda path: run_command(*words, str(path))


_STORAGES = {"bag1": "ros1", "db3": "sqlite3", "mcap": "mcap"}


def _bag_targets() -> list[Target]:
    found = []
    for name, storage in _STORAGES.items():
        found += [
            Target(name, bags.of(bags.scan_bags, storage), _with_options(read_log, BAG_OPTIONS), sane.log, weight=4.0),
            Target(f"{name}_map", bags.of(bags.map_bags, storage), read_bag_map, sane.grid, weight=2.0),
            Target(f"{name}_camera", bags.of(bags.camera_bags, storage), _camera, sane.camera, weight=2.0),
        ]
    return found


def _camera(path: Path) -> Any:
    """Read what the bag has of a camera; the first error that is not about a missing topic counts."""
    return _first_of(path, read_camera, read_fiducials, lambda where: list(read_camera_images(where)))


def _first_of(path: Path, *readers: Callable[[Path], Any]) -> Any:
    for read in readers[:-1]:
        try:
            return read(path)
        except ValueError as error:
            if "no topic of type" not in str(error):
                raise
    return readers[-1](path)


TARGETS: tuple[Target, ...] = (
    Target("map_yaml", maps.map_yamls, _map_and_notes, sane.grid),
    Target("pgm", lambda: maps.pictures(".pgm"), read_map, sane.grid),
    Target("png", lambda: maps.pictures(".png"), read_map, sane.grid, weight=2.0),
    Target("bmp", lambda: maps.pictures(".bmp"), read_map, sane.grid),
    Target("wean_map", maps.wean_maps, read_map, sane.grid),
    Target("range_table", maps.range_tables, _range_table, sane.range_table),
    Target("carmen", logs.carmen_logs, _with_options(read_log, LOG_OPTIONS), sane.log, weight=2.0),
    Target("wean_log", logs.wean_logs, _with_options(read_log, LOG_OPTIONS), sane.log),
    Target("gfs", logs.gfs_logs, _with_options(read_log, LOG_OPTIONS), sane.log),
    Target("g2o", logs.g2o_logs, _with_options(read_log, LOG_OPTIONS), sane.log),
    Target("coreslam", logs.coreslam_logs, _with_options(read_log, LOG_OPTIONS), sane.log),
    Target("sonar", logs.sonar_logs, read_log, sane.log),
    Target("trajectory", logs.trajectories, read_trajectory, sane.track),
    Target("filter_run", logs.filter_runs, read_run, sane.filter_run),
    Target("landmarks", landmarks.landmark_maps, read_landmarks, sane.landmarks),
    Target("lines", landmarks.line_maps, read_line_map, sane.lines),
    Target("sightings", landmarks.sightings, _sightings, sane.sightings),
    Target("beam_model", parameters.beam_models, read_beam_model, sane.beam_model),
    Target("field_model", parameters.field_models, read_likelihood_field, sane.field_model),
    Target("landmark_model", parameters.landmark_models, read_landmark_model, sane.landmark_model),
    Target("stack_yaml", parameters.stack_yamls, _parameters, sane.stack_file, weight=2.0),
    Target("launch", parameters.launch_files, _parameters, sane.stack_file),
    Target("ini", parameters.ini_files, _parameters, sane.stack_file),
    Target("manifest", fleets.manifests, read_manifest, sane.manifest),
    Target("run_record", fleets.records, lambda path: record_from_json(path.read_bytes(), str(path)), sane.run_record),
    *_bag_targets(),
    Target("ros2_folder", bags.folder_bags, read_log, sane.log, weight=2.0),
    Target("translate_patch", parameters.patched_files, translate_and_patch, check_patch, writes=True, weight=2.0),
    Target("calibrate_patch", parameters.patched_files, calibrate_and_patch, check_patch, writes=True, weight=2.0),
    Target("doctor", lambda: [*parameters.stack_yamls(), *parameters.launch_files(), *parameters.ini_files()],
           _command("doctor"), sane.command),
    Target("inspect_log", lambda: [*logs.carmen_logs(), *logs.gfs_logs(), *logs.g2o_logs(), *logs.sonar_logs()],
           _command("inspect"), sane.command),
    Target("inspect_bag", lambda: [*bags.scan_bags("mcap"), *bags.map_bags("mcap")], _command("inspect"), sane.command),
    Target("inspect_map", lambda: [*maps.map_yamls(), *maps.wean_maps()], _command("inspect"), sane.command),
)  # fmt: skip
BY_NAME = {target.name: target for target in TARGETS}
