"""Draw what a scan says about the pose, and what is left of it in its features (6.6.5).

Run: python -m benchmarks.feature_study.picture [FILE.svg]
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm
from matplotlib.figure import Figure
from matplotlib.image import AxesImage
from scipy.ndimage import maximum_filter

from beamfield.errors import TooLittleDataError
from beamfield.features.corners import find_corners
from beamfield.features.lines import find_lines
from beamfield.features.map_features import MapFeatures, map_features
from beamfield.features.sweep import RangeNoise
from beamfield.figures.drawing import colour_bar, framed_map, known_limits, mark_robot
from beamfield.figures.gallery import save_figure
from beamfield.figures.likelihood_over_map import PALE_MAP, REFERENCE_COLOUR
from beamfield.figures.world import FigureWorld, simulated_world
from beamfield.localization.pose_posterior import PoseLattice, PosePosterior
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.plot import draw_array
from beamfield.report.drawing import legend, new_figure, style

from .noise import TYPICAL_NOISE, FeatureNoise
from .posteriors import learn_feature_noise, posteriors_of_scan

RESOLUTION, HEADINGS = 0.25, 60
# A scan is taken for so many independent beams (6.3.4), as in Figure 6.7.
INDEPENDENT_BEAMS = 12
# Of so many scans of a log, one with many corners is shown.
SCANS_TRIED = 40
# The noise of features is learned from so many scans, none of them near the one that is shown in time.
SCANS_LEARNED, SCANS_APART = 40, 5
# Positions this many times less probable than the most probable of all panels are white.
SPAN = 1e5


def kept_information_figure(world: FigureWorld) -> Figure:
    """Draw the posterior over positions given (a) a scan, (b) its walls, (c) its corners."""
    index = _scan_with_corners(world)
    scan, pose = world.log.scan(index), np.asarray(world.log.poses[index])
    lattice = PoseLattice.over_map(world.grid, resolution=RESOLUTION, headings=HEADINGS)
    exponent = min(1.0, INDEPENDENT_BEAMS / scan.finder.n_beams)
    features = map_features(world.grid)
    noise, learned = _noise_of_other_scans(world, index, features, lattice)
    result = posteriors_of_scan(scan, world.grid, world.parameters, features, lattice, exponent=exponent, noise=noise)
    panels = (
        ("(a) the whole scan", result.scan),
        (f"(b) its {result.n_lines} walls", result.lines),
        (f"(c) its {result.n_corners} corners", result.corners),
    )
    limits = known_limits(world.grid)
    aspect = (limits[3] - limits[2]) / (limits[1] - limits[0])
    beside = aspect > 1.0
    size = (12.0, float(np.clip(3.6 * aspect, 4.0, 9.0))) if beside else (8.4, float(np.clip(22.0 * aspect, 6.0, 18.0)))
    figure = new_figure(*size)
    axes = figure.subplots(*((1, 3) if beside else (3, 1)))
    densities = [position_mass(posterior) / RESOLUTION**2 for _, posterior in panels]
    top = max(float(np.nanmax(density)) for density in densities)
    for ax, (title, posterior), density in zip(axes, panels, densities, strict=True):
        image = draw_posterior(posterior, density, world.grid, ax, top)
        mark_robot(pose, ax, size=0.014 * (limits[1] - limits[0]), color=REFERENCE_COLOUR, label="reference pose")
        told = f"entropy {posterior.entropy:.1f} of {posterior.prior_entropy:.1f} nats"
        style(ax, title=f"{title}: {told}", x="x [m]", y="y [m]", grid="none")
        ax.set_facecolor(PALE_MAP[1])
        colour_bar(image, ax, "p(x, y | ...) [1/m²]")
    legend(axes[0], loc="best")
    if not learned:
        figure.suptitle("the log shows too few features to learn their noise: that of typical offices is taken")
    return figure


def _noise_of_other_scans(
    world: FigureWorld, index: int, features: MapFeatures, lattice: PoseLattice
) -> tuple[FeatureNoise, bool]:
    """Learn the features' noise from scans all over the log; what is typical, and False, where they show too little."""
    posed = np.flatnonzero(np.isfinite(world.log.poses).all(axis=1))
    others = posed[np.abs(posed - index) >= SCANS_APART]
    others = others[world.grid.look_up(world.grid.free, world.log.poses[others, :2])]
    if not len(others):
        return TYPICAL_NOISE, False
    chosen = np.unique(others[np.linspace(0, len(others) - 1, SCANS_LEARNED).astype(int)])
    try:
        return learn_feature_noise(world.log, chosen, world.grid, world.parameters, features, lattice), True
    except TooLittleDataError:
        return TYPICAL_NOISE, False


def _scan_with_corners(world: FigureWorld) -> int:
    """Return the index of a scan with many corners; of the scan to show, if one was asked for."""
    if world.index == world.open_index:
        return world.index
    noise = RangeNoise(world.parameters.sigma_hit)
    posed = np.flatnonzero(np.isfinite(world.log.poses).all(axis=1))
    tried = posed[np.linspace(0, len(posed) - 1, min(len(posed), SCANS_TRIED)).astype(int)]
    return int(max(tried, key=lambda index: len(find_corners(find_lines(world.log.scan(index), noise)))))


def position_mass(posterior: PosePosterior) -> np.ndarray:
    """Return the probability of each position (rows, cols), headings summed; NaN where there is no cell."""
    mass = np.full(posterior.lattice.inside.shape, np.nan)
    mass[posterior.lattice.inside] = np.exp(posterior.log_mass).sum(axis=1)
    return mass


def draw_posterior(
    posterior: PosePosterior, density: np.ndarray, grid: OccupancyGrid, ax: Axes, top: float
) -> AxesImage:
    """Draw a density over positions (rows, cols) above the map, on a logarithmic scale that ends at `top`."""
    framed_map(grid, ax, colours=PALE_MAP)
    # Single cells would be lost: each is drawn as dark as the best of its neighbours.
    shown = maximum_filter(np.nan_to_num(density), size=3, mode="constant")
    masked = np.ma.masked_where(shown < top / SPAN, shown)
    lattice = posterior.lattice
    return draw_array(masked, lattice.resolution, lattice.corner, ax, cmap="magma_r", norm=LogNorm(top / SPAN, top))


if __name__ == "__main__":
    default = Path(__file__).resolve().parents[2] / "docs" / "images" / "section_6_6_5.svg"
    save_figure(kept_information_figure(simulated_world()), Path(sys.argv[1]) if len(sys.argv) > 1 else default)
