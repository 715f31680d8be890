"""The last step of a calibration: how well each scan of its own log fits, and whether the robot was ever lost."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beamfield.calibration.calibrate import Calibration
from beamfield.calibration.cross_fit import CrossFitMaps
from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.range_mixture import RangeMixtureModel
from beamfield.models.sonar import model_of_sensor
from beamfield.scan_fit.cross_fit_statistics import cross_fit_statistics
from beamfield.scan_fit.reference import ScanFitReference, calibrate_scan_fit
from beamfield.scan_fit.scan_fit import ScanFits, judge_log
from beamfield.scan_fit.statistics import fit_statistics
from beamfield.sensors import SensorLog


@dataclass(frozen=True, eq=False)
class CalibrationFit:
    """Result of `fit_of_calibration`.

    Parameters
    ----------
    fits, reference
        Each scan of the log against the others; None if they cannot be judged.
    missing
        Why they cannot; empty if they can.
    """

    fits: ScanFits | None = None
    reference: ScanFitReference | None = None
    missing: str = ""


def fit_of_calibration(calibration: Calibration, grid: OccupancyGrid | CrossFitMaps, log: SensorLog) -> CalibrationFit:
    """Judge every scan of a calibration's log by the others, with the parameters that were learned.

    The map may be the two maps that the log drew itself. A log with too few scans or a map without free cells is not an
    error: `missing` says so.

    References
    ----------
    Section 6.3.1; (6.2).
    """
    if calibration.map_from_log and not isinstance(grid, CrossFitMaps):
        return CalibrationFit(
            missing="a map that the scans drew themselves fits them whatever happens, and the two maps of the halves "
            "were not given"
        )

    def model_on(grid: OccupancyGrid) -> RangeMixtureModel:
        return model_of_sensor(log.finder)(grid, calibration.parameters)

    if isinstance(grid, CrossFitMaps):
        # Wrong poses are scored in the map of all scans: what a scan drew itself is not where they are.
        model, statistics = model_on(grid.whole), cross_fit_statistics(model_on, grid, log)
    else:
        model = model_on(grid)
        statistics = fit_statistics(model, log.ranges, log.finder, log.poses)
    options = calibration.options
    try:
        reference = calibrate_scan_fit(
            model, log, selection=options.selection, block_s=options.block_s, statistics=statistics
        )
        fits = judge_log(model, log, reference, is_own=True, statistics=statistics)
    except (TooLittleDataError, InvalidInputError) as error:
        return CalibrationFit(missing=str(error))
    if np.isnan(fits.p_value).all():
        return CalibrationFit(missing="no scan could be judged")
    return CalibrationFit(fits, reference)
