"""Figure 6.1: what a ring of sonars measures, why some of it is wrong, and a scanner's scan of the same place."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Patch, Polygon, Wedge
from numpy.typing import ArrayLike

from beamfield.figures.drawing import frame, framed_map, mark_robot
from beamfield.figures.world import FigureWorld
from beamfield.geometry import FloatArray, compose
from beamfield.maps.cone import ConeCaster
from beamfield.models.beam_parameters import BeamParameters
from beamfield.plot import draw_scan
from beamfield.report.colours import QUIET
from beamfield.report.drawing import new_figure
from beamfield.sensors import RangeFinder
from beamfield.simulation.log import drawn_readings
from beamfield.simulation.sonar import heard_ranges, sonar_ring

N_SENSORS, MAX_RANGE = 24, 5.0
# Scans that are tried for one with readings of every kind.
N_TRIALS = 30
# Half the side of the maps, metres.
REACH = 4.7
# A reading is right if it is this near to the nearest thing in the cone, metres.
RIGHT = 0.15
KINDS = (
    ("nearest thing in the cone", "#0072B2"),
    ("too long: a late echo", "#D55E00"),
    ("too short: a person, another's pulse", "#CC79A7"),
    ("no echo: mirrored away", "#7A8793"),
)
# The legend names the colours of the cones: the scanner and the robot have others.
SCAN_COLOUR, ROBOT_COLOUR, WALL_COLOUR = "#009E73", "#111111", "#3C444D"
# Of the sonars, and the share of pulses that walls scatter.
SONAR = BeamParameters(z_hit=0.8, z_short=0.08, z_max=0.02, z_rand=0.1, sigma_hit=0.03, lambda_short=0.5)
ROUGHNESS = 0.3
# Of the sketch: half the opening angle, and the angle to the wall's normal.
HALF, ALPHA = np.radians(13.0), np.radians(35.0)


def sonar_figure(world: FigureWorld) -> Figure:
    """Draw Figure 6.1: (a) a sonar scan, (b) why pulses get lost, (c) the world's own scan of the same place.

    The sonars are simulated in the world's map (see `simulation.sonar`), at the pose of its scan.
    """
    ring = sonar_ring(N_SENSORS, max_range=MAX_RANGE)
    pose = world.pose
    readings = telling_readings(world, ring)
    figure = new_figure(11.0, 4.9)
    left, middle, right = figure.subplots(1, 3, width_ratios=(1.0, 0.72, 1.0))
    for ax in (left, right):
        framed_map(world.grid, ax)
    draw_cones(readings, ring, pose, left)
    draw_misreading(middle)
    draw_scan(world.scan, pose, right, label="measured", color=SCAN_COLOUR, size=8.0, rays=True)
    own = world.scan.finder
    shown = f"{own.n_beams} sonars" if own.opening_angle > 0.0 else f"a scanner, {own.n_beams} beams"
    for ax, title in ((left, f"(a) {N_SENSORS} sonars"), (right, f"(c) {shown}")):
        mark_robot(pose, ax, size=0.28, color=ROBOT_COLOUR, label="robot")
        frame(ax, pose[:2] - REACH, pose[:2] + REACH, title)
        ax.set_anchor("N")
    handles = [Patch(facecolor=colour, alpha=0.6, label=label) for label, colour in KINDS]
    # Axes of equal scales move after the layout has made room, so the room for the legend is given.
    figure.set_layout_engine("constrained", rect=(0.0, 0.08, 1.0, 0.92))
    figure.legend(handles=handles, loc="lower center", ncols=4, fontsize=8.5, frameon=False)
    return figure


@dataclass(frozen=True, eq=False)
class SonarReadings:
    """What a ring measures at one pose, (k,) metres, and the distance to the nearest thing in each cone."""

    ranges: FloatArray
    nearest: FloatArray


def sonar_readings(world: FigureWorld, ring: RangeFinder, rng: np.random.Generator) -> SonarReadings:
    """Draw what a ring measures at the world's pose; +inf for no return."""
    caster = ConeCaster(world.grid)
    nearest = caster.expected_ranges(world.pose, ring)
    heard = heard_ranges(caster, world.pose[None], ring, ROUGHNESS, rng)
    return SonarReadings(drawn_readings(heard, ring, SONAR, rng)[0], nearest)


def telling_readings(world: FigureWorld, ring: RangeFinder) -> SonarReadings:
    """Return the first of 30 simulated scans at the world's pose that has the most kinds of readings."""
    rng = np.random.default_rng(61)
    scans = [sonar_readings(world, ring, rng) for _ in range(N_TRIALS)]
    return max(scans, key=lambda readings: np.isin(np.arange(len(KINDS)), kinds_of(readings, ring)).sum())


def draw_cones(readings: SonarReadings, ring: RangeFinder, pose: FloatArray, ax: Axes) -> None:
    """Draw each cone up to what it measured, coloured by what that is."""
    sensors = compose(pose, ring.mounts)
    half = np.degrees(0.5 * ring.opening_angle)
    z, kinds = readings.ranges, kinds_of(readings, ring)
    for (x, y, theta), reading, kind in zip(sensors, z, kinds, strict=True):
        if kind < 0:
            continue
        colour, lost = KINDS[kind][1], kind == len(KINDS) - 1
        length, middle = min(float(reading), ring.max_range), np.degrees(theta)
        ax.add_patch(Wedge((x, y), length, middle - half, middle + half, facecolor=colour, linewidth=0.0,
                           alpha=0.10 if lost else 0.22, zorder=2 if lost else 3))  # fmt: skip
        if lost:
            ax.add_patch(Wedge((x, y), length, middle - half, middle + half, facecolor="none", edgecolor=colour,
                               linewidth=0.7, linestyle=(0, (4, 3)), alpha=0.6, zorder=2))  # fmt: skip
            continue
        ax.add_patch(Arc((x, y), 2 * length, 2 * length, theta1=middle - half, theta2=middle + half, color=colour,
                         linewidth=2.2, zorder=5))  # fmt: skip


def kinds_of(readings: SonarReadings, ring: RangeFinder) -> FloatArray:
    """Return which of `KINDS` each reading is; -1 for no echo where there is nothing in the cone."""
    error = readings.ranges - readings.nearest
    silent = np.isposinf(readings.ranges)
    kinds = np.select([silent, error > RIGHT, error < -RIGHT], [3, 1, 2], 0)
    return np.asarray(np.where(silent & (readings.nearest >= ring.max_range), -1, kinds))


def draw_misreading(ax: Axes) -> None:
    """Draw a pulse that meets a smooth wall at an angle above half the opening angle, and is mirrored away."""
    hit = np.array([1.6, 0.0])
    normal = np.array([-np.cos(ALPHA), np.sin(ALPHA)])
    along = np.array([normal[1], -normal[0]])
    wall = np.array([hit - 1.15 * along, hit + 1.5 * along])
    depth = -0.12 * normal
    ax.add_patch(Polygon([*wall, *(wall[::-1] + depth)], facecolor=WALL_COLOUR, zorder=3))
    edges = []
    for angle in (-HALF, HALF):
        way = np.array([np.cos(angle), np.sin(angle)])
        at = way * (hit @ normal) / (way @ normal)
        mirrored = way - 2.0 * (way @ normal) * normal
        edges.append((at, at + 1.9 * mirrored))
    (low, low_end), (high, high_end) = edges
    ax.add_patch(Polygon([(0, 0), low, high], facecolor="#0072B2", alpha=0.22, linewidth=0.0, zorder=2))
    ax.add_patch(Polygon([low, low_end, high_end, high], facecolor="#D55E00", alpha=0.22, linewidth=0.0, zorder=2))
    away = np.array([1.0, 0.0]) - 2.0 * normal[0] * normal
    for start, end, colour in (((0.0, 0.0), hit, "#0072B2"), (hit, hit + 1.75 * away, "#D55E00")):
        arrow = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.6}
        ax.annotate("", _xy(end), _xy(start), arrowprops=arrow, zorder=4)
    foot = hit + 1.25 * normal
    ax.plot(*np.column_stack([hit, foot]), "--", color=QUIET, linewidth=1.0, zorder=3)
    ax.text(*_xy(foot + 0.1 * normal), "normal", ha="center", va="bottom", fontsize=8.5, color=QUIET)
    straight = np.degrees(np.arctan2(normal[1], normal[0]))
    ax.add_patch(Arc(_xy(hit), 1.3, 1.3, theta1=straight, theta2=180.0, color="#222222", linewidth=1.0, zorder=4))
    between = np.array([-np.cos(ALPHA / 2), np.sin(ALPHA / 2)])
    ax.text(*_xy(hit + 0.78 * between), r"$\alpha$", ha="center", va="center", fontsize=11)
    ax.text(0.62, -0.34, "opening angle", ha="center", va="top", fontsize=8.5, color="#0072B2")
    ax.add_patch(Arc((0.0, 0.0), 1.1, 1.1, theta1=-np.degrees(HALF), theta2=np.degrees(HALF), color="#0072B2",
                     linewidth=1.2, zorder=4))  # fmt: skip
    ax.text(*_xy(hit + 1.55 * away - [0.12, 0.0]), "the echo\ngoes elsewhere", ha="right", va="center", fontsize=8.5,
            color="#B24700")  # fmt: skip
    mark_robot(np.zeros(3), ax, size=0.16, color=ROBOT_COLOUR, label="sonar")
    frame(ax, [-0.4, -1.3], [2.9, 2.3], "(b) a misreading")
    ax.set_anchor("N")
    ax.set_axis_off()


def _xy(point: ArrayLike) -> tuple[float, float]:
    x, y = np.asarray(point, dtype=np.float64)
    return float(x), float(y)
