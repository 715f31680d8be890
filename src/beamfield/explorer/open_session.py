"""A session from a log and a map: parameter files read, the log's own values learned, its scans judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.calibration.field.learning import learn_field_parameters
from beamfield.errors import BeamfieldError
from beamfield.explorer.parameter_set import fitted_sets, read_set, typical_sets
from beamfield.explorer.session import Session
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.scan_fit.reference import calibrate_scan_fit
from beamfield.scan_fit.scan_fit import judge_log
from beamfield.sensors import SensorLog, usable_ranges

Progress = Callable[[str, int, int], None]


def open_session(
    log: SensorLog,
    grid: OccupancyGrid,
    files: Sequence[str | Path] = (),
    *,
    fit: bool = True,
    progress: Progress | None = None,
) -> tuple[Session, str | None]:
    """Return a session, and why nothing was learned from the log, if that was asked for and could not be.

    Parameters
    ----------
    log
        Scans of a laser scanner, with odometry for filters, and reference poses for all that judges.
    grid
        The map.
    files
        Parameter files to compare: beam_model.yaml, likelihood_field.yaml, or another program's.
    fit
        Whether to learn a beam model and a likelihood field from the log, and to judge its scans: some seconds.
    progress
        Called with stage, steps done and steps in all.

    Raises
    ------
    FormatError
        If a file cannot be used.
    """
    report = progress or _silent
    sets = [read_set(Path(file), grid, log.finder) for file in files]
    numbers: dict[str, FloatArray] = {}
    why = None
    if fit:
        try:
            beam = calibrate(log, grid, CalibrationOptions(refine=False), progress=report).parameters
            report("learning the likelihood field", 0, 1)
            field = learn_field_parameters(log, grid)
            sets += fitted_sets(beam, field, grid, log.finder)
            numbers = _timeline(log, grid, beam, report)
        except BeamfieldError as error:
            why = str(error)
    return Session(log, grid, [*sets, *typical_sets(grid, log.finder)], numbers=numbers), why


def _silent(*_: object) -> None:
    pass


def _timeline(
    log: SensorLog, grid: OccupancyGrid, parameters: BeamParameters, report: Progress
) -> dict[str, FloatArray]:
    """Return how well each scan fits at its reference pose."""
    model = BeamModel(grid, parameters)
    reference = calibrate_scan_fit(model, log, progress=lambda done, total: report("scoring wrong poses", done, total))
    fits = judge_log(
        model, log, reference, is_own=True, progress=lambda done, total: report("judging scans", done, total)
    )
    each = np.full(len(log), np.nan)
    for i in np.flatnonzero(np.isfinite(log.poses).all(axis=1)):
        scan = log[int(i)]
        n = np.isfinite(usable_ranges(scan.ranges, scan.finder)).sum()
        if n:
            each[i] = model.log_likelihood(scan, log.poses[i]) / n
    return {"log likelihood of a beam": each, "p-value": fits.p_value, "probability of being lost": fits.lost}
