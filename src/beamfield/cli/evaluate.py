"""Replay robots' own particle filters on logs, side by side.

Run the filter that each parameter file sets up (nav2, ROS 1 amcl, Beluga, MRPT or F1TENTH, emulated) over logs with
reference poses, with many seeds, and compare: position and heading error, how often the particles hold the truth, lost
runs, processor time, and which differences are more than chance. The first file is what others are compared with.
Every run starts from a belief around the first reference pose. With --global and --kidnap, also how often and soon a
lost robot is found. Prints tables and writes evaluation.json, evaluation.csv (one line per run) and evaluation.svg,
whole or not at all.

for example:

  beamfield evaluate run.bag --map map.yaml --params nav2_before.yaml nav2_after.yaml
  beamfield evaluate run1.bag run2.bag --map map.yaml --params nav2.yaml --seeds 20 --global
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from beamfield.cli import inputs, options
from beamfield.cli.fitted_poses import posed_log
from beamfield.cli.outcome import Outcome
from beamfield.cli.parser import Parser, add_command, count, positive
from beamfield.cli.progress import StageProgress
from beamfield.cli.provenance import file_name, provenance
from beamfield.cli.recordings import add_recordings, check_recordings, wants_recording, write_recordings
from beamfield.errors import FormatError, InvalidInputError, TooLittleDataError

if TYPE_CHECKING:
    from beamfield.io.recordings.recording import Recording
    from beamfield.localization.replay import PoseBelief, ReplayedFilter
    from beamfield.localization.replay_comparison import ReplayTrials
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.report.evaluation import Evaluation, FindTrials
    from beamfield.sensors import SensorLog
    from beamfield.stacks.files.filter_file import FilterSettings
    from beamfield.stacks.files.parameter_file import StackFile


def add_parser(subparsers: argparse._SubParsersAction[Parser]) -> None:
    """Register the command."""
    parser = add_command(subparsers, run, "evaluate", __doc__)
    parser.add_argument("logs", type=Path, nargs="+", metavar="LOG", help=options.LOG_FORMATS)
    options.add_map(parser, required=True)
    parser.add_argument("--params", type=Path, nargs="+", required=True, metavar="FILE",
                        help="parameter files of nav2, ROS 1 amcl, Beluga, MRPT or F1TENTH")  # fmt: skip
    parser.add_argument("--filter-maps", type=Path, nargs="+", metavar="MAP",
                        help="the map that the filter of each parameter file reads, as amcl_map.yaml of calibrate "
                        "(default: --map)")  # fmt: skip
    parser.add_argument("--poses", type=Path, nargs="+", metavar="FILE",
                        help="reference poses of each LOG, TUM or CSV (default: those in the logs, or else fitted to "
                        "the map)")  # fmt: skip
    options.add_start(parser, "for one LOG without reference poses, ")
    parser.add_argument("--seeds", type=count, default=50, metavar="N",
                        help="runs of each filter on each log (default: %(default)s)")  # fmt: skip
    parser.add_argument("--start-error", type=positive, nargs=2, default=(0.5, 15.0), metavar=("M", "DEG"),
                        help="standard deviations of the start's position and heading (default: 0.5 15)")  # fmt: skip
    parser.add_argument("--global", action="store_true", dest="from_anywhere",
                        help="also start without any idea where the robot is")  # fmt: skip
    parser.add_argument("--kidnap", action="store_true",
                        help="also cut out the middle third of each log, unnoticed by the odometry")  # fmt: skip
    options.add_whose_files(parser)
    options.add_out(parser, "beamfield_evaluation", metavar="DIR", what="output folder")
    add_recordings(parser)
    options.add_log(parser)
    options.add_seed(parser)
    options.add_threads(parser)


def run(arguments: argparse.Namespace) -> Outcome:
    """Read, replay, compare, write."""
    from beamfield.figures.gallery import save_figure
    from beamfield.io.files.atomic import atomic_folder, check_folder_writable
    from beamfield.report.as_json import json_text
    from beamfield.report.evaluation import evaluation_as_dict, evaluation_csv, evaluation_line, evaluation_tables
    from beamfield.report.evaluation_figure import evaluation_figure
    from beamfield.stacks.files.filter_file import read_filter_settings

    _check(arguments)
    inputs.refuse_moved_map(arguments.map)
    check_folder_writable(arguments.out, "evaluation.json", "evaluation.csv")
    check_recordings(arguments)
    files, notes = _read_files(arguments)
    settings = {name: read_filter_settings(file) for name, file in files.items()}
    with options.progress(arguments) as progress:
        progress("reading the map", 0, 1)
        grid = inputs.read_walls(arguments)
        maps = _maps(arguments, list(files), grid)
        filters = _filters(settings, maps, progress)
        progress("reading the logs", 0, 1)
        logs, more = _read_logs(arguments, grid, progress)
        more += _errors(files, maps, next(iter(logs.values())))
        evaluation = _evaluate(arguments, filters, logs, progress)
        document = {
            "provenance": provenance(arguments),
            "notes": [*notes, *more],
            "stacks": {name: {"stack": one.stack, "model": one.model} for name, one in settings.items()},
            **evaluation_as_dict(evaluation),
        }
        with atomic_folder(arguments.out) as folder:
            (folder / "evaluation.json").write_text(json_text(document), encoding="utf-8")
            (folder / "evaluation.csv").write_text(evaluation_csv(evaluation), encoding="utf-8")
            save_figure(evaluation_figure(evaluation), folder / "evaluation.svg")
            written = sorted(path.name for path in folder.iterdir())
            log = next(iter(logs.values()))
            recorded = write_recordings(arguments, lambda: _recording(arguments, filters, log, grid))
    wrote = ", ".join([f"wrote {', '.join(written)} into {arguments.out}", *map(str, recorded)])
    brief = evaluation_line(evaluation)
    text = f"{evaluation_tables(evaluation)}\n\n{brief}"
    return Outcome(wrote, text, document, (*notes, *more), [arguments.out, *recorded], brief=brief)


def _check(arguments: argparse.Namespace) -> None:
    if arguments.poses is not None and len(arguments.poses) != len(arguments.logs):
        raise InvalidInputError(
            f"--poses: expected one file for each LOG, got {len(arguments.poses)} for {len(arguments.logs)}"
        )
    if arguments.filter_maps is not None and len(arguments.filter_maps) != len(arguments.params):
        raise InvalidInputError(
            f"--filter-maps: expected one map for each file of --params, got {len(arguments.filter_maps)} for "
            f"{len(arguments.params)}"
        )
    if arguments.start is not None and len(arguments.logs) > 1:
        raise InvalidInputError(f"--start: expected one LOG, got {len(arguments.logs)}")
    if wants_recording(arguments) and len(arguments.logs) > 1:
        raise InvalidInputError(f"--rerun, --mcap: expected one LOG, got {len(arguments.logs)}")


def _read_files(arguments: argparse.Namespace) -> tuple[dict[str, StackFile], list[str]]:
    """Return the parameter files by a short name, and what was noticed."""
    from beamfield.stacks.files.calibration_record import MOVED_MAP, goes_with_moved_map
    from beamfield.stacks.files.parameter_file import read_stack_file

    files: dict[str, StackFile] = {}
    notes: list[str] = []
    for name, path in _short_names(arguments.params).items():
        file = files[name] = read_stack_file(path, stack=arguments.stack, section=arguments.section)
        notes += [f"{name}: {file.uncertainty}"] if file.uncertainty else []
        if arguments.filter_maps is None and goes_with_moved_map(file.section.text):
            notes.append(f"{name}: its values were chosen for the map {MOVED_MAP}: give that with --filter-maps")
        notes += file.unread
    return files, notes


def _errors(
    files: Mapping[str, StackFile], maps: Mapping[str, tuple[Path, OccupancyGrid]], log: SensorLog
) -> list[str]:
    """Return what makes a parameter file useless, such as weights that are all zero or a map that it misreads."""
    from beamfield.stacks.doctor.examine import hopeless_notes

    return [f"{name}: {note}" for name, file in files.items() for note in hopeless_notes(file, maps[name][1], log)]


def _maps(
    arguments: argparse.Namespace, names: list[str], grid: OccupancyGrid
) -> dict[str, tuple[Path, OccupancyGrid]]:
    """Return the map that each parameter file's filter reads, and its file."""
    from beamfield.io.read_map import read_map

    paths = arguments.filter_maps or [arguments.map] * len(names)
    return {
        name: (path, grid if path == arguments.map else read_map(path, topic=arguments.map_topic))
        for name, path in zip(names, paths, strict=True)
    }


def _filters(
    settings: Mapping[str, FilterSettings], maps: Mapping[str, tuple[Path, OccupancyGrid]], progress: StageProgress
) -> dict[str, ReplayedFilter]:
    """Return the filter of each parameter file, on the map that it reads."""
    filters: dict[str, ReplayedFilter] = {}
    for name, one in settings.items():
        progress(f"preparing {name}", 0, 1)
        path, read = maps[name]
        try:
            filters[name] = one.filter(read)
        except InvalidInputError as error:
            raise FormatError(path, str(error).removeprefix("grid: ")) from error
    return filters


def _read_logs(
    arguments: argparse.Namespace, grid: OccupancyGrid, progress: StageProgress
) -> tuple[dict[str, SensorLog], list[str]]:
    logs: dict[str, SensorLog] = {}
    notes: list[str] = []
    poses = arguments.poses or [None] * len(arguments.logs)
    for (name, path), reference in zip(_short_names(arguments.logs).items(), poses, strict=True):
        sensor, noticed = inputs.read_sensor(arguments, path, reference)
        inputs.require_odometry(sensor, path)
        start = options.start_of(arguments)
        logs[name], _, found = posed_log(sensor, grid, arguments, progress, path, reference, start)
        notes += [f"{name}: {note}" for note in (*noticed, *(finding.full_text for finding in found))]
    return logs, notes


def _evaluate(
    arguments: argparse.Namespace, filters: Mapping[str, ReplayedFilter], logs: Mapping[str, SensorLog],
    progress: StageProgress,
) -> Evaluation:  # fmt: skip
    from beamfield.localization.replay_trials import run_trials
    from beamfield.report.evaluation import Evaluation, FindTrials

    trials: dict[str, list[ReplayTrials]] = {name: [] for name in filters}
    finds: dict[str, list[FindTrials]] = {name: [] for name in filters}
    seeds = range(arguments.seed, arguments.seed + arguments.seeds)
    for log_name, log in logs.items():
        for name, replayed in filters.items():
            show = partial(progress, f"{name} on {log_name}")
            try:
                made = run_trials(replayed, log, seeds, name=log_name, spread=_spread(arguments), progress=show)
                trials[name].append(made)
                for task, seconds in _find(arguments, f"{name} on {log_name}", replayed, log, progress).items():
                    finds[name].append(FindTrials(task, log_name, seconds))
            except TooLittleDataError as error:
                raise TooLittleDataError(f"{log_name}: {error}") from error
    return Evaluation(trials, finds)


def _spread(arguments: argparse.Namespace) -> tuple[float, float]:
    distance, degrees = arguments.start_error
    return distance, options.radians(degrees) or 0.0


def _find(
    arguments: argparse.Namespace, stage: str, replayed: ReplayedFilter, log: SensorLog, progress: StageProgress
) -> dict[str, tuple[float | None, ...]]:
    """Return when each run found the robot, by the tasks that were asked for."""
    from beamfield.localization.found import kidnapped
    from beamfield.localization.parallel_runs import run_each
    from beamfield.localization.replay import reference_start

    position, heading = _spread(arguments)
    first, start = reference_start(log, sd_position=position, sd_heading=heading)
    part = log[first:]
    tasks: dict[str, tuple[SensorLog, PoseBelief | None, int]] = {}
    if arguments.from_anywhere:
        tasks["global start"] = part, None, 0
    if arguments.kidnap:
        cut, after = kidnapped(part)
        tasks["kidnapping"] = cut, start, after

    seeds = range(arguments.seed, arguments.seed + arguments.seeds)
    return {
        name: tuple(run_each(partial(_seconds, replayed, *task), seeds, partial(progress, f"{stage}, {name}")))
        for name, task in tasks.items()
    }


def _seconds(replayed: ReplayedFilter, log: SensorLog, start: PoseBelief | None, since: int, seed: int) -> float | None:
    """Return when a run found the robot, in seconds after a scan."""
    import numpy as np

    from beamfield.localization.found import time_to_find

    return time_to_find(replayed.run(log, start, np.random.default_rng(seed)), log, since)


def _recording(
    arguments: argparse.Namespace, filters: Mapping[str, ReplayedFilter], log: SensorLog, grid: OccupancyGrid
) -> Recording:
    """Return the path that each filter published in the run of the first seed, and how far it was off."""
    import numpy as np

    from beamfield.io.recordings.recording import Recording
    from beamfield.localization.replay import reference_start

    position, heading = _spread(arguments)
    first, start = reference_start(log, sd_position=position, sd_heading=heading)
    part = log[first:]
    paths = {"reference": part.poses}
    numbers = {}
    for name, replayed in filters.items():
        found = replayed.run(part, start, np.random.default_rng(arguments.seed))
        paths[name] = found.poses
        numbers[f"position error, {name} [m]"] = np.hypot(*(found.poses - part.poses)[:, :2].T)
    return Recording(grid, part, paths, numbers=numbers)


def _short_names(paths: list[Path]) -> dict[str, Path]:
    """Return the files by name; those of one name with their folder, or a number, before it."""
    names = [file_name(path) for path in paths]
    if len(set(names)) < len(names):
        names = [f"{file_name(path.resolve().parent)}/{name}" for name, path in zip(names, paths, strict=True)]
    if len(set(names)) < len(names):
        names = [f"{i}. {name}" for i, name in enumerate(names, 1)]
    return dict(zip(names, paths, strict=True))
