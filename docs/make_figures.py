"""Redraw the pictures of the documentation from the simulated demo: ``python docs/make_figures.py``."""

from __future__ import annotations

import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse, Wedge

from beamfield.calibration.calibrate import Calibration, CalibrationOptions, calibrate
from beamfield.cli import demo
from beamfield.cli.main import main as beamfield
from beamfield.figures.gallery import chosen_figures, gallery_page, save_figure
from beamfield.figures.world import simulated_world
from beamfield.geometry import compose, invert, transform_points
from beamfield.io.read_log import read_log
from beamfield.io.read_map import read_map
from beamfield.io.trajectory import attach_poses, read_trajectory
from beamfield.localization.replay import Replay, reference_start
from beamfield.localization.trajectory import fit_trajectory
from beamfield.maps.cone import ConeCaster
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam import BeamModel
from beamfield.report.colours import FIT, HELD_OUT, MODEL, QUIET
from beamfield.report.drawing import legend_above, log_scale, new_figure, style
from beamfield.report.map_figures import draw_map, frame
from beamfield.report.scan_fit_figures import draw_sides
from beamfield.scan_fit.reference import calibrate_scan_fit
from beamfield.scan_fit.scan_fit import judge_log
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.simulation.dependence import Dependence
from beamfield.simulation.log import simulate_log
from beamfield.stacks.files.filter_file import read_filter_settings
from beamfield.stacks.files.parameter_file import read_stack_file

HERE = Path(__file__).parent
IN_BURSTS = [word for word in demo.SIMULATED if word != "--odometry-only"]
BEFORE_AND_AFTER = {"before": HELD_OUT, "after": FIT}
TITLES = {"before": "amcl as nav2 ships it", "after": "amcl, calibrated"}
CHI2_95 = 5.991
# Of so many updates, the README's picture shows the particles of one.
ELLIPSES = 15


def main() -> None:
    """Draw every picture."""
    matplotlib.rcParams["svg.hashsalt"] = "beamfield"
    (HERE / "images").mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        beamfield(["demo", "--out", folder, "--quiet"])
        save(readme_picture(Path(folder)), "demo")
        beamfield(["simulate", "--out", f"{folder}/with_poses", "--duration", "300", "--quiet", *IN_BURSTS])
        world = Path(folder) / "with_poses"
        log, grid = read_log(world / "log.carmen").only_sensor(), read_map(world / "map.yaml")
    save(cones_picture(simulated_world().grid), "cones")
    save(lost_picture(log, grid), "lost")
    draw_scan_fit(calibrate(log, grid, CalibrationOptions(refine=False)), grid, log)
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
    for mask, color, name in ((~low, FIT, "fits at 5%"), (low, HELD_OUT, "does not fit")):
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


def lost_picture(log: SensorLog, grid: OccupancyGrid) -> Figure:
    """Draw a drive whose filter is set to a wrong place after 30 s and found again after 70 s, as a fit shows it."""
    seconds = log.stamps - log.stamps[0]
    log = log[np.flatnonzero(seconds <= 100.0)]
    seconds = seconds[: len(log)]
    away = (seconds >= 30.0) & (seconds < 70.0)
    set_wrongly = compose(log.poses[away][0] + np.array([0.8, -0.6, 0.25]), invert(log.poses[away][0]))
    own = log.poses.copy()
    own[away] = compose(set_wrongly, own[away])
    fitted = fit_trajectory(log, grid).poses
    off = np.hypot(*(own - fitted)[:, :2].T)
    figure = new_figure(11, 4.2)
    path, error = figure.subplots(1, 2, width_ratios=(1.1, 1))
    seen = np.concatenate([own, fitted])[:, :2]
    (x0, y0), (x1, y1) = seen.min(axis=0) - 1.5, seen.max(axis=0) + 1.5
    draw_map(path, grid, (x0, x1, y0, y1))
    path.plot(*fitted[:, :2].T, color=FIT, lw=1.5, label="fitted to the map")
    path.plot(*own[:, :2].T, color=HELD_OUT, lw=1.2, ls="--", label="said by the robot's filter")
    frame(path, (x0, x1, y0, y1))
    legend_above(path)
    error.plot(seconds, off, color=HELD_OUT, lw=1.3, label="own poses beside the fitted ones")
    error.axhline(0.5, color=QUIET, lw=0.9, ls="--", label="lost beyond 0.5 m")
    error.set_xlim(0.0, seconds[-1])
    error.set_ylim(0.0, None)
    style(error, x="time [s]", y="distance [m]")
    legend_above(error)
    return figure


def save(figure: Figure, name: str) -> None:
    figure.savefig(HERE / "images" / f"{name}.svg", metadata={"Date": None}, bbox_inches="tight")


def draw_gallery() -> None:
    """Draw the chapter's figures from the simulated world, and write the page that shows them."""
    world, figures = simulated_world(), chosen_figures()
    for figure in figures:
        save_figure(figure.draw(world), HERE / "images" / f"{figure.stem}.svg")
    (HERE / "gallery.md").write_text(gallery_page(figures, world.name, folder="images"), encoding="utf-8")


def readme_picture(folder: Path) -> Figure:
    """Draw what the demo finds: nav2's filter on the second drive before and after, and its error over time."""
    log, grid, replays = demo_replays(folder)
    figure = new_figure(11, 6.2)
    axes = figure.subplot_mosaic([["before", "after"], ["error", "error"]], height_ratios=(1.6, 1))
    for name, color in BEFORE_AND_AFTER.items():
        draw_way(axes[name], name, color, log, grid, replays[name][0])
        draw_errors(axes["error"], name, color, log, replays[name])
    axes["error"].set_xlim(0.0, log.stamps[-1] - log.stamps[0])
    log_scale(axes["error"])
    style(axes["error"], x="time [s]", y="position error [m]")
    legend_above(axes["error"], ncols=2)
    return figure


def demo_replays(folder: Path) -> tuple[SensorLog, OccupancyGrid, dict[str, list[Replay]]]:
    """Return the second drive with its true poses, the map, and the demo's runs of the filter before and after."""
    log = read_log(folder / "second_drive" / "log.carmen", lone_poses="odometry")
    log = attach_poses(log, read_trajectory(folder / "second_drive" / "truth.tum")).only_sensor()
    first, start = reference_start(log)
    log, maps = log[first:], (folder / "drive" / "map.yaml", folder / "calibration" / "amcl_map.yaml")
    files = folder / demo.BEFORE, folder / "calibration" / demo.AFTER
    replays = {}
    for name, path, seen in zip(BEFORE_AND_AFTER, files, maps, strict=True):
        one = read_filter_settings(read_stack_file(path, stack="nav2")).filter(read_map(seen))
        replays[name] = [one.run(log, start, np.random.default_rng(seed)) for seed in range(demo.SEEDS)]
    return log, read_map(maps[0]), replays


def error_of(log: SensorLog, replay: Replay) -> np.ndarray:
    return np.hypot(*(replay.poses - log.poses)[:, :2].T)


def draw_way(axes: Axes, name: str, color: str, log: SensorLog, grid: OccupancyGrid, replay: Replay) -> None:
    (x0, y0), (x1, y1) = grid.to_map([[0, 0], grid.shape[::-1]])
    draw_map(axes, grid, (x0, x1, y0, y1))
    axes.plot(*log.poses[:, :2].T, color=MODEL, lw=2.0)
    axes.plot(*replay.poses[:, :2].T, ".", color=color, ms=2.5)
    for mean, covariance in zip(replay.means[::ELLIPSES], replay.covariances[::ELLIPSES], strict=True):
        values, vectors = np.linalg.eigh(covariance[:2, :2])
        angle = np.degrees(np.arctan2(vectors[1, 1], vectors[0, 1]))
        across, along = 2.0 * np.sqrt(np.maximum(values, 0.0) * CHI2_95)
        axes.add_patch(Ellipse(mean[:2], along, across, angle=angle, fc="none", ec=color, lw=0.8))
    frame(axes, (x0, x1, y0, y1))
    axes.set_title(TITLES[name], fontsize=10, loc="left", fontweight="bold", color=color)


def draw_errors(axes: Axes, name: str, color: str, log: SensorLog, replays: list[Replay]) -> None:
    seconds, off = log.stamps - log.stamps[0], np.array([error_of(log, one) for one in replays])
    low, high = np.quantile(off, [0.1, 0.9], axis=0)
    axes.fill_between(seconds, low, high, color=color, alpha=0.2, linewidth=0)
    label = f"{TITLES[name]}: {off.mean():.3f} m on average over {len(off)} runs"
    axes.plot(seconds, off.mean(axis=0), color=color, lw=1.3, label=label)


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
    legend_above(axes)
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
