"""What a localization did: the path in the map, the errors over time, the particles as they moved."""

from __future__ import annotations

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from beamfield.figures.drawing import framed_map, mark_robot
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.localization.replay import Replay
from beamfield.maps.end_points import end_points
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.plot import draw_trajectory
from beamfield.report.drawing import legend, new_figure, style
from beamfield.sensors import SensorLog

ESTIMATE, REFERENCE, BOUND, GUESS = "#0072B2", "#D55E00", "#8A949E", "#CC79A7"
# Of a chi-square variable with 2 degrees of freedom, and of a standard normal one.
BOUND_2D, BOUND_1D = 5.991, 1.960
WITHIN = "95% of the particles within"
MARGIN = 2.0
# Of an animation.
FRAMES_PER_SECOND, ANIMATED_BEAMS, COLOURS = 10, 180, 64


def localization_figure(
    found: Replay, log: SensorLog, grid: OccupancyGrid, *, sure_after: float | None = 0.0
) -> Figure:
    """Draw where the filter was in the map, and over time how far off and how sure.

    Poses until `sure_after`, seconds since the first scan, are drawn as guesses, or as of an earlier place; all of them
    if it is None.
    """
    figure = new_figure(12.0, 6.0)
    axes = figure.subplot_mosaic([["path", "position"], ["path", "heading"]], width_ratios=(1.15, 1.0))
    _draw_path(found, log, grid, axes["path"], sure_after)
    _draw_errors(found, log, axes["position"], axes["heading"])
    return figure


def animation(frames: Sequence[tuple[int, FloatArray]], found: Replay, log: SensorLog, grid: OccupancyGrid) -> bytes:
    """Return the particles over time as a GIF; frames, at least one, are the index of a scan and particles (n, 3)."""
    figure = new_figure(6.4, 6.0)
    canvas = FigureCanvasAgg(figure)
    ax = figure.add_subplot()
    framed_map(grid, ax)
    _zoom(ax, np.concatenate([found.poses, log.poses]), grid)
    style(ax, x="x [m]", y="y [m]", grid="none")
    cloud = ax.scatter([], [], s=4.0, color=ESTIMATE, alpha=0.35, linewidths=0, zorder=5)
    scan = ax.scatter([], [], s=5.0, color=REFERENCE, linewidths=0, zorder=4)
    (way,) = ax.plot([], [], color=ESTIMATE, linewidth=1.2, zorder=4)
    clock = ax.text(0.5, 1.02, "", ha="center", transform=ax.transAxes)
    moving = (way, scan, cloud, clock)
    for artist in moving:
        artist.set_animated(True)
    # The map takes a hundred times as long as what moves on it.
    canvas.draw()  # type: ignore[no-untyped-call]
    still = canvas.copy_from_bbox(figure.bbox)  # type: ignore[no-untyped-call]
    beams = np.unique(np.linspace(0, log.finder.n_beams - 1, ANIMATED_BEAMS).astype(np.int64))
    finder = log.finder.subset(beams)
    pictures = []
    for i, particles in frames:
        ends = end_points(log.ranges[i, beams], finder, found.poses[i])
        cloud.set_offsets(particles[:, :2])
        scan.set_offsets(ends[np.isfinite(ends).all(axis=1)])
        way.set_data(found.poses[: i + 1, 0], found.poses[: i + 1, 1])
        clock.set_text(f"{log.stamps[i] - log.stamps[0]:.1f} s: particles, scan and estimate")
        canvas.restore_region(still)  # type: ignore[no-untyped-call]
        for artist in moving:
            ax.draw_artist(artist)
        pixels = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
        # Few colours: a third of the size.
        pictures.append(Image.fromarray(pixels[..., :3].copy()).quantize(COLOURS, Image.Quantize.FASTOCTREE))
    out = io.BytesIO()
    pictures[0].save(
        out, format="GIF", save_all=True, append_images=pictures[1:], duration=1000 // FRAMES_PER_SECOND, loop=0
    )
    return out.getvalue()


def _draw_path(found: Replay, log: SensorLog, grid: OccupancyGrid, ax: Axes, sure_after: float | None) -> None:
    framed_map(grid, ax)
    if log.has_poses:
        draw_trajectory(log.poses, ax, label="reference", color=REFERENCE, ends=False)
    sure = np.zeros(len(log), dtype=bool) if sure_after is None else log.stamps - log.stamps[0] >= sure_after
    if not sure.all():
        # Points: a guess jumps, and a line would say that the robot went there.
        ax.plot(*found.poses[~sure, :2].T, ".", color=GUESS, markersize=3, label="guess, or an earlier place", zorder=4)
    if sure.any():
        draw_trajectory(found.poses[sure], ax, label="estimate", color=ESTIMATE, ends=False)
    known = found.poses[np.isfinite(found.poses).all(axis=1)]
    _zoom(ax, np.concatenate([known, log.poses]), grid)
    low, high = ax.get_xlim()
    mark_robot(known[-1], ax, size=0.02 * (high - low), color=ESTIMATE, label="end")
    style(ax, title="The path in the map", x="x [m]", y="y [m]", grid="none")
    legend(ax, loc="best")


def _zoom(ax: Axes, poses: FloatArray, grid: OccupancyGrid) -> None:
    """Show the part of the map that the poses are in."""
    known = poses[np.isfinite(poses).all(axis=1), :2]
    margin = MARGIN + 0.1 * float(np.ptp(known, axis=0).max())
    low = np.maximum(known.min(axis=0) - margin, grid.bounds[:2])
    high = np.minimum(known.max(axis=0) + margin, grid.bounds[2:])
    ax.set_xlim(low[0], high[0])
    ax.set_ylim(low[1], high[1])


def _draw_errors(found: Replay, log: SensorLog, top: Axes, bottom: Axes) -> None:
    """Draw the errors of position and heading, if the log has poses to tell, and what the particles say of them."""
    time = log.stamps - log.stamps[0]
    at = time[found.updates]
    widest = np.linalg.eigvalsh(found.covariances[:, :2, :2])[:, -1]
    top.plot(at, np.sqrt(BOUND_2D * np.maximum(widest, 0.0)), color=BOUND, linewidth=1.0, label=WITHIN)
    # No heading is further off than half a turn.
    heading = np.minimum(BOUND_1D * np.degrees(np.sqrt(found.covariances[:, 2, 2])), 180.0)
    bottom.plot(at, heading, color=BOUND, linewidth=1.0, label=WITHIN)
    if log.has_poses:
        off = found.poses - log.poses
        top.plot(time, np.hypot(off[:, 0], off[:, 1]), color=ESTIMATE, linewidth=1.0, label="error")
        turn = np.degrees(np.abs(wrap_angle(off[:, 2])))
        bottom.plot(time, turn, color=ESTIMATE, linewidth=1.0, label="error")
    for ax, of, unit in ((top, "position", "m"), (bottom, "heading", "deg")):
        title, what = (f"Error of the {of}", "error") if log.has_poses else (f"How sure of the {of}", WITHIN)
        style(ax, title=title, x="time [s]", y=f"{what} [{unit}]")
        ax.set_ylim(bottom=0.0)
        ax.set_xlim(0.0, max(float(time[-1]), 1e-3))
        if log.has_poses:
            legend(ax, loc="upper right")
