"""Figures of the measured ranges with the fitted density: the chapter's Figures 6.5 and 6.6."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure, SubFigure
from matplotlib.ticker import MaxNLocator

from beamfield.calibration.calibrate import Calibration
from beamfield.geometry import FloatArray
from beamfield.models.beam_density import CAUSES, beam_cdf
from beamfield.models.beam_parameters import BeamParameters
from beamfield.report.colours import CAUSE_COLOURS, DATA, MODEL, QUIET
from beamfield.report.drawing import NARROW, WIDE, filled_steps, legend, legend_above, log_scale, new_panel, style
from beamfield.report.panel import Panel, ReportFigure, one_picture, svg_panel
from beamfield.report.range_bins import RangeBin, range_step, telling_bin, thinned, typical_bins

# Expected ranges over which the model of a group is averaged, and readings in the series: as in Figure 6.5.
MOST_AVERAGED = 400
MOST_IN_SERIES = 10_000


def range_histograms(calibration: Calibration) -> ReportFigure:
    """Histograms of measured ranges for several expected ranges, with the fitted density: Figures 6.5 and 6.6."""
    bins = typical_bins(calibration.table)
    return ReportFigure(
        "histograms",
        "Measured ranges and fitted density",
        tuple(_histogram_panel(calibration, group, i) for i, group in enumerate(bins)),
        "Each panel takes the beams with nearly the same expected range z*: grey is what the sensor measured, black "
        "what the fitted model predicts for these very beams. Above, the hits near z* on a linear scale: the black "
        "curve should follow the grey peak in place, width and height. Below, all ranges on a logarithmic scale: the "
        "slope left of z* is unexpected objects (short), the floor right of it unexplained readings (rand), the bar at "
        "the end the readings without return (max), a probability drawn as an area (// marks ranges left out). A grey "
        "peak away from the black one means that the map lacks an obstacle there, or shows one that is gone.",
        "Section 6.3.2; Figures 6.5 and 6.6",
    )


def reading_series(calibration: Calibration) -> ReportFigure:
    """Raw readings for one expected range, in order: Figure 6.5."""
    table = calibration.table
    group = telling_bin(typical_bins(table))
    shown, known = len(thinned(group.rows, MOST_IN_SERIES)), len(group.rows)
    count = f"All {known} readings" if shown == known else f"{shown} of the {known} readings"
    figure = new_panel(WIDE, 3.6, above=1)
    draw_readings(figure.add_subplot(), calibration, group)
    low, high = np.quantile(table.ranges[group.rows], [0.05, 0.95])
    return one_picture(
        "readings",
        f"Readings one after the other, for an expected range of {group.centre:g} m",
        figure,
        f"Measured range against number of the reading for expected ranges around {group.centre:g} m: 90% of the "
        f"readings lie between {low:.2f} and {high:.2f} m, the rest are short, random or without return.",
        f"{count} whose expected range is within {group.half_width:g} m of {group.centre:g} m, in the order of "
        "the log. Scattered dots are what the model is made for. Bands and stripes are not: a block of readings away "
        "from the dashed line is one place where map and world disagree, or a stretch where the reference poses are "
        "off.",
        "Section 6.3.2; Figure 6.5",
        cloud=True,
    )


def draw_readings(axes: Axes, calibration: Calibration, group: RangeBin) -> None:
    """Draw the readings of a group in the order of the log, coloured by their most likely cause: Figure 6.5."""
    table = calibration.table
    rows = thinned(group.rows, MOST_IN_SERIES)
    number = np.arange(1, len(rows) + 1)
    ranges = table.ranges[rows]
    end = _shown_end(ranges[ranges < table.max_range], group.centre, table.max_range)
    top = table.max_range if end == table.max_range else 1.1 * end
    height = np.where(ranges >= table.max_range, top, ranges)
    for cause, (name, colour) in enumerate(zip(CAUSES, CAUSE_COLOURS, strict=True)):
        mine = calibration.causes[rows] == cause
        size = 3.0 if cause == 0 else 7.0
        axes.scatter(number[mine], height[mine], s=size, color=colour, linewidths=0, rasterized=True)
        axes.scatter([], [], s=36, color=colour, label=name, linewidths=0)
    axes.axhline(group.centre, color=MODEL, linewidth=0.8, linestyle="--", label=f"expected: z* = {group.centre:g} m")
    axes.set(xlim=(0, len(rows) + 1), ylim=(0, top * 1.03))
    style(axes, x="number of the reading", y="measured range z [m]")
    _mark_limit(axes, end, table.max_range, top, vertical=True)
    legend_above(axes)


def _histogram_panel(calibration: Calibration, group: RangeBin, number: int) -> Panel:
    figure = new_panel(NARROW, 4.3)
    draw_histogram(figure, calibration, group)
    ranges = calibration.table.ranges[group.rows]
    counts = np.bincount(calibration.causes[group.rows], minlength=4)
    shares = ", ".join(f"{name} {n / len(group.rows):.1%}" for name, n in zip(CAUSES, counts, strict=True))
    alt = (
        f"Histogram of {len(ranges)} measured ranges for expected ranges around {group.centre:g} m with the fitted "
        f"density. Median measured range {np.median(ranges):.3f} m; most likely causes: {shares}."
    )
    return svg_panel(figure, f"histogram{number}", alt)


def draw_histogram(figure: Figure | SubFigure, calibration: Calibration, group: RangeBin) -> None:
    """Draw measured ranges and the fitted density: linear near z* above, logarithmic over all below; Figure 6.6."""
    table, parameters = calibration.table, calibration.parameters
    ranges = table.ranges[group.rows]
    expected = table.expected_ranges[thinned(group.rows, MOST_AVERAGED)]
    model = _Averaged(expected, parameters, table.min_range, table.max_range)
    step = range_step(ranges[ranges < table.max_range])
    near, far = figure.subplots(2, 1)
    _draw_near(near, ranges, model, step)
    span = f"z* = {group.centre - group.half_width:.4g} to {group.centre + group.half_width:.4g} m"
    style(near, title=f"{span}: {len(ranges)} readings", x="measured range z [m]", y="density [1/m]", grid="y")
    _draw_far(far, ranges, model, step)
    style(far, x="measured range z, all up to the limit [m]", y="density, log scale [1/m]", grid="y")


class _Averaged(NamedTuple):
    """The model of beams with several expected ranges."""

    expected: FloatArray
    parameters: BeamParameters
    min_range: float
    max_range: float

    def cdf(self, z: FloatArray) -> FloatArray:
        return averaged_cdf(z, self.expected, self.parameters, self.max_range, min_range=self.min_range)


def _draw_near(axes: Axes, ranges: FloatArray, model: _Averaged, step: float) -> None:
    low, high = _near_limits(ranges, model)
    edges = _bin_edges(low, high, (high - low) / 60, step)
    counts, _ = np.histogram(ranges[ranges < model.max_range], edges)
    width = edges[1] - edges[0]
    filled_steps(axes, counts / (len(ranges) * width), edges, color=DATA, label="measured")
    z = np.linspace(edges[0], edges[-1], 241)
    density = np.diff(model.cdf(z)) / np.diff(z)
    axes.plot((z[1:] + z[:-1]) / 2, density, color=MODEL, linewidth=1.4, label="fitted model")
    span = float(model.expected.min()), float(model.expected.max())
    axes.axvspan(*span, ymax=0.035, color="#E69F00", linewidth=0, label="z* of these beams", zorder=3)
    axes.set(xlim=(edges[0], edges[-1]), ylim=(0, 1.3 * axes.get_ylim()[1]))
    legend(axes, loc="upper center", ncols=3, columnspacing=0.9, handlelength=1.4)


def _draw_far(axes: Axes, ranges: FloatArray, model: _Averaged, step: float) -> None:
    max_range, z_max = model.max_range, model.parameters.z_max
    below = ranges[ranges < max_range]
    end = _shown_end(below, float(model.expected.max()), max_range)
    edges = _bin_edges(0.0, end, end / 110, step)
    edges[-1] = min(edges[-1], max_range)
    counts, _ = np.histogram(below, edges)
    widths = np.diff(edges)
    # Nothing below the density of a third of a reading can be seen in the data.
    floor = 0.3 / (len(ranges) * widths[0])
    measured = counts / (len(ranges) * widths)
    fitted = np.diff(model.cdf(edges)) / widths
    filled_steps(axes, np.maximum(measured, floor), edges, base=floor, color=DATA)
    steps = np.maximum(np.append(fitted, fitted[-1]), floor)
    axes.plot(edges, steps, drawstyle="steps-post", color=MODEL, linewidth=1.2)
    share = float((ranges >= max_range).mean())
    gap = 0.01 * end if end == max_range else 0.06 * end
    bar = (edges[-1] + gap, edges[-1] + gap + 3 * widths[0])
    # The bar's area is the probability, as drawn in the chapter: one third of it per bin.
    height = max(share / (3 * widths[0]), floor)
    filled_steps(axes, [height], bar, base=floor, color=CAUSE_COLOURS[2], alpha=0.6)
    axes.hlines(max(z_max / (3 * widths[0]), floor), *bar, color=MODEL, linewidth=2.0)
    log_scale(axes)
    top = max(float(measured.max()), float(fitted.max()), 100 * floor) * 30
    axes.set(ylim=(floor, top), xlim=(0, bar[1] + 0.01 * end))
    _mark_limit(axes, end, max_range, sum(bar) / 2)
    text, corner = f"no return: {share:.2%}\nmodel: {z_max:.2%}", axes.transAxes
    axes.text(0.99, 0.97, text, transform=corner, ha="right", va="top", fontsize=8, color="#00664C")


def _shown_end(below: FloatArray, expected: float, max_range: float) -> float:
    """Where the axis of z ends: at the limit, or where the readings end if most of the way to it is empty."""
    farthest = max(float(below.max()) if len(below) else 0.0, 1.5 * expected) * 1.03
    return max_range if farthest > 0.6 * max_range else farthest


def _mark_limit(axes: Axes, end: float, max_range: float, place: float, *, vertical: bool = False) -> None:
    """Label the place of the readings without return; the axis between it and `end` is left out."""
    axis = axes.yaxis if vertical else axes.xaxis
    ticks = [tick for tick in MaxNLocator(6).tick_values(0.0, end) if 0.0 <= tick <= 0.93 * end]
    axis.set_ticks([*ticks, place], [*(f"{tick:g}" for tick in ticks), f"{max_range:.4g}"])
    if end < max_range:
        at = end + 0.3 * (place - end)
        x, y = (0.0, at) if vertical else (at, 0.0)
        transform = axes.get_yaxis_transform() if vertical else axes.get_xaxis_transform()
        box = {"facecolor": "white", "linewidth": 0, "pad": 0.5}
        axes.text(x, y, "//", transform=transform, ha="center", va="center", fontsize=9, color=QUIET, bbox=box)


def averaged_cdf(
    z: FloatArray, expected: FloatArray, parameters: BeamParameters, max_range: float, *, min_range: float = 0.0
) -> FloatArray:
    """P(reading < z) averaged over the expected ranges, (n,); at max_range the mass there is left out."""
    inside = np.clip(z, min_range, np.nextafter(max_range, 0.0))
    cdf = beam_cdf(inside[:, None], expected[None, :], max_range, parameters, min_range=min_range).mean(axis=1)
    return np.asarray(np.where(z > min_range, cdf, 0.0))


def _near_limits(ranges: FloatArray, model: _Averaged) -> tuple[float, float]:
    """Range of z that shows the hits: the model's, or the data's where they lie elsewhere."""
    p = model.parameters
    centre = float(np.median(model.expected)) + p.range_offset
    spread = float(np.hypot(p.sigma_hit, p.sigma_slope * centre)) + float(np.ptp(model.expected)) / 4
    close = ranges[np.abs(ranges - centre) < 10 * spread]
    low, high = centre - 4.5 * spread, centre + 4.5 * spread
    if len(close):
        low, high = min(low, float(np.quantile(close, 0.02))), max(high, float(np.quantile(close, 0.98)))
    return max(low, model.min_range), min(high, model.max_range)


def _bin_edges(low: float, high: float, width: float, step: float) -> FloatArray:
    """Edges of equal bins; where the sensor's values have a step, each bin holds as many of them."""
    if step > 0.0:
        width = max(1.0, round(width / step)) * step
        low = (np.floor(low / step) - 0.5) * step
    n = max(2, int(np.ceil((high - low) / width)))
    return np.asarray(low + width * np.arange(n + 1))
