"""The part of ``beamfield calibrate`` that fits the poses of a log to the map, and measures what that hides."""

from __future__ import annotations

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING

from beamfield.cli import options
from beamfield.cli.fitted_poses import NAME, fit_in_map, has_poses, instead_of_own
from beamfield.cli.report_part import ReportPart

if TYPE_CHECKING:
    from beamfield.calibration.calibrate import Calibration
    from beamfield.cli.calibrate_sensor import CalibrationJob
    from beamfield.localization.fitted_poses import CrossFittedPoses
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.sensors import SensorLog


def cross_fitted(job: CalibrationJob, sensor: SensorLog) -> CrossFittedPoses | None:
    """Return poses of a log, fitted by one half of its beams each; None for a log with poses that hold, or no map."""
    from beamfield.calibration.reference_checks import pose_findings
    from beamfield.localization.fitted_poses import cross_fit_poses

    start, instead_of = options.start_of(job.arguments), None
    if job.grid is None:
        return None
    if has_poses(sensor, start):
        found = tuple(pose_findings(sensor, job.grid))
        better = None if job.arguments.poses is not None else instead_of_own(sensor, job.grid, found, job.progress)
        if better is None:
            return None
        instead_of = better.instead_of
    fitted = fit_in_map(
        cross_fit_poses, sensor, job.grid, job.arguments, job.progress, path=job.arguments.log, start=start
    )
    return replace(fitted, instead_of=instead_of)


def with_fitted_error(job: CalibrationJob, fitted: CrossFittedPoses) -> CalibrationJob:
    """Return the job with the poses' error as the fit says it, unless the user gave one."""
    if job.error_is_given:
        return job
    error = float(f"{fitted.reference_error:.3g}")
    options = {**job.origin["options"], "reference_error": error}
    arguments = argparse.Namespace(**{**vars(job.arguments), "reference_error": error})
    return replace(job, arguments=arguments, origin={**job.origin, "options": options})


def judge_fitted(job: CalibrationJob, fitted: CrossFittedPoses, grid: OccupancyGrid, result: Calibration) -> ReportPart:
    """Learn from the other beams too, at poses from the first and at their own: the difference is what fitting hides.

    The form of the hit component is that of the result.
    """
    from beamfield.calibration.calibrate import calibrate
    from beamfield.report.fitted_poses_section import (
        SAME,
        SWAPPED,
        TITLE,
        USED,
        fitted_poses_as_dict,
        fitted_poses_section,
        fitted_poses_sentence,
    )

    results = {USED: result}
    form = result.parameters
    plain = replace(
        job.options, refine=False, range_offset="on" if form.range_offset else "off",
        sigma_slope="on" if form.sigma_slope else "off",
    )  # fmt: skip
    job.progress("learning from the other beams", 0, 2)
    for name, log in ((SWAPPED, fitted.swapped), (SAME, fitted.same)):
        if log is not None:
            results[name] = calibrate(log, grid, plain)
            job.progress("learning from the other beams", len(results) - 1, 2)
    error = job.arguments.reference_error
    said, *others = fitted.findings(fitted_poses_sentence(fitted, error))
    sentence, known = said.full_text, {finding.name for finding in result.findings}
    findings = (said, *(finding for finding in others if finding.name not in known))
    return ReportPart(
        NAME, f"{sentence} What was measured about the fit: report.html, {TITLE!r}.",
        fitted_poses_as_dict(fitted, results, error),
        fitted_poses_section(sentence, fitted, results, given=job.error_is_given), findings=findings,
    )  # fmt: skip
