"""Figure 6.13: where a robot can be that has seen one landmark."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from beamfield.detections import Detections
from beamfield.figures.drawing import colour_bar, frame
from beamfield.figures.world import FigureWorld
from beamfield.geometry import FloatArray
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.landmark import LandmarkModel
from beamfield.models.landmark_parameters import LandmarkParameters
from beamfield.models.landmark_poses import sample_poses
from beamfield.plot import draw_array
from beamfield.report.drawing import legend, new_figure

# What was seen, as in the chapter, and how well.
RANGE, BEARING_DEG = 5.0, 30.0
SIGMA_RANGE, SIGMA_BEARING_DEG = 0.35, 8.0
N_POSES = 300
# Half the side of the pictures, and the side of a cell of (a), metres.
REACH, STEP = 7.0, 0.05
# Metres of a line that shows a heading.
TICK = 0.75
POSE_COLOUR, LANDMARK_COLOUR = "#0072B2", "#D55E00"


def poses_of_detection_figure(world: FigureWorld) -> Figure:
    """Draw Figure 6.13: (a) the density of positions given one range and bearing, (b) poses drawn from it.

    It has a landmark of its own; nothing of the world is shown.
    """
    del world
    noise = LandmarkParameters(SIGMA_RANGE, float(np.radians(SIGMA_BEARING_DEG)))
    model = LandmarkModel(LandmarkMap(np.zeros((1, 2))), noise, correspondence="known")
    figure = new_figure(10.8, 4.9)
    left, right = figure.subplots(1, 2)
    cells = int(2 * REACH / STEP)
    corner = np.array([-REACH, -REACH, 0.0])
    image = draw_array(position_density(model, corner, cells), STEP, corner, left, cmap="Blues", vmin=0.0)
    poses = sample_poses(model, detection(np.radians(BEARING_DEG)), N_POSES, np.random.default_rng(6)).poses
    _draw_poses(poses, right)
    what = f"seen at {RANGE:g} m, {BEARING_DEG:g} degrees to the left"
    for ax, title in ((left, f"(a) p(x, y | f, c, m): {what}"), (right, f"(b) {N_POSES} poses drawn from it")):
        ax.plot(0.0, 0.0, "*", color=LANDMARK_COLOUR, markersize=13, markeredgecolor="white", linestyle="none",
                label="landmark", zorder=5)  # fmt: skip
        frame(ax, [-REACH, -REACH], [REACH, REACH], title)
        legend(ax, loc="upper right")
    colour_bar(image, left, "density [1/m²]")
    return figure


def detection(bearing: float) -> Detections:
    """Return the landmark's detection with this bearing (radians, or NaN for none)."""
    return Detections(np.array([RANGE]), np.array([bearing]), ids=np.array([1]))


def position_density(model: LandmarkModel, corner: FloatArray, cells: int) -> FloatArray:
    """Return p(x, y | r, phi) per square metre at the centres of cells x cells: all headings together.

    For every position one heading fits the bearing, and all bearings have the same room: the bearing falls out.
    """
    centres = (np.arange(cells) + 0.5) * STEP
    poses = np.zeros((cells, cells, 3))
    poses[..., 0] = corner[0] + centres[None, :]
    poses[..., 1] = corner[1] + centres[:, None]
    log_density = model.log_likelihood(detection(np.nan), poses)
    density = np.exp(log_density - log_density.max())
    return np.asarray(density / (density.sum() * STEP**2))


def _draw_poses(poses: FloatArray, ax: Axes) -> None:
    tips = poses[:, :2] + TICK * np.column_stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])])
    ax.add_collection(LineCollection(list(np.stack([poses[:, :2], tips], axis=1)), colors=POSE_COLOUR, linewidths=0.8,
                                     alpha=0.7))  # fmt: skip
    ax.plot(poses[:, 0], poses[:, 1], "o", color=POSE_COLOUR, markersize=2.6, linestyle="none",
            label="pose; the line points ahead")  # fmt: skip
