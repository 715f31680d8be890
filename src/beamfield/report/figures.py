"""All figures of the report in the order of the page."""

from __future__ import annotations

from beamfield.calibration.calibrate import Calibration
from beamfield.calibration.cross_fit import CrossFitMaps
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.report.check_figures import causes_by_bearing, noise_by_range, opposite_widths, pose_shifts
from beamfield.report.density_figures import range_histograms, reading_series
from beamfield.report.map_figures import cause_map, fit_map
from beamfield.report.mixture_figure import mixture
from beamfield.report.panel import ReportFigure
from beamfield.report.pit_figure import pit_histogram
from beamfield.report.scan_fit_figures import fit_of_own_log
from beamfield.scan_fit.calibration_fit import CalibrationFit
from beamfield.sensors import SensorLog


def report_figures(
    calibration: Calibration, grid: OccupancyGrid | CrossFitMaps, log: SensorLog, scan_fit: CalibrationFit | None = None
) -> list[ReportFigure]:
    """Draw every figure for which the calibration has data.

    The map may be the two maps that the log drew itself.
    """
    shown = grid.whole if isinstance(grid, CrossFitMaps) else grid
    drawn = [
        range_histograms(calibration),
        reading_series(calibration),
        mixture(calibration),
        pit_histogram(calibration),
        cause_map(calibration, shown, log),
        fit_map(calibration, shown, log),
        None if scan_fit is None else fit_of_own_log(scan_fit, map_from_log=calibration.map_from_log),
        noise_by_range(calibration),
        causes_by_bearing(calibration, log),
        opposite_widths(calibration, log),
        pose_shifts(calibration),
    ]
    return [figure for figure in drawn if figure is not None]
