"""The part of ``beamfield calibrate`` that learns how many independent beams a scan is worth."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from beamfield.cli.report_part import ReportPart
from beamfield.errors import TooLittleDataError

if TYPE_CHECKING:
    from beamfield.calibration.calibrate import Calibration
    from beamfield.calibration.context.exponent import ExponentLearning
    from beamfield.cli.calibrate_sensor import CalibrationJob
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.sensors import SensorLog

NAME = "independent_beams"
# More than 30 beams add nothing to a beam model's posteriors, and each costs a ray: docs/evidence/in_context.md.
N_BEAMS = 30


def learn_beam_exponent(
    job: CalibrationJob, sensor: SensorLog, grid: OccupancyGrid, result: Calibration
) -> ExponentLearning | TooLittleDataError:
    """Learn the exponents of the beam model from the log and map of its parameters, or return why not."""
    from beamfield.calibration.context.exponent import learn_exponent
    from beamfield.models.sonar import model_of_sensor

    job.progress("learning how much beams count", 0, 1)
    unknown: Literal["free", "occupied"] = "occupied" if result.options.unknown == "occupied" else "free"
    try:
        return learn_exponent(
            model_of_sensor(sensor.finder)(grid, result.parameters, n_beams=N_BEAMS, unknown=unknown),
            sensor,
            grid,
            reference_error=job.arguments.reference_error,
            selection=result.options.selection,
            block_s=job.arguments.block,
            seed=job.arguments.seed,
        )
    except TooLittleDataError as error:
        return error


def exponent_part(learned: ExponentLearning | TooLittleDataError) -> ReportPart:
    """Return what is said of the exponents."""
    from beamfield.report.exponent_section import ANCHOR, TITLE, exponent_as_dict, exponent_section, exponent_table
    from beamfield.report.page_section import PageSection

    if isinstance(learned, TooLittleDataError):
        why = str(learned)
        table = f"how many independent beams a scan is worth was not learned: {why}"
        section = PageSection.without(ANCHOR, TITLE, f"Not learned: {why}.")
        return ReportPart(NAME, table, {"missing": why}, section)
    return ReportPart(NAME, exponent_table(learned), exponent_as_dict(learned), exponent_section(learned))
