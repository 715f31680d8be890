"""Figure 6.7: a scan in the map, and its likelihood over all positions."""

from __future__ import annotations

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from scipy.ndimage import maximum_filter

from beamfield.figures.drawing import (
    colour_bar,
    frame,
    framed_map,
    known_limits,
    legend_under_title,
    mark_robot,
    scan_limits,
)
from beamfield.geometry import FloatArray
from beamfield.localization.likelihood_map import LikelihoodMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.plot import draw_array, draw_scan
from beamfield.report.drawing import new_figure, style
from beamfield.sensors import Scan

# Free, unknown and occupied behind a likelihood, which takes all dark colours.
PALE_MAP = ("#FFFFFF", "#F1F3F5", "#A9B2BB")
BEST_COLOUR, REFERENCE_COLOUR = "#D55E00", "#0072B2"
# Metres shown around a scan.
MARGIN = 1.5
# Nats below the maximum from which on a place is drawn as white: e^-30 of the largest value. Where values lie closer
# together, as correlations of maps and scans of few sonars do, all places would be dark.
SPAN = 30.0
# With more cells along a side than this, dots are drawn larger than a cell.
CELLS_ACROSS = 400


def likelihood_figure(
    scan: Scan, grid: OccupancyGrid, result: LikelihoodMap, reference: FloatArray | None, *, model_name: str
) -> Figure:
    """Draw (a) a scan at its reference pose in the map, if there is one, and (b) its likelihood over the map."""
    limits = known_limits(grid)
    aspect = (limits[3] - limits[2]) / (limits[1] - limits[0])
    title = f"p(z | x, m), the best heading at each place: {model_name}"
    if reference is None:
        figure = new_figure(8.0, float(np.clip(7.0 * aspect + 1.2, 3.5, 10.0)))
        draw_likelihood_map(result, grid, figure.add_subplot(), title=title)
        return figure
    if aspect < 0.75:
        figure = new_figure(9.4, float(np.clip(8.6 * aspect, 2.0, 6.5)) + 4.6)
        left, right = figure.subplots(2, 1, height_ratios=(3.7, float(np.clip(8.6 * aspect, 2.0, 6.5))))
    else:
        figure = new_figure(12.0, float(np.clip(6.6 * aspect, 4.2, 9.0)))
        left, right = figure.subplots(1, 2, width_ratios=(1.0, 1.2))
    draw_scan_in_map(scan, grid, reference, left)
    draw_likelihood_map(result, grid, right, reference=reference, title=f"(b) {title}")
    _lay_out(figure)
    return figure


def _lay_out(figure: Figure) -> None:
    """Place the axes before drawing does: from where they begin, its own pass may leave a colour bar half outside."""
    if (engine := figure.get_layout_engine()) is not None:
        for _ in range(2):
            engine.execute(figure)


def draw_scan_in_map(scan: Scan, grid: OccupancyGrid, pose: FloatArray, ax: Axes) -> None:
    """Draw a scan in the part of the map that it sees."""
    framed_map(grid, ax)
    draw_scan(scan, pose, ax, label="end points", color=BEST_COLOUR, size=9.0, rays=True)
    low, high = scan_limits(scan, pose, MARGIN)
    mark_robot(pose, ax, size=0.03 * float((high - low).max()), color=REFERENCE_COLOUR, label="robot")
    frame(ax, low, high, "(a) the scan at its reference pose")
    ax.set_facecolor("#E1E5EA")
    legend_under_title(ax)


def plot_likelihood_map(result: LikelihoodMap, grid: OccupancyGrid) -> Figure:
    """Draw the likelihood over the map in a figure of its own."""
    figure = Figure(figsize=(8.0, 6.0), layout="constrained")
    draw_likelihood_map(result, grid, figure.subplots())
    return figure


def draw_likelihood_map(
    result: LikelihoodMap, grid: OccupancyGrid, ax: Axes, *, reference: FloatArray | None = None, title: str = ""
) -> None:
    """Draw log p(z | x, m) over the map, the darker the more likely, with its maximum and the reference pose (3,).

    Peaks are often one cell wide and would be lost in the picture of a building: every place is drawn as dark as the
    best one within half a percent of the picture's width. Places 30 nats below the maximum are white, or those that are
    no better than half of all places. A colour bar is added beside the axes.
    """
    span = _fitting_span(result)
    framed_map(grid, ax, colours=PALE_MAP)
    row, col = result.best_cell
    top = result.log_likelihood[row, col]
    below = result.log_likelihood - top if np.isfinite(top) else np.zeros(result.evaluated.shape)
    size = 2 * round(max(below.shape) / CELLS_ACROSS) + 1
    below = maximum_filter(below, size=size, mode="constant", cval=-np.inf)
    shown = np.ma.masked_where(~(result.evaluated & (below > -span)), below)
    image = draw_array(shown, result.resolution, result.origin, ax, cmap=_white_to_dark(), vmin=-span, vmax=0.0)
    extent = max(np.diff(ax.get_xlim())[0], np.diff(ax.get_ylim())[0])
    if not result.is_flat:
        x, y, _ = result.best_pose
        ax.plot(x, y, "o", color=BEST_COLOUR, markerfacecolor="none", markersize=13, markeredgewidth=2, label="maximum",
                linestyle="none", zorder=6)  # fmt: skip
    if reference is not None:
        mark_robot(reference, ax, size=0.014 * float(extent), color=REFERENCE_COLOUR, label="reference pose")
    colour_bar(image, ax, "log p(z | x, m) below the maximum [nats]")
    style(ax, title=title, x="x [m]", y="y [m]", grid="none")
    ax.set_facecolor(PALE_MAP[1])
    legend_under_title(ax)


def _fitting_span(result: LikelihoodMap) -> float:
    """Return the nats between the best and the median of the possible places, SPAN at most."""
    if result.is_flat:
        return SPAN
    values = result.log_likelihood[result.evaluated]
    median = float(values.max() - np.median(values[np.isfinite(values)]))
    # Where half of the places are exactly as good as the best one, what tells the others apart is below.
    return min(median, SPAN) if median > 0.0 else SPAN


def _white_to_dark() -> ListedColormap:
    """Return a colour map whose lightness falls all the way from white to nearly black."""
    shades = colormaps["magma_r"](np.linspace(0.12, 1.0, 256))
    # Its lightest colour is a pale yellow that would end in a sharp edge against the white map.
    fade = np.linspace(0.15, 1.0, 32)[:, None]
    shades[:32, :3] = (1.0 - fade) + fade * shades[:32, :3]
    return ListedColormap(shades)
