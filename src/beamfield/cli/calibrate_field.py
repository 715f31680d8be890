"""The part of ``beamfield calibrate`` that learns the likelihood field and writes its file."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from beamfield.cli.progress import StageProgress
from beamfield.errors import TooLittleDataError

if TYPE_CHECKING:
    from beamfield.calibration.calibrate import Calibration
    from beamfield.finding import Finding
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.report.page_section import PageSection
    from beamfield.sensors import SensorLog

FILE_NAME = "likelihood_field.yaml"


@dataclass(frozen=True)
class FieldResult:
    """What learning the likelihood field adds to the outputs.

    Parameters
    ----------
    table
        For the terminal.
    document
        For calibration.json.
    section
        For the report.
    files
        The parameter file by its name; none if too little could be learned from.
    findings
        For the findings of the calibration.
    """

    table: str
    document: Mapping[str, Any]
    section: PageSection
    files: Mapping[str, str]
    findings: tuple[Finding, ...] = ()


def learn_field(
    arguments: argparse.Namespace,
    sensor: SensorLog,
    grid: OccupancyGrid,
    result: Calibration,
    origin: Mapping[str, Any],
    progress: StageProgress,
) -> FieldResult:
    """Learn the likelihood field from the log and the map that the beam model was learned from."""
    from beamfield.calibration.field.learning import learn_field_parameters
    from beamfield.io.parameters.likelihood_field_file import likelihood_field_text
    from beamfield.report.as_json import plain
    from beamfield.report.field_section import field_missing, field_section, field_tables

    progress("learning the likelihood field", 0, 1)
    try:
        learned = learn_field_parameters(
            sensor,
            grid,
            beam_parameters=result.parameters,
            reference_error=arguments.reference_error,
            selection=result.options.selection,
            block_s=arguments.block,
            seed=arguments.seed,
        )
    except TooLittleDataError as error:
        return FieldResult(f"no likelihood field: {error}", {"missing": str(error)}, field_missing(str(error)), {})
    text = likelihood_field_text(
        learned.parameters,
        sensor.finder,
        exponent=learned.exponent,
        n_beams=learned.n_beams,
        intervals=learned.intervals,
        provenance=origin,
    )
    return FieldResult(
        field_tables(learned), plain(learned), field_section(learned, text), {FILE_NAME: text}, learned.findings
    )
