"""What ``beamfield calibrate`` does for one sensor: learn, and put what was learned into files and tables."""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from beamfield.calibration.calibrate import Calibration, CalibrationOptions, calibrate
from beamfield.calibration.cross_fit import CrossFitMaps, build_cross_fit_maps
from beamfield.cli.calibrate_choice import choose_own_model
from beamfield.cli.calibrate_exponent import exponent_part, learn_beam_exponent
from beamfield.cli.calibrate_field import field_part, learn_field
from beamfield.cli.calibrate_fitted import cross_fitted, judge_fitted, with_fitted_error
from beamfield.cli.calibrate_odometry import learn_odometry
from beamfield.cli.calibrate_stack import fit_for_stack, warn_if_too_short
from beamfield.cli.fitted_poses import with_map_judged
from beamfield.cli.progress import StageProgress
from beamfield.cli.report_part import ReportPart, StackPart
from beamfield.cli.terminal import filled, line_width
from beamfield.cli.wording import in_options
from beamfield.errors import TooLittleDataError, about_file
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.report import html
from beamfield.report.as_json import calibration_as_dict, json_text
from beamfield.report.results import calibration_details, calibration_text
from beamfield.report.verdict import doubts
from beamfield.scan_fit.calibration_fit import fit_of_calibration
from beamfield.sensors import SensorLog

if TYPE_CHECKING:
    from beamfield.calibration.context.exponent import ExponentLearning
    from beamfield.localization.fitted_poses import CrossFittedPoses
    from beamfield.models.beam_parameters import BeamParameters
    from beamfield.stacks.files.parameter_file import StackFile


@dataclass(frozen=True)
class SensorResult:
    """What was learned about one sensor.

    Parameters
    ----------
    files
        Content by name.
    table
        For the terminal.
    document
        Content of calibration.json.
    stack
        The other program's part, if there is one.
    problems
        Why the exit code is 3; none if it is 0.
    learned
        The beam model's parameters, and the scans at the poses that they were learned at.
    """

    files: Mapping[str, str | bytes]
    table: str
    document: Mapping[str, Any]
    stack: StackPart | None
    problems: tuple[str, ...]
    learned: tuple[BeamParameters, SensorLog]


@dataclass(frozen=True)
class CalibrationJob:
    """What is the same for all sensors of a log.

    Parameters
    ----------
    arguments
        The command line.
    grid
        The map; None if it is to be drawn.
    options
        For learning.
    origin
        See `provenance`.
    notes
        From reading the log.
    patched
        The other program's file that is to be changed.
    progress
        Called with stage, steps done and steps in all.
    error_is_given
        Whether --reference-error was typed: poses that are fitted say it themselves.
    """

    arguments: argparse.Namespace
    grid: OccupancyGrid | None
    options: CalibrationOptions
    origin: Mapping[str, Any]
    notes: tuple[str, ...]
    patched: StackFile | None
    progress: StageProgress
    error_is_given: bool = False

    def learn(self, sensor: SensorLog) -> SensorResult:
        """Learn the beam model, the likelihood field and the stack's parameters, and draw the report.

        Poses that the log does not have are fitted first, to every other beam; the others are learned from.
        """
        fitted = cross_fitted(self, sensor)
        if fitted is not None:
            return with_fitted_error(self, fitted)._learned(fitted.judged, fitted)
        return self._learned(sensor, None)

    def _learned(self, sensor: SensorLog, fitted: CrossFittedPoses | None) -> SensorResult:
        with about_file(self.arguments.log):
            maps, result, exponents, parts = self._learn(sensor, fitted)
        self.progress("judging scans", 0, 1)
        scan_fit = fit_of_calibration(result, maps, sensor)
        self.progress("writing the report", 0, 1)
        document = {
            "provenance": self.origin,
            "notes": list(self.notes),
            **calibration_as_dict(result, scan_fit),
            **{part.name: part.document for part in parts},
        }
        model = calibration_text(result, exponents, provenance=self.origin)
        page = html.render_report(
            result,
            maps,
            sensor,
            {**self.origin, "notes": self.notes},
            sections=[part.section for part in parts],
            scan_fit=scan_fit,
        )
        files = {
            "beam_model.yaml": model,
            "calibration.json": json_text(document),
            "report.html": page,
            **{name: text for part in parts for name, text in part.files.items()},
        }
        problems = [] if result.converged else ["the fit did not converge"]
        problems += [part.problem for part in parts if part.problem]
        problems += [doubt] if (doubt := doubts(result).rstrip(".")) else []
        stack = next((part for part in parts if isinstance(part, StackPart)), None)
        return SensorResult(files, _table(result, parts), document, stack, tuple(problems), (result.parameters, sensor))

    def _learn(
        self, sensor: SensorLog, fitted: CrossFittedPoses | None
    ) -> tuple[OccupancyGrid | CrossFitMaps, Calibration, ExponentLearning | None, list[ReportPart]]:
        """Return the map, or those drawn, what was learned, how much beams count, and what else a map teaches."""
        if self.grid is None:
            resolution = self.arguments.resolution or 0.05
            maps = build_cross_fit_maps(sensor, resolution=resolution, progress=self.progress)
            result = calibrate(sensor, maps, self.options, progress=self.progress)
            return maps, result, None, [learn_odometry(self, sensor)[0]] if self.arguments.odometry_noise else []
        whole = sensor if fitted is None else fitted.log
        if self.arguments.stack is not None:
            warn_if_too_short(self, whole, self.grid)
        covariances = None if fitted is None else fitted.fit.covariances
        result = calibrate(sensor, self.grid, self.options, covariances=covariances, progress=self.progress)
        if fitted is not None:
            result = replace(result, findings=with_map_judged(result.findings, fitted))
        counting = learn_beam_exponent(self, sensor, self.grid, result)
        parts = [] if fitted is None else [judge_fitted(self, fitted, self.grid, result)]
        field = learn_field(self, sensor, self.grid, result)
        choice = choose_own_model(self, sensor, self.grid, result, counting, field)
        if choice is not None:
            counting, field = choice.counting, choice.field
        parts += [exponent_part(counting), field_part(self, field), *([] if choice is None else [choice.part])]
        found = [finding for part in parts for finding in part.findings]
        result = replace(result, findings=(*result.findings, *found))
        motion: dict[str, Any] = {}
        if self.arguments.odometry_noise:
            part, motion = learn_odometry(self, sensor)
            parts.append(part)
        if self.arguments.stack is not None:
            # Another program sees whole scans.
            parts.append(fit_for_stack(self, whole, self.grid, result, motion))
        return self.grid, result, None if isinstance(counting, TooLittleDataError) else counting, parts


def _table(result: Calibration, parts: Sequence[ReportPart]) -> str:
    """Return what is printed before the verdict.

    Lines are broken for a terminal only: elsewhere, a line is a parameter or a warning.
    """
    width = line_width()
    details = calibration_details(result, width=width, wording=in_options)
    paragraphs = [paragraph for part in parts if part.table for paragraph in part.table.split("\n\n")]
    # A table has several lines, a sentence has one.
    return "\n\n".join([details, *(text if "\n" in text else filled(text) for text in paragraphs)])
