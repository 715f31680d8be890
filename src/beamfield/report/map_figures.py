"""Figures in the map's frame: where each cause occurs, and where scans fit."""

from __future__ import annotations

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from numpy.typing import NDArray

from beamfield.calibration.calibrate import Calibration
from beamfield.geometry import FloatArray, compose
from beamfield.maps.end_points import points_along
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_density import CAUSES
from beamfield.plot import categories, draw_cells
from beamfield.report.colours import CAUSE_COLOURS, MODEL
from beamfield.report.drawing import NARROW, WIDE, legend_above, new_axes, style
from beamfield.report.panel import ReportFigure, one_picture
from beamfield.report.range_bins import thinned
from beamfield.sensors import SensorLog

MOST_POINTS = 40_000
# Metres shown around the data.
MARGIN = 1.0
Limits = tuple[float, float, float, float]
# A map higher than this many times its width is drawn narrow: as wide as the page, it would leave most of it empty.
TALL = 1.3
# Free, unknown, occupied.
MAP_COLOURS = ("#FFFFFF", "#EEF0F2", "#8A929B")


def cause_map(calibration: Calibration, grid: OccupancyGrid, log: SensorLog) -> ReportFigure:
    """Draw the end points of the beams on the map, coloured by their most likely cause."""
    table = calibration.table
    rows = thinned(np.flatnonzero(~table.hits_nothing), MOST_POINTS)
    points = beam_ends(calibration, log, rows)
    causes = calibration.causes[rows]
    path = log.poses[calibration.selection.used, :2]
    limits = _limits(points[causes != 3], path)
    tall = _aspect(limits) > TALL
    width, lines, columns = (NARROW, 3, 2) if tall else (WIDE, 1, 6)
    figure, axes = new_axes(width, figure_height(limits, width=width), above=lines)
    draw_map(axes, grid, limits)
    all_causes = calibration.causes[~table.hits_nothing]
    shares = np.bincount(all_causes, minlength=4) / max(len(all_causes), 1)
    sizes, alphas, markers = (2.5, 4.0, 3.0, 4.0), (0.8, 0.7, 0.5, 0.8), ("o", "o", "^", "s")
    # From below to above. Every wall has some readings without return: they show where hits do not cover them.
    for order, cause in enumerate((2, 0, 3, 1)):
        x, y = points[causes == cause].T
        dots = axes.scatter(x, y, s=sizes[cause], marker=markers[cause], color=CAUSE_COLOURS[cause], linewidths=0)
        dots.set(alpha=alphas[cause], zorder=2 + 0.1 * order)
    for cause, name in enumerate(CAUSES):
        label = f"{name} {shares[cause]:.1%}"
        axes.scatter([], [], s=40, marker=markers[cause], color=CAUSE_COLOURS[cause], label=label)
    _draw_path(axes, path)
    frame(axes, limits)
    legend_above(axes, ncols=columns)
    said = ", ".join(f"{name} {share:.1%}" for name, share in zip(CAUSES, shares, strict=True))
    return one_picture(
        "cause-map",
        "Readings in the map, by their cause",
        figure,
        f"Map with the end points of the beams, by most likely cause: {said}.",
        f"Where {len(rows)} beams end, by most likely cause: hit (the mapped obstacle), short (something nearer, which "
        "the map lacks), max (no return: triangles where the map has the obstacle, as on glass, black or distant "
        "surfaces), rand (nothing explains it). Black is the robot's path (circle: start, cross: end). A dense group "
        "of short points is an object that the map lacks; random points in rows behind a wall are an opened door, a "
        "moved wall, or poses that are off.",
        "Section 6.3.3 (the correspondence c_i of a reading); (6.32) projects the end points",
        cloud=True,
    )


def fit_map(calibration: Calibration, grid: OccupancyGrid, log: SensorLog) -> ReportFigure | None:
    """Draw the path on the map, coloured by how well the scans taken there fit; None for fewer than two scans."""
    line = calibration.timeline
    if len(line.scan) < 2:
        return None
    poses = log.poses[line.scan]
    limits = _limits(poses[:, :2], poses[:, :2], margin=3 * MARGIN)
    figure, axes = new_axes(WIDE, figure_height(limits) + 0.6, above=2.6)
    draw_map(axes, grid, limits)
    low, high = np.quantile(line.log_likelihood, [0.02, 0.98])
    order = np.argsort(-line.log_likelihood)
    dots = axes.scatter(
        poses[order, 0], poses[order, 1], c=line.log_likelihood[order], s=22, cmap="cividis", vmin=low, vmax=high,
        edgecolors=MODEL, linewidths=0.2,
    )  # fmt: skip
    frame(axes, limits)
    colour_bar(figure, axes, dots, "log-likelihood per beam [nats]")
    worst = poses[int(np.argmin(line.log_likelihood))]
    return one_picture(
        "fit-map",
        "Where scans fit",
        figure,
        f"The path on the map, coloured by log-likelihood per beam; the worst scan was taken at x "
        f"{worst[0]:.1f} m, y {worst[1]:.1f} m.",
        "One dot per scan where the robot stood, dark where its beams fit badly, with the worst on top. Dark dots "
        "that come back at one place speak against the map there; dark dots along one stretch of the path only once "
        "speak of people, or against the reference poses. Wrong poses along a corridor hardly show.",
        "Section 6.1, (6.2); Table 6.1",
        cloud=True,
    )


def beam_ends(calibration: Calibration, log: SensorLog, rows: NDArray[np.int64]) -> FloatArray:
    """Return (n, 2) where beams end in the map; beams without return end at their expected range."""
    table = calibration.table
    origin = compose(log.poses[table.scan[rows]], log.finder.mounts[table.beam[rows]])
    no_return = table.ranges[rows] >= table.max_range
    reach = np.where(no_return, table.expected_ranges[rows], table.ranges[rows])
    return points_along(origin, reach)


def _limits(points: FloatArray, path: FloatArray, margin: float = MARGIN) -> Limits:
    """(x low, x high, y low, y high) of the data; a few stray end points do not count."""
    both = [path[np.isfinite(path).all(axis=1)]]
    if len(points) > 20:
        both.append(np.quantile(points, [0.002, 0.998], axis=0))
    return limits_around(np.concatenate(both), margin)


def limits_around(points: FloatArray, margin: float = MARGIN) -> Limits:
    """Return (x low, x high, y low, y high) of points (n, 2), with a margin."""
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def figure_height(limits: Limits, *, width: float = WIDE, rest: float = 0.85, least: float = 2.0) -> float:
    """Return the height of a figure in inches for equal axes, within what a screen takes; `rest` is for the text."""
    most = 7.0 if width > NARROW else 5.5
    return float(np.clip((width - 0.7) * _aspect(limits) + rest, least, most))


def _aspect(limits: Limits) -> float:
    return (limits[3] - limits[2]) / max(limits[1] - limits[0], 1e-9)


def colour_bar(figure: Figure, axes: Axes, drawn: ScalarMappable, label: str) -> None:
    """Add a colour bar above axes, over their left half; as high in a tall map as in a flat one."""
    inch = 1.0 / (figure.get_figheight() - 1.1)  # in heights of the axes
    beside = axes.inset_axes((0.0, 1.0 + 0.03 * inch, 0.5, 0.1 * inch))
    bar = figure.colorbar(drawn, cax=beside, orientation="horizontal")
    bar.ax.xaxis.set_ticks_position("top")
    bar.ax.xaxis.set_label_position("top")
    bar.set_label(label, fontsize=9, color="#222222")
    bar.ax.tick_params(labelsize=9)
    bar.outline.set_visible(False)


def number_place(axes: Axes, number: int, x: float, y: float) -> None:
    """Write the number of a place beside it."""
    text = axes.annotate(
        str(number), (x, y), (7, 7), textcoords="offset points", fontsize=9, fontweight="bold", color=MODEL, zorder=5
    )
    text.set_path_effects([patheffects.withStroke(linewidth=2.5, foreground="white")])


def squares_at(corners: FloatArray, side: float) -> list[FloatArray]:
    """Return the outlines (4, 2) of squares by their lower left corners (n, 2)."""
    return list(corners[:, None] + side * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]))


def draw_map(axes: Axes, grid: OccupancyGrid, limits: Limits) -> None:
    """Draw the part of the map within the limits (x low, x high, y low, y high), turned by the origin's yaw."""
    corners = grid.to_cells(np.array([[limits[i], limits[j]] for i in (0, 1) for j in (2, 3)]))
    size = grid.shape[::-1]
    col, row = np.clip(np.floor(corners.min(axis=0)), 0, size).astype(np.int64).tolist()
    col_end, row_end = np.clip(np.ceil(corners.max(axis=0)), 0, size).astype(np.int64).tolist()
    if col >= col_end or row >= row_end:
        return
    corner = np.array([*grid.to_map([col, row]), grid.origin[2]])
    draw_cells(categories(grid)[row:row_end, col:col_end], grid.resolution, corner, axes, colours=MAP_COLOURS)


def _draw_path(axes: Axes, path: FloatArray) -> None:
    axes.plot(path[:, 0], path[:, 1], color=MODEL, linewidth=1.1, label="robot's path")
    axes.plot(*path[0], "o", color=MODEL, markersize=6, markerfacecolor="white")
    axes.plot(*path[-1], "X", color=MODEL, markersize=6.5, markeredgecolor="white", markeredgewidth=0.6)


def frame(axes: Axes, limits: Limits) -> None:
    """Show the part of the map within the limits (x low, x high, y low, y high)."""
    axes.set(xlim=limits[:2], ylim=limits[2:], aspect="equal")
    style(axes, x="x in the map [m]", y="y in the map [m]", grid="none")
    # Off the map nothing is known either.
    axes.set_facecolor(MAP_COLOURS[1])
