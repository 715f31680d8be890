"""The part of ``beamfield calibrate`` that fits another program's model and writes its file."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield import __version__
from beamfield.cli.progress import StageProgress
from beamfield.errors import InvalidInputError

if TYPE_CHECKING:
    from beamfield.calibration.calibrate import Calibration
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.report.page_section import PageSection
    from beamfield.sensors import SensorLog
    from beamfield.stacks.files.parameter_file import StackFile
    from beamfield.stacks.fit.fit import StackFit


@dataclass(frozen=True)
class StackResult:
    """What fitting a stack adds to the outputs.

    Parameters
    ----------
    table
        For the terminal.
    document
        For calibration.json.
    section
        For the report.
    file_name, file_text
        The stack's own parameter file.
    values
        The parameters that changed, for a file that is patched.
    record
        The comment by which `beamfield doctor` knows the values again; "" if they did not do well.
    """

    table: str
    document: Mapping[str, Any]
    section: PageSection
    file_name: str
    file_text: str
    values: Mapping[str, Any]
    record: str


def add_stack_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that name a stack."""
    group = parser.add_argument_group("for another program")
    group.add_argument("--stack", metavar="NAME",
                       help="fit a model of nav2, ros1, beluga, mrpt or f1tenth in its own formula")  # fmt: skip
    group.add_argument(
        "--model", metavar="NAME", help="the stack's model (default: the best one, or the patched file's)"
    )
    group.add_argument("--patch", type=Path, metavar="FILE",
                       help="start from this parameter file and change the values in it; keeps a backup")  # fmt: skip
    group.add_argument("--section", metavar="LABEL", help="which section of it, if several have such parameters")


def read_stack_request(arguments: argparse.Namespace) -> StackFile | None:
    """Check the options before any long work, and return the file to patch, if any."""
    from beamfield.calibration.pose_windows import WindowOptions
    from beamfield.stacks.files.parameter_file import check_patch_target, read_stack_file
    from beamfield.stacks.files.typed_values import checked_values
    from beamfield.stacks.registry import stack_named

    if not 0.0 < arguments.reference_error < WindowOptions().spread:
        raise InvalidInputError(
            f"--reference-error: expected 0 to {WindowOptions().spread:g} m, without 0, got {arguments.reference_error}"
        )
    if arguments.stack is None:
        for name in ("model", "patch", "section"):
            if getattr(arguments, name) is not None:
                raise InvalidInputError(f"--{name}: is for another program's model, name it with --stack")
        return None
    stack = stack_named(arguments.stack)
    if arguments.model is not None:
        stack.model(arguments.model)
    if arguments.map is None:
        raise InvalidInputError("--stack: needs --map: other programs' models see the map in their own way")
    if arguments.patch is None:
        return None
    file = read_stack_file(arguments.patch, stack=arguments.stack, model=arguments.model, section=arguments.section)
    check_patch_target(file)
    checked_values(file)
    return file


def fit_for_stack(
    arguments: argparse.Namespace, sensor: SensorLog, grid: OccupancyGrid, result: Calibration, file: StackFile | None,
    progress: StageProgress,
) -> StackResult:  # fmt: skip
    """Fit one model of the stack, or all of them, and return what comes of it."""
    from beamfield.calibration.pose_windows import REFERENCE_LEVER, WindowOptions
    from beamfield.report.stack_section import stack_as_dict, stack_section, stack_tables
    from beamfield.stacks.files.typed_values import checked_values
    from beamfield.stacks.fit.fit import fit_stack, net_score
    from beamfield.stacks.registry import STACKS

    stack = STACKS[arguments.stack]
    models = tuple(stack.models)
    if file is not None:  # read with the model asked for, if any
        models = (file.model,)
    elif arguments.model is not None:
        models = (arguments.model,)
    plain = next((form.result.parameters for form in result.candidates if form.is_chapter), None)
    fits = []
    for model in models:
        start = stack.start(model) if file is None else checked_values(file)
        fits.append(
            fit_stack(
                stack.name, model, sensor, grid, start=start, beam_parameters=plain,
                options=WindowOptions(
                    reference_error=arguments.reference_error,
                    reference_turn_error=arguments.reference_error / REFERENCE_LEVER, seed=arguments.seed,
                ),
                selection=result.options.selection, block_s=arguments.block, progress=progress,
            )
        )  # fmt: skip
    best = max(fits, key=lambda fit: net_score(fit.chosen.crossed))
    record = _record(best) if best.covers else ""
    text = _file_text(arguments, best.model.model, asdict(best.parameters), record)
    start_values = asdict(best.start)
    changed = {name: value for name, value in asdict(best.parameters).items() if value != start_values[name]}
    return StackResult(
        stack_tables(fits, best), stack_as_dict(fits, best), stack_section(fits, best, text),
        f"{stack.name}.{stack.syntax}", text, changed, record,
    )  # fmt: skip


def write_patch(file: StackFile, fitted: StackResult) -> str:
    """Change the user's file and return a line that says so."""
    from beamfield.stacks.files.parameter_file import write_values

    values = file.by_names_in_file(fitted.values)
    backup = write_values(file.section, values, record=fitted.record)
    return f"changed {', '.join(values) or 'nothing'} in {file.section.path}; the old file is {backup.name}"


def _record(fit: StackFit) -> str:
    from beamfield.stacks.files.calibration_record import record_text

    held_out = fit.chosen.held_out
    judged = f"{held_out.coverage:.0%} of {len(held_out.log_score)} held-out windows covered"
    return record_text(fit.model.stack, fit.model.model, fit.parameters, __version__, judged)


def _file_text(arguments: argparse.Namespace, model: str, values: dict[str, Any], record: str) -> str:
    from beamfield.stacks.files.new_file import new_file_text

    comments = [
        record or f"{arguments.stack} {model}: fitted by beamfield {__version__}, but too many held-out windows missed",
        f"log {json.dumps(arguments.log.name)}, map {json.dumps(arguments.map.name)}",
    ]
    return new_file_text(arguments.stack, values, comments=comments)
