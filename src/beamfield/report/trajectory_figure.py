"""The picture of a fitted trajectory: the path over the map, coloured by trust."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from beamfield.geometry import FloatArray
from beamfield.localization.own_poses import LOST
from beamfield.localization.trajectory import TrajectoryFit, position_deviations
from beamfield.maps.end_points import hit_points
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.plot import CHI_SQUARE_95, PATH_COLOUR, draw_map
from beamfield.report.colours import QUIET
from beamfield.sensors import SensorLog

NOT_TRUSTED = "#D55E00"
SCANS, OWN_POSES = "#56B4E9", "#CC79A7"
# Ellipses are drawn this far apart, share of the path, and so many times larger, so that centimetres can be seen.
ELLIPSES, MAGNIFIED = 25, 10.0
MOST_POINTS = 40_000
MARGIN = 1.5


def draw_fit(fit: TrajectoryFit, log: SensorLog, grid: OccupancyGrid, title: str) -> Figure:
    """Draw the map, the scans' end points, the path and the log's own poses, and what the path is worth."""
    points = _points(fit, log)
    seen = np.concatenate([points, fit.poses[:, :2]])
    low, high = np.quantile(seen, 0.002, axis=0) - MARGIN, np.quantile(seen, 0.998, axis=0) + MARGIN
    if log.has_poses:
        # A lost filter's poses are what one looks for; of another map's frame they would leave nothing to be seen.
        own = log.poses[np.isfinite(log.poses).all(axis=1), :2].clip(grid.bounds[:2], grid.bounds[2:])
        low, high = np.minimum(low, own.min(axis=0) - MARGIN), np.maximum(high, own.max(axis=0) + MARGIN)
    width, height = high - low
    size = 9.0 / max(width, height)
    figure = Figure(figsize=(max(6.0, width * size), max(3.5, height * size) + 3.4), layout="compressed")
    above, below = figure.subplots(2, 1, height_ratios=(max(3.5, height * size), 2.2))
    _draw_path(fit, points, draw_map(grid, above))
    if log.has_poses:
        above.plot(*log.poses[:, :2].T, color=OWN_POSES, lw=1.2, label="the log's own poses", zorder=3)
    above.set_xlim(low[0], high[0])
    above.set_ylim(low[1], high[1])
    above.set_title(title, fontsize=11, parse_math=False)  # names of files may hold $
    above.legend(loc="best", fontsize=8, framealpha=0.9)
    _draw_deviations(fit, log, below)
    return figure


def _points(fit: TrajectoryFit, log: SensorLog) -> FloatArray:
    every = max(1, len(log) * log.finder.n_beams // MOST_POINTS)
    return hit_points(log.ranges[::every], log.finder, fit.poses[::every])


def _draw_path(fit: TrajectoryFit, points: FloatArray, ax: Axes) -> None:
    ax.scatter(points[:, 0], points[:, 1], s=0.5, color=SCANS, linewidths=0, rasterized=True, zorder=2)
    ax.scatter([], [], s=12, color=SCANS, label="end points")  # in the legend a point would be too small to be seen
    x, y = fit.poses[:, 0], fit.poses[:, 1]
    ax.plot(np.where(fit.trusted, x, np.nan), y, color=PATH_COLOUR, lw=1.4, label="trusted", zorder=4)
    if not fit.trusted.all():
        ax.plot(*_with_neighbours(~fit.trusted, x, y), color=NOT_TRUSTED, lw=2.2, label="not trusted", zorder=5)
    ax.plot(x[0], y[0], "o", color="#111111", markersize=7, label="start", zorder=6)
    ax.plot(x[-1], y[-1], "s", color="#111111", markersize=6, label="end", zorder=6)
    circle = np.stack([np.cos(np.linspace(0.0, 2.0 * np.pi, 40)), np.sin(np.linspace(0.0, 2.0 * np.pi, 40))])
    for number, i in enumerate(_spread_along(fit.poses)):
        root = np.linalg.cholesky(fit.covariances[i, :2, :2])
        ellipse = fit.poses[i, :2, None] + MAGNIFIED * np.sqrt(CHI_SQUARE_95) * (root @ circle)
        label = f"95% ellipses, {MAGNIFIED:g} times larger" if number == 0 else None
        ax.plot(*ellipse, color="#111111", lw=0.8, zorder=5, label=label)


def _with_neighbours(mask: NDArray[np.bool_], x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the path where it is not trusted, joined to what is before and after."""
    wider = mask.copy()
    wider[1:] |= mask[:-1]
    wider[:-1] |= mask[1:]
    return np.where(wider, x, np.nan), y


def _spread_along(poses: FloatArray) -> NDArray[np.int64]:
    way = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    return np.unique(np.searchsorted(way, np.linspace(0.0, way[-1], ELLIPSES)).clip(max=len(poses) - 1))


def _draw_deviations(fit: TrajectoryFit, log: SensorLog, ax: Axes) -> None:
    """Draw how uncertain the fitted positions are, and how far the log's own ones are from them."""
    since, deviation = fit.stamps - fit.stamps[0], position_deviations(fit.covariances)
    ax.plot(since, deviation, color=PATH_COLOUR, lw=1.2, label="standard deviation of the fitted position")
    top = 1.1 * float(deviation.max())
    if log.has_poses:
        off = np.hypot(*(log.poses - fit.poses)[:, :2].T)
        ax.plot(since, off, color=OWN_POSES, lw=1.2, label="from the fitted to the log's own position")
        ax.axhline(LOST, color=QUIET, lw=0.9, ls="--", label=f"lost beyond {LOST:g} m")
        top = max(top, 1.1 * LOST, 1.1 * float(np.nanmax(off)))
        ax.legend(loc="best", fontsize=8, framealpha=0.9)
    if not fit.trusted.all():
        ax.fill_between(since, 0.0, top, where=~fit.trusted, color=NOT_TRUSTED, alpha=0.3, step="mid", lw=0)
    ax.set_ylim(0.0, top)
    ax.set_xlim(since[0], since[-1])
    ax.set_xlabel("time since the first scan [s]")
    ax.set_ylabel("distance [m]" if log.has_poses else "standard deviation\nof the position [m]")
    ax.grid(alpha=0.3)
