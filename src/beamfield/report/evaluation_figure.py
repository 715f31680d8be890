"""The one figure of filters side by side: every run's error, and how often the particles hold the truth."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator, FuncFormatter, NullFormatter

from beamfield.localization.replay_comparison import ReplayTrials
from beamfield.report.colours import CAUSE_COLOURS, MODEL, QUIET
from beamfield.report.drawing import WIDE, new_panel, style
from beamfield.report.evaluation import Evaluation

# Rows of one log lie a unit apart, logs a little more.
GAP = 0.7
# Labels of the logarithmic axis, metres.
TICKS = tuple(digit * 10.0**power for power in range(-3, 3) for digit in (1, 1.5, 2, 3, 5, 7))
RIGHT_SHARE = 0.95
LONGEST_LABEL = 40


def evaluation_figure(evaluation: Evaluation) -> Figure:
    """Return the figure: one row per log and filter; a dashed line where the share inside is right."""
    names = list(evaluation.trials)
    rows = [
        (f"{one.log}: {name}", one, CAUSE_COLOURS[names.index(name) % len(CAUSE_COLOURS)], GAP * k)
        for k, trials in enumerate(zip(*evaluation.trials.values(), strict=True))
        for name, one in zip(names, trials, strict=True)
    ]
    heights = np.array([i + gap for i, (*_, gap) in enumerate(rows)])
    figure = new_panel(WIDE, 1.1 + 0.38 * (heights[-1] + 1.0))
    errors, inside = figure.subplots(1, 2, sharey=True, width_ratios=(2.2, 1.0))
    for y, (_, one, colour, _) in zip(heights, rows, strict=True):
        _dots(errors, one, one.column("mean"), y, colour)
        _dots(inside, one, one.column("inside"), y, colour)
    _error_axis(errors, [one for _, one, _, _ in rows])
    inside.axvline(RIGHT_SHARE, color=QUIET, linewidth=1.0, linestyle="--")
    inside.set_xlim(-0.03, 1.03)
    style(inside, x="share of updates with the reference in\nthe particles' 95% ellipse; dashed: 0.95", grid="x")
    errors.set_yticks(heights, [_shortened(label) for label, *_ in rows], parse_math=False)
    errors.set_ylim(heights[-1] + 0.6, -0.6)
    return figure


def _dots(axes: Axes, trials: ReplayTrials, values: np.ndarray, y: float, colour: str) -> None:
    """Draw one dot per run, crosses for lost ones, and a bar at the mean."""
    lost = np.array([one.lost for one in trials.errors])
    # Spread over the row's height by rank, the same on every run.
    spread = y + 0.5 * ((np.argsort(np.argsort(trials.seeds)) * 0.618034) % 1.0 - 0.5)
    axes.plot(values[~lost], spread[~lost], ".", color=colour, markersize=5, alpha=0.55, markeredgewidth=0)
    axes.plot(values[lost], spread[lost], "x", color=colour, markersize=5, markeredgewidth=1.2)
    axes.plot([values.mean()] * 2, [y - 0.36, y + 0.36], "-", color=MODEL, linewidth=2.0)


def _error_axis(axes: Axes, trials: list[ReplayTrials]) -> None:
    values = np.concatenate([one.column("mean") for one in trials])
    low, high = max(float(values.min()), 1e-3) / 1.25, max(float(values.max()), 1e-3) * 1.25
    axes.set_xscale("log")
    axes.set_xlim(low, high)
    axes.xaxis.set_major_locator(FixedLocator([tick for tick in TICKS if low <= tick <= high]))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())
    style(axes, x="mean position error of a run [m], log scale\ndots: runs, crosses: lost ones, bars: means", grid="x")
    axes.tick_params(which="minor", bottom=False)


def _shortened(label: str) -> str:
    return label if len(label) <= LONGEST_LABEL else f"{label[: LONGEST_LABEL - 3]}..."
