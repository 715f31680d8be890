"""The four components of the beam model and their mixture: the chapter's Figures 6.3 and 6.4."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure, SubFigure

from beamfield.calibration.calibrate import Calibration
from beamfield.geometry import FloatArray
from beamfield.models.beam_density import CAUSES, beam_components
from beamfield.models.beam_parameters import BeamParameters
from beamfield.report.colours import CAUSE_COLOURS, QUIET
from beamfield.report.drawing import NARROW, legend, log_scale, new_panel, style
from beamfield.report.panel import ReportFigure, one_picture
from beamfield.report.range_bins import telling_bin, typical_bins


def mixture(calibration: Calibration) -> ReportFigure:
    """The four components and their mixture at one expected range: Figure 6.4."""
    table, parameters = calibration.table, calibration.parameters
    expected = telling_bin(typical_bins(table)).centre
    figure = new_panel(NARROW, 4.2)
    draw_mixture(figure, expected, parameters, table.max_range, min_range=table.min_range)
    weights = ", ".join(f"{name} {weight:.3f}" for name, weight in zip(CAUSES, parameters.weights, strict=True))
    return one_picture(
        "mixture",
        f"The four causes and their mixture, for an expected range of {expected:g} m",
        figure,
        f"The mixture density for an expected range of {expected:g} m on a logarithmic scale; weights: {weights}.",
        "The density of each cause multiplied by its fitted weight, on a logarithmic scale (dashed: z*), and in grey "
        "their sum, the model's answer. The readings without return are not a density but a probability, hence the "
        "axis of their own.",
        "Section 6.3.1; Figure 6.4, (6.4) to (6.12)",
    )


def draw_components(
    figure: Figure | SubFigure, expected: float, parameters: BeamParameters, max_range: float, *, min_range: float = 0.0
) -> None:
    """Draw Figure 6.3 for an expected range z*: each density alone, over the ranges where it is not 0."""
    spread = 6 * float(np.hypot(parameters.sigma_hit, parameters.sigma_slope * expected))
    centre = expected + parameters.range_offset
    views = (
        ("(a) hit", max(centre - spread, min_range), min(centre + spread, max_range)),
        ("(b) short", 0.0, min(1.3 * expected, max_range)),
        ("(c) max", 0.8 * max_range, 1.04 * max_range),
        ("(d) rand", 0.0, 1.04 * max_range),
    )
    for cause, (axes, (title, low, high)) in enumerate(zip(figure.subplots(2, 2).flat, views, strict=True)):
        colour = CAUSE_COLOURS[cause]
        if cause == 2:
            axes.stairs([1.0], [max_range, max_range * 1.008], fill=True, color=colour)
            axes.set_ylim(0, 1.1)
        else:
            z = np.unique(np.concatenate([np.linspace(low, high, 301), _both_sides(expected)]))
            density = beam_components(z, expected, max_range, parameters, min_range=min_range)[:, cause]
            axes.fill_between(z, density, color=colour, alpha=0.25, linewidth=0)
            axes.plot(z, density, color=colour, linewidth=1.4)
            axes.set_ylim(0, float(density.max()) * 1.12)
        if cause < 2:
            axes.axvline(expected, color=QUIET, linewidth=0.8, linestyle="--")
        axes.set_xlim(low, high)
        style(axes, title=title, x="z [m]", y="probability [1]" if cause == 2 else "density [1/m]", grid="none")
        axes.title.set_fontsize(8.5)
        axes.locator_params(axis="x", nbins=4)


def draw_mixture(
    figure: Figure | SubFigure, expected: float, parameters: BeamParameters, max_range: float, *, min_range: float = 0.0
) -> None:
    """Draw Figure 6.4: weighted densities for an expected range z*, and their sum; the point mass on its own axis."""
    left, right = figure.subplots(1, 2, width_ratios=(7, 1))
    z = _fine_ranges(expected, parameters, min_range, max_range)
    weighted = beam_components(z, expected, max_range, parameters, min_range=min_range) * np.array(parameters.weights)
    total = weighted.sum(axis=1)
    # Far below the smallest density of the sum there is nothing to see.
    floor = float(total.min()) / 3 if total.min() > 0 else max(float(total.max()), 1e-9) * 1e-6
    left.plot(z, np.maximum(total, floor / 10), color="#C4CAD0", linewidth=5.0, label="sum", solid_capstyle="round")
    for cause in (0, 1, 3):
        line = np.where(weighted[:, cause] > 0, weighted[:, cause], floor / 10)
        label = f"{CAUSES[cause]}: {parameters.weights[cause]:.1%}"
        left.plot(z, line, color=CAUSE_COLOURS[cause], linewidth=1.6, label=label)
    left.axvline(expected, color=QUIET, linewidth=0.8, linestyle="--")
    log_scale(left)
    left.set(ylim=(floor, max(float(total.max()), 10 * floor) * 30), xlim=(0, float(z[-1])))
    y = "weight times density, log scale [1/m]"
    style(left, title="Mixture, with the fitted weights", x="z [m]", y=y, grid="y")
    legend(left, loc="upper right", ncols=2)
    right.bar([0], [parameters.z_max], width=0.7, color=CAUSE_COLOURS[2])
    right.set(xlim=(-0.6, 0.6), ylim=(0, max(1.3 * parameters.z_max, 0.01)))
    right.set_xticks([0], [f"{max_range:.4g}"])
    style(right, x="z [m]", y="probability [1]", grid="y")
    right.annotate(f"{parameters.z_max:.1%}", (0, parameters.z_max), xytext=(0, 3), textcoords="offset points",
                   ha="center", fontsize=8)  # fmt: skip


def _both_sides(expected: float) -> list[float]:
    """Return z* and the next number, between which p_short falls to 0."""
    return [expected, float(np.nextafter(expected, np.inf))]


def _fine_ranges(expected: float, parameters: BeamParameters, min_range: float, max_range: float) -> FloatArray:
    """Ranges up to where nothing new is to be seen, fine around the hits and with the step at the end of p_short."""
    spread = float(np.hypot(parameters.sigma_hit, parameters.sigma_slope * expected))
    near = expected + parameters.range_offset + spread * np.linspace(-7, 7, 281)
    end = min(max_range, max(2.0 * expected, float(near[-1])))
    z = np.unique(np.concatenate([near, np.linspace(0.0, end, 241), _both_sides(expected)]))
    return z[(z >= min_range) & (z <= end) & (z < max_range)]
