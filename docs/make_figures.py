"""Redraw the pictures of the documentation from the simulated demo: ``python docs/make_figures.py``."""

from __future__ import annotations

import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Wedge

from beamfield.calibration.calibrate import Calibration, CalibrationOptions, calibrate
from beamfield.cli.main import main as beamfield
from beamfield.figures.gallery import chosen_figures, gallery_page, save_figure
from beamfield.figures.world import simulated_world
from beamfield.geometry import compose, transform_points
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.maps.cone import ConeCaster
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam import CAUSES, BeamModel, beam_log_density
from beamfield.report.colours import CAUSE_COLOURS, DATA, FIT, HELD_OUT, MODEL, QUIET
from beamfield.report.drawing import legend_above, log_scale, new_figure, style
from beamfield.report.map_figures import beam_ends, draw_map, frame
from beamfield.report.scan_fit_figures import draw_sides
from beamfield.scan_fit.reference import calibrate_scan_fit
from beamfield.scan_fit.scan_fit import judge_log
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.log import simulate_log

HERE = Path(__file__).parent
EXPECTED = 3.0


def main() -> None:
    """Draw every picture."""
    matplotlib.rcParams["svg.hashsalt"] = "beamfield"
    with tempfile.TemporaryDirectory() as folder:
        beamfield(["demo", "--out", folder, "--quiet"])
        world = Path(folder) / "world"
        log, grid = read_log(world / "log.carmen").only_sensor(), read_map(world / "map.yaml")
    result = calibrate(log, grid, CalibrationOptions(refine=False))
    (HERE / "images").mkdir(exist_ok=True)
    save(readme_picture(result, grid, log), "demo")
    save(cones_picture(simulated_world().grid), "cones")
    draw_scan_fit(result, grid, log)
    draw_gallery()


def draw_scan_fit(result: Calibration, grid: OccupancyGrid, log: SensorLog) -> None:
    """Draw what `beamfield check` says of a drive whose pose is 2.3 m off between 40 and 65 s."""
    model = BeamModel(grid, result.parameters)
    reference = calibrate_scan_fit(model, log)
    # Errors in bursts, as in the demo's own log.
    like_the_demo = {"scan_rate": 5.0, "dependence": Dependence(angle=np.radians(4.0), time=1.0)}
    drive = simulate_log(grid, log.finder, result.parameters, duration=100.0, seed=12, **like_the_demo).only_sensor()
    seconds = drive.stamps - drive.stamps[0]
    away = (seconds >= 40.0) & (seconds < 65.0)
    believed = np.where(away[:, None], drive.poses + np.array([1.9, -1.3, 0.0]), drive.poses)
    fits = judge_log(model, drive.with_poses(believed), reference)
    figure = new_figure(11, 4.8)
    axes = figure.subplot_mosaic([["p", "map"], ["lost", "map"]], width_ratios=(1.4, 1))
    low = fits.p_value <= 0.05
    for mask, color, name in ((~low, FIT, "fits at 5 %"), (low, HELD_OUT, "does not fit")):
        axes["p"].scatter(seconds[mask], fits.p_value[mask], s=9, linewidths=0, color=color, label=name)
    axes["p"].axhline(0.05, color=QUIET, lw=0.9, ls="--")
    log_scale(axes["p"])
    style(axes["p"], y="p-value [1]")
    legend_above(axes["p"])
    axes["lost"].fill_between(seconds, fits.lost, step="post", color=HELD_OUT, alpha=0.4, linewidth=0)
    axes["lost"].set_ylim(-0.03, 1.03)
    style(axes["lost"], x="time [s]; grey: the pose is 2.3 m off", y="lost probability [1]")
    for name in ("p", "lost"):
        axes[name].axvspan(40.0, 65.0, color="0.9", zorder=0)
        axes[name].set_xlim(0.0, seconds[-1])
    draw_sides(axes["map"], model, drive.with_poses(believed), grid, int(np.flatnonzero(away)[60]))
    axes["map"].set_title("A scan at the wrong pose", fontsize=10, loc="left", fontweight="bold", pad=32)
    save(figure, "scan_fit")


def save(figure: Figure, name: str) -> None:
    figure.savefig(HERE / "images" / f"{name}.svg", metadata={"Date": None}, bbox_inches="tight")


def draw_gallery() -> None:
    """Draw the chapter's figures from the simulated world, and write the page that shows them."""
    world, figures = simulated_world(), chosen_figures()
    for figure in figures:
        save_figure(figure.draw(world), HERE / "images" / f"{figure.stem}.svg")
    (HERE / "gallery.md").write_text(gallery_page(figures, world.name, folder="images"), encoding="utf-8")


def readme_picture(result: Calibration, grid: OccupancyGrid, log: SensorLog) -> Figure:
    """Draw what the demo finds: one scan in the map by cause, and readings with the fitted density."""
    figure = new_figure(11, 4.6)
    left, right = figure.subplots(1, 2, width_ratios=(1.6, 1))
    draw_scan_in_map(left, result, grid, log)
    draw_readings(right, result)
    return figure


def draw_scan_in_map(axes: Axes, result: Calibration, grid: OccupancyGrid, log: SensorLog) -> None:
    # The scan that sees most of the building.
    scan = int(np.argmax(np.bincount(result.table.scan, weights=result.table.expected_ranges)))
    rows = np.flatnonzero((result.table.scan == scan) & ~result.table.hits_nothing)
    ends, causes = beam_ends(result, log, rows), result.causes[rows]
    start = log.poses[scan, :2]
    (x0, y0), (x1, y1) = grid.to_map([[0, 0], grid.shape[::-1]])
    limits = (x0 + 0.5, x1 - 0.5, y0 + 0.5, y1 - 0.5)
    draw_map(axes, grid, limits)
    for cause, name in enumerate(CAUSES):
        mine, color = ends[causes == cause], CAUSE_COLOURS[cause]
        lines = [(start, end) for end in mine]
        axes.add_collection(LineCollection(lines, colors=color, linewidths=1.0, alpha=0.6))
        axes.scatter(*mine.T, s=14, linewidths=0, color=color, zorder=3, label=f"{name} {len(mine)}")
    axes.plot(*start, "^", color=MODEL, ms=7, zorder=4)
    frame(axes, limits)
    axes.set_title("One scan in the map: each beam's most likely cause", fontsize=10, loc="left", fontweight="bold",
                   pad=20)  # fmt: skip


def draw_readings(axes: Axes, result: Calibration) -> None:
    table, limit = result.table, result.table.max_range
    near = np.abs(table.expected_ranges - EXPECTED) < 0.1
    z, expected = table.ranges[near], table.expected_ranges[near]
    edges = np.concatenate([np.arange(0.0, 2.6, 0.2), np.arange(2.6, 3.4, 0.02), np.arange(3.4, limit + 0.1, 0.2)])
    counts, _ = np.histogram(z[z < limit], edges)
    axes.stairs(counts / len(z) / np.diff(edges), edges, fill=True, color=DATA, label=f"{len(z)} readings")
    grid_z = np.concatenate([np.linspace(0.01, 2.5, 120), np.linspace(2.5, 3.5, 250), np.linspace(3.5, limit, 90)[:-1]])
    sample = expected[:: max(1, len(expected) // 400)]
    log_density = beam_log_density(
        grid_z[None, :], sample[:, None], limit, result.parameters, min_range=table.min_range
    )
    density = np.where(grid_z < table.min_range, np.nan, np.exp(log_density).mean(axis=0))
    axes.plot(grid_z, density, color=MODEL, lw=1.5, label="fitted density")
    share = (z >= limit).mean()
    text = f"no return: {share:.1%} (fit {result.parameters.z_max:.1%})"
    axes.plot([limit], [share], "D", color=CAUSE_COLOURS[2], ms=6, label=text)
    log_scale(axes)
    axes.set_ylim(2e-3, 30)
    style(axes, x="measured range z [m]", y="density [1/m]")
    legend_above(axes, ncols=2)
    axes.set_title(f"Readings where z* is {EXPECTED:g} m", fontsize=10, loc="left", fontweight="bold", pad=34)


def cones_picture(grid: OccupancyGrid) -> Figure:
    """Draw what a ring of sonars is expected to measure in a map, and how the range changes as one sonar turns."""
    figure = new_figure(11, 4.8)
    left, right = figure.subplots(1, 2, width_ratios=(1.1, 1))
    ring = RangeFinder.from_bearings(np.radians(np.arange(0, 360, 30)), 4.0, opening_angle=np.radians(30.0))
    pose = np.array([2.6, 7.4, 0.2])
    draw_ring_in_map(left, grid, ring, pose)
    draw_turning_sonar(right, grid, pose)
    return figure


def draw_ring_in_map(axes, grid: OccupancyGrid, ring: RangeFinder, pose) -> None:
    limits = (pose[0] - 4.3, pose[0] + 4.3, pose[1] - 4.0, pose[1] + 4.0)
    draw_map(axes, grid, limits)
    cones, rays = ConeCaster(grid), RayCaster(grid)
    ranges, beams = cones.expected_ranges(pose, ring), rays.expected_ranges(pose, ring)
    points, _ = cones.expected_points(pose, ring)
    half = np.degrees(ring.opening_angle) / 2.0
    for direction, z in zip(np.degrees(pose[2] + ring.bearings), ranges, strict=True):
        axes.add_patch(Wedge(pose[:2], z, direction - half, direction + half, fc="#0072b2", ec="#0072b2", alpha=0.25))
    ends = transform_points(compose(pose, ring.mounts), np.column_stack([beams, np.zeros(len(beams))]))
    for end in ends:
        axes.plot([pose[0], end[0]], [pose[1], end[1]], color="#d55e00", lw=0.8, ls="--")
    axes.plot(*ends.T, "x", color="#d55e00", ms=5, label="end of the axis, as a beam")
    axes.plot(*points.T, "o", color="#0072b2", ms=5, label="nearest point in the cone")
    axes.plot(*pose[:2], "k^", ms=6)
    frame(axes, limits)
    axes.set_title("Expected ranges of a ring of twelve cones of 30 degrees", fontsize=10, loc="left",
                   fontweight="bold", pad=20)  # fmt: skip


def draw_turning_sonar(axes, grid: OccupancyGrid, pose) -> None:
    turn = np.radians(np.linspace(0, 360, 1441))
    origins = np.column_stack([np.full((len(turn), 2), pose[:2]), turn])
    cones, rays = ConeCaster(grid), RayCaster(grid)
    axes.plot(np.degrees(turn), rays.cast(origins, 4.0), color="#d55e00", lw=0.8, label="beam")
    for width, color in ((10.0, "#56b4e9"), (30.0, "#0072b2")):
        found = cones.cast(origins, np.radians(width), 4.0)
        axes.plot(np.degrees(turn), found, color=color, lw=1.5, label=f"cone of {width:g} degrees")
    axes.set_xlim(0, 360)
    axes.set_ylim(0, 4.15)
    style(axes, x="direction [deg]", y="expected range [m]")
    legend_above(axes)
    axes.set_title("One sonar turning at the same place", fontsize=10, loc="left", fontweight="bold", pad=20)


if __name__ == "__main__":
    main()
