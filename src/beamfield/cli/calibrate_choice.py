"""The part of ``beamfield calibrate`` that says which of the two models localizes better in our own filter."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING

from beamfield.cli.report_part import ReportPart
from beamfield.errors import TooLittleDataError

if TYPE_CHECKING:
    from beamfield.calibration.calibrate import Calibration
    from beamfield.calibration.context.exponent import ExponentLearning
    from beamfield.calibration.field.learning import FieldLearning
    from beamfield.cli.calibrate_sensor import CalibrationJob
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.models.base import MeasurementModel
    from beamfield.sensors import Scan, SensorLog

NAME = "own_filter"


def choose_own_model(
    job: CalibrationJob,
    sensor: SensorLog,
    grid: OccupancyGrid,
    result: Calibration,
    counting: ExponentLearning | None,
    field: FieldLearning | None,
) -> ReportPart | None:
    """Run the filter of ``beamfield localize`` with both models.

    None with --stack, for sonars, without odometry, if one model was not learned with its exponent, or no value may be
    used. What posteriors gain on held-out blocks says it less well, least where reference poses are good to some
    centimetres only: docs/evidence/localization.md.
    """
    from beamfield.localization.model_choice import choose_model
    from beamfield.maps.solids import hollowed
    from beamfield.models.beam import BeamModel
    from beamfield.models.likelihood_field import LikelihoodFieldModel
    from beamfield.report.model_choice_section import choice_as_dict, choice_section, choice_table
    from beamfield.report.verdict import doubts

    if job.arguments.stack is not None or sensor.finder.opening_angle > 0.0:
        return None
    # In another building's map a filter searches for the robot, in vain and for long.
    if counting is None or field is None or field.exponents is None or doubts(result):
        return None
    beam = BeamModel(grid, result.parameters, n_beams=counting.n_beams, exponent=counting.drive.value)
    of_field = LikelihoodFieldModel(hollowed(grid), field.parameters, n_beams=field.n_beams, exponent=field.exponent)
    models: dict[str, MeasurementModel[Scan]] = {"likelihood_field.yaml": of_field, "beam_model.yaml": beam}
    try:
        choice = choose_model(models, grid, sensor, progress=partial(job.progress, "localizing with both models"))
    except TooLittleDataError:
        return None
    return ReportPart(NAME, choice_table(choice), choice_as_dict(choice), choice_section(choice))
