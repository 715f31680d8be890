"""The part of ``beamfield calibrate`` that learns the errors and the noise of odometry."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from beamfield.cli.report_part import ReportPart
from beamfield.cli.terminal import line_width
from beamfield.errors import TooLittleDataError

if TYPE_CHECKING:
    from beamfield.calibration.odometry.result import OdometryCalibration
    from beamfield.cli.calibrate_sensor import CalibrationJob
    from beamfield.sensors import SensorLog
    from beamfield.stacks.files.parameter_file import StackFile

NAME = "odometry"


def learn_odometry(job: CalibrationJob, sensor: SensorLog) -> tuple[ReportPart, dict[str, Any]]:
    """Calibrate the odometry; return the part of the report, and values for the file of the stack asked for."""
    from beamfield.calibration.odometry.learning import calibrate_odometry
    from beamfield.calibration.odometry.result import OdometryOptions
    from beamfield.report.odometry_section import ANCHOR, TITLE, odometry_as_dict, odometry_section, odometry_tables
    from beamfield.report.page_section import PageSection

    job.progress("calibrating the odometry", 0, 1)
    options = OdometryOptions(reference_error=job.arguments.reference_error)
    try:
        result = calibrate_odometry(sensor, options)
    except TooLittleDataError as missing:
        why = f"odometry not calibrated: {missing}"
        section = PageSection.without(ANCHOR, TITLE, f"Not calibrated: {missing}.")
        return ReportPart(NAME, why, {"missing": str(missing)}, section, problem=why), {}
    programs, stack = _by_program(result), job.arguments.stack
    shown = {stack: programs[stack]} if stack in programs else programs
    tables = odometry_tables(result, shown, width=line_width())
    part = ReportPart(NAME, tables, odometry_as_dict(result, programs), odometry_section(result, shown))
    return part, _for_stack(job.arguments.stack, job.patched, result)


def _by_program(result: OdometryCalibration) -> dict[str, dict[str, dict[str, float]]]:
    from beamfield.stacks.registry import STACKS

    found: dict[str, dict[str, dict[str, float]]] = {}
    for name, stack in STACKS.items():
        # Without a model's other names.
        first = {values: model for model, values in reversed(list(stack.motions.items()))}
        if first:
            noise = {model: values(result) for model, values in stack.motions.items() if first[values] == model}
            found |= {name: noise} if all(noise.values()) else {}
    return found


def _for_stack(name: str | None, patched: StackFile | None, result: OdometryCalibration) -> dict[str, Any]:
    """Return what to write: parameters of the motion model that the user's file chooses, or of the stack's default.

    None for filters that take every scan: theirs belong to other steps, and replay learns them itself.
    """
    from beamfield.stacks.registry import STACKS

    if name is None:
        return {}
    stack = STACKS[name]
    if stack.filter is None or not hasattr(stack.filter.parameters, "update_min_d"):
        return {}
    entry = None if patched is None else patched.section.entries.get(patched.name_in_file(stack.motion_key))
    convert = stack.motion_from(None if entry is None or entry.value is None else str(entry.value))
    return {} if convert is None else dict(convert(result))
