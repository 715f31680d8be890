"""The pictures of ``beamfield inspect``."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from beamfield.geometry import FloatArray
from beamfield.maps.end_points import end_points
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.plot import MAP_COLOURS, PATH_COLOUR, draw_map, draw_ranges, draw_scan, draw_trajectory
from beamfield.printable import printable
from beamfield.sensors import ScanLog, SensorLog, Track

MOST_POINTS = 150_000
MOST_SENSORS = 4
WIDTH = 13.0  # inches
# Share of the end points that may lie outside the picture at each side, so that a few far ones do not shrink the rest.
OUTSIDE = 0.005
MARGIN = 0.04


def map_picture(grid: OccupancyGrid, title: str) -> Figure:
    """Draw a map with the share of each category and the frame of its origin."""
    width, height = grid.shape[1], grid.shape[0]
    size = 9.0 / max(width, height)
    figure = Figure(figsize=(max(5.5, width * size + 1.5), max(4.5, height * size + 1.5)), layout="constrained")
    ax = draw_map(grid, figure.add_subplot())
    ax.set_title(f"{title}: {width} x {height} cells of {grid.resolution:.4g} m", fontsize=11)
    shares = (grid.free.mean(), grid.unknown.mean(), grid.occupied.mean())
    handles: list[Patch | Line2D] = [
        Patch(facecolor=colour, edgecolor="#5B6570", label=f"{name} {share:.1%}")
        for name, colour, share in zip(("free", "unknown", "occupied"), MAP_COLOURS, shares, strict=True)
    ]
    (x_min, x_max), (y_min, y_max) = ax.get_xlim(), ax.get_ylim()
    if x_min <= 0.0 <= x_max and y_min <= 0.0 <= y_max:
        ax.plot(0.0, 0.0, "+", color=PATH_COLOUR, markersize=12, markeredgewidth=2)
        handles.append(
            Line2D([], [], color=PATH_COLOUR, marker="+", linestyle="none", markersize=10, markeredgewidth=2,
                   label="(0, 0) of the map frame")
        )  # fmt: skip
    figure.legend(
        handles=handles,
        loc="outside lower center",
        ncols=4 if figure.get_figwidth() > 6.5 else 2,
        fontsize=9,
        frameon=False,
    )
    return figure


def poses_picture(track: Track, title: str, grid: OccupancyGrid | None = None) -> Figure:
    """Draw the path of a file of poses, over a map if there is one."""
    figure = Figure(figsize=(9.0, 7.0), layout="constrained")
    ax = figure.add_subplot()
    if grid is not None:
        draw_map(grid, ax)
    draw_trajectory(track.poses, ax, label="robot")
    ax.set_title(f"{title}: {len(track):,} poses", fontsize=11)
    ax.legend(loc="best", fontsize=8, framealpha=0.9)
    return figure


def log_picture(log: ScanLog, title: str, grid: OccupancyGrid | None = None) -> Figure:
    """Draw one row per sensor, of up to four: the scans along the path, one scan, and the ranges.

    The map is drawn under the scans of sensors that have reference poses.
    """
    shown = list(log.sensors.items())[:MOST_SENSORS]
    layouts = [_layout_for(sensor) for _, sensor in shown]
    heights = [height for _, _, height in layouts]
    figure = Figure(figsize=(WIDTH, 0.6 + sum(heights)), layout="constrained")
    more = f" (the first {len(shown)} of {len(log.sensors)} sensors)" if len(shown) < len(log.sensors) else ""
    figure.suptitle(title + more, fontsize=13, fontweight="bold")
    if not shown:
        return figure
    parts = figure.subfigures(len(shown), 1, height_ratios=heights, squeeze=False)[:, 0]
    for (name, sensor), part, (layout, options, _) in zip(shown, parts, layouts, strict=True):
        part.suptitle(f"sensor {printable(name)}".replace("$", r"\$"), fontsize=12)
        panels = part.subplot_mosaic(layout, **options)
        if "path" in panels:
            _draw_path_and_scans(sensor, panels["path"], grid)
        _draw_one_scan(sensor, panels["scan"])
        _draw_histogram(sensor, panels["ranges"])
    return figure


def _layout_for(sensor: SensorLog) -> tuple[list[list[str]], dict[str, Any], float]:
    """Return where the panels stand, so that a long corridor and a round room both fill their panel, and the height."""
    poses, _ = _poses_to_draw(sensor)
    if poses is None:
        return [["scan", "ranges"]], {}, 5.0
    low, high = _limits(_points_along(sensor, poses)[0].reshape(-1, 2), OUTSIDE)
    aspect = float((high - low)[0] / (high - low)[1])
    if aspect < 1.3:
        return [["path", "scan"], ["path", "ranges"]], {"width_ratios": (1.4, 1.0)}, 8.0
    path_height = min(7.0, max(2.5, 0.85 * WIDTH / aspect))
    return [["path", "path"], ["scan", "ranges"]], {"height_ratios": (path_height, 4.5)}, path_height + 4.5


def _poses_to_draw(sensor: SensorLog) -> tuple[FloatArray | None, str]:
    if sensor.has_poses:
        return sensor.poses, "map frame, from the reference poses"
    if sensor.has_odometry:
        return sensor.odometry, "odometry frame, which drifts"
    return None, ""


def _points_along(sensor: SensorLog, poses: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
    """Return the end points (n, k, 2) of scans spread over the path, and which scans these are."""
    chosen = _scans_along(poses, sensor.finder.n_beams)
    points = end_points(sensor.ranges[chosen], sensor.finder, poses[chosen])
    # A robot that measured nothing is still somewhere.
    return np.concatenate([points, poses[chosen, None, :2]], axis=1), chosen


def _draw_path_and_scans(sensor: SensorLog, ax: Axes, grid: OccupancyGrid | None) -> None:
    poses, frame = _poses_to_draw(sensor)
    if poses is None:
        return
    points, chosen = _points_along(sensor, poses)
    if grid is not None and sensor.has_poses:
        draw_map(grid, ax)
    seen = np.isfinite(points).all(axis=-1)
    since = np.broadcast_to((sensor.stamps[chosen] - sensor.stamps[0])[:, None], seen.shape)
    x, y = points[seen].T
    dots = ax.scatter(x, y, c=since[seen], s=0.8, cmap="plasma", linewidths=0, rasterized=True, zorder=2)
    draw_trajectory(poses, ax, label="robot", color="#111111")
    _zoom(ax, points.reshape(-1, 2))
    # As an inset it is as high as the axes, whatever their aspect.
    ax.figure.colorbar(dots, cax=ax.inset_axes((1.01, 0.0, 0.02, 1.0)), label="time since the first scan [s]")
    ax.set_title(f"{len(chosen)} of {len(sensor)} scans in the {frame}", fontsize=11)
    ax.legend(loc="best", fontsize=8, framealpha=0.9)


def _scans_along(poses: FloatArray, n_beams: int) -> NDArray[np.int64]:
    """Return scans that have a pose, spread evenly along the path so that standing still does not fill the picture."""
    known = np.flatnonzero(np.isfinite(poses).all(axis=1))
    steps = np.hypot(*np.diff(poses[known, :2], axis=0).T)
    turns = np.abs(np.angle(np.exp(1j * np.diff(poses[known, 2]))))
    # A turn by one radian shows as much that is new as a path of one metre; the last term keeps the order strict.
    way = np.concatenate([[0.0], np.cumsum(steps + turns + 1e-6)])
    wanted = np.linspace(0.0, way[-1], max(2, min(len(known), MOST_POINTS // max(n_beams, 1))))
    return np.asarray(known[np.unique(np.searchsorted(way, wanted).clip(max=len(known) - 1))], dtype=np.int64)


def _draw_one_scan(sensor: SensorLog, ax: Axes) -> None:
    measured = np.isfinite(sensor.ranges).sum(axis=1)
    if not len(sensor) or not measured.any():
        _say(ax, "no scan measured anything")
        return
    # Of the middle third, because logs often begin and end beside a wall or a person.
    first, end = len(sensor) // 3, max(len(sensor) // 3 + 1, 2 * len(sensor) // 3)
    index = first + int(np.argmax(measured[first:end])) if measured[first:end].any() else int(np.argmax(measured))
    draw_scan(sensor.scan(index), np.zeros(3), ax, label="end points", rays=True)
    ax.annotate("", (0.6, 0.0), (0.0, 0.0), arrowprops={"arrowstyle": "-|>", "color": PATH_COLOUR, "lw": 2}, zorder=6)
    ax.plot(0.0, 0.0, "o", color=PATH_COLOUR, markersize=6, label="robot, facing +x", zorder=6)
    points = end_points(sensor.ranges[index], sensor.finder)
    _zoom(ax, np.concatenate([points, [[0.0, 0.0], [0.6, 0.0]]]), outside=0.0)
    ax.set_title(f"scan {index} in the robot frame", fontsize=11)
    ax.legend(loc="best", fontsize=7, framealpha=0.9)


def _draw_histogram(sensor: SensorLog, ax: Axes) -> None:
    if not sensor.ranges.size:
        _say(ax, "no readings")
        return
    draw_ranges(sensor.ranges, sensor.finder, ax)
    ax.set_title(f"{sensor.ranges.size:,} readings", fontsize=11)


def _zoom(ax: Axes, points: FloatArray, outside: float = OUTSIDE) -> None:
    low, high = _limits(points, outside)
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])


def _limits(points: FloatArray, outside: float) -> tuple[FloatArray, FloatArray]:
    known = points[np.isfinite(points).all(axis=1)]
    low, high = np.quantile(known, (outside, 1.0 - outside), axis=0)
    margin = MARGIN * max(float((high - low).max()), 1.0)
    return low - margin, high + margin


def _say(ax: Axes, text: str) -> None:
    ax.set_axis_off()
    ax.text(0.5, 0.5, text, ha="center", va="center", wrap=True, color="#5B6570", transform=ax.transAxes)
