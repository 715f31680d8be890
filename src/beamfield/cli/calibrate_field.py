"""The part of ``beamfield calibrate`` that learns the likelihood field and writes its file."""

from __future__ import annotations

from typing import TYPE_CHECKING

from beamfield.cli.report_part import ReportPart
from beamfield.cli.terminal import line_width
from beamfield.errors import TooLittleDataError

if TYPE_CHECKING:
    from beamfield.calibration.calibrate import Calibration
    from beamfield.calibration.field.learning import FieldLearning
    from beamfield.cli.calibrate_sensor import CalibrationJob
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.sensors import SensorLog

NAME = "likelihood_field"


def learn_field(
    job: CalibrationJob, sensor: SensorLog, grid: OccupancyGrid, result: Calibration
) -> FieldLearning | TooLittleDataError:
    """Learn the likelihood field from the log and the map that the beam model was learned from, or return why not."""
    from beamfield.calibration.field.learning import learn_field_parameters
    from beamfield.maps.solids import hollowed

    job.progress("learning the likelihood field", 0, 1)
    try:
        # As `localize` takes it.
        return learn_field_parameters(
            sensor,
            hollowed(grid),
            beam_parameters=result.parameters,
            reference_error=job.arguments.reference_error,
            selection=result.options.selection,
            block_s=job.arguments.block,
            seed=job.arguments.seed,
        )
    except TooLittleDataError as error:
        return error


def field_part(job: CalibrationJob, learned: FieldLearning | TooLittleDataError) -> ReportPart:
    """Return the file of the likelihood field, and what is said of it."""
    from beamfield.report.as_json import plain
    from beamfield.report.field_section import ANCHOR, TITLE, field_section, field_tables
    from beamfield.report.page_section import PageSection
    from beamfield.report.results import field_text

    if isinstance(learned, TooLittleDataError):
        why = str(learned)
        section = PageSection.without(ANCHOR, TITLE, f"Not learned: {why}.")
        return ReportPart(NAME, f"no likelihood field: {why}", {"missing": why}, section)
    text = field_text(learned, provenance=job.origin)
    return ReportPart(
        NAME, field_tables(learned, width=line_width()), plain(learned), field_section(learned, text),
        {f"{NAME}.yaml": text}, learned.findings,
    )  # fmt: skip
