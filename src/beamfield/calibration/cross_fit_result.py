"""What a fit to drawn walls lacks: the beams that met clutter, and how far the walls themselves are off."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.beam_table import BeamTable
from beamfield.calibration.cross_fit import CrossFitMaps
from beamfield.calibration.hit_forms import form_intervals, learn_form
from beamfield.calibration.intrinsic.block_intervals import IntervalResult
from beamfield.calibration.options import CalibrationOptions
from beamfield.finding import Finding
from beamfield.geometry import FloatArray
from beamfield.maps.drawn_walls import LINE, ranges_to_walls
from beamfield.models.beam_parameters import WEIGHTS, BeamParameters
from beamfield.sensors import SensorLog

# Fewer beams in clutter say too little of the weights there.
FEWEST_IN_CLUTTER = 500
# Two maps that differ by more than this many sigma_hit show two surfaces; such beams are not hits.
SAME_SURFACE = 3.0
# Both maps take bent walls and clutter for straight lines in the same way, which their difference does not show. In
# simulated offices the whole variance of a wall's place is 1.6 to 3.4 times what it does show.
LARGEST_FACTOR = 4.0
# At least so much of sigma_hit^2 remains.
SMALLEST_REST = 0.1
# An interval that reaches so far below sigma_hit is worth a warning.
WIDE = 0.25
# With a smaller share of the beams, the places that are seen often speak for all.
FEW_USED = 0.25


def with_clutter(
    parameters: BeamParameters, intervals: IntervalResult, n_beams: int, clutter: BeamTable, options: CalibrationOptions
) -> tuple[BeamParameters, IntervalResult]:
    """Average the weights over beams that met walls and beams that met clutter, by their numbers.

    Straight walls are easy to measure. Beams that meet corners and furniture have a sigma_hit of their own, for their
    expected ranges are less exact, but their weights belong to the result as well; the other parameters stay as they
    were.

    Ends of the weights' intervals are averaged too, as if both fits erred together, and then moved out to hold the
    interval of walls alone; that of lambda_short is moved out to hold clutter's estimate: where the two differ, it may
    be the drawn map that errs. Nothing changes if too few beams met clutter.
    """
    clutter = clutter.select(~clutter.hits_nothing)
    if len(clutter) < FEWEST_IN_CLUTTER:
        return parameters, intervals
    hold = {name: value for name, value in options.hold.items() if name in (*WEIGHTS, "lambda_short")}
    fit = learn_form(clutter, hold, offset=True).parameters
    there = form_intervals(clutter, fit, hold, options.block_s, offset=True)
    share = n_beams / (n_beams + len(clutter))

    def average(here: float, there: float) -> float:
        return share * here + (1.0 - share) * there

    weights = {name: average(getattr(parameters, name), getattr(fit, name)) for name in WEIGHTS}
    names = [name for name in WEIGHTS if name in intervals.intervals and name in there.intervals]
    ends = {}
    for name in names:
        (low, high), (low_there, high_there) = intervals.intervals[name], there.intervals[name]
        ends[name] = min(low, average(low, low_there)), max(high, average(high, high_there))
    if "lambda_short" in intervals.intervals and np.isfinite(there.intervals.get("lambda_short", (0.0, np.inf))[1]):
        low, high = intervals.intervals["lambda_short"]
        ends["lambda_short"] = min(low, fit.lambda_short), max(high, fit.lambda_short)
    errors = {name: average(intervals.standard_errors[name], there.standard_errors[name]) for name in names}
    return replace(parameters, **weights), replace(
        intervals, intervals={**intervals.intervals, **ends}, standard_errors={**intervals.standard_errors, **errors}
    )


def wall_variance(log: SensorLog, maps: CrossFitMaps, table: BeamTable, sigma_hit: float) -> float:
    """Return the variance of expected ranges that is due to the noise of one half's map, square metres.

    Each wall is drawn twice, once by each half of the scans. Half the mean square of the difference, along the beams of
    the table, is the variance of one of the two. 0 if no beam meets a wall that both halves have drawn, and for maps
    drawn from cones.
    """
    if maps.counts is None:
        return 0.0
    own: FloatArray = np.full((len(log), log.finder.n_beams), np.nan)
    used = np.bincount(table.scan, minlength=len(log)) > 0
    for half in (0, 1):
        scans = np.flatnonzero(used & (maps.half == half))
        if len(scans):
            walls = ranges_to_walls(maps.counts[half], log.poses[scans], log.finder)
            own[scans] = np.where(walls.met == LINE, walls.expected, np.nan)
    difference = (own[table.scan, table.beam] - table.expected_ranges)[~table.hits_nothing]
    same: NDArray[np.bool_] = np.abs(difference) < SAME_SURFACE * sigma_hit
    return 0.5 * float(np.mean(difference[same] ** 2)) if same.any() else 0.0


def without_wall_error(
    parameters: BeamParameters, intervals: IntervalResult, variance: float
) -> tuple[BeamParameters, IntervalResult]:
    """Take the error of drawn walls out of sigma_hit, and widen its interval by what is not known of that error.

    The variance, square metres, is subtracted; the interval is from four times the variance subtracted to none. At
    least a tenth of sigma_hit^2 remains. Nothing changes if sigma_hit was not learned.
    """
    if "sigma_hit" not in intervals.intervals or variance == 0.0:
        return parameters, intervals
    low, high = intervals.intervals["sigma_hit"]
    sigma, lowest = _without(parameters.sigma_hit, variance), _without(low, LARGEST_FACTOR * variance)
    error = float(np.hypot(intervals.standard_errors["sigma_hit"], parameters.sigma_hit - sigma))
    return replace(parameters, sigma_hit=sigma), replace(
        intervals,
        intervals={**intervals.intervals, "sigma_hit": (min(lowest, sigma), high)},
        standard_errors={**intervals.standard_errors, "sigma_hit": error},
    )


def cross_fit_findings(
    maps: CrossFitMaps, table: BeamTable, n_clutter: int, parameters: BeamParameters, intervals: IntervalResult
) -> Iterator[Finding]:
    """Report that the map comes from the log itself, what that means, and what stays uncertain.

    Warnings are where few beams are used or sigma_hit may be mostly the map's error. n_clutter of the beams left out of
    the table met clutter.
    """
    total = len(table) + table.n_unknown + table.n_unsure
    known, used = 1.0 - table.n_unknown / total, (len(table) + n_clutter) / total
    ends = (
        f"A beam is expected to end at the line through the end points of the wall it meets: {used:.0%} of the beams "
        "meet something that the other half maps with certainty, and are used; the choice does not depend on "
        "their readings. range_offset is near 0 whatever the sensor does. "
        if maps.counts is not None
        else f"Expected ranges are those of cells of {maps.whole.resolution:g} m. "
    )
    yield Finding(
        "cross-fitted-map",
        "info",
        "No map was given. Each half of the scans was judged by a map drawn from the other half, so no beam met a "
        f"wall that it drew itself; {known:.0%} of the beams stay within what the other half has seen. {ends}"
        "Errors that the map and the poses share do not show: sigma_hit is the repeatability of the sensor "
        "at these poses.",
        {"resolution": maps.whole.resolution, "share_known": known, "share_used": used},
    )
    if used < FEW_USED:
        yield Finding(
            "few-walls-drawn",
            "warning",
            f"Only {used:.0%} of the beams meet something that the other half of the scans maps with certainty.",
            {"share_used": used},
            why="The parameters are those of these beams.",
            do="Give a map, or a log that sees each place more often.",
        )
    low = intervals.intervals.get("sigma_hit", (parameters.sigma_hit,))[0]
    if maps.counts is not None and low < (1.0 - WIDE) * parameters.sigma_hit:
        yield Finding(
            "sigma-includes-map-error",
            "warning",
            "The walls that the two halves drew differ. The error that this shows is taken out of sigma_hit, "
            "but there may be more.",
            {"low": low},
            why=f"sigma_hit may be as low as {low:.3f} m.",
            do="Give a map, or a log that sees each wall more often.",
        )


def _without(sigma: float, variance: float) -> float:
    return float(np.sqrt(max(sigma**2 - variance, SMALLEST_REST * sigma**2)))
