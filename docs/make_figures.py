"""Redraw the pictures of the documentation from the simulated demo: ``python docs/make_figures.py``."""

from __future__ import annotations

import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Wedge

from beamfield.calibration.calibrate import Calibration, CalibrationOptions, calibrate
from beamfield.calibration.evaluation import likely_causes
from beamfield.cli.main import main as beamfield
from beamfield.figures.gallery import chosen_figures, gallery_page, save_figure
from beamfield.figures.world import simulated_world
from beamfield.geometry import compose, transform_points
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.maps.cone import ConeCaster
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam import BeamModel, beam_log_density
from beamfield.scan_fit.reference import calibrate_scan_fit
from beamfield.scan_fit.scan_fit import judge_log
from beamfield.scan_fit.surprise import beam_side
from beamfield.sensors import RangeFinder, SensorLog, usable_ranges
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.log import simulate_log

HERE = Path(__file__).parent
CAUSES = (("hit", "#0072b2"), ("short", "#d55e00"), ("max", "#009e73"), ("rand", "#cc79a7"))
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
    figure = readme_picture(result, grid, log)
    figure.savefig(HERE / "images" / "demo.svg", metadata={"Date": None}, bbox_inches="tight")
    cones_picture(simulated_world().grid).savefig(
        HERE / "images" / "cones.svg", metadata={"Date": None}, bbox_inches="tight"
    )
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
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    axes = figure.subplot_mosaic([["p", "map"], ["lost", "map"]], width_ratios=(1.5, 1))
    low = fits.p_value <= 0.05
    for mask, color, name in ((~low, "#0072b2", "fits at 5 %"), (low, "#d55e00", "does not")):
        axes["p"].plot(seconds[mask], fits.p_value[mask], ".", ms=3, color=color, label=name)
    axes["p"].axhline(0.05, color="0.4", lw=0.8, ls="--")
    axes["p"].set(yscale="log", ylabel="p-value", title="does each scan fit the map?")
    axes["p"].legend(loc="lower left", fontsize=8)
    axes["lost"].fill_between(seconds, fits.lost, step="post", color="#d55e00", alpha=0.4)
    axes["lost"].set(xlabel="time [s]", ylabel="lost probability", ylim=(-0.03, 1.03))
    for name in ("p", "lost"):
        axes[name].axvspan(40.0, 65.0, color="0.9", zorder=0)
        axes[name].set_xlim(0.0, seconds[-1])
    draw_disagreement(axes["map"], model, drive, believed, int(np.flatnonzero(away)[60]))
    figure.savefig(HERE / "images" / "scan_fit.svg", metadata={"Date": None}, bbox_inches="tight")


def draw_disagreement(axes, model: BeamModel, log: SensorLog, poses: np.ndarray, scan: int) -> None:
    grid, pose = model.grid, poses[scan]
    (x0, y0), (x1, y1) = grid.to_map([[0, 0], grid.shape[::-1]])
    shade = np.full(grid.shape, 0.86)
    shade[grid.free], shade[grid.occupied] = 1.0, 0.25
    axes.imshow(shade, origin="lower", extent=(x0, x1, y0, y1), cmap="gray", vmin=0, vmax=1, interpolation="none")
    limit = log.finder.max_range
    ranges, expected = usable_ranges(log.ranges[scan], log.finder), model.expected(pose, log.finder)
    side = beam_side(ranges, expected, limit, model.parameters)
    rays = compose(pose, log.finder.mounts)
    drawn = np.where(ranges >= limit, expected, ranges)
    ends = transform_points(rays, np.column_stack([drawn, np.zeros(len(drawn))]))
    colors = ("#0072b2", "#d55e00", "#7a0177", "#009e73")
    for number, name in enumerate(("as mapped", "short", "through a wall", "no return")):
        chosen = side == number
        for start, end in zip(rays[chosen, :2], ends[chosen], strict=True):
            axes.plot([start[0], end[0]], [start[1], end[1]], color=colors[number], lw=0.4, alpha=0.35)
        axes.plot(ends[chosen, 0], ends[chosen, 1], "o", ms=2, color=colors[number], label=f"{name} ({chosen.sum()})")
    axes.plot(*pose[:2], "k^", ms=5)
    middle, half = 0.5 * (ends.min(axis=0) + ends.max(axis=0)), 0.5 * np.ptp(ends, axis=0).max() + 1.0
    axes.set(xlabel="x [m]", ylabel="y [m]", title="a scan at the wrong pose")
    axes.set_xlim(middle[0] - half, middle[0] + half)
    axes.set_ylim(middle[1] - half, middle[1] + half)
    axes.legend(loc="upper right", fontsize=7, framealpha=0.95)


def draw_gallery() -> None:
    """Draw the chapter's figures from the simulated world, and write the page that shows them."""
    world, figures = simulated_world(), chosen_figures()
    for figure in figures:
        save_figure(figure.draw(world), HERE / "images" / f"{figure.stem}.svg")
    (HERE / "gallery.md").write_text(gallery_page(figures, world.name, folder="images"), encoding="utf-8")


def readme_picture(result: Calibration, grid: OccupancyGrid, log: SensorLog) -> Figure:
    """Draw what the demo finds: one scan in the map by cause, and readings with the fitted density."""
    figure = Figure(figsize=(11, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.75, 1))
    draw_scan_in_map(left, result, grid, log)
    draw_readings(right, result)
    return figure


def draw_scan_in_map(axes, result: Calibration, grid: OccupancyGrid, log: SensorLog) -> None:
    rows, cols = grid.shape
    (x0, y0), (x1, y1) = grid.to_map([[0, 0], [cols, rows]])
    shade = np.full((rows, cols), 0.86)
    shade[grid.free], shade[grid.occupied] = 1.0, 0.25
    axes.imshow(shade, origin="lower", extent=(x0, x1, y0, y1), cmap="gray", vmin=0, vmax=1, interpolation="none")
    axes.plot(log.poses[:, 0], log.poses[:, 1], color="0.55", lw=0.8)
    # The scan that sees most of the building.
    scan = int(np.argmax(np.bincount(result.table.scan, weights=result.table.expected_ranges)))
    table = result.table.select(result.table.scan == scan)
    cause = likely_causes(table, result.parameters)
    rays = compose(log.poses[scan], log.finder.mounts[table.beam])
    drawn = np.where(cause == 2, table.expected_ranges, table.ranges)
    ends = transform_points(rays, np.column_stack([drawn, np.zeros(len(drawn))]))
    for number, (name, color) in enumerate(CAUSES):
        chosen = cause == number
        for start, end in zip(rays[chosen, :2], ends[chosen], strict=True):
            axes.plot([start[0], end[0]], [start[1], end[1]], color=color, lw=0.4, alpha=0.35)
        axes.plot(ends[chosen, 0], ends[chosen, 1], "o", ms=2.5, color=color, label=f"{name} ({chosen.sum()})")
    axes.plot(*log.poses[scan, :2], "k^", ms=5)
    axes.set(xlabel="x [m]", ylabel="y [m]", title="one scan in the map: each beam's most likely cause")
    axes.legend(loc="upper right", fontsize=8, framealpha=0.95)
    axes.set_xlim(x0 + 0.5, x1 - 0.5)
    axes.set_ylim(y0 + 0.5, y1 - 0.5)


def draw_readings(axes, result: Calibration) -> None:
    table, limit = result.table, result.table.max_range
    near = np.abs(table.expected_ranges - EXPECTED) < 0.1
    z, expected = table.ranges[near], table.expected_ranges[near]
    edges = np.concatenate([np.arange(0.0, 2.6, 0.2), np.arange(2.6, 3.4, 0.02), np.arange(3.4, limit + 0.1, 0.2)])
    counts, _ = np.histogram(z[z < limit], edges)
    axes.stairs(counts / len(z) / np.diff(edges), edges, fill=True, color="0.8", label=f"{len(z)} readings")
    grid_z = np.concatenate([np.linspace(0.01, 2.5, 120), np.linspace(2.5, 3.5, 250), np.linspace(3.5, limit, 90)[:-1]])
    sample = expected[:: max(1, len(expected) // 400)]
    log_density = beam_log_density(
        grid_z[None, :], sample[:, None], limit, result.parameters, min_range=table.min_range
    )
    density = np.where(grid_z < table.min_range, np.nan, np.exp(log_density).mean(axis=0))
    axes.plot(grid_z, density, color="#0072b2", lw=1.5, label="fitted density")
    share = (z >= limit).mean()
    axes.plot(
        [limit],
        [share],
        "D",
        color="#009e73",
        ms=5,
        label=f"no return: {share:.1%} (fit {result.parameters.z_max:.1%})",
    )
    axes.set(
        yscale="log",
        xlabel="measured range z [m]",
        ylabel="density [1/m]",
        title=f"readings where z* is {EXPECTED:g} m",
    )
    axes.set_ylim(2e-3, 30)
    axes.legend(fontsize=8)


def cones_picture(grid: OccupancyGrid) -> Figure:
    """Draw what a ring of sonars is expected to measure in a map, and how the range changes as one sonar turns."""
    figure = Figure(figsize=(11, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2, width_ratios=(1.1, 1))
    ring = RangeFinder.from_bearings(np.radians(np.arange(0, 360, 30)), 4.0, opening_angle=np.radians(30.0))
    pose = np.array([2.6, 7.4, 0.2])
    draw_ring_in_map(left, grid, ring, pose)
    draw_turning_sonar(right, grid, pose)
    return figure


def draw_ring_in_map(axes, grid: OccupancyGrid, ring: RangeFinder, pose) -> None:
    rows, cols = grid.shape
    (x0, y0), (x1, y1) = grid.to_map([[0, 0], [cols, rows]])
    shade = np.full((rows, cols), 0.86)
    shade[grid.free], shade[grid.occupied] = 1.0, 0.25
    axes.imshow(shade, origin="lower", extent=(x0, x1, y0, y1), cmap="gray", vmin=0, vmax=1, interpolation="none")
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
    axes.set(xlabel="x [m]", ylabel="y [m]", title="expected ranges of a ring of twelve cones of 30 degrees")
    axes.set_xlim(pose[0] - 4.3, pose[0] + 4.3)
    axes.set_ylim(pose[1] - 4.0, pose[1] + 4.0)
    axes.legend(loc="upper right", fontsize=8, framealpha=0.95)


def draw_turning_sonar(axes, grid: OccupancyGrid, pose) -> None:
    turn = np.radians(np.linspace(0, 360, 1441))
    origins = np.column_stack([np.full((len(turn), 2), pose[:2]), turn])
    cones, rays = ConeCaster(grid), RayCaster(grid)
    axes.plot(np.degrees(turn), rays.cast(origins, 4.0), color="#d55e00", lw=0.8, label="beam")
    for width, color in ((10.0, "#56b4e9"), (30.0, "#0072b2")):
        found = cones.cast(origins, np.radians(width), 4.0)
        axes.plot(np.degrees(turn), found, color=color, lw=1.5, label=f"cone of {width:g} degrees")
    axes.set(xlabel="direction [degrees]", ylabel="expected range [m]", title="one sonar turning at the same place")
    axes.set_xlim(0, 360)
    axes.set_ylim(0, 4.15)
    axes.legend(loc="lower right", fontsize=8, framealpha=0.95)


if __name__ == "__main__":
    main()
