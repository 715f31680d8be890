"""Figures 6.7, 6.11 and 6.12: one scan over the map, its own likelihood field, and a local map from several."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from beamfield.figures.drawing import colour_bar, frame, framed_map, mark_robot, scan_limits
from beamfield.figures.likelihood_over_map import likelihood_figure
from beamfield.figures.world import FigureWorld
from beamfield.localization.lattice_noise import widened_for_lattice
from beamfield.localization.likelihood_map import likelihood_map
from beamfield.maps.mapping import local_map
from beamfield.maps.scan_field import ScanField
from beamfield.models.beam import BeamModel
from beamfield.models.map_matching import MapMatchingModel
from beamfield.plot import draw_array, draw_scan
from beamfield.report.drawing import legend, new_figure

RESOLUTION, HEADINGS = 0.10, 72
# Of each scan in Figure 6.7: neighbouring beams are dependent (6.3.4).
N_BEAMS = 12
# A maximum this near to the reference pose is the right place, metres.
AT_POSE = 0.5
LOCAL_SCANS = 10
# Positions around the reference pose in Figure 6.12b: +- metres, and the step.
OFFSET, OFFSET_STEP = 1.5, 0.05
SCAN_COLOUR, ROBOT_COLOUR = "#D55E00", "#0072B2"


def likelihood_over_map_figure(world: FigureWorld) -> Figure:
    """Draw Figure 6.7: a scan in the map and its likelihood by the learned beam model.

    Of the world's scans with far readings the first is shown whose maximum is at its pose; the first if none is.
    """
    wide = widened_for_lattice(world.parameters, resolution=RESOLUTION, headings=HEADINGS)
    model = BeamModel(world.grid, wide, n_beams=N_BEAMS)
    tried = []
    for index in (world.index, *world.others):
        scan, pose = world.log.scan(index), np.asarray(world.log.poses[index])
        result = likelihood_map(model, scan, world.grid, resolution=RESOLUTION, headings=HEADINGS)
        tried.append((scan, pose, result))
        if np.hypot(*(pose[:2] - np.asarray(result.best_pose)[:2])) < AT_POSE:
            break
    else:
        scan, pose, result = tried[0]
    return likelihood_figure(scan, world.grid, result, pose, model_name=f"beam model, {N_BEAMS} beams")


def scan_field_figure(world: FigureWorld) -> Figure:
    """Draw Figure 6.11: (a) a scan from above, (b) the likelihood field over what it saw."""
    scan = world.log.scan(world.open_index)
    field = ScanField.from_scan(scan, sigma_hit=0.08)
    low, high = scan_limits(scan, np.zeros(3), 1.0)
    width, height = high - low
    figure = new_figure(11.0, float(np.clip(5.0 * height / width + 0.6, 3.0, 9.5)))
    left, right = figure.subplots(1, 2)
    draw_scan(scan, np.zeros(3), left, label="end points", color=SCAN_COLOUR, size=9.0)
    step = max(width, height) / 500.0
    cols, rows = (int(np.ceil(v / step)) for v in (width, height))
    row, col = np.indices((rows, cols))
    value = field.log_density(low + (np.stack([col, row], axis=-1) + 0.5) * step)
    # White from what is not seen upwards: neither an end point there nor one on a surface contradicts the scan.
    neutral = -np.log(scan.finder.max_range)
    shown, origin = np.minimum(value, neutral) - neutral, np.array([*low, 0.0])
    image = draw_array(shown, step, origin, right, cmap="gray", vmin=float(value.min()) - neutral, vmax=0)
    draw_scan(scan, np.zeros(3), right, label="end points", color=SCAN_COLOUR, size=3.0)
    colour_bar(image, right, "log-likelihood of an end point, against unseen places [nats]")
    for ax, title in ((left, "(a) the scan, from above"), (right, "(b) its likelihood field")):
        mark_robot(np.zeros(3), ax, size=0.025 * float(max(width, height)), color=ROBOT_COLOUR, label="robot")
        frame(ax, low, high, title, x="x in the robot's frame [m]")
        legend(ax, loc="best")
    return figure


def local_map_figure(world: FigureWorld) -> Figure:
    """Draw Figure 6.12: (a) a local map with one of its scans, (b) its correlation with the map around the pose."""
    index = world.open_index
    local = local_map(world.log, index, n=LOCAL_SCANS, resolution=max(0.05, world.grid.resolution))
    figure = new_figure(11.0, 5.0)
    left, right = figure.subplots(1, 2, width_ratios=(1.35, 1.0))
    framed_map(local, left)
    scan = world.log.scan(index)
    draw_scan(scan, np.zeros(3), left, label="last scan", color=SCAN_COLOUR, size=5.0)
    low, high = scan_limits(scan, np.zeros(3), 1.0)
    mark_robot(np.zeros(3), left, size=0.03 * float((high - low).max()), color=ROBOT_COLOUR, label="robot")
    posed = np.isfinite(world.log.poses[max(0, index + 1 - LOCAL_SCANS) : index + 1]).all(axis=1).sum()
    title = f"(a) local map from {posed} {'scan' if posed == 1 else 'scans'}"
    frame(left, low, high, title, x="x in the robot's frame [m]")
    left.set_facecolor("#E1E5EA")
    legend(left, loc="best")
    offsets = np.arange(-OFFSET, OFFSET + OFFSET_STEP / 2, OFFSET_STEP)
    poses = np.tile(world.log.poses[index], (len(offsets), len(offsets), 1))
    poses[..., 0] += offsets[None, :]
    poses[..., 1] += offsets[:, None]
    rho = MapMatchingModel(world.grid).correlation(local, poses)
    corner = -OFFSET - OFFSET_STEP / 2
    image = draw_array(rho, OFFSET_STEP, np.array([corner, corner, 0.0]), right, cmap="cividis")
    best = np.unravel_index(int(np.argmax(rho)), rho.shape)
    right.plot(0.0, 0.0, "+", color="white", markersize=13, markeredgewidth=2.0, linestyle="none", label="reference")
    right.plot(offsets[best[1]], offsets[best[0]], "o", color=SCAN_COLOUR, markerfacecolor="none", markersize=11,
               markeredgewidth=2.0, linestyle="none", label=f"best: {rho.max():.2f}")  # fmt: skip
    labels = {"x": "x beside the reference pose [m]", "y": "y beside it [m]"}
    frame(right, [corner, corner], [-corner, -corner], "(b) correlation with the map", **labels)
    colour_bar(image, right, "correlation rho of (6.35) [1]")
    right.legend(loc="lower left", fontsize=8, facecolor="#9AA3AB", framealpha=0.9)
    return figure
