"""Figures that check what the calibration rests on: the map, the reference poses, the form of the noise."""

from __future__ import annotations

import numpy as np
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from beamfield.calibration.calibrate import Calibration
from beamfield.calibration.evaluation import Z95, block_standard_error
from beamfield.calibration.opposite_beams import opposite_pairs
from beamfield.calibration.time_split import time_blocks
from beamfield.geometry import FloatArray
from beamfield.models.beam_density import CAUSES, beam_responsibilities
from beamfield.report.colours import CAUSE_COLOURS, FIT, MODEL, QUIET
from beamfield.report.drawing import NARROW, WIDE, filled_steps, legend, new_axes
from beamfield.report.panel import Panel, ReportFigure, one_picture, svg_panel
from beamfield.report.range_bins import thinned
from beamfield.report.text_table import plus_minus
from beamfield.sensors import SensorLog

MOST_BEAMS = 300_000
MOST_PAIRS = 12_000
FEWEST_HITS = 50
RANGE_BINS = 12
BEARING_BINS = 180


def noise_by_range(calibration: Calibration) -> ReportFigure | None:
    """Mean and spread of the hits by expected range, beside the model's; None with too few hits."""
    parameters, points = calibration.parameters, noise_points(calibration)
    if len(points) == 0:
        return None
    z = np.linspace(0.0, float(points[:, 0].max()) * 1.05, 100)
    sigma = np.hypot(parameters.sigma_hit, parameters.sigma_slope * z)
    labels = "Spread of the hits", "standard deviation [m]", "sigma of the model"
    spread = _line_panel("sigma", labels, points[:, [0, 3, 4]], z, sigma)
    offset = np.full_like(z, parameters.range_offset)
    labels = "Mean of the hits", "measured minus expected [m]", "model's mean"
    mean = _line_panel("offset", labels, points[:, [0, 1, 2]], z, offset, least=0.3 * parameters.sigma_hit)
    return ReportFigure(
        "noise",
        "The noise of a hit, by expected range",
        (spread, mean),
        "Dots: standard deviation and mean of measured minus expected range, over readings weighted by their "
        "probability of being a hit, in groups of equal size by expected range; bars are 95% intervals from blocks of "
        "time. Lines: the fitted model. Dots that rise to the right show noise that grows with range "
        "(sigma_slope; errors of the reference heading do the same). A mean off zero means that mapped walls are "
        "drawn too thick (positive) or too thin (negative), or the sensor has a bias.",
        "Section 6.3.2; Figure 6.6 (the smaller the range, the more accurate the measurement)",
    )


def noise_points(calibration: Calibration) -> FloatArray:
    """Return mean and spread of the hits in groups of equal size by expected range.

    Readings are weighted by their probability of being a hit. The rows of (g, 5), metres: expected range, mean of
    measured minus expected range, its standard error, standard deviation about the model's range offset, its standard
    error; none with too few hits.
    """
    table, parameters = calibration.table, calibration.parameters
    rows = thinned(np.flatnonzero(~table.hits_nothing & (table.ranges < table.max_range)), MOST_BEAMS)
    expected = table.expected_ranges[rows]
    causes = beam_responsibilities(table.ranges[rows], expected, table.max_range, parameters, min_range=table.min_range)
    hit = causes[:, 0]
    residual = table.ranges[rows] - expected
    blocks = time_blocks(table.stamps, calibration.options.block_s)[rows]
    return _by_expected_range(expected, residual, hit, blocks, parameters.range_offset)


def causes_by_bearing(calibration: Calibration, log: SensorLog) -> ReportFigure:
    """Share of each cause by the direction of the beam."""
    table = calibration.table
    rows = np.flatnonzero(~table.hits_nothing)
    bearings = np.degrees(log.finder.bearings[table.beam[rows]])
    low, high = float(np.degrees(log.finder.bearings.min())), float(np.degrees(log.finder.bearings.max()))
    n_bins = max(1, min(BEARING_BINS, log.finder.n_beams))
    pad = (high - low) / max(n_bins - 1, 1) / 2 if high > low else 1.0
    edges = np.linspace(low - pad, high + pad, n_bins + 1)
    index = np.clip(np.searchsorted(edges, bearings, side="right") - 1, 0, n_bins - 1)
    counts = np.array([np.bincount(index[calibration.causes[rows] == c], minlength=n_bins) for c in range(4)])
    shares = np.divide(counts, counts.sum(axis=0), out=np.zeros(counts.shape), where=counts.sum(axis=0) > 0)
    x = "direction of the beam in the robot's frame, counter-clockwise [deg]"
    figure, axes = new_axes(WIDE, 3.0, x=x, y="share of readings [1]", grid="y")
    base: FloatArray = np.zeros(n_bins)
    # Hits fill the rest, so that the axis can show the others large.
    for cause in (3, 1, 2):
        tops, name = base + shares[cause], CAUSES[cause]
        filled_steps(axes, tops, edges, base=base, color=CAUSE_COLOURS[cause], label=name)
        base = tops
    axes.set(xlim=(edges[0], edges[-1]), ylim=(0, min(1.0, max(float(base.max()) * 1.25, 0.02))))
    legend(axes, loc="upper right", ncols=3)
    worst = int(np.argmax(base))
    return one_picture(
        "bearings",
        "Causes by direction of the beam",
        figure,
        f"Stacked shares of rand, short and max by direction; the largest sum is {base[worst]:.0%} at "
        f"{(edges[worst] + edges[worst + 1]) / 2:.0f} deg.",
        "Share of readings that are not hits, by direction. A narrow tower of short readings is a part of the robot "
        "that the sensor sees (mask those beams); a broad rise where beams are long, ahead in a corridor, "
        "is people, or small errors of the heading; a rise to one side, a sensor mounted at another angle than the log "
        "says.",
        "Section 6.3.1 (each beam has its own cause)",
    )


def opposite_widths(calibration: Calibration, log: SensorLog) -> ReportFigure | None:
    """Measured against mapped width between opposite walls; None if the sensor cannot tell."""
    fit = calibration.opposite
    if fit is None:
        return None
    table = calibration.table
    first, second = opposite_pairs(log, table)
    chosen = thinned(np.arange(len(first)), MOST_PAIRS)
    first, second = first[chosen], second[chosen]
    mapped = table.expected_ranges[first] + table.expected_ranges[second]
    difference = table.ranges[first] + table.ranges[second] - mapped
    x = "mapped width between opposite walls [m]"
    figure, axes = new_axes(WIDE, 3.6, x=x, y="measured minus mapped width [m]")
    axes.scatter(mapped, difference, s=4, color=FIT, alpha=0.35, linewidths=0, label="pair of opposite beams")
    ends = np.array([mapped.min(), mapped.max()]) if len(mapped) else np.array([0.0, 1.0])
    axes.plot(ends, (fit.scale - 1) * ends + fit.widening, color=MODEL, linewidth=1.4, label="robust line")
    axes.axhline(0.0, color=QUIET, linewidth=0.8)
    reach = max(float(np.quantile(np.abs(difference), 0.99)) * 1.2, 0.1) if len(difference) else 1.0
    axes.set_ylim(-reach, reach)
    legend(axes, loc="upper left", ncols=2)
    return one_picture(
        "opposite",
        "Widths measured and mapped",
        figure,
        f"Measured minus mapped width of {fit.n_pairs} pairs of opposite beams against the mapped width; "
        f"median difference {fit.median_difference:.3f} m, scale {plus_minus(fit.scale, fit.scale_se)}.",
        "The sum of two opposite beams is the width of the room there and hardly depends on the pose, so this judges "
        f"the map alone. Median difference {fit.median_difference:+.3f} m; line: scale "
        f"{plus_minus(fit.scale, fit.scale_se)}, widening {plus_minus(fit.widening, fit.widening_se)} m. A cloud above "
        "zero: walls drawn too thick, by half of it on each side. A cloud that climbs or falls: a wrong "
        "scale of the map.",
        "Not in the book; checks that the map deserves the trust that (6.4) puts in z*",
        cloud=True,
    )


def pose_shifts(calibration: Calibration) -> ReportFigure | None:
    """How far the refined poses lie from the reference; None if they were not refined."""
    refinement = calibration.refinement
    if refinement is None or len(refinement.scans) == 0:
        return None
    shifts = refinement.shifts
    figure, axes = new_axes(NARROW, 3.6, title="Shift of the pose", x="forward [m]", y="left [m]")
    axes.axhline(0, color=QUIET, linewidth=0.8)
    axes.axvline(0, color=QUIET, linewidth=0.8)
    axes.scatter(shifts[:, 0], shifts[:, 1], s=14, color=FIT, alpha=0.8, linewidths=0)
    reach = max(float(np.abs(shifts[:, :2]).max()) * 1.15, 0.02)
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach), aspect="equal")
    axes.xaxis.set_major_locator(MaxNLocator(5))
    x = "turn, counter-clockwise [deg]"
    turn, histogram = new_axes(NARROW, 3.6, title="Turn of the pose", x=x, y="number of scans", grid="y")
    degrees = np.degrees(shifts[:, 2])
    counts, edges = np.histogram(degrees, bins=24)
    filled_steps(histogram, counts, edges, color=FIT)
    histogram.set_ylim(0.0, 1.05 * float(counts.max()))
    histogram.axvline(0, color=MODEL, linewidth=0.8)
    moved = f"Shifts of {len(shifts)} refined poses, median length {np.median(np.hypot(*shifts[:, :2].T)):.3f} m."
    turned = f"Histogram of their turns, median {np.median(degrees):.2f} degrees."
    return ReportFigure(
        "refinement",
        "Reference poses, refined",
        (svg_panel(figure, "shift", moved), svg_panel(turn, "turn", turned)),
        f"{len(shifts)} reference poses were moved to where every other beam likes them best. On the remaining beams "
        f"sigma_hit goes from {refinement.sigma_before:.4f} to {refinement.sigma_after:.4f} m: a large "
        "drop is error of the reference poses, for which the sensor is not to blame. A cloud that is not "
        "centred at zero is a sensor mounted elsewhere than the log says, or a delay between scans and poses.",
        "Section 6.3.2: learning needs the positions X of (6.13)",
    )


def _by_expected_range(
    expected: FloatArray, residual: FloatArray, hit: FloatArray, blocks: NDArray[np.int64], offset: float
) -> FloatArray:
    """(g, 5) expected range, mean, its standard error, standard deviation about the offset, its standard error."""
    if hit.sum() < FEWEST_HITS:
        return np.empty((0, 5))
    edges = np.unique(np.quantile(expected, np.linspace(0, 1, RANGE_BINS + 1)))
    group = np.clip(np.searchsorted(edges, expected, side="right") - 1, 0, max(len(edges) - 2, 0))
    points = []
    for g in np.unique(group):
        mine = group == g
        weight = hit[mine]
        if weight.sum() < FEWEST_HITS:
            continue
        mean = float(np.average(residual[mine], weights=weight))
        squares = (residual[mine] - offset) ** 2
        variance = float(np.average(squares, weights=weight))
        # Influence of each reading on the weighted mean and on the variance, for the dependence within blocks.
        share = weight / weight.mean()
        mean_error = block_standard_error(share * (residual[mine] - mean), blocks[mine])
        variance_error = block_standard_error(share * (squares - variance), blocks[mine])
        spread = float(np.sqrt(variance))
        points.append(
            (float(np.median(expected[mine])), mean, mean_error, spread, variance_error / (2 * max(spread, 1e-12)))
        )
    return np.array(points).reshape(-1, 5)


def _line_panel(
    name: str, labels: tuple[str, str, str], points: FloatArray, z: FloatArray, line: FloatArray, least: float = 0.0
) -> Panel:
    """Dots with whiskers and the model's line; labels are the title and those of the y axis and the line."""
    title, y, label = labels
    figure, axes = new_axes(NARROW, 3.2, title=title, x="expected range z* [m]", y=y)
    whisker = Z95 * np.nan_to_num(points[:, 2])
    axes.vlines(points[:, 0], points[:, 1] - whisker, points[:, 1] + whisker, color=FIT, linewidth=1.2)
    axes.plot(points[:, 0], points[:, 1], "o", color=FIT, markersize=5, label="readings")
    axes.plot(z, line, color=MODEL, linewidth=1.4, label=label)
    axes.set_xlim(0, float(z[-1]))
    if name == "sigma":
        axes.set_ylim(0, float(max((points[:, 1] + whisker).max(), line.max())) * 1.25)
    else:
        axes.axhline(0, color=QUIET, linewidth=0.8)
        low = min(float((points[:, 1] - whisker).min()), -least, float(line.min()))
        high = max(float((points[:, 1] + whisker).max()), least, float(line.max()))
        axes.set_ylim(low - 0.08 * (high - low), high + 0.3 * (high - low))
    legend(axes, loc="upper left", ncols=2)
    text = ", ".join(f"{v:.3f} m at {r:.1f} m" for r, v, _ in points)
    return svg_panel(figure, name, f"{title} by expected range: {text}.")
