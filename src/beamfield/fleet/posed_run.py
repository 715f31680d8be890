"""A run with poses: read, in its map, with the scans that are worth their beams."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.odometry.learning import learn_systematic_errors
from beamfield.calibration.selection import Selection, select_scans
from beamfield.errors import FormatError, InvalidInputError, TooLittleDataError
from beamfield.fleet.beam_rows import PosedBeams, days_of, for_float32
from beamfield.fleet.manifest import ManifestRow
from beamfield.fleet.run_record import OdometryErrors
from beamfield.fleet.scan_job import RunFiles
from beamfield.geometry import FloatArray
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.io.trajectory import attach_poses, read_trajectory
from beamfield.localization.fitted_poses import cross_fit_poses
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import SensorLog

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
    """

    grid: OccupancyGrid
    log: SensorLog
    parts: tuple[PosedBeams, ...]
    covariances: FloatArray | None
    pose_source: Literal["log", "file", "fitted"]
    share_trusted: float
    selection: Selection
    days: NDArray[np.int64]


def read_run(row: ManifestRow, files: RunFiles) -> PosedRun:
    """Read a run, and fit its poses to the map if it has none.

    Parameters
    ----------
    row, files
        What the manifest says of it, and where it is on this machine.

    Raises
    ------
    BeamfieldError
        If it cannot be used, as the readers, `cross_fit_poses` and `select_scans` say.
    OSError
        As the file system says.
    """
    grid = read_map(files.map)
    if not grid.occupied.any():
        raise FormatError(files.map, "the map has no occupied cell: no ray has an expected range")
    scans = read_log(files.log, sensor_topic=row.sensor or None, lone_poses=row.lone_poses)
    source: Literal["log", "file", "fitted"] = "log"
    if files.poses is not None:
        try:
            scans, source = attach_poses(scans, read_trajectory(files.poses)), "file"
        except InvalidInputError as error:
            raise FormatError(files.poses, str(error)) from error
    log = for_float32(scans.only_sensor())
    days = days_of(log.stamps)
    if days is None:
        raise FormatError(files.log, "stamps are in no year from 1970 to 9999: seconds since 1970 are expected")
    covariances, share = None, 1.0
    parts: tuple[PosedBeams, ...] = (_all_beams(log),)
    if not log.has_poses:
        log, parts, covariances, share = _fitted(log, grid, row, files)
        source = "fitted"
    elif row.start is not None:
        raise FormatError(row.manifest, "is for a log without poses, and this one has them", line=row.line or None,
                          field="start")  # fmt: skip
    selection = select_scans(parts[0].log, grid)
    return PosedRun(grid, log, parts, covariances, source, share, selection, days)


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


def _all_beams(log: SensorLog) -> PosedBeams:
    return PosedBeams(log, np.arange(log.finder.n_beams, dtype=np.int32))


def _fitted(
    log: SensorLog, grid: OccupancyGrid, row: ManifestRow, files: RunFiles
) -> tuple[SensorLog, tuple[PosedBeams, ...], FloatArray, float]:
    """Return a log with poses by all its beams, each half of the beams with poses by the other, and how sure they are.

    The covariances are those of one half's poses; those of the other are much alike.
    """
    if not log.has_odometry:
        raise FormatError(
            files.log, f"{NO_POSES}, and without odometry none is fitted: scans alone slide along corridors; give poses"
        )
    if log.finder.opening_angle > 0.0:
        raise FormatError(files.log, f"{NO_POSES}, and none is fitted to the cones of a sonar; give poses")
    start = None
    if row.start is not None:
        x, y, degrees = row.start
        start = (x, y, math.radians(degrees))
    fitted = cross_fit_poses(log, grid, start=start)
    if fitted.swapped is None:
        parts: tuple[PosedBeams, ...] = (_all_beams(fitted.judged),)
    else:
        k = log.finder.n_beams
        parts = tuple(
            PosedBeams(half, np.arange(first, k, 2, dtype=np.int32))
            for first, half in enumerate((fitted.judged, fitted.swapped))
        )
    return fitted.log, parts, fitted.fit.covariances, fitted.n_trusted / len(log)
