"""Figures 6.8 to 6.10: likelihood fields, and what one beam sees of one."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from scipy.signal import find_peaks

from beamfield.figures.drawing import colour_bar, frame, framed_map, known_limits, mark_robot
from beamfield.figures.obstacle_scene import ObstacleScene
from beamfield.figures.world import FigureWorld
from beamfield.geometry import FloatArray
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import BeamProfile, LikelihoodFieldModel
from beamfield.plot import draw_array
from beamfield.report.colours import CAUSE_COLOURS, QUIET
from beamfield.report.drawing import new_figure, style

BEAM_COLOUR = "#D55E00"
ROBOT_COLOUR = "#0072B2"
# Obstacles along a beam that are named, most likely first.
MOST_PEAKS = 3


def obstacles_figure(world: FigureWorld) -> Figure:
    """Draw Figure 6.8: (a) obstacles and one beam, (b) the likelihood field."""
    scene = world.scene
    limits = known_limits(scene.grid, 0.0)
    aspect = (limits[3] - limits[2]) / (limits[1] - limits[0])
    figure = new_figure(10.5, float(np.clip(4.9 * aspect + 0.4, 3.0, 7.0)))
    left, right = figure.subplots(1, 2)
    framed_map(scene.grid, left, colours=("#FFFFFF", "#EDEFF1", "#A3ABB3"))
    _draw_beam(scene, left)
    style(left, title="(a) the situation", x="x [m]", y="y [m]", grid="none")
    model = LikelihoodFieldModel(scene.grid, scene.parameters)
    density = field_density(model, scene.finder.max_range)
    image = draw_array(density, scene.grid.resolution, scene.grid.origin, right, cmap="gray", vmin=0.0)
    outline = {"levels": [0.5], "colors": ROBOT_COLOUR, "linewidths": 0.7, "alpha": 0.8}
    right.contour(*_cell_centres(scene.grid), scene.grid.occupied, **outline)
    _draw_beam(scene, right)
    right.set(xlim=left.get_xlim(), ylim=left.get_ylim(), aspect="equal")
    style(right, title="(b) the likelihood field", x="x [m]", y="y [m]", grid="none")
    colour_bar(image, right, "z_hit prob(dist, sigma_hit) + z_rand / z_max [1/m]")
    for ax in (left, right):
        ax.legend(loc="lower left", fontsize=8, framealpha=0.95)
    return figure


def beam_profile_figure(world: FigureWorld) -> Figure:
    """Draw Figure 6.9: (a) p_hit along the beam of Figure 6.8, (b) with the two uniform parts of (6.34)."""
    scene = world.scene
    model = LikelihoodFieldModel(scene.grid, scene.parameters, interpolation="bilinear")
    profile = model.profile(scene.pose, scene.finder, scene.beam, n=600)
    figure = new_figure(10.5, 3.6)
    left, right, mass = figure.subplots(1, 3, width_ratios=(8.0, 8.0, 0.9))
    _draw_hit(profile, left)
    _draw_with_uniforms(profile, scene, right)
    z_max = max(0.0, 1.0 - scene.parameters.z_hit - scene.parameters.z_rand)
    mass.bar([0], [z_max], width=0.7, color=CAUSE_COLOURS[2])
    mass.set(xlim=(-0.6, 0.6), ylim=(0.0, max(0.1, 1.4 * z_max)))
    mass.set_xticks([0], [f"{scene.finder.max_range:.4g}"])
    mass.annotate(f"z_max\n{z_max:.2f}", (0, z_max), xytext=(0, 4), textcoords="offset points", ha="center", fontsize=8)
    style(mass, x="z [m]", y="probability [1]", grid="y")
    return figure


def map_field_figure(world: FigureWorld) -> Figure:
    """Draw Figure 6.10: (a) an occupancy grid map, (b) its likelihood field; constant where nothing is known."""
    grid = world.grid
    sigma = max(0.15, 2.0 * grid.resolution)
    model = LikelihoodFieldModel(grid, LikelihoodFieldParameters(0.8, 0.15, sigma), unknown="uniform")
    max_range = world.log.finder.max_range
    density = np.where(grid.unknown, 1.0 / max_range, field_density(model, max_range))
    limits = known_limits(grid)
    aspect = (limits[3] - limits[2]) / (limits[1] - limits[0])
    if aspect < 0.8:
        figure = new_figure(8.6, float(np.clip(2 * 8.0 * aspect + 1.3, 4.5, 13.0)))
        above, below = figure.subplots(2, 1)
    else:
        figure = new_figure(11.5, float(np.clip(5.6 * aspect + 0.4, 4.0, 9.0)))
        above, below = figure.subplots(1, 2)
    framed_map(grid, above)
    style(above, title="(a) the map: free white, occupied dark, unknown grey", x="x [m]", y="y [m]", grid="none")
    image = draw_array(density, grid.resolution, grid.origin, below, cmap="gray", norm=LogNorm())
    title = f"(b) its likelihood field, sigma_hit {sigma:.2g} m; in unknown cells 1 / z_max"
    frame(below, limits[::2], limits[1::2], title)
    below.set_facecolor(image.cmap(image.norm(np.array(1.0 / max_range))))
    colour_bar(image, below, "likelihood of an end point, log scale [1/m]")
    return figure


def field_density(model: LikelihoodFieldModel, max_range: float) -> FloatArray:
    """Return z_hit prob(dist, sigma_hit) + z_rand / z_max in each cell of the map, (rows, cols) 1/metre."""
    p, margin = model.parameters, model.distances.margin_cells
    rows, cols = model.distances.grid.shape
    distance = model.distances.distance[margin : margin + rows, margin : margin + cols].astype(np.float64)
    normal = np.exp(-0.5 * (distance / p.sigma_hit) ** 2) / (p.sigma_hit * np.sqrt(2.0 * np.pi))
    return np.asarray(p.z_hit * normal + p.z_rand / max_range)


def _draw_beam(scene: ObstacleScene, ax: Axes) -> None:
    x, y, heading = scene.ray
    reach = scene.finder.max_range
    limits = ax.get_xlim(), ax.get_ylim()
    end_x, end_y = x + reach * np.cos(heading), y + reach * np.sin(heading)
    ax.plot([x, end_x], [y, end_y], "--", color=BEAM_COLOUR, linewidth=1.6, label="sensor axis", zorder=4)
    ax.set(xlim=limits[0], ylim=limits[1])
    width = float(np.diff(limits[0])[0])
    mark_robot(scene.pose, ax, size=0.04 * width, color=ROBOT_COLOUR, label="robot")


def _draw_hit(profile: BeamProfile, ax: Axes) -> None:
    ax.fill_between(profile.ranges, profile.hit, color=CAUSE_COLOURS[0], alpha=0.2, linewidth=0)
    ax.plot(profile.ranges, profile.hit, color=CAUSE_COLOURS[0], linewidth=1.5)
    for number, z in enumerate(_nearest_points(profile), start=1):
        height = float(np.interp(z, profile.ranges, profile.hit))
        ax.plot([z, z], [0.0, height], color=QUIET, linewidth=0.8, linestyle=":")
        ax.annotate(f"$o_{number}$", (z, height), xytext=(0, 4), textcoords="offset points", ha="center", fontsize=11)
    ax.set(xlim=(0.0, _shown_end(profile)), ylim=(0.0, 1.22 * max(float(profile.hit.max()), 1e-9)))
    style(ax, title="(a) p_hit along the sensor axis", x="z [m]", y="p_hit(z) [1/m]", grid="none")


def _draw_with_uniforms(profile: BeamProfile, scene: ObstacleScene, ax: Axes) -> None:
    uniform = scene.parameters.z_rand / scene.finder.max_range
    ax.fill_between(profile.ranges, uniform, color=CAUSE_COLOURS[3], alpha=0.45, linewidth=0, label="z_rand p_rand")
    ax.fill_between(profile.ranges, uniform, profile.density, color=CAUSE_COLOURS[0], alpha=0.2, linewidth=0,
                    label="z_hit p_hit")  # fmt: skip
    ax.plot(profile.ranges, profile.density, color="#111111", linewidth=1.4, label="sum, with z_max p_max beside")
    ax.set(xlim=(0.0, _shown_end(profile)), ylim=(0.0, 1.45 * float(profile.density.max())))
    style(ax, title="(b) p(z | x, m)", x="z [m]", y="density [1/m]", grid="none")
    ax.legend(loc="upper left", fontsize=8, frameon=False, ncols=2)


def _shown_end(profile: BeamProfile) -> float:
    """Return where the axis of z ends: past the last obstacle, if the sensor reaches much further."""
    limit = float(profile.ranges[-1])
    near = profile.ranges[profile.hit > 1e-3 * profile.hit.max()] if profile.hit.any() else profile.ranges
    return min(limit, 1.3 * float(near[-1]))


def _nearest_points(profile: BeamProfile) -> FloatArray:
    """Return the ranges of the highest peaks, in order; a stretch inside an obstacle counts as one, at its middle."""
    hit = np.concatenate([[0.0], profile.hit, [0.0]])
    peaks, properties = find_peaks(hit, prominence=0.02 * max(float(hit.max()), 1e-12), plateau_size=1)
    highest = np.argsort(properties["prominences"])[::-1][:MOST_PEAKS]
    return np.sort(profile.ranges[peaks[highest] - 1])


def _cell_centres(grid: OccupancyGrid) -> tuple[FloatArray, FloatArray]:
    """Return x and y (rows, cols) of the cells' centres in the map frame."""
    row, col = np.indices(grid.shape)
    points = grid.to_map(np.stack([col + 0.5, row + 0.5], axis=-1))
    return points[..., 0], points[..., 1]
