"""Draw residuals of two real landmark sensors with what was fitted: ``python benchmarks/landmark_noise_picture.py``."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy import stats

from beamfield.landmark_noise.learning import LandmarkLearningResult, learn_landmark_parameters
from beamfield.report.drawing import legend, new_figure, style
from landmark_sets import read_mrclam, read_plaza

FIT, OTHER, DATA = "#0072b2", "#d55e00", "0.8"


def landmark_noise_picture(data: Path) -> Figure:
    """Draw range and bearing residuals of a camera, and ranges of radios whose bias is a scale.

    Parameters
    ----------
    data
        Folder with mrclam_instant and plaza_range_only.
    """
    camera = read_mrclam(data / "mrclam_instant" / "mrclam1.mat")
    radio = read_plaza(data / "plaza_range_only" / "Plaza1_.mat")
    learned = learn_landmark_parameters(*camera, n_replicates=2)
    scaled, biased = (learn_landmark_parameters(*radio, fit_scale=scale, n_replicates=2) for scale in (True, False))
    figure = new_figure(10, 6.4)
    axes = figure.subplots(2, 2)
    draw_camera(axes[0, 0], learned, "range")
    draw_camera(axes[0, 1], learned, "bearing")
    draw_radio_over_distance(axes[1, 0], scaled, biased)
    draw_radio_residuals(axes[1, 1], scaled, biased)
    return figure


def draw_camera(axes: Axes, result: LandmarkLearningResult, what: str) -> None:
    residuals, p = getattr(result.table, f"{what}_residuals"), result.parameters
    span, unit = (0.5, "m") if what == "range" else (0.11, "rad")
    axes.hist(residuals, np.linspace(-span, span, 101), density=True, color=DATA, label=f"{len(residuals):,} sightings")
    x = np.linspace(-span, span, 800)
    bias, sigma = getattr(p, f"{what}_bias"), getattr(p, f"sigma_{what}")
    axes.plot(x, stats.norm.pdf(x, bias, sigma), color=FIT, label=f"sigma_{what} {sigma:.2g} {unit}")
    style(axes, title=f"MRCLAM 1, camera: {what}s", x=f"measured minus true {what} [{unit}]", y=f"density [1/{unit}]")
    # Where the bearings' tail lies, nothing is seen on a linear axis.
    if what == "bearing":
        axes.set_yscale("log")
        axes.set_ylim(2e-3, 2e4)
    legend(axes, loc="upper left")


def draw_radio_over_distance(axes: Axes, scaled: LandmarkLearningResult, biased: LandmarkLearningResult) -> None:
    table = scaled.table
    axes.plot(table.expected_ranges, table.range_residuals, ".", ms=1.5, color="0.6", rasterized=True)
    d = np.array([0.0, table.expected_ranges.max()])
    p = scaled.parameters
    axes.plot(d, (p.range_scale - 1.0) * d + p.range_bias, color=FIT, label=f"range_scale {p.range_scale:.4f}")
    label = f"range_bias {biased.parameters.range_bias:+.2f} m alone"
    axes.plot(d, np.full(2, biased.parameters.range_bias), color=OTHER, ls="--", label=label)
    style(axes, title="Plaza 1, ranging radios", x="true range [m]", y="measured minus true range [m]")
    legend(axes, loc="upper left")


def draw_radio_residuals(axes: Axes, scaled: LandmarkLearningResult, biased: LandmarkLearningResult) -> None:
    x = np.linspace(-4.0, 4.0, 400)
    for result, color, dashes, name in ((biased, OTHER, "--", "bias alone"), (scaled, FIT, "-", "bias and scale")):
        p, table = result.parameters, result.table
        left = table.ranges - p.range_scale * table.expected_ranges - p.range_bias
        axes.hist(left, np.linspace(-4.0, 4.0, 81), density=True, histtype="stepfilled", color=color, alpha=0.25)
        axes.plot(x, stats.norm.pdf(x, 0.0, p.sigma_range), color=color, ls=dashes,
                  label=f"{name}: sigma_range {p.sigma_range:.2f} m")  # fmt: skip
    style(axes, title="Plaza 1: what sigma is left with", x="what remains of a range [m]", y="density [1/m]")
    axes.set_ylim(0, 1.05)
    legend(axes, loc="upper right")


if __name__ == "__main__":
    ROOT = Path(__file__).resolve().parents[1]
    matplotlib.rcParams["svg.hashsalt"] = "beamfield"
    landmark_noise_picture(ROOT.parent / "shared" / "data").savefig(
        ROOT / "docs" / "images" / "landmark_noise.svg", metadata={"Date": None}, bbox_inches="tight"
    )
