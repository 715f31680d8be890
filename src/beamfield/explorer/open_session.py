"""A session from a log and a map: the log's own values learned, its scans judged."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from beamfield.arguments import checked
from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.calibration.context.exponent import ExponentLearning, learn_exponent
from beamfield.calibration.field.learning import learn_field_parameters
from beamfield.errors import BeamfieldError, TooLittleDataError
from beamfield.explorer.parameter_set import ParameterSet, fitted_sets, typical_sets
from beamfield.explorer.reading import beam_parameters, reading_score
from beamfield.explorer.session import Session
from beamfield.explorer.shown_run import ERROR, ShownRun
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.maps.solids import hollowed
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.scan_fit.reference import calibrate_scan_fit
from beamfield.scan_fit.scan_fit import ScanFits, judge_log
from beamfield.sensors import SensorLog

# Of a beam model that is fitted: more beams add nothing to its posteriors, and each costs a ray
# (docs/evidence/in_context.md).
N_BEAMS = 30
Progress = Callable[[str, int, int], None]


@checked
def open_session(
    log: SensorLog,
    grid: OccupancyGrid,
    sets: Sequence[ParameterSet] = (),
    *,
    run: ShownRun | None = None,
    fit: bool = True,
    progress: Progress | None = None,
) -> tuple[Session, str | None]:
    """Return a session, and why nothing was learned from the log, if that was asked for and could not be.

    The log has odometry for filters, and reference poses for all that judges. The sets are compared with those that are
    learned, and with typical ones. To fit a beam model and a likelihood field, and judge the scans, takes some seconds.
    """
    report = progress or _silent
    numbers: dict[str, FloatArray] = {}
    held_out = why = None
    if fit:
        try:
            learned = calibrate(log, grid, CalibrationOptions(refine=False), progress=report)
            report("learning the likelihood field", 0, 1)
            field = learn_field_parameters(log, hollowed(grid))
            report("learning how much beams count", 0, 1)
            fitted = fitted_sets(learned.parameters, _exponent(log, grid, learned.parameters), field, grid, log.finder)
            numbers = _timeline(log, grid, fitted[0], run, report)
            sets, held_out = [*sets, *fitted], np.unique(learned.table.scan[learned.held_out])
        except BeamfieldError as error:
            why = str(error)
    if run is not None and log.has_poses:
        numbers[ERROR] = np.hypot(*(run.poses - log.poses)[:, :2].T)
    sets = [*sets, *typical_sets(grid, log.finder, sets)]
    return Session(log, grid, sets, numbers=numbers, run=run, held_out=held_out), why


def _silent(*_: object) -> None:
    pass


def _exponent(log: SensorLog, grid: OccupancyGrid, parameters: BeamParameters) -> ExponentLearning | None:
    """Return how much the beams of a beam model count, as calibrate learns it; None if the log is too short."""
    try:
        return learn_exponent(BeamModel(grid, parameters, n_beams=N_BEAMS), log, grid)
    except TooLittleDataError:
        return None


def _timeline(
    log: SensorLog, grid: OccupancyGrid, learned: ParameterSet, run: ShownRun | None, report: Progress
) -> dict[str, FloatArray]:
    """Return how well each scan fits at its reference pose, and how likely a filter's run was lost."""
    model = BeamModel(grid, beam_parameters(learned.values))
    reference = calibrate_scan_fit(model, log, progress=lambda done, total: report("scoring wrong poses", done, total))

    def judged(posed: SensorLog) -> ScanFits:
        return judge_log(
            model, posed, reference, is_own=True, progress=lambda done, total: report("judging scans", done, total)
        )

    fits, each, caster = judged(log), np.full(len(log), np.nan), RayCaster(grid)
    for i in np.flatnonzero(np.isfinite(log.poses).all(axis=1)):
        score = reading_score(learned, learned.values, log[int(i)], log.poses[i], caster)
        each[i] = np.nan if score is None else score
    numbers = {
        "log likelihood of a reading [nats]": each,
        "p-value": fits.p_value,
        "probability of being lost": fits.lost,
    }
    if run is not None:
        numbers["filter: probability of being lost"] = judged(log.with_poses(run.poses)).lost
    return numbers
