"""Figures of how well scans fit: p-value and lost probability over time, and where the worst scans disagree."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure, SubFigure
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, compose
from beamfield.maps.end_points import points_along
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.range_mixture import RangeMixtureModel
from beamfield.report.as_json import LEVEL
from beamfield.report.colours import CAUSE_COLOURS, FIT, HELD_OUT, MODEL, THROUGH
from beamfield.report.drawing import NARROW, WIDE, legend_above, new_axes, new_panel, style
from beamfield.report.map_figures import MARGIN, draw_map, frame
from beamfield.report.panel import Panel, ReportFigure, one_picture, png_panel
from beamfield.scan_fit.calibration_fit import CalibrationFit
from beamfield.scan_fit.reference import ScanFitReference
from beamfield.scan_fit.scan_fit import PROBLEMS, ScanFits
from beamfield.scan_fit.statistics import known_expected_ranges, stopping_rays
from beamfield.scan_fit.surprise import beam_side
from beamfield.sensors import SensorLog, usable_ranges

FIT_NAME, FIT_TITLE = "scan-fit", "Does each scan fit the map, and is the robot lost?"
FIT_SOURCE = "Section 6.1, (6.2); Table 6.1"
# Length of the arrow for the robot's heading, as a share of the picture's side.
ARROW = 0.09
# How a beam disagrees, in the order of `beam_side`: hit, short, through the wall, no return.
SIDE_NAMES = ("as mapped", "short", "through the wall", "no return")
SIDE_COLOURS = (CAUSE_COLOURS[0], CAUSE_COLOURS[1], THROUGH, CAUSE_COLOURS[2])


def fit_over_time(fits: ScanFits, reference: ScanFitReference, *, own: bool) -> ReportFigure | None:
    """Draw p-value and lost probability over the log; None if no scan could be judged.

    `own`: the reference is learned from the same log.
    """
    judged = ~np.isnan(fits.p_value)
    if not judged.any():
        return None
    figure = new_panel(WIDE, 4.8, above=1.0)
    draw_fit(figure, fits, reference.smallest_p_value)
    share = fits.share_that_fits(LEVEL)
    compared = "the other scans of this log, none closer in time than a block" if own else "the scans of the good log"
    n_silent = int((~judged).sum())
    silent = f" {n_silent} scan{'s' if n_silent > 1 else ''} could not be judged." if n_silent else ""
    return one_picture(
        FIT_NAME,
        FIT_TITLE,
        figure,
        f"P-value and lost probability of {len(fits)} scans: {share:.0%} fit at {LEVEL:.0%}, "
        f"lost probability at most {fits.lost.max():.2f}.",
        f"Above: how many of {len(reference)} good scans ({compared}) fit as badly as this one; one good scan in "
        f"twenty has less than {LEVEL:g}. {share:.1%} of the scans fit at {LEVEL:.0%}. The good scans are worth about "
        f"{reference.n_effective:.0f} independent ones, so that a p-value of {LEVEL:g} is uncertain by "
        f"{np.sqrt(LEVEL * (1 - LEVEL) / max(reference.n_effective, 1.0)):.2g}. Below: running probability that the "
        "robot is elsewhere than its pose says, from successive scans; a crowd or a moved cupboard lowers p-values, "
        f"but should leave this line low. The first scan's stamp is {fits.stamps[0]:.3f} s.{silent}",
        FIT_SOURCE,
        cloud=len(fits) >= 1500,
    )


def draw_fit(figure: Figure | SubFigure, fits: ScanFits, smallest: float) -> None:
    """Draw p-value and lost probability over time, of a log of which at least one scan could be judged."""
    seconds = fits.stamps - fits.stamps[0]
    judged = ~np.isnan(fits.p_value)
    above, below = figure.subplots(2, 1, sharex=True)
    low = fits.p_value <= LEVEL
    above.scatter(seconds[judged & ~low], fits.p_value[judged & ~low], s=8, color=FIT, linewidths=0, label="fits")
    above.scatter(
        seconds[judged & low], fits.p_value[judged & low], s=12, color=HELD_OUT, marker="v", linewidths=0,
        label=f"does not fit at {LEVEL:.0%}",
    )  # fmt: skip
    above.axhline(LEVEL, color=HELD_OUT, linewidth=1.0, linestyle="--")
    above.set_yscale("log")
    ticks = [t for t in (0.001, 0.01, 0.05, 0.1, 0.5, 1.0) if t >= 0.5 * smallest]
    above.set_yticks(ticks, [f"{t:g}" for t in ticks])
    above.minorticks_off()
    above.set_ylim(0.7 * min(LEVEL / 2, float(np.nanmin(fits.p_value))), 1.4)
    style(above, y="p-value [1]")
    legend_above(above, ncols=2)
    below.fill_between(seconds, fits.lost, step="post", color=HELD_OUT, alpha=0.25, linewidth=0)
    below.plot(seconds, fits.lost, color=HELD_OUT, linewidth=1.2, drawstyle="steps-post")
    below.axhline(0.5, color=MODEL, linewidth=0.8, linestyle="--")
    below.set(ylim=(-0.03, 1.03), xlim=(-0.01 * float(seconds[-1]), max(1.01 * float(seconds[-1]), 1e-3)))
    style(below, x="time since the first scan [s]", y="lost probability [1]")


def fit_of_own_log(fit: CalibrationFit, *, map_from_log: bool) -> ReportFigure:
    """Draw p-value and lost probability over the log of a calibration; a caption without picture says why it cannot."""
    drawn = None if fit.fits is None or fit.reference is None else fit_over_time(fit.fits, fit.reference, own=True)
    if drawn is None:
        return ReportFigure(FIT_NAME, FIT_TITLE, (), f"Not drawn: {fit.missing}.", FIT_SOURCE)
    if not map_from_log:
        return drawn
    note = (
        " The map is the log's own: each scan is judged by what the other half of the scans drew, so that an error of "
        "the poses shows where single scans are off or where a place is seen again, and not where both halves share it."
    )
    return replace(drawn, caption=drawn.caption + note)


def worst_scans(
    fits: ScanFits, model: RangeMixtureModel, log: SensorLog, grid: OccupancyGrid, scans: NDArray[np.int64]
) -> ReportFigure | None:
    """Draw scans on the map, each beam coloured by how it disagrees; None if there are none."""
    panels = [_scan_panel(fits, model, log, grid, int(i)) for i in scans]
    if not panels:
        return None
    return ReportFigure(
        "worst-scans",
        "Where and why beams disagree",
        tuple(panels),
        "The scans that fit worst, apart from each other in time, on the map at their poses. Blue beams end where the "
        "map says; orange ones end before (people, new things); purple ones go through a mapped wall (a wrong pose, or "
        "something that is no longer there); green ones have no return although the map has an obstacle (glass, black "
        "surfaces; drawn up to it). Orange and purple in whole groups mean a wrong pose.",
        "Section 6.3.1; (6.32) projects the end points",
    )


def _scan_panel(fits: ScanFits, model: RangeMixtureModel, log: SensorLog, grid: OccupancyGrid, scan: int) -> Panel:
    figure, axes = new_axes(NARROW, 4.6, above=2)
    draw_sides(axes, model, log, grid, scan)
    where = PROBLEMS[int(fits.problem[scan])]
    name = f"scan {scan}, {fits.stamps[scan] - fits.stamps[0]:.1f} s after the first"
    text = f"p-value {fits.p_value[scan]:.2g}, lost probability {fits.lost[scan]:.2f}{where and f' ({where})'}"
    axes.set_title(f"{name}\n{text}", fontsize=8.5, loc="left", pad=34)
    return png_panel(figure, f"{name}: {text}", dpi=120)


def draw_sides(axes: Axes, model: RangeMixtureModel, log: SensorLog, grid: OccupancyGrid, scan: int) -> None:
    """Draw a scan on the map at its pose, each beam coloured by how it disagrees with the model."""
    pose, finder = log.poses[scan], log.finder
    expected = known_expected_ranges(model, stopping_rays(model), pose[None, :], finder)[0]
    ranges = usable_ranges(log.ranges[scan], finder)
    side = beam_side(ranges, expected, finder.max_range, model.parameters)
    drawn = side >= 0
    reach = np.where(ranges >= finder.max_range, np.nan_to_num(expected), np.nan_to_num(ranges))
    rays = compose(pose, finder.mounts)
    ends = points_along(rays, reach)
    # Where the ray hits nothing and nothing returned, there is nothing to show.
    drawn &= ~((ranges >= finder.max_range) & (np.nan_to_num(expected) >= finder.max_range))
    limits = _limits(np.vstack([pose[None, :2], ends[drawn]]))
    draw_map(axes, grid, limits)
    for number, (name, colour) in enumerate(zip(SIDE_NAMES, SIDE_COLOURS, strict=True)):
        mine = drawn & (side == number)
        lines = np.stack([rays[mine, :2], ends[mine]], axis=1)
        axes.add_collection(LineCollection(list(lines), colors=colour, linewidths=0.6, alpha=0.45))
        axes.scatter(ends[mine, 0], ends[mine, 1], s=9, color=colour, linewidths=0, label=f"{name} {mine.sum()}")
    # As long on every picture, whatever the scan sees: of 0.4 m a scan along a corridor leaves a blot.
    tip = pose[:2] + ARROW * (limits[1] - limits[0]) * np.array([np.cos(pose[2]), np.sin(pose[2])])
    arrow = {"arrowstyle": "-|>", "color": MODEL, "linewidth": 1.6, "shrinkA": 0.0, "shrinkB": 0.0}
    axes.annotate("", tip, pose[:2], arrowprops=arrow)
    axes.plot(*pose[:2], "o", color=MODEL, markersize=4)
    frame(axes, limits)
    legend_above(axes, ncols=2)


def _limits(points: FloatArray) -> tuple[float, float, float, float]:
    """A square around the points, so that panels side by side are alike."""
    low, high = points.min(axis=0) - MARGIN, points.max(axis=0) + MARGIN
    centre, half = 0.5 * (low + high), 0.5 * float((high - low).max())
    (left, bottom), (right, top) = (centre - half).tolist(), (centre + half).tolist()
    return left, right, bottom, top
