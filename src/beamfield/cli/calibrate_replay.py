"""The part of ``beamfield calibrate --stack`` that replays the program's filter to decide which values are written."""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield.errors import FormatError, TooLittleDataError
from beamfield.stacks.files.calibration_record import MOVED_MAP, MOVED_PICTURE

if TYPE_CHECKING:
    from beamfield.cli.calibrate_sensor import CalibrationJob
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.sensors import SensorLog
    from beamfield.stacks.files.filter_file import FilterSettings
    from beamfield.stacks.fit.fit import StackFit
    from beamfield.stacks.fit.replay_choice import ReplayChoice


def replay_fit(
    job: CalibrationJob, sensor: SensorLog, grid: OccupancyGrid, fit: StackFit, others: Sequence[StackFit],
    learned: Mapping[str, Any],
) -> tuple[ReplayChoice | None, str]:  # fmt: skip
    """Choose between the values before and those fitted, with several motion noises, by the stack's own filter.

    Returns the decision, or none and why nothing was replayed. `others` are fits of other models of the stack.
    `learned` is the motion noise that was asked for with --odometry-noise: it is then the only other one.
    """
    from beamfield.stacks.files.calibration_record import goes_with_moved_map
    from beamfield.stacks.fit.kept_runs import kept_runs
    from beamfield.stacks.fit.motion_candidates import BEFORE, LEARNED, motion_candidates
    from beamfield.stacks.fit.replay_amount import replay_options
    from beamfield.stacks.fit.replay_choice import choose_by_replay
    from beamfield.stacks.fit.replay_runs import half_cell_shift
    from beamfield.stacks.fit.replay_segments import cut_segments
    from beamfield.stacks.registry import STACKS

    if not sensor.has_odometry:
        return None, "the log has no odometry"
    try:
        before = _settings(job, fit)
        if before is None:
            return None, f"the particle filter of {fit.model.stack} is not emulated"
        options = replay_options(before, sensor, job.arguments.seed)
        most, longest = options.most_stretches, options.longest
        stretches = cut_segments(sensor, *before.update_distances, most=most, longest=longest)
    except (FormatError, TooLittleDataError) as problem:  # a value that only the filter reads, or a short drive
        return None, str(problem)
    job.progress("replay: looking at the odometry", 0, 1)
    motions = motion_candidates(before, sensor, job.arguments.reference_error)
    if learned:
        motions = motions._replace(by_name={BEFORE: {}, LEARNED: learned})
    sensors = {BEFORE: (fit.model.model, fit.before.parameters)}
    if fit.chosen is not fit.before:
        sensors["fitted"] = fit.model.model, fit.parameters
    for other in others:
        sensors[f"{other.model.model} fitted"] = other.model.model, other.parameters
    shift = half_cell_shift(STACKS[before.stack], grid) if _can_write(job) else 0.0
    hollow = takes_hollow_map(job, before.stack, sensors.values(), grid)
    inputs = before, sensors, motions, shift, stretches, grid, options
    its_own = job.patched is not None and goes_with_moved_map(job.patched.section.text)
    is_moved = (bool(shift) or hollow) and its_own
    try:
        with kept_runs(_cache_folder(), (inputs, hollow, is_moved)) as kept:
            return choose_by_replay(*inputs, job.progress, kept, hollow=hollow, is_moved=is_moved), ""
    except TooLittleDataError as problem:
        return None, str(problem)


def filter_map_files(job: CalibrationJob, choice: ReplayChoice, grid: OccupancyGrid) -> dict[str, str | bytes]:
    """Return the files of the filter's own map, by name; none if it is the user's."""
    import numpy as np

    from beamfield.cli.inputs import OF_MOVED_MAP
    from beamfield.cli.provenance import file_name
    from beamfield.io.maps.ros_map import image_path
    from beamfield.io.maps.ros_map_writer import map_files, moved_map_text
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.stacks.fit.replay_runs import HOLLOW

    setting, arguments = choice.chosen, job.arguments
    if not setting.changes_map:
        return {}
    what, why, last, files, shift = [], [], [], {}, setting.key.origin
    if setting.key.solids == HOLLOW:
        own = setting.map_of(grid)
        # With the usual thresholds, as those of a map that knows only black and white may have no grey between them.
        cells = np.select([own.occupied, own.free], [np.float32(1.0), np.float32(0.0)], np.float32(np.nan))
        whole = OccupancyGrid(cells, own.resolution, own.origin)
        text, files[MOVED_PICTURE] = map_files(whole, MOVED_PICTURE, "trinary")
        what.append("it is unknown where the map is painted black far from what is free")
        why += ["The filter's field is as high inside of solids as on a wall: poses fit whose readings end there."]
    else:
        # Files of several sensors lie in folders of their own.
        folder = arguments.out / "sensor" if len(arguments.sensor or []) > 1 else arguments.out
        image, place = image_path(arguments.map).resolve(), folder.resolve()
        # An absolute path outlives a copy of this file.
        named = image.relative_to(place) if image.is_relative_to(place) else image
        text = moved_map_text(arguments.map, (shift, shift), str(named))
        last = [f"On another computer put this file beside the picture, and write image: {file_name(image)}"]
    if shift:
        what.append(f"its origin is moved by {shift:g} m, half a cell, in x and in y")
        why += [
            "amcl takes the origin for the centre of the first cell, everything else for its corner. With this origin",
            "amcl has the walls where they are.",
        ]
    comments = [
        f"{file_name(arguments.map)} {OF_MOVED_MAP} {', and '.join(what)}.", *why,
        "Costmaps, planners and rviz need the map as it was: let a second map_server publish this one, on a topic that",
        "amcl alone takes.", *last,
    ]  # fmt: skip
    return files | {MOVED_MAP: "".join(f"# {line}\n" for line in comments) + text}


def takes_hollow_map(job: CalibrationJob, stack: str, sensors: Iterable[tuple[str, Any]], grid: OccupancyGrid) -> bool:
    """Return whether the map is painted black where nothing is known, and a file may give one of some fields another.

    `sensors` are models and their parameters.
    """
    from beamfield.maps.solids import has_fill
    from beamfield.stacks.registry import model_named

    is_misled = any(model_named(stack, model).solids_attract(parameters) for model, parameters in sensors)
    return is_misled and _can_write(job) and has_fill(grid)


def _can_write(job: CalibrationJob) -> bool:
    return not job.arguments.keep_map and job.arguments.map.suffix in (".yaml", ".yml")


def _settings(job: CalibrationJob, fit: StackFit) -> FilterSettings | None:
    """Return the user's filter, or the program's default; None if it is not emulated."""
    from dataclasses import replace

    from beamfield.stacks.files.filter_file import FilterSettings, read_filter_settings
    from beamfield.stacks.registry import STACKS

    described = STACKS[fit.model.stack].filter
    if described is None:
        return None
    if job.patched is not None:
        # With the sensor's values that the program can run with.
        return replace(read_filter_settings(job.patched), sensor=fit.before.parameters)
    return FilterSettings(
        fit.model.stack, fit.model.model, fit.before.parameters, described.motion(), described.parameters()
    )


def _cache_folder() -> Path:
    """Return where interrupted replays are kept: not beside the results, of which nothing partial may be left."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache", "beamfield")
    except RuntimeError:  # a user without a home, as in containers: nothing is kept
        return Path(os.devnull, "beamfield")
