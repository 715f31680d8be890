"""The part of ``beamfield calibrate`` that says with which model and exponent our own filter localizes better."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, NamedTuple

from beamfield.cli.report_part import ReportPart
from beamfield.errors import TooLittleDataError

if TYPE_CHECKING:
    from beamfield.calibration.calibrate import Calibration
    from beamfield.calibration.context.exponent import ExponentLearning
    from beamfield.calibration.field.learning import FieldLearning
    from beamfield.cli.calibrate_sensor import CalibrationJob
    from beamfield.localization.model_choice import ModelChoice
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.models.base import MeasurementModel
    from beamfield.models.beam_parameters import BeamParameters
    from beamfield.sensors import Scan, SensorLog

NAME = "own_filter"
FIELD, BEAM = "likelihood_field.yaml", "beam_model.yaml"
# The exponent of single scans makes a filter surer: it is taken if the error on the log is by so much less, relatively.
MARGIN = 0.05


class OwnChoice(NamedTuple):
    """What our own filter does on the log."""

    part: ReportPart
    counting: ExponentLearning
    """How much the beams of the beam model count, with the exponent to take."""
    field: FieldLearning
    """The likelihood field, with the exponent to take."""


def choose_own_model(
    job: CalibrationJob,
    sensor: SensorLog,
    grid: OccupancyGrid,
    result: Calibration,
    counting: ExponentLearning | TooLittleDataError,
    field: FieldLearning | TooLittleDataError,
) -> OwnChoice | None:
    """Run the filter of ``beamfield localize`` with both models, each with the exponents of drives and of single scans.

    None with --stack, for sonars, without odometry, if one model was not learned with its exponent, or no value may be
    used. What posteriors gain on held-out blocks says it less well, least where reference poses are good to some
    centimetres only: docs/evidence/localization.md.
    """
    from beamfield.localization.model_choice import choose_model
    from beamfield.report.model_choice_section import choice_as_dict, choice_section, choice_table
    from beamfield.report.verdict import doubts

    # In another building's map a filter searches for the robot, in vain and for long.
    if job.arguments.stack is not None or sensor.finder.opening_angle > 0.0 or doubts(result):
        return None
    if isinstance(counting, TooLittleDataError) or isinstance(field, TooLittleDataError) or field.exponents is None:
        return None
    models = models_to_try(grid, result.parameters, counting, field)
    try:
        tried = choose_model(models, grid, sensor, progress=partial(job.progress, "localizing with both models"))
    except TooLittleDataError:
        return None
    counting = with_better_exponent(BEAM, counting, tried)
    exponents = with_better_exponent(FIELD, field.exponents, tried)
    field = replace(
        field, exponents=exponents, exponent=exponents.in_filter.value,
        intervals={**field.intervals, "exponent": exponents.in_filter.interval},
    )  # fmt: skip
    files = {name_of(FIELD, field.exponent): FIELD, name_of(BEAM, counting.in_filter.value): BEAM}
    part = ReportPart(NAME, choice_table(tried, files), choice_as_dict(tried, files), choice_section(tried, files))
    return OwnChoice(part, counting, field)


def models_to_try(
    grid: OccupancyGrid, parameters: BeamParameters, counting: ExponentLearning, field: FieldLearning
) -> dict[str, MeasurementModel[Scan]]:
    """Return both models with both exponents, as ``beamfield localize`` makes them of their files."""
    from beamfield.maps.solids import hollowed
    from beamfield.models.beam import BeamModel
    from beamfield.models.likelihood_field import LikelihoodFieldModel

    assert field.exponents is not None
    solid = hollowed(grid)
    of_field = {
        name_of(FIELD, exponent): LikelihoodFieldModel(
            solid, field.parameters, n_beams=field.n_beams, exponent=exponent
        )
        for exponent in _both(field.exponents)
    }
    of_beams = {
        name_of(BEAM, exponent): BeamModel(grid, parameters, n_beams=counting.n_beams, exponent=exponent)
        for exponent in _both(counting)
    }
    return {**of_field, **of_beams}


def with_better_exponent(file: str, learned: ExponentLearning, tried: ModelChoice) -> ExponentLearning:
    """Return the exponents of a file, with that for a filter with which ours errs less."""
    drive, single = (tried.trials[name_of(file, exponent)].mean("mean") for exponent in _both(learned))
    return replace(learned, single_in_filter=single < (1.0 - MARGIN) * drive)


def _both(learned: ExponentLearning) -> tuple[float, float]:
    return learned.drive.value, learned.single.value


def name_of(file: str, exponent: float) -> str:
    """Return what a model with an exponent is called where several are tried."""
    return f"{file}, exponent {exponent:.3g}"
