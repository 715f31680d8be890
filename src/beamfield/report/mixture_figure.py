"""The four components of the beam model and their mixture: the chapter's Figures 6.3 and 6.4."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure, SubFigure

from beamfield.calibration.calibrate import Calibration
from beamfield.geometry import FloatArray
from beamfield.models.beam_density import beam_components
from beamfield.models.beam_parameters import BeamParameters
from beamfield.report.drawing import (
    CAUSE_COLOURS,
    CAUSE_NAMES,
    NARROW,
    QUIET,
    Panel,
    ReportFigure,
    legend,
    log_scale,
    new_figure,
    style,
    svg_panel,
)
from beamfield.report.range_bins import telling_bin, typical_bins


def mixture(calibration: Calibration) -> ReportFigure:
    """The four components and their mixture at one expected range: Figures 6.3 and 6.4."""
    group = telling_bin(typical_bins(calibration.table))
    parameters = calibration.parameters
    limits = calibration.table.min_range, calibration.table.max_range
    return ReportFigure(
        "mixture",
        f"The four causes and their mixture, for an expected range of {group.centre:g} m",
        (
            _components_panel(group.centre, parameters, *limits),
            _mixture_panel(group.centre, parameters, *limits),
        ),
        "First, each cause alone, over the ranges where it matters (dashed: z*); the densities integrate to 1. Then "
        "the same multiplied by their fitted weights, on a logarithmic scale, and in grey their sum, the model's "
        "answer. The readings without return are not a density but a probability, hence the axis of their own.",
        "Section 6.3.1; Figures 6.3 and 6.4, (6.4) to (6.12)",
    )


def _components_panel(group_range: float, parameters: BeamParameters, min_range: float, max_range: float) -> Panel:
    figure = new_figure(NARROW, 4.2)
    draw_components(figure, group_range, parameters, max_range, min_range=min_range)
    alt = (
        f"Four small plots for an expected range of {group_range:g} m: the peak of a hit, the decay of unexpected "
        f"objects up to the expected range, the point mass at {max_range:g} m, the flat density of random readings."
    )
    return svg_panel(figure, "components", alt)


def draw_components(
    figure: Figure | SubFigure,
    group_range: float,
    parameters: BeamParameters,
    max_range: float,
    *,
    min_range: float = 0.0,
) -> None:
    """Draw Figure 6.3: each density alone, over the ranges where it is not 0.

    Parameters
    ----------
    figure
        An empty figure.
    group_range
        Expected range z*, metres.
    parameters, max_range, min_range
        The model, and the sensor's limits in metres.
    """
    spread = 6 * float(np.hypot(parameters.sigma_hit, parameters.sigma_slope * group_range))
    centre = group_range + parameters.range_offset
    views = (
        ("(a) hit", max(centre - spread, min_range), min(centre + spread, max_range)),
        ("(b) short", 0.0, min(1.3 * group_range, max_range)),
        ("(c) max", 0.8 * max_range, 1.04 * max_range),
        ("(d) rand", 0.0, 1.04 * max_range),
    )
    for cause, (axes, (title, low, high)) in enumerate(zip(figure.subplots(2, 2).flat, views, strict=True)):
        colour = CAUSE_COLOURS[cause]
        if cause == 2:
            axes.stairs([1.0], [max_range, max_range * 1.008], fill=True, color=colour)
            axes.set_ylim(0, 1.1)
        else:
            z = np.unique(
                np.concatenate([np.linspace(low, high, 301), [group_range, np.nextafter(group_range, np.inf)]])
            )
            density = beam_components(z, group_range, max_range, parameters, min_range=min_range)[:, cause]
            axes.fill_between(z, density, color=colour, alpha=0.25, linewidth=0)
            axes.plot(z, density, color=colour, linewidth=1.4)
            axes.set_ylim(0, float(density.max()) * 1.12)
        if cause < 2:
            axes.axvline(group_range, color=QUIET, linewidth=0.8, linestyle="--")
        axes.set_xlim(low, high)
        style(axes, title=title, x="z [m]", y="probability [1]" if cause == 2 else "density [1/m]", grid="none")
        axes.title.set_fontsize(8.5)
        axes.locator_params(axis="x", nbins=4)


def _mixture_panel(expected: float, parameters: BeamParameters, min_range: float, max_range: float) -> Panel:
    figure = new_figure(NARROW, 4.2)
    draw_mixture(figure, expected, parameters, max_range, min_range=min_range)
    weights = ", ".join(f"{name} {weight:.3f}" for name, weight in zip(CAUSE_NAMES, parameters.weights, strict=True))
    alt = f"The mixture density for an expected range of {expected:g} m on a logarithmic scale; weights: {weights}."
    return svg_panel(figure, "mixture", alt)


def draw_mixture(
    figure: Figure | SubFigure,
    expected: float,
    parameters: BeamParameters,
    max_range: float,
    *,
    min_range: float = 0.0,
) -> None:
    """Draw Figure 6.4: the densities times their weights and their sum; the point mass on an axis of its own.

    Parameters
    ----------
    figure
        An empty figure.
    expected
        Expected range z*, metres.
    parameters, max_range, min_range
        The model, and the sensor's limits in metres.
    """
    left, right = figure.subplots(1, 2, width_ratios=(7, 1))
    z = _fine_ranges(expected, parameters, min_range, max_range)
    weighted = beam_components(z, expected, max_range, parameters, min_range=min_range) * np.array(parameters.weights)
    total = weighted.sum(axis=1)
    # Far below the smallest density of the sum there is nothing to see.
    floor = float(total.min()) / 3 if total.min() > 0 else max(float(total.max()), 1e-9) * 1e-6
    left.plot(z, np.maximum(total, floor / 10), color="#C4CAD0", linewidth=5.0, label="sum", solid_capstyle="round")
    for cause in (0, 1, 3):
        line = np.where(weighted[:, cause] > 0, weighted[:, cause], floor / 10)
        left.plot(z, line, color=CAUSE_COLOURS[cause], linewidth=1.6, label=_weight_label(parameters, cause))
    left.axvline(expected, color=QUIET, linewidth=0.8, linestyle="--")
    log_scale(left)
    left.set_ylim(floor, max(float(total.max()), 10 * floor) * 30)
    left.set_xlim(0, float(z[-1]))
    style(
        left, title="Mixture, with the fitted weights", x="z [m]", y="weight times density, log scale [1/m]", grid="y"
    )
    legend(left, loc="upper right", ncols=2)
    right.bar([0], [parameters.z_max], width=0.7, color=CAUSE_COLOURS[2])
    right.set_xlim(-0.6, 0.6)
    right.set_ylim(0, max(1.3 * parameters.z_max, 0.01))
    right.set_xticks([0], [f"{max_range:.4g}"])
    style(right, x="z [m]", y="probability [1]", grid="y")
    right.annotate(f"{parameters.z_max:.1%}", (0, parameters.z_max), xytext=(0, 3), textcoords="offset points",
                   ha="center", fontsize=8)  # fmt: skip


def _weight_label(parameters: BeamParameters, cause: int) -> str:
    return f"{CAUSE_NAMES[cause]}: {parameters.weights[cause]:.1%}"


def _fine_ranges(expected: float, parameters: BeamParameters, min_range: float, max_range: float) -> FloatArray:
    """Ranges up to where nothing new is to be seen, fine around the hits and with the step at the end of p_short."""
    spread = float(np.hypot(parameters.sigma_hit, parameters.sigma_slope * expected))
    near = expected + parameters.range_offset + spread * np.linspace(-7, 7, 281)
    end = min(max_range, max(2.0 * expected, float(near[-1])))
    step = [expected, np.nextafter(expected, np.inf)]
    z = np.unique(np.concatenate([near, np.linspace(0.0, end, 241), step]))
    return z[(z >= min_range) & (z <= end) & (z < max_range)]
