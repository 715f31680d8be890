"""What several figures share: maps in a frame, arrays over a map, a robot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from numpy.typing import ArrayLike

from beamfield.geometry import FloatArray, transform_points
from beamfield.maps.end_points import hit_points
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.plot import MAP_COLOURS, categories, draw_cells
from beamfield.report.colours import GRID
from beamfield.report.drawing import legend_above, style
from beamfield.sensors import Scan

# Share of a scan's end points that may lie outside a picture at each side.
STRAY = 0.04

Limits = tuple[float, float, float, float]


def framed_map(grid: OccupancyGrid, ax: Axes, *, colours: Sequence[str] = MAP_COLOURS) -> None:
    """Draw a map in metres, in colours of free, unknown and occupied cells, and show the part of it that is known."""
    draw_cells(categories(grid), grid.resolution, grid.origin, ax, colours=colours)
    limits = known_limits(grid)
    ax.set(xlim=limits[:2], ylim=limits[2:], aspect="equal")


def frame(ax: Axes, low: ArrayLike, high: ArrayLike, title: str, *, x: str = "x [m]", y: str = "y [m]") -> None:
    """Show what lies between two corners (2,), in metres, under a title."""
    (left, bottom), (right, top) = np.asarray(low), np.asarray(high)
    ax.set(xlim=(left, right), ylim=(bottom, top), aspect="equal")
    style(ax, title=title, x=x, y=y, grid="none", wrap=True)


def legend_under_title(ax: Axes) -> None:
    """Add a legend in one line between axes and their title, where it hides no map; nothing if nothing has a label."""
    if not ax.get_legend_handles_labels()[0]:
        return
    legend_above(ax)
    ax.set_title(ax.get_title("left"), loc="left", y=1.0, pad=20.0, fontsize=10, color="#111111", fontweight="bold",
                 wrap=True)  # fmt: skip


def known_limits(grid: OccupancyGrid, margin: float = 0.5) -> Limits:
    """Return (x low, x high, y low, y high) of the cells that are known, in the map frame; of all if none is."""
    rows, cols = np.nonzero(~grid.unknown)
    if not len(rows):
        rows, cols = np.array([0, grid.shape[0] - 1]), np.array([0, grid.shape[1] - 1])
    c0, c1, r0, r1 = cols.min(), cols.max() + 1, rows.min(), rows.max() + 1
    corners = grid.to_map([[c0, r0], [c1, r0], [c1, r1], [c0, r1]])
    low, high = corners.min(axis=0) - margin, corners.max(axis=0) + margin
    return float(low[0]), float(high[0]), float(low[1]), float(high[1])


def scan_limits(scan: Scan, pose: ArrayLike, margin: float) -> tuple[FloatArray, FloatArray]:
    """Return the corners (low, high) of what a scan sees from a pose (3,), a few stray end points left out.

    The margin, in metres, is added on each side.
    """
    place = np.asarray(pose, dtype=np.float64)
    points = hit_points(scan.ranges, scan.finder, place)
    low, high = np.quantile(points, (STRAY, 1.0 - STRAY), axis=0) if len(points) else (place[:2], place[:2])
    return np.minimum(low, place[:2]) - margin, np.maximum(high, place[:2]) + margin


def mark_robot(pose: ArrayLike, ax: Axes, *, size: float, color: str, label: str) -> None:
    """Draw a robot as a triangle that points along its heading; `size` is from its centre to its tip, metres."""
    from matplotlib.patches import Polygon

    outline = size * np.array([[1.0, 0.0], [-0.7, 0.65], [-0.4, 0.0], [-0.7, -0.65]])
    corners = transform_points(np.asarray(pose, dtype=np.float64), outline)
    ax.add_patch(Polygon(corners, closed=True, facecolor=color, edgecolor="white", linewidth=0.8, zorder=7))
    ax.plot([], [], marker=(3, 0, -90), color=color, linestyle="none", markersize=8, label=label)


def colour_bar(image: ScalarMappable, ax: Axes, label: str) -> None:
    """Add a colour bar beside axes; its label carries the unit."""
    # As an inset it is as high as the axes, whatever their aspect.
    bar = ax.figure.colorbar(image, cax=ax.inset_axes((1.015, 0.0, 0.022, 1.0)))
    bar.set_label(label, fontsize=9)
    bar.ax.tick_params(labelsize=9)
    bar.outline.set_edgecolor(GRID)
