"""Figures of the measured ranges and the fitted densities: the chapter's Figures 6.3 to 6.6."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from beamfield.calibration.calibrate import Calibration
from beamfield.geometry import FloatArray
from beamfield.models.beam_density import beam_cdf, beam_components
from beamfield.models.beam_parameters import BeamParameters
from beamfield.report.drawing import (
    CAUSE_COLOURS,
    CAUSE_NAMES,
    DATA,
    MODEL,
    NARROW,
    QUIET,
    WIDE,
    Panel,
    ReportFigure,
    legend,
    new_figure,
    png_panel,
    style,
    svg_panel,
)
from beamfield.report.range_bins import RangeBin, fullest_bin, range_step, thinned, typical_bins

# Expected ranges over which the model of a group is averaged, and readings in the series: as in Figure 6.5.
MOST_AVERAGED = 60
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
        "the end the readings without return (max), a probability that is drawn as one bin wide. A grey peak away "
        "from the black one means that the map lacks an obstacle there, or shows one that is gone.",
        "Section 6.3.2; Figures 6.5 and 6.6",
    )


def reading_series(calibration: Calibration) -> ReportFigure:
    """Raw readings for one expected range, in order: Figure 6.5."""
    table = calibration.table
    group = fullest_bin(typical_bins(table))
    rows = thinned(group.rows, MOST_IN_SERIES)
    figure = new_figure(WIDE, 3.6)
    axes = figure.add_subplot()
    number = np.arange(1, len(rows) + 1)
    for cause, (name, colour) in enumerate(zip(CAUSE_NAMES, CAUSE_COLOURS, strict=True)):
        mine = calibration.causes[rows] == cause
        size = 3.0 if cause == 0 else 7.0
        axes.scatter(number[mine], table.ranges[rows][mine], s=size, color=colour, label=name, linewidths=0)
    axes.axhline(group.centre, color=MODEL, linewidth=0.8, linestyle="--", label=f"expected: z* = {group.centre:g} m")
    axes.set_xlim(0, len(rows) + 1)
    axes.set_ylim(0, table.max_range * 1.03)
    style(axes, x="number of the reading", y="measured range z [m]")
    _legend_above(axes)
    return ReportFigure(
        "readings",
        f"Readings one after the other, for an expected range of {group.centre:g} m",
        (png_panel(figure, _series_alt(calibration, group), wide=True),),
        f"{len(rows)} of the {len(group.rows)} readings whose expected range is within {group.half_width:g} m of "
        f"{group.centre:g} m, in the order of the log. Scattered dots are what the model is made for. Bands and "
        "stripes are not: a block of readings away from the dashed line is one place where map and world disagree, or "
        "a stretch where the reference poses are off.",
        "Section 6.3.2; Figure 6.5",
    )


def mixture(calibration: Calibration) -> ReportFigure:
    """The four components and their mixture at one expected range: Figures 6.3 and 6.4."""
    group = fullest_bin(typical_bins(calibration.table))
    max_range, parameters = calibration.table.max_range, calibration.parameters
    z = _fine_ranges(group.centre, parameters, max_range)
    components = beam_components(z, group.centre, max_range, parameters)
    return ReportFigure(
        "mixture",
        f"The four causes and their mixture, for an expected range of {group.centre:g} m",
        (
            _components_panel(z, components, group.centre, parameters, max_range),
            _mixture_panel(z, components, group.centre, parameters, max_range),
        ),
        "Left, the density of each cause alone (each integrates to 1). Right, the same multiplied by their fitted "
        "weights, on a logarithmic scale, and their sum. The readings without return are not a density but a "
        "probability, drawn as a narrow bar of that area at the sensor's limit.",
        "Section 6.3.1; Figures 6.3 and 6.4, (6.4) to (6.12)",
    )


def _histogram_panel(calibration: Calibration, group: RangeBin, number: int) -> Panel:
    """Linear near z* above, logarithmic over all ranges below."""
    table, parameters = calibration.table, calibration.parameters
    ranges = table.ranges[group.rows]
    chosen = thinned(group.rows, MOST_AVERAGED)
    expected = table.expected_ranges[chosen]
    step = range_step(ranges[ranges < table.max_range])
    figure = new_figure(NARROW, 4.3)
    near, far = figure.subplots(2, 1)
    _draw_near(near, ranges, expected, parameters, table.max_range, step)
    style(
        near,
        title=f"z* = {group.centre - group.half_width:.4g} to {group.centre + group.half_width:.4g} m: "
        f"{len(ranges)} readings",
        x="measured range z [m]",
        y="density [1/m]",
        grid="y",
    )
    _draw_far(far, ranges, expected, parameters, table.max_range, step)
    style(far, x="measured range z, all up to the limit [m]", y="density, log scale [1/m]", grid="y")
    shares = " ".join(
        f"{name} {share:.1%}," for name, share in zip(CAUSE_NAMES, _cause_shares(calibration, group), strict=True)
    )
    alt = (
        f"Histogram of {len(ranges)} measured ranges for expected ranges around {group.centre:g} m with the fitted "
        f"density. Median measured range {np.median(ranges):.3f} m; most likely causes: {shares.rstrip(',')}."
    )
    return svg_panel(figure, f"histogram{number}", alt)


def _draw_near(
    axes: Axes, ranges: FloatArray, expected: FloatArray, parameters: BeamParameters, max_range: float, step: float
) -> None:
    low, high = _near_limits(ranges, expected, parameters, max_range)
    edges = _bin_edges(low, high, (high - low) / 60, step)
    counts, _ = np.histogram(ranges[ranges < max_range], edges)
    width = edges[1] - edges[0]
    axes.stairs(counts / (len(ranges) * width), edges, fill=True, color=DATA, label="measured")
    z = np.linspace(edges[0], edges[-1], 241)
    slope = _averaged_cdf(z, expected, parameters, max_range)
    axes.plot((z[1:] + z[:-1]) / 2, np.diff(slope) / np.diff(z), color=MODEL, linewidth=1.4, label="fitted model")
    axes.axvspan(float(expected.min()), float(expected.max()), color="#F0E442", alpha=0.35, linewidth=0, label="z*")
    axes.set_xlim(edges[0], edges[-1])
    axes.set_ylim(bottom=0)
    legend(axes, loc="upper left" if low > 0 or np.median(expected) > (low + high) / 2 else "upper right")


def _draw_far(
    axes: Axes, ranges: FloatArray, expected: FloatArray, parameters: BeamParameters, max_range: float, step: float
) -> None:
    edges = _bin_edges(0.0, max_range, max_range / 110, step)
    edges[-1] = max_range
    counts, _ = np.histogram(ranges[ranges < max_range], edges)
    widths = np.diff(edges)
    # Nothing below the density of a third of a reading can be seen in the data.
    floor = 0.3 / (len(ranges) * widths[0])
    measured = counts / (len(ranges) * widths)
    model = np.diff(_averaged_cdf(edges, expected, parameters, max_range)) / widths
    axes.stairs(np.maximum(measured, floor), edges, baseline=floor, fill=True, color=DATA)
    axes.stairs(np.maximum(model, floor), edges, baseline=None, color=MODEL, linewidth=1.2)
    share = float((ranges >= max_range).mean())
    bar = (max_range + 0.5 * widths[0], max_range + 2.5 * widths[0])
    axes.stairs([max(share / widths[0], floor)], bar, baseline=floor, fill=True, color=CAUSE_COLOURS[2], alpha=0.55)
    axes.hlines(max(parameters.z_max / widths[0], floor), *bar, color=MODEL, linewidth=2.0)
    top = max(measured.max(), model.max(), share / widths[0], parameters.z_max / widths[0]) * 12
    axes.set_yscale("log")
    axes.set_ylim(floor, max(top, floor * 100))
    axes.set_xlim(0, bar[1] + 0.5 * widths[0])
    axes.annotate(
        f"no return: {share:.2%}\nmodel: {parameters.z_max:.2%}",
        (0.985, 0.97),
        xycoords="axes fraction",
        ha="right",
        va="top",
        fontsize=8,
        color="#00664C",
    )


def _averaged_cdf(z: FloatArray, expected: FloatArray, parameters: BeamParameters, max_range: float) -> FloatArray:
    """P(reading < z) averaged over the expected ranges, (n,); at max_range the mass there is left out."""
    below = np.minimum(z, np.nextafter(max_range, 0.0))
    cdf = beam_cdf(np.maximum(below, 0.0)[:, None], expected[None, :], max_range, parameters).mean(axis=1)
    return np.asarray(np.where(z > 0.0, cdf, 0.0))


def _near_limits(
    ranges: FloatArray, expected: FloatArray, parameters: BeamParameters, max_range: float
) -> tuple[float, float]:
    """Range of z that shows the hits: the model's, or the data's where they lie elsewhere."""
    centre = float(np.median(expected)) + parameters.range_offset
    spread = float(np.hypot(parameters.sigma_hit, parameters.sigma_slope * centre)) + float(np.ptp(expected)) / 4
    close = ranges[np.abs(ranges - centre) < 10 * spread]
    low, high = centre - 4.5 * spread, centre + 4.5 * spread
    if len(close):
        low, high = min(low, float(np.quantile(close, 0.02))), max(high, float(np.quantile(close, 0.98)))
    return max(low, 0.0), min(high, max_range)


def _bin_edges(low: float, high: float, width: float, step: float) -> FloatArray:
    """Edges of equal bins; where the sensor's values have a step, each bin holds as many of them."""
    if step > 0.0:
        width = max(1.0, round(width / step)) * step
        low = (np.floor(low / step) - 0.5) * step
    n = max(2, int(np.ceil((high - low) / width)))
    return np.asarray(low + width * np.arange(n + 1))


def _cause_shares(calibration: Calibration, group: RangeBin) -> FloatArray:
    return np.bincount(calibration.causes[group.rows], minlength=4) / len(group.rows)


def _series_alt(calibration: Calibration, group: RangeBin) -> str:
    ranges = calibration.table.ranges[group.rows]
    low, high = np.quantile(ranges, [0.05, 0.95])
    return (
        f"Measured range against number of the reading for expected ranges around {group.centre:g} m: 90 % of the "
        f"readings lie between {low:.2f} and {high:.2f} m, the rest are short, random or without return."
    )


def _legend_above(axes: Axes) -> None:
    axes.legend(
        fontsize=8.5,
        frameon=False,
        ncols=5,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
        markerscale=2.5,
        handletextpad=0.4,
        columnspacing=1.2,
        borderaxespad=0.2,
    )


def _fine_ranges(expected: float, parameters: BeamParameters, max_range: float) -> FloatArray:
    """Ranges fine enough around the hits to draw them, and two at the end of p_short for its step."""
    spread = float(np.hypot(parameters.sigma_hit, parameters.sigma_slope * expected))
    near = expected + parameters.range_offset + spread * np.linspace(-6, 6, 241)
    coarse = np.linspace(0.0, max_range, 241)
    step = [expected, np.nextafter(expected, np.inf)]
    z = np.unique(np.concatenate([near, coarse, step]))
    return z[(z >= 0.0) & (z < max_range)]


def _components_panel(
    z: FloatArray, components: FloatArray, expected: float, parameters: BeamParameters, max_range: float
) -> Panel:
    figure = new_figure(NARROW, 4.0)
    titles = (
        f"(a) hit: sigma_hit {parameters.sigma_hit:.3g} m",
        f"(b) short: lambda {parameters.lambda_short:.3g} 1/m",
        "(c) max: no return",
        "(d) rand",
    )
    for cause, axes in enumerate(figure.subplots(2, 2).flat):
        colour = CAUSE_COLOURS[cause]
        if cause == 2:
            axes.stairs([1.0], [max_range * 0.985, max_range * 1.015], fill=True, color=colour)
            axes.set_ylim(0, 1.1)
        else:
            axes.fill_between(z, components[:, cause], color=colour, alpha=0.25, linewidth=0)
            axes.plot(z, components[:, cause], color=colour, linewidth=1.4)
            axes.set_ylim(0, float(components[:, cause].max()) * 1.1)
        axes.axvline(expected, color=QUIET, linewidth=0.8, linestyle="--")
        axes.set_xlim(0, max_range * 1.03)
        style(axes, title=titles[cause], x="z [m]", y="probability" if cause == 2 else "density [1/m]", grid="none")
        axes.title.set_fontsize(8.5)
    alt = (
        f"Four small plots for an expected range of {expected:g} m: the peak of a hit, the decay of unexpected objects "
        f"up to the expected range, the point mass at {max_range:g} m, the flat density of random readings."
    )
    return svg_panel(figure, "components", alt)


def _mixture_panel(
    z: FloatArray, components: FloatArray, expected: float, parameters: BeamParameters, max_range: float
) -> Panel:
    figure = new_figure(NARROW, 4.0)
    axes = figure.add_subplot()
    weighted = components * np.array(parameters.weights)
    total = weighted.sum(axis=1)
    width = max_range / 60
    mass = parameters.z_max / width
    positive = total[total > 0]
    floor = max(float(positive.min()) / 5, float(positive.max()) * 1e-7) if len(positive) else 1e-6
    for cause, name in enumerate(CAUSE_NAMES):
        label = f"{name}: {parameters.weights[cause]:.2%}"
        if cause == 2:
            edges = (max_range, max_range + width)
            axes.stairs([max(mass, floor)], edges, baseline=floor, fill=True, color=CAUSE_COLOURS[2], label=label)
        else:
            line = np.where(weighted[:, cause] > floor, weighted[:, cause], np.nan)
            axes.plot(z, line, color=CAUSE_COLOURS[cause], linewidth=1.6, label=label)
    axes.plot(z, np.where(total > floor, total, np.nan), color=MODEL, linewidth=1.0, label="sum")
    axes.axvline(expected, color=QUIET, linewidth=0.8, linestyle="--")
    axes.set_yscale("log")
    axes.set_ylim(floor, max(float(total.max()), mass) * 60)
    axes.set_xlim(0, max_range + 2 * width)
    style(axes, title="Mixture, with the fitted weights", x="z [m]", y="weighted density, log scale [1/m]", grid="y")
    legend(axes, loc="upper right", ncols=2)
    weights = ", ".join(f"{name} {weight:.3f}" for name, weight in zip(CAUSE_NAMES, parameters.weights, strict=True))
    alt = f"The mixture density for an expected range of {expected:g} m on a logarithmic scale; weights: {weights}."
    return svg_panel(figure, "mixture", alt)
