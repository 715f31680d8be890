"""Draw maps, scans, their features, trajectories and ranges: matplotlib Axes in and out, units on every axis.

Matplotlib is imported when something is drawn, so that importing beamfield stays quick.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import require
from beamfield.errors import InvalidInputError
from beamfield.features.corners import Corner
from beamfield.features.feature import Feature, polar_jacobian
from beamfield.features.minima import LocalMinimum
from beamfield.features.poles import Pole
from beamfield.features.straight_line import Line
from beamfield.geometry import FloatArray, as_pose, compose, transform_points
from beamfield.maps.end_points import end_points, points_along
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, Scan, usable_ranges

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.image import AxesImage

# Free, unknown, occupied.
# Pixels along a side of a drawn map.
MOST_PIXELS = 2000
MAP_COLOURS = ("#FFFFFF", "#E1E5EA", "#3C444D")
SCAN_COLOUR = "#D55E00"
PATH_COLOUR = "#0072B2"
NO_RETURN_COLOUR = "#009E73"
# Name, colour and marker of each kind of feature.
FEATURE_STYLES: tuple[tuple[type[Feature], str, str, str], ...] = (
    (Line, "line", "#0072B2", ""),
    (Corner, "corner", "#009E73", "s"),
    (LocalMinimum, "local minimum", "#CC79A7", "v"),
    (Pole, "pole", "#111111", "+"),
)
# 95% of chi-square with two degrees of freedom.
CHI_SQUARE_95 = 5.991


def draw_map(grid: OccupancyGrid, ax: Axes) -> Axes:
    """Draw a map in metres, in the map frame, turned by the yaw of its origin: free white, unknown grey, occupied dark.

    Parameters
    ----------
    grid
        The map.
    ax
        Where to draw.

    Returns
    -------
    The axes.

    Notes
    -----
    Larger maps are drawn with at most 2,000 pixels a side; a pixel is dark if any of its cells is occupied, so thin
    walls stay.
    """
    step = -(-max(grid.shape) // MOST_PIXELS)
    # The last pixel of a coarser picture may stand over the map's edge.
    draw_cells(categories(grid, step), step * grid.resolution, grid.origin, ax)
    left, bottom, right, top = grid.bounds
    ax.set(xlim=(left, right), ylim=(bottom, top))
    return _in_metres(ax)


def draw_cells(
    kinds: NDArray[np.uint8], resolution: float, origin: FloatArray, ax: Axes, *, colours: Sequence[str] = MAP_COLOURS
) -> AxesImage:
    """Draw cells (rows, cols) as from `categories` at their place in the map frame; limits are left to the caller.

    The resolution is in metres, the origin the pose (3,) of the lower-left corner; colours are of free, unknown and
    occupied cells.
    """
    from matplotlib.colors import ListedColormap

    return draw_array(kinds, resolution, origin, ax, cmap=ListedColormap(list(colours)), vmin=0, vmax=2, zorder=0)


def categories(grid: OccupancyGrid, step: int = 1) -> NDArray[np.uint8]:
    """Return 0 free, 1 unknown, 2 occupied for blocks of step x step cells; any occupied or else free cell decides."""
    occupied, free = (_any_in_block(mask, step) for mask in (grid.occupied, grid.free))
    return np.where(occupied, 2, np.where(free, 0, 1)).astype(np.uint8)


def draw_array(values: ArrayLike, resolution: float, origin: FloatArray, ax: Axes, **options: Any) -> AxesImage:
    """Draw an array (rows, cols), row 0 lowest, at its place in the map frame; masked cells are left out.

    The resolution is in metres, the origin the pose (3,) of the lower-left corner; options are for `imshow`.
    """
    from matplotlib.transforms import Affine2D

    rows, cols = np.shape(values)
    x, y, yaw = (float(v) for v in origin)
    in_map = Affine2D().rotate(yaw).translate(x, y) + ax.transData
    options = {"interpolation": "nearest", "zorder": 1, **options}
    extent = (0.0, cols * resolution, 0.0, rows * resolution)
    return ax.imshow(values, origin="lower", extent=extent, transform=in_map, **options)


def draw_trajectory(
    poses: ArrayLike, ax: Axes, *, label: str = "trajectory", color: str = PATH_COLOUR, ends: bool = True
) -> Axes:
    """Draw the path of a robot; it breaks where a pose is missing.

    Parameters
    ----------
    poses
        (t, 3) poses, or (t, 2) positions, in metres; NaN where there is none.
    ax
        Where to draw.
    label
        Name in a legend.
    color
        Of the line.
    ends
        Mark the start with a circle and the end with a square.

    Returns
    -------
    The axes.

    Raises
    ------
    InvalidInputError
        If the shape is another.
    """
    track = np.asarray(poses, dtype=np.float64)
    require(track.ndim == 2 and track.shape[1] in (2, 3), "poses", "shape (t, 3) or (t, 2)", track.shape)
    ax.plot(track[:, 0], track[:, 1], color=color, linewidth=1.3, label=label, zorder=4)
    known = track[np.isfinite(track[:, :2]).all(axis=1)]
    if ends and len(known):
        for position, marker, name in ((known[0], "o", "start"), (known[-1], "s", "end")):
            look: dict[str, Any] = {"color": color, "markeredgecolor": "white", "markersize": 7, "zorder": 5}
            ax.plot(position[0], position[1], marker, label=name, linestyle="none", **look)
    return _in_metres(ax)


def draw_scan(
    scan: Scan,
    pose: ArrayLike,
    ax: Axes,
    *,
    label: str = "scan",
    color: str = SCAN_COLOUR,
    size: float = 6.0,
    rays: bool = False,
) -> Axes:
    """Draw the end points of a scan seen from a pose, equation (6.32); beams without a measured range have none.

    Parameters
    ----------
    scan
        The scan.
    pose
        (3,) pose of the robot in the frame of the axes, metres and radians.
    ax
        Where to draw.
    label
        Name in a legend.
    color, size
        Of the points; the size is an area in points squared, as in matplotlib.
    rays
        Also draw each beam: to its end point if it measured something, and as a dotted stub of a tenth of max_range
        if there was no return.

    Returns
    -------
    The axes.

    Raises
    ------
    InvalidInputError
        If the pose is not finite (3,).
    """
    from matplotlib.collections import LineCollection

    place = as_pose(pose)
    points = end_points(scan.ranges, scan.finder, place)
    if rays:
        starts = compose(place, scan.finder.mounts)
        z = usable_ranges(scan.ranges, scan.finder)
        stubs = np.where(z >= scan.finder.max_range, 0.1 * scan.finder.max_range, np.nan)
        for ends, style, shade, name in (
            (points, "solid", color, "measured"),
            (points_along(starts, stubs), "dotted", NO_RETURN_COLOUR, "no return"),
        ):
            seen = np.isfinite(ends).all(axis=1)
            lines = np.stack([starts[seen, :2], ends[seen]], axis=1)
            look: dict[str, Any] = {"colors": shade, "linewidths": 0.6, "alpha": 0.45, "linestyles": style, "zorder": 2}
            ax.add_collection(LineCollection(list(lines), label=name if seen.any() else None, **look))
        ax.autoscale_view()
    ax.scatter(points[:, 0], points[:, 1], s=size, color=color, linewidths=0, label=label, zorder=3)
    return _in_metres(ax)


def draw_features(features: Sequence[Feature], pose: ArrayLike, ax: Axes) -> Axes:
    """Draw the features of a scan seen from a pose: lines from end to end, poles as circles, the others as points.

    Around each position, but not a line's, stands its 95% ellipse.

    Parameters
    ----------
    features
        Of any kinds, in the robot frame.
    pose
        (3,) pose of the robot in the frame of the axes, metres and radians.
    ax
        Where to draw.

    Returns
    -------
    The axes; the legend's entries say how many there are of each kind.

    Raises
    ------
    InvalidInputError
        If the pose is not finite (3,).
    """
    place = as_pose(pose)
    for kind, name, colour, marker in FEATURE_STYLES:
        chosen = [feature for feature in features if isinstance(feature, kind)]
        label = f"{name} ({len(chosen)})"
        for feature in chosen:
            if isinstance(feature, Line):
                ends = transform_points(place, np.stack([feature.start, feature.end]))
                ax.plot(ends[:, 0], ends[:, 1], "-", color=colour, linewidth=2.0, alpha=0.8, label=label, zorder=4)
            else:
                x, y = transform_points(place, feature.position)
                ax.plot(x, y, marker, color=colour, fillstyle="none", markersize=8, linestyle="none", label=label,
                        zorder=5)  # fmt: skip
                outline = transform_points(place, feature.position + _ellipse(feature))
                ax.plot(outline[:, 0], outline[:, 1], "-", color=colour, linewidth=0.8, zorder=5)
            if isinstance(feature, Pole):
                outline = transform_points(place, feature.position + feature.diameter / 2.0 * _unit_circle())
                ax.plot(outline[:, 0], outline[:, 1], "-", color=colour, linewidth=1.5, zorder=5)
            # One entry in the legend stands for all of a kind.
            label = "_nolegend_"
    return _in_metres(ax)


def draw_ranges(ranges: ArrayLike, finder: RangeFinder, ax: Axes) -> Axes:
    """Draw the histogram of the measured ranges; the legend says what share is no return, NaN or too close.

    Parameters
    ----------
    ranges
        (..., k) metres in the conventions of `Scan`.
    finder
        The sensor.
    ax
        Where to draw.

    Returns
    -------
    The axes; the vertical one is logarithmic, because rare long ranges matter.

    Raises
    ------
    InvalidInputError
        If there is no reading at all.
    """
    z = np.asarray(ranges, dtype=np.float64)
    if z.size == 0:
        raise InvalidInputError("ranges: expected at least one reading, got none")
    usable = usable_ranges(z, finder)
    measured = usable[usable < finder.max_range]
    no_return = np.mean(usable >= finder.max_range)
    if measured.size:
        ax.hist(measured, bins=80, color=PATH_COLOUR, label=f"measured: {measured.size / z.size:.1%}")
        ax.set_yscale("log")
        # Room for the legend above the highest bin.
        ax.set_ylim(0.7, 12.0 * ax.get_ylim()[1])
    reaches_limit = bool(measured.size) and float(measured.max()) > 0.6 * finder.max_range
    if reaches_limit or not measured.size:
        ax.axvline(finder.max_range, color=NO_RETURN_COLOUR, linewidth=1.2, linestyle="--")
    ax.plot([], [], color=NO_RETURN_COLOUR, linestyle="--",
            label=f"no return ({finder.max_range:.4g} m or more): {no_return:.1%}")  # fmt: skip
    rest = np.isnan(usable).mean()
    if rest > 0:
        ax.plot([], [], linestyle="none", label=f"too close or no measurement: {rest:.1%}")
    ax.set(xlabel="range [m]", ylabel="readings per bin")
    ax.legend(loc="upper right", fontsize=8, framealpha=1.0)
    return ax


def _ellipse(feature: Feature) -> FloatArray:
    """Return the outline (n, 2) of the 95% ellipse around a feature's position, robot frame, metres."""
    from_polar = np.linalg.inv(polar_jacobian(feature.position))
    covariance = from_polar @ feature.covariance[:2, :2] @ from_polar.T
    values, vectors = np.linalg.eigh(covariance)
    axes = vectors * np.sqrt(CHI_SQUARE_95 * np.maximum(values, 0.0))
    return np.asarray(_unit_circle() @ axes.T)


def _unit_circle() -> FloatArray:
    angle = np.linspace(0.0, 2.0 * np.pi, 49)
    return np.column_stack([np.cos(angle), np.sin(angle)])


def _any_in_block(mask: NDArray[np.bool_], step: int) -> NDArray[Any]:
    if step == 1:
        return mask
    rows, cols = (np.arange(0, n, step) for n in mask.shape)
    return np.asarray(np.logical_or.reduceat(np.logical_or.reduceat(mask, rows, axis=0), cols, axis=1))


def _in_metres(ax: Axes) -> Axes:
    ax.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    return ax
