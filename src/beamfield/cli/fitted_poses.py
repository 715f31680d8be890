"""What commands do with a log that has no reference poses: fit them to the map first."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from beamfield.cli.options import start_of
from beamfield.cli.progress import StageProgress
from beamfield.errors import (
    BeamfieldError,
    FormatError,
    InvalidInputError,
    TooLittleDataError,
    TrajectoryNotFoundError,
    about_file,
)
from beamfield.localization.robot_faults import OF_THE_ROBOT

if TYPE_CHECKING:
    from beamfield.finding import Finding
    from beamfield.localization.fitted_poses import FittedPoses
    from beamfield.maps.occupancy import OccupancyGrid
    from beamfield.sensors import SensorLog

NAME = "fitted_poses"
Fitted = TypeVar("Fitted", bound="FittedPoses")
Start = tuple[float, float, float] | None
NO_POSE = "no scan has a reference pose"
# Why fitted poses may not move as the odometry does, and what helps.
SLID = (
    "The fit slides where much of the map is out of date or little is in sight, or the odometry slips: the scans do "
    "not tell which."
)
INSTEAD = (
    "Look at the path over the map there (beamfield trajectory draws it). Map that place anew, drive again where the "
    "map is right, or give poses from elsewhere with --poses."
)
# What refutes a log's own poses.
REFUTED = ("map-disagrees", "map-disagrees-in-part", "map-out-of-date", "reference-slides", "reference-stands-still")
# What may be the fault of poses that lie a little off, or of a laser or a clock that moved them.
IN_DOUBT = {*REFUTED, "odometry-disagrees"}
# At a filter's poses all of these look like something else.
NAMED_AT_FITTED_POSES = {*OF_THE_ROBOT, "scan-parts-disagree"}


def posed_log(
    sensor: SensorLog, grid: OccupancyGrid, arguments: argparse.Namespace, progress: StageProgress, path: Path,
    poses: Path | None, start: Start,
) -> tuple[SensorLog, FittedPoses | None, tuple[Finding, ...]]:  # fmt: skip
    """Return a log with reference poses, its own or else fitted to the map, what was fitted, and findings on the poses.

    Its own are those of a localizer that may have been lost: where they do not go with the map or the odometry, and
    others can be fitted that are elsewhere or show what is wrong with the robot, these are taken; not if they are from
    a file that the user named, `poses`.
    """
    from beamfield.calibration.reference_checks import pose_findings
    from beamfield.localization.fitted_poses import fit_poses
    from beamfield.maps.range_scale import require_metres
    from beamfield.sensors.robot_in_sight import robot_in_sight

    if not has_poses(sensor, start):
        fitted = fit_in_map(fit_poses, sensor, grid, arguments, progress, path=path, start=start)
        return fitted.log, fitted, fitted.findings()
    with about_file(path):
        require_metres(sensor, grid)
    found = tuple(pose_findings(sensor, grid))
    if poses is None:
        better = instead_of_own(sensor, grid, found, progress)
        if better is not None:
            return better.log, better, better.findings()
    # Beams that see the robot disagree with any map.
    return sensor, None, (*robot_in_sight(sensor), *found)


def posed_as_asked(
    sensor: SensorLog, grid: OccupancyGrid, arguments: argparse.Namespace, progress: StageProgress
) -> tuple[SensorLog, FittedPoses | None, tuple[Finding, ...]]:
    """Return LOG with reference poses; see `posed_log`."""
    path, poses, start = arguments.log, arguments.poses, start_of(arguments)
    return posed_log(sensor, grid, arguments, progress, path, poses, start)


def has_poses(sensor: SensorLog, start: Start) -> bool:
    """Return whether a log has poses of its own, and refuse a --start for them."""
    if sensor.has_poses and start is not None:
        raise InvalidInputError("--start: is for a log without reference poses, and this one has them")
    return sensor.has_poses


def instead_of_own(
    sensor: SensorLog, grid: OccupancyGrid, found: tuple[Finding, ...], progress: StageProgress
) -> FittedPoses | None:
    """Return poses to take instead of a log's own, if those are in doubt by what was found.

    None if no others can be fitted, or if they are in the same place, as much in doubt, and nothing is wrong with robot
    or map.
    """
    from beamfield.calibration.reference_checks import pose_findings
    from beamfield.localization.fitted_poses import fit_poses
    from beamfield.localization.own_poses import compare_own_poses

    doubts = {one.name for one in found} & IN_DOUBT
    if not doubts or not sensor.has_odometry or sensor.finder.opening_angle > 0.0:
        return None
    try:
        fitted = fit_poses(sensor, grid, progress=progress)
    except BeamfieldError:
        return None
    compared = compare_own_poses(sensor, fitted.fit)
    if compared is None:
        return None
    is_better = (
        compared.name == "own-poses-lost"
        or any(one.name in NAMED_AT_FITTED_POSES for one in fitted.fit.findings)
        or (fitted.fit.is_beyond_doubt and "map-disagrees" in doubts)
        # A filter's poses may lie just so far off that the map or the odometry seems to be what is wrong.
        or (fitted.fit.is_beyond_doubt and {one.name for one in pose_findings(fitted.log, grid)} & IN_DOUBT < doubts)
    )
    return replace(fitted, instead_of=compared) if is_better else None


def with_map_judged(findings: tuple[Finding, ...], fitted: FittedPoses) -> tuple[Finding, ...]:
    """Return findings at fitted poses: if these are beyond doubt, a map that disagrees is out of date.

    Poses that do not move as the odometry does are not answered with the advice to fit some.
    """
    from beamfield.maps.outdated_map import outdated_at_right_poses

    def judged(one: Finding) -> Finding:
        if one.name in ("reference-slides", "reference-stands-still"):
            return replace(one, why=SLID, do=INSTEAD)
        if one.name != "map-disagrees" or not fitted.fit.is_beyond_doubt:
            return one
        return outdated_at_right_poses(one.values["median_agreement"]) or one

    return tuple(judged(one) for one in findings)


def fit_in_map(
    fit: Callable[..., Fitted],
    sensor: SensorLog,
    grid: OccupancyGrid,
    arguments: argparse.Namespace,
    progress: StageProgress,
    *,
    path: Path,
    start: Start,
) -> Fitted:
    """Return what `fit` (`fit_poses` or `cross_fit_poses`) finds, or an error in the words of the command line."""
    if not sensor.has_odometry:
        raise FormatError(
            path,
            f"{NO_POSE}, and without odometry at the times of the scans none is fitted: scans alone slide along "
            "corridors; beamfield inspect says what was read, and whether two clocks differ; or give poses with "
            "--poses (beamfield trajectory makes some of scans, to look at)",
        )
    if sensor.finder.opening_angle > 0.0:
        raise FormatError(path, f"{NO_POSE}, and none is fitted to the cones of a sonar; give poses with --poses")
    try:
        return fit(sensor, grid, start=start, progress=progress)
    except InvalidInputError as error:
        raise about_its_file(error, arguments, path) from error
    except TooLittleDataError as error:
        raise TooLittleDataError(f"{path}: {NO_POSE}, and none can be fitted: {error}") from error
    except TrajectoryNotFoundError as error:
        helps = "--start X Y DEG, or --poses FILE" if start is None else "another --start, or --poses FILE"
        raise FormatError(
            path, f"{NO_POSE}, and none can be fitted: {str(error).rstrip('.')}; what helps: {helps}"
        ) from error


def about_its_file(error: InvalidInputError, arguments: argparse.Namespace, log: Path) -> BeamfieldError:
    """Return an error of the library as one of the file that it is about; a bad start is a wrong option."""
    about, _, text = str(error).partition(": ")
    if about == "start":
        return InvalidInputError(f"--start: {text}")
    return FormatError(arguments.map if about == "grid" else log, text or str(error))


def as_document(fitted: FittedPoses | None) -> dict[str, Any] | None:
    """Return what --json and the written documents say about fitted poses; None for a log with poses."""
    from beamfield.report.as_json import plain

    if fitted is None:
        return None
    return {
        "n_scans": len(fitted.log),
        "n_trusted": fitted.n_trusted,
        "deviation_m": fitted.deviation,
        "start": plain(fitted.fit.poses[0]),
        "hypotheses": plain(fitted.fit.hypotheses),
        "converged": fitted.fit.converged,
        "findings": plain(fitted.findings()),
    }
