"""``beamfield localize --params nav2.yaml``: a log through the robot's own filter, emulated."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING

from beamfield.cli import options
from beamfield.cli.inputs import is_moved_map
from beamfield.errors import FormatError, InvalidInputError

if TYPE_CHECKING:
    from beamfield.cli.film import Film
    from beamfield.geometry import FloatArray
    from beamfield.localization.replay import PoseBelief
    from beamfield.localization.scan_localizer import Localization
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.sensors import SensorLog

# What a stack's parameter file says itself, or its filter does not have.
_OF_OUR_FILTER = (
    "model", "particles", "beams", "exponent", "odometry_error", "leave_out_short", "animation",
    "range_table",
)  # fmt: skip


def is_stack_file(path: Path | None) -> bool:
    """Return whether --params is not one of our own files."""
    from beamfield.stacks.files.other_files import own_model

    return path is not None and not own_model(path)


def stack_filter(
    log: SensorLog, grid: OccupancyGrid, start: PoseBelief | None, arguments: argparse.Namespace
) -> tuple[Callable[[Film, Callable[[int], None]], Localization], str, list[str]]:
    """Return what runs the filter that --params sets up over the log; which filter that is, in words; and notes."""
    import numpy as np

    from beamfield.calibration.reference_checks import jump_findings
    from beamfield.localization.scan_localizer import Localization
    from beamfield.stacks.doctor.examine import hopeless_notes
    from beamfield.stacks.files.calibration_record import MOVED_MAP, goes_with_moved_map
    from beamfield.stacks.files.filter_file import read_filter_settings
    from beamfield.stacks.files.parameter_file import read_stack_file

    options.refuse(arguments, _OF_OUR_FILTER, f"for our own filter; {arguments.params} sets up a robot's own")
    file = read_stack_file(arguments.params, stack=arguments.stack, section=arguments.section)
    settings = read_filter_settings(file)
    try:
        replayed = settings.filter(grid)
    except InvalidInputError as error:
        raise FormatError(arguments.map, str(error).removeprefix("grid: ")) from error
    which = f"that of {file.program.title}, emulated, with its model {settings.model}"
    notes = [f"{arguments.params}: {file.uncertainty}"] if file.uncertainty else []
    if goes_with_moved_map(file.section.text) and not is_moved_map(arguments.map):
        notes.append(
            f"{arguments.params}: its values were chosen for the map {MOVED_MAP}, and run on {arguments.map} here; "
            "beamfield evaluate takes both maps (--filter-maps)"
        )
    notes += [*file.unread, *(f"{arguments.params}: {note}" for note in hopeless_notes(file, grid, log))]

    def run(film: Film, step: Callable[[int], None]) -> Localization:
        def watch(i: int, poses: FloatArray, weights: FloatArray) -> None:
            step(i)
            film.add_cloud(i, poses, weights)

        found = replayed.run(log, start, np.random.default_rng(arguments.seed), watch=watch)
        findings = tuple(jump_findings(log))
        return Localization(**{item.name: getattr(found, item.name) for item in fields(found)}, findings=findings)

    return run, which, notes
