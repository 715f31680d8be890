"""The part of ``beamfield calibrate`` that fits another program's model and writes its file."""

from __future__ import annotations

import argparse
import json
import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from beamfield import __version__
from beamfield.cli import options
from beamfield.cli.calibrate_replay import filter_map_files, replay_fit, takes_hollow_map
from beamfield.cli.report_part import StackPart
from beamfield.cli.terminal import complain, line_width
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.stacks.files.calibration_record import MOVED_MAP, goes_with_moved_map, is_noted, notes_values

if TYPE_CHECKING:
    from beamfield.calibration.calibrate import Calibration
    from beamfield.calibration.pose_windows import WindowOptions
    from beamfield.cli.calibrate_sensor import CalibrationJob
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.report.stack_result import StackResult
    from beamfield.sensors import SensorLog
    from beamfield.stacks.files.parameter_file import StackFile
    from beamfield.stacks.fit.fit import StackFit
    from beamfield.stacks.fit.replay_choice import ReplayChoice

# Nats of a window that the best values must have on the map that the log belongs to. So much is known by who knows only
# that the robot is at the reference, not elsewhere on the map: its prior is a half.
LEAST_SCORE = math.log(2.0)
# Findings for which values would make up, and be wrong once the robot is right; and what to correct.
MENDED_FIRST = {"laser-mount": "laser's mount", "scan-delay": "scans' stamps"}


def add_stack_options(parser: argparse.ArgumentParser) -> None:
    """Add the options that name a stack."""
    group = parser.add_argument_group("for another program")
    group.add_argument("--stack", metavar="NAME",
                       help="fit a model of nav2, ros1, beluga, mrpt or f1tenth in its own formula")  # fmt: skip
    group.add_argument(
        "--model",
        metavar="NAME",
        help="the stack's model (default: the file's or the stack's own, unless another is better)",
    )
    group.add_argument("--patch", type=Path, metavar="FILE",
                       help="start from this parameter file and change the values in it; keeps a backup")  # fmt: skip
    group.add_argument("--section", metavar="LABEL", help="which section of it, if several have such parameters")
    group.add_argument(
        "--keep-map",
        action="store_true",
        help="choose values for the map as it is, even if the program reads it half a cell off, or fits poses into the "
        "black where nothing is known",
    )


def read_stack_request(arguments: argparse.Namespace) -> StackFile | None:
    """Check the options before any long work, and return the file to patch, if any."""
    from beamfield.calibration.pose_windows import WindowOptions

    if not 0.0 < arguments.reference_error < WindowOptions().spread:
        raise InvalidInputError(
            f"--reference-error: expected 0 to {WindowOptions().spread:g} m, without 0, got {arguments.reference_error}"
        )
    if arguments.stack is None:
        names = ("model", "patch", "section", "keep_map")
        options.refuse(arguments, names, "is for another program's model, name it with --stack")
        return None
    from beamfield.stacks.files.parameter_file import check_patch_target, read_stack_file
    from beamfield.stacks.files.typed_values import checked_values
    from beamfield.stacks.registry import stack_named

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


def warn_if_too_short(job: CalibrationJob, sensor: SensorLog, grid: OccupancyGrid) -> None:
    """Say before the work that the log is too short for the stack; the beam model is learned all the same."""
    from beamfield.calibration.pose_windows import cut_windows, draw_rivals

    options, arguments = _window_options(job), job.arguments
    try:
        cut_windows(sensor, grid, draw_rivals(options, grid), options, job.options.selection, arguments.block)
    except TooLittleDataError as error:
        if not arguments.quiet:
            complain(f"beamfield: warning: too short for --stack {arguments.stack}, the rest goes on: {error}")


def fit_for_stack(
    job: CalibrationJob, sensor: SensorLog, grid: OccupancyGrid, result: Calibration, motion: Mapping[str, Any]
) -> StackPart:
    """Fit models of the stack, choose one, and return what comes of it; `motion` goes into its file, too."""
    from beamfield.report.page_section import PageSection
    from beamfield.report.stack_result import StackResult
    from beamfield.report.stack_section import stack_as_dict, stack_section, stack_tables
    from beamfield.report.verdict import doubts
    from beamfield.stacks.registry import STACKS

    stack = job.arguments.stack
    try:
        fits = _fits(job, sensor, grid, result)
        best = _best(fits)
    except TooLittleDataError as error:
        why = f"no values for {stack}: {error}"
        section = PageSection.without("stack", f"For {stack}", why)
        document = {"stack": stack, "missing": str(error), "verdict": why}
        # The verdict says it, below all tables.
        return StackPart("stack", "", document, section, doubt=why, problem=why)
    # The model that runs stays unless replay says otherwise.
    own, *others = fits
    choice, why_not = replay_fit(job, sensor, grid, own, others, motion)
    chosen = best if choice is None else _fit_of(fits, choice.chosen.filter.model)
    known = {finding.name for finding in result.findings}
    found = StackResult(
        fits, chosen, choice, why_not, doubts(result),
        disagrees=bool(known & {"map-out-of-date", "map-disagrees-in-part"}),
        leaves_out_jumps="odometry-reset" in known,
    )  # fmt: skip
    unproven = found.unproven.rstrip(".")
    record = _record(found) if found.covers and not (found.doubt or unproven) else ""
    for_map = _for_map(job.patched, choice)
    start_values = asdict(found.start)
    changed = {name: value for name, value in asdict(found.parameters).items() if value != start_values[name]}
    noise = dict(motion) if choice is None else found.motion
    said = _said(stack, noise)
    changed |= found.recovery | ({} if said else noise)
    values = {**asdict(found.parameters), **_motion_for_new_file(job.patched, choice), **changed}
    text = _file_text(job.arguments, found, values, record, said)
    files: dict[str, str | bytes] = {f"{stack}.{STACKS[stack].syntax}": text}
    if choice is not None:
        files |= filter_map_files(job, choice, grid)
    return StackPart(
        "stack", "\n\n".join([stack_tables(found, width=line_width()), *said]), stack_as_dict(found),
        stack_section(found, text), files, values=changed, record="; ".join(filter(None, (record, for_map))),
        doubt=found.doubt or unproven, problem=unproven,
    )  # fmt: skip


def _motion_for_new_file(file: StackFile | None, choice: ReplayChoice | None) -> dict[str, Any]:
    """Return what a new file says of the motion model: where it is not as the program has it by default."""
    from beamfield.stacks.files.typed_values import typed_fields

    if file is None or file.program.filter is None or file.program.motion_elsewhere:
        return {}
    kind = file.program.filter.motion
    motion = typed_fields(file, kind).parameters if choice is None else choice.chosen.filter.motion
    default = asdict(kind())
    return {name: value for name, value in asdict(motion).items() if value != default[name]}


def _for_map(file: StackFile | None, choice: ReplayChoice | None) -> str:
    """Return what to note in the user's file about the map its values are for; "" if it is the one that it had."""
    if choice is not None and choice.chosen.changes_map:
        return f"chosen for the map {MOVED_MAP}"
    was_moved = choice is not None and file is not None and goes_with_moved_map(file.section.text)
    return "chosen for the map as it is" if was_moved else ""


def _said(stack: str, noise: Mapping[str, Any]) -> list[str]:
    """Return a line about values of the motion model that the stack's file has no place for."""
    from beamfield.stacks.registry import STACKS

    where = STACKS[stack].motion_elsewhere
    if not where or not noise:
        return []
    values = ", ".join(f"{name} = {value:g}" for name, value in noise.items())
    return [f"motion noise to go with it, not written: it belongs under {where}: {values}"]


def _fits(job: CalibrationJob, sensor: SensorLog, grid: OccupancyGrid, result: Calibration) -> list[StackFit]:
    """Return a fit of the model asked for, the file's or the stack's own.

    If that adds up cubes, which are flat whatever the values, and none was asked for, that of a field's product comes
    next.
    """
    from beamfield.maps.solids import hollowed
    from beamfield.report.verdict import DOUBTS
    from beamfield.stacks.doctor.map_checks import YAW_TOLERANCE
    from beamfield.stacks.files.typed_values import checked_values
    from beamfield.stacks.fit.fit import fit_stack
    from beamfield.stacks.registry import STACKS
    from beamfield.stacks.stack import FIELD_PRODUCT

    arguments, file = job.arguments, job.patched
    stack = STACKS[arguments.stack]
    if stack.turned_map and abs(yaw := grid.origin[2]) > YAW_TOLERANCE:
        raise TooLittleDataError(
            f"the map's origin has a yaw of {math.degrees(yaw):.3g} degrees, and {stack.turned_map}. Save the map with "
            "a yaw of 0 (rotate the picture)."
        )
    for finding in result.findings:
        if finding.name == "map-disagrees":
            raise TooLittleDataError(DOUBTS[finding.name])
        if finding.name == "odometry-sign":
            # Replayed with the sign put right, a filter says nothing of the robot's, which takes it as it is.
            raise TooLittleDataError(
                f"{finding.text.partition(';')[0].lower()}; the robot's filter takes it as it is and gets lost, "
                f"whatever the values. {finding.do}"
            )
        if (wrong := MENDED_FIRST.get(finding.name)) is not None:
            raise TooLittleDataError(f"correct the {wrong} first: {finding.text} {finding.do}")
    own = (arguments.model or stack.default_model) if file is None else file.model
    models = [own]
    if arguments.model is None and not stack.model(own).weight.is_product:
        models += [name for name in stack.models if stack.model(name).weight == FIELD_PRODUCT]
    plain = next((form.result.parameters for form in result.candidates if form.is_chapter), None)

    def fit(model: str) -> StackFit:
        start = stack.start(model) if file is None else checked_values(replace(file, model=model))
        seen = hollowed(grid) if takes_hollow_map(job, stack.name, [(model, start)], grid) else grid
        return fit_stack(
            stack.name, model, sensor, seen, start=start,
            beam_parameters=plain, options=_window_options(job), selection=result.options.selection,
            block_s=arguments.block, progress=job.progress,
        )  # fmt: skip

    return [fit(model) for model in models]


def _best(fits: Sequence[StackFit]) -> StackFit:
    """Return the fit of the best model, if scans tell anything with its values."""
    from beamfield.stacks.fit.fit import net_score

    best = max(fits, key=lambda fit: net_score(fit.chosen.crossed))
    score = best.chosen.held_out.mean
    if score < LEAST_SCORE:
        raise TooLittleDataError(
            f"with the best ones {best.options.scans} scans tell {score:.2f} nats of where the robot is, less than "
            f"that it is near its reference pose at all ({LEAST_SCORE:.2f}); do log, poses and map belong together?"
        )
    return best


def _fit_of(fits: Sequence[StackFit], model: str) -> StackFit:
    return next(fit for fit in fits if fit.model.model == model)


def _window_options(job: CalibrationJob) -> WindowOptions:
    from beamfield.calibration.pose_windows import WindowOptions

    return WindowOptions(reference_error=job.arguments.reference_error, seed=job.arguments.seed)


def write_patch(file: StackFile, fitted: StackPart) -> tuple[str, Path | None]:
    """Change the user's file, unless there is nothing new or no value may be used yet.

    Returns
    -------
    A line that says what was done, and the backup; None if the file stays.
    """
    from beamfield.stacks.files.parameter_file import write_values

    values = file.by_names_in_file(fitted.values or {})
    left = f"left {file.section.path} as it was"
    if fitted.doubt:
        return "; what would have changed is in ".join([left, *fitted.files][:2]), None
    if not values and is_noted(fitted.record, file.section.text):
        return left, None
    backup = write_values(file.section, values, record=fitted.record)
    noted = "that its values were checked" if notes_values(fitted.record) else "for which map its values are"
    changed = f"changed {', '.join(values)}" if values else f"noted {noted}"
    said = [
        f"{changed} in {file.section.path}",
        file.section.arguments_replaced_by(values),
        f"the old file is {backup.name}",
    ]
    return "; ".join(text for text in said if text), backup


def next_step(arguments: argparse.Namespace, backup: Path, fitted: StackPart, before: StackFile) -> str:
    """Return the command that compares the file with the old one on another drive; empty if they do the same."""
    is_moved, was_moved = MOVED_MAP in fitted.files, goes_with_moved_map(before.section.text)
    if not (fitted.values or is_moved > was_moved):
        return ""
    moved = arguments.out / MOVED_MAP
    words = ["--map", arguments.map, "--params", backup, arguments.patch]
    words += ["--map-topic", arguments.map_topic] if arguments.map_topic is not None else []
    # Without being told, evaluate takes the file for that of the likeliest program.
    words += ["--stack", before.stack] if before.stack != before.possible[0] else []
    words += ["--filter-maps", moved if was_moved else arguments.map, moved] if is_moved else []
    words += ["--section", arguments.section] if arguments.section is not None else []
    return f"next, on another drive: beamfield evaluate OTHER_LOG {shlex.join(map(str, words))}"


def _record(found: StackResult) -> str:
    from beamfield.stacks.files.calibration_record import record_text
    from beamfield.stacks.registry import STACKS

    held_out, model = found.trial.held_out, found.chosen.model
    judged = f"{held_out.coverage:.0%} of {len(held_out.log_score)} held-out windows covered"
    replay = None if STACKS[model.stack].motion_elsewhere else found.replay
    motion = None if replay is None else replay.chosen.filter.motion
    return record_text(model.stack, model.model, found.parameters, motion, __version__, judged)


def _file_text(
    arguments: argparse.Namespace, found: StackResult, values: dict[str, Any], record: str, said: list[str]
) -> str:
    from beamfield.report.stack_findings import other_motion, small_z_hit
    from beamfield.report.stack_section import stack_verdict
    from beamfield.stacks.files.new_file import new_file_text

    model = found.chosen.model
    missed = "" if found.covers else ", but too many held-out windows missed"
    comments = [
        record or f"{model.stack} {model.model}: fitted by beamfield {__version__}{missed}",
        f"log {json.dumps(arguments.log.name)}, map {json.dumps(arguments.map.name)}",
        stack_verdict(found),
        *said,
        *(item.text for item in small_z_hit(model.stack, model.model, found.parameters)),
        *(item.text for item in other_motion(found)),
    ]
    if found.replay is not None and found.replay.chosen.changes_map:
        comments.append(f"for the map {MOVED_MAP} beside this file, see there")
    return new_file_text(arguments.stack, values, comments=comments)
