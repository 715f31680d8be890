"""A run with poses: read, in its map, with the scans that are worth their beams."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.odometry.learning import learn_systematic_errors
from beamfield.calibration.selection import Selection, select_scans
from beamfield.errors import FormatError, InvalidInputError, TooLittleDataError, TrajectoryNotFoundError
from beamfield.finding import Finding
from beamfield.fleet.beam_rows import PosedBeams, days_of, for_float32
from beamfield.fleet.manifest import ManifestRow
from beamfield.fleet.pose_trust import doubts_in, lost_finding, partly_disagrees, pose_warnings, warnings_in
from beamfield.fleet.run_record import OdometryErrors
from beamfield.fleet.scan_job import RunFiles
from beamfield.geometry import FloatArray, Pose
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.io.trajectory import attach_poses, read_trajectory
from beamfield.localization.fitted_poses import cross_fit_poses
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog

PoseSource = Literal["log", "file", "fitted"]
# What fitting poses may end with.
NOT_FITTED = (InvalidInputError, TooLittleDataError, TrajectoryNotFoundError)
NO_POSES = "no scan has a reference pose"


@dataclass(frozen=True, eq=False)
class PosedRun:
    """A run that can be cast.

    Parameters
    ----------
    grid
        The map.
    log
        All beams, with poses.
    parts
        The beams that are cast, with the poses at which they are judged: beams are not judged at poses that were fitted
        to themselves.
    covariances
        (t, 3, 3) of fitted poses; None for others.
    pose_source, share_trusted
        See `RunRecord`.
    selection
        Which scans are used.
    days
        (t,) day (UTC) of each scan, from 1970-01-01.
    findings
        Warnings about the poses and the odometry.
    doubt
        Why the poses cannot be trusted, and the beams not be used; "" if they can.
    notes
        How the log was read.
    """

    grid: OccupancyGrid
    log: SensorLog
    parts: tuple[PosedBeams, ...]
    covariances: FloatArray | None
    pose_source: PoseSource
    share_trusted: float
    selection: Selection
    days: NDArray[np.int64]
    findings: tuple[Finding, ...] = ()
    doubt: str = ""
    notes: tuple[str, ...] = ()


def read_run(row: ManifestRow, files: RunFiles) -> PosedRun:
    """Read a run, and fit its poses to the map if it has none, or if those of its log are wrong.

    BeamfieldError if it cannot be used, as the readers, `cross_fit_poses` and `select_scans` say.
    """
    grid = read_map(files.map)
    if not grid.occupied.any():
        raise FormatError(files.map, "the map has no occupied cell: no ray has an expected range")
    mount = None if row.mount is None else _in_radians(row.mount)
    scans = read_log(files.log, sensor_topic=row.sensor or None, mount=mount, lone_poses=row.lone_poses)
    source: PoseSource = "log"
    if files.poses is not None:
        try:
            scans, source = attach_poses(scans, read_trajectory(files.poses)), "file"
        except InvalidInputError as error:
            raise FormatError(files.poses, str(error)) from error
    log = for_float32(scans.only_sensor())
    days = days_of(log.stamps)
    if days is None:
        raise FormatError(files.log, "stamps are in no year from 1970 to 9999: seconds since 1970 are expected")
    if not log.has_poses:
        _require_fittable(log, files)
        return replace(_fitted_run(log, grid, row, days), notes=scans.notes)
    if row.start is not None:
        raise FormatError(row.manifest, "is for a log without poses, and this one has them", line=row.line or None,
                          field="start")  # fmt: skip
    selection = select_scans(log, grid)
    findings = pose_warnings(log, grid, selection)
    run = PosedRun(grid, log, (_all_beams(log),), None, source, 1.0, selection, days, findings)
    if doubts_in(findings):
        run = _repaired(run, row)
    elif partly_disagrees(findings) and source == "log":
        run = _repaired_in_part(run, row)
    return replace(run, notes=scans.notes)


def odometry_errors(run: PosedRun) -> tuple[OdometryErrors | None, str]:
    """Return the systematic errors of a run's odometry, or why they are not known."""
    try:
        found = learn_systematic_errors(run.log, covariances=run.covariances)
    except (TooLittleDataError, InvalidInputError) as error:
        return None, str(error)
    if not np.isfinite(found.covariance).all():
        return None, "too few blocks of the drive for an interval"
    values = tuple(estimate.value for estimate in found.errors.values())
    return OdometryErrors(tuple(found.errors), values, tuple(map(tuple, found.covariance.tolist()))), ""


def _in_radians(pose: Pose) -> Pose:
    x, y, degrees = pose
    return x, y, math.radians(degrees)


def _all_beams(log: SensorLog) -> PosedBeams:
    return PosedBeams(log, np.arange(log.finder.n_beams, dtype=np.int32))


def _require_fittable(log: SensorLog, files: RunFiles) -> None:
    if not log.has_odometry:
        raise FormatError(
            files.log, f"{NO_POSES}, and without odometry none is fitted: scans alone slide along corridors; give poses"
        )
    if log.finder.opening_angle > 0.0:
        raise FormatError(files.log, f"{NO_POSES}, and none is fitted to the cones of a sonar; give poses")


def _fitted_run(log: SensorLog, grid: OccupancyGrid, row: ManifestRow, days: NDArray[np.int64]) -> PosedRun:
    """Return a run with poses by all its beams, and each half of the beams with poses by the other.

    The covariances are those of one half's poses; those of the other are much alike.
    """
    start = None if row.start is None else _in_radians(row.start)
    fitted = cross_fit_poses(log, grid, start=start)
    if fitted.swapped is None:
        parts: tuple[PosedBeams, ...] = (_all_beams(fitted.judged),)
    else:
        k = log.finder.n_beams
        parts = tuple(
            PosedBeams(half, np.arange(first, k, 2, dtype=np.int32))
            for first, half in enumerate((fitted.judged, fitted.swapped))
        )
    selection = select_scans(parts[0].log, grid)
    findings = (*warnings_in(fitted.findings()), *pose_warnings(fitted.log, grid, selection))
    doubts = doubts_in(findings)
    doubt = f"poses were fitted to the map, but cannot be trusted: {_texts(doubts)}" if doubts else ""
    return PosedRun(grid, fitted.log, parts, fitted.fit.covariances, "fitted", fitted.n_trusted / len(log), selection,
                    days, findings, doubt)  # fmt: skip


def _repaired(run: PosedRun, row: ManifestRow) -> PosedRun:
    """Return a run whose poses are wrong with those that fit its scans, or as it is with the reason for the doubt.

    Where both are nearly the same the robot was not lost, and the odometry is what disagrees: the run keeps its poses.
    Poses that were given in a file are somebody's word, and not replaced. Where the map is out of date the poses are
    right, and others would be fitted to what is not there.
    """
    doubts = doubts_in(run.findings)
    if any(finding.name == "map-out-of-date" for finding in doubts):
        return replace(run, doubt=_texts(doubts))
    culprit = "the given poses are wrong" if run.pose_source == "file" else "the robot was lost"
    doubt = f"{culprit}, or this is not the map: {_texts(doubts)}"
    if not _is_fittable(run.log):
        return replace(run, doubt=doubt)
    try:
        fitted = _fitted_run(run.log, run.grid, row, run.days)
    except NOT_FITTED as error:
        return replace(run, doubt=f"{doubt} No other poses could be fitted: {error}")
    if fitted.doubt:
        return replace(run, doubt=f"{doubt} Other poses were fitted, but cannot be trusted either.")
    lost = lost_finding(run.log, fitted.log, doubts)
    if lost is None:
        known = {"poses-fitted", *(finding.name for finding in run.findings)}
        return replace(run, findings=(*run.findings, *(one for one in fitted.findings if one.name not in known)))
    if run.pose_source == "file":
        return replace(run, doubt=f"{doubt} They are up to {lost.values['largest_m']:.1f} m from those that fit.")
    return replace(fitted, findings=(lost, *fitted.findings))


def _repaired_in_part(run: PosedRun, row: ManifestRow) -> PosedRun:
    """Return a run many of whose scans disagree with the map with other poses, if with these they agree.

    The robot was then lost for part of the run; else part of the map is out of date, and the run stays as it is.
    """
    if not _is_fittable(run.log):
        return run
    try:
        fitted = _fitted_run(run.log, run.grid, row, run.days)
    except NOT_FITTED:
        return run
    lost = lost_finding(run.log, fitted.log, partly_disagrees(run.findings))
    if fitted.doubt or lost is None or partly_disagrees(fitted.findings):
        return run
    return replace(fitted, findings=(lost, *fitted.findings))


def _is_fittable(log: SensorLog) -> bool:
    return log.has_odometry and log.finder.opening_angle == 0.0


def _texts(findings: tuple[Finding, ...]) -> str:
    return " ".join(finding.text for finding in findings)
