"""Figures that judge the fit on held-out beams: scores, candidates, randomised PIT, log-likelihood over time."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MaxNLocator

from beamfield.calibration.calibrate import Calibration
from beamfield.calibration.evaluation import LEAST_GAIN, Timeline, block_standard_error
from beamfield.calibration.time_split import time_blocks
from beamfield.geometry import FloatArray
from beamfield.report.colours import DATA, FIT, HELD_OUT, QUIET
from beamfield.report.drawing import NARROW, WIDE, filled_steps, legend, legend_above, log_scale, new_axes
from beamfield.report.panel import ReportFigure, one_picture
from beamfield.report.text_table import form_line, form_name, plus_minus

PIT_BINS = 20
# Half the width of a 95% interval in standard errors.
Z95 = 1.96


def score_plot(calibration: Calibration) -> ReportFigure:
    """Held-out log-likelihood per beam of the fit, the defaults and a uniform."""
    scores = calibration.scores
    x = "log-likelihood per held-out beam [nats], more is better"
    figure, axes = new_axes(NARROW, 0.55 + 0.42 * len(scores), x=x, grid="x")
    _dots(axes, [(s.name, s.log_likelihood, s.standard_error, i == 0) for i, s in enumerate(scores)])
    said = "; ".join(f"{s.name} {plus_minus(s.log_likelihood, s.standard_error)} nats" for s in scores)
    return one_picture(
        "scores",
        "Log-likelihood per beam",
        figure,
        f"Dot plot of the log-likelihood per held-out beam: {said}",
        "Mean log-likelihood of beams from blocks of time that the fit has not seen, with 95% intervals from these "
        "blocks. The intervals of two models overlap more than their difference is uncertain, because both are scored "
        "on the same beams: the table gives the uncertainty of the differences. One nat more makes a beam 2.7 times as "
        "likely.",
        "Section 6.3.2, (6.13)",
    )


def candidate_plot(calibration: Calibration) -> ReportFigure | None:
    """Held-out gain of each form of the hit component; None if only one was allowed."""
    candidates = calibration.candidates
    if len(candidates) < 2:
        return None
    x = "gain per held-out beam [nats]"
    figure, axes = new_axes(NARROW, 0.75 + 0.42 * len(candidates), above=1, x=x, grid="x")
    _dots(axes, [(form_name(c), c.gain, c.gain_se, c.chosen) for c in candidates], decimals=4)
    # A span of less than the least gain that counts would blow noise up.
    low, high = axes.get_xlim()
    axes.set_xlim(min(low, -LEAST_GAIN), max(high, 1.5 * LEAST_GAIN))
    if max(high, -low) < 20 * LEAST_GAIN:
        axes.axvline(LEAST_GAIN, color=HELD_OUT, linewidth=1.0, linestyle="--", label="least gain worth a parameter")
        legend_above(axes)
    axes.axvline(0.0, color=QUIET, linewidth=0.8)
    axes.xaxis.set_major_locator(MaxNLocator(3))
    said = "; ".join(f"{form_name(c)} {plus_minus(c.gain, c.gain_se)}" for c in candidates)
    return one_picture(
        "candidates",
        "Which form of the hit component",
        figure,
        f"Dot plot of held-out gains: {said}",
        f"{form_line(calibration)} Gains are over {form_name(candidates[0])}. A range offset lets hits lie beside the "
        "expected range (walls drawn too thick or too thin); a sigma slope lets the noise grow with range. The filled "
        f"dot is the form that was kept: a further parameter must gain {LEAST_GAIN:g} nats per held-out beam and twice "
        "the standard error.",
        "Section 6.3.2; Figure 6.6 (narrower peaks at shorter range)",
    )


def pit_histogram(calibration: Calibration) -> ReportFigure:
    """Randomised PIT of the held-out beams."""
    pit = calibration.pit
    edges = np.linspace(0.0, 1.0, PIT_BINS + 1)
    density = np.histogram(pit, edges)[0] / max(len(pit), 1) * PIT_BINS
    band, from_blocks = pit_band(calibration)
    x = "share of the predicted distribution below the reading (randomised PIT) [1]"
    figure, axes = new_axes(WIDE, 3.2, x=x, y="density [1]", grid="y")
    filled_steps(axes, density, edges, facecolor=DATA, edgecolor=QUIET, linewidth=0.8, label="held-out beams")
    axes.axhspan(max(1 - band, 0.0), 1 + band, color=FIT, alpha=0.22, linewidth=0, label="95% band of a right model")
    axes.axhline(1.0, color=FIT, linewidth=1.0)
    axes.set(xlim=(0, 1), ylim=(0, max(float(density.max()) * 1.18, 1 + 1.3 * band, 1.4)))
    legend(axes, loc="upper center", ncols=2)
    outside = int((np.abs(density - 1) > band).sum())
    why = (
        "The band allows for beams of one scan and of neighbouring scans depending on each other (from blocks of time)."
        if from_blocks
        else "With a single block of held-out time the band is that of independent beams, which is too narrow."
    )
    return one_picture(
        "pit",
        "Is the whole distribution right?",
        figure,
        f"Histogram of the randomised probability integral transform of {len(pit)} held-out beams in {PIT_BINS} bins; "
        f"{outside} bins lie outside the band around 1; densities from {density.min():.2f} to {density.max():.2f}.",
        "For each held-out beam: which share of the predicted distribution lies below the reading. If the model is "
        "right, all values are equally frequent and the bars stay in the band. How to read deviations: bars high at "
        "both ends, the noise is larger than sigma_hit; a hump in the middle, smaller; a slope, hits lie beside the "
        "expected range; a peak at the left end only, more short readings than modelled; at the right end only, "
        f"readings beyond the mapped wall. {outside} of {PIT_BINS} bars lie outside the band; the largest distance "
        f"between the distributions is {calibration.pit_deviation:.3f}. {why}",
        "Not in the book; judges the mixture (6.12) as a whole",
    )


def pit_band(calibration: Calibration) -> tuple[float, bool]:
    """Return the half width of the 95% band of a PIT histogram's density, and whether it comes from time blocks.

    Within blocks, beams depend on each other: the standard error of each bin's share is taken from blocks of time,
    pooled over the bins. With fewer than two blocks it is that of independent beams.
    """
    table, pit = calibration.table, calibration.pit
    rows = calibration.held_out & ~table.hits_nothing
    blocks = time_blocks(table.stamps, calibration.options.block_s)[rows]
    independent = np.sqrt((1 / PIT_BINS) * (1 - 1 / PIT_BINS) / max(len(pit), 1))
    if len(blocks) != len(pit) or len(np.unique(blocks)) < 2:
        return float(Z95 * independent * PIT_BINS), False
    in_bin = np.minimum((pit * PIT_BINS).astype(np.int64), PIT_BINS - 1)
    errors = [block_standard_error((in_bin == b).astype(np.float64), blocks) for b in range(PIT_BINS)]
    pooled = float(np.sqrt(np.mean(np.square(errors))))
    return float(Z95 * max(pooled, independent) * PIT_BINS), True


def likelihood_over_time(calibration: Calibration) -> ReportFigure:
    """Mean log-likelihood per beam, scan by scan."""
    line = calibration.timeline
    seconds = line.stamps - line.stamps.min() if len(line.stamps) else line.stamps
    x = "time since the first used scan [s]"
    figure, axes = new_axes(WIDE, 3.4, x=x, y="log-likelihood per beam [nats]")
    for held_out, colour, name in ((False, FIT, "fit blocks"), (True, HELD_OUT, "held-out blocks")):
        mine = line.held_out == held_out
        axes.scatter(seconds[mine], line.log_likelihood[mine], s=7, color=colour, linewidths=0, label=name)
    for begin, end in _held_out_spans(line, seconds):
        axes.axvspan(begin, end, color=HELD_OUT, alpha=0.08, linewidth=0)
    rivals = ((s.name, s.log_likelihood) for s in calibration.scores[1:])
    name, best = max(rivals, key=lambda item: item[1], default=("", np.nan))
    if np.isfinite(best):
        axes.axhline(best, color=QUIET, linewidth=1.0, linestyle="--", label=f"{name}, mean")
    axes.set_ylim(_finite_limits(line.log_likelihood))
    if len(seconds):
        axes.set_xlim(-0.01 * seconds.max(), max(1.01 * float(seconds.max()), 1e-3))
    legend(axes, loc="lower left", ncols=3)
    return one_picture(
        "timeline",
        "How well each scan fits",
        figure,
        _timeline_alt(line, seconds),
        "One dot per scan: mean log-likelihood of its beams under the fit. Held-out blocks (shaded) should look like "
        "the others; if they lie lower, the fit does not carry over. A dip is a stretch where people stood around, the "
        "map is out of date, or the reference poses are off. The opposite is not true: wrong poses along a corridor "
        "hardly show.",
        "Section 6.1, (6.2); Table 6.1",
        cloud=True,
    )


def likelihood_trace(calibration: Calibration) -> ReportFigure | None:
    """How the learning approached its maximum; None if the trace has fewer than two values."""
    trace = np.asarray(calibration.learning.trace, dtype=np.float64).ravel()
    if len(trace) < 2 or not np.isfinite(trace[-1]):
        return None
    missing = trace[-1] - trace
    figure, axes = new_axes(WIDE, 2.8, x="iteration", y="nats per beam still missing")
    shown = np.where(np.isfinite(missing) & (missing > 0), missing, np.nan)
    axes.plot(np.arange(len(trace)), shown, color=FIT, linewidth=1.2, marker="o", markersize=3.5)
    if np.isfinite(shown).any():
        log_scale(axes)
    axes.set_xlim(0, len(trace) - 1)
    axes.locator_params(axis="x", integer=True)
    state = "converged" if calibration.converged else "did not converge"
    return one_picture(
        "trace",
        "Learning",
        figure,
        f"Distance of the log-likelihood per beam from its final value over {len(trace)} recorded values.",
        f"Distance of the log-likelihood from its final value. The learning {state} after "
        f"{calibration.learning.iterations} iterations. The likelihood never falls; a long flat line is a parameter "
        "that the data hardly determine.",
        "Section 6.3.2, Table 6.2 (with exact maximisations)",
    )


def _dots(axes: Axes, values: list[tuple[str, float, float, bool]], *, decimals: int = 3) -> None:
    """One line per (name, value, standard error, filled), from top to bottom: dot, 95% whiskers, number."""
    y = np.arange(len(values))[::-1]
    for place, (_, value, error, filled) in zip(y, values, strict=True):
        if not np.isfinite(value):
            continue
        edge = FIT if filled else QUIET
        if np.isfinite(error):
            axes.hlines(place, value - Z95 * error, value + Z95 * error, color=edge, linewidth=1.6)
        axes.plot([value], [place], "o", color=FIT if filled else "white", markeredgecolor=edge, markersize=7)
        text, above = f"{round(value, decimals) + 0.0:.{decimals}f}", (0, 7)
        axes.annotate(text, (value, place), xytext=above, textcoords="offset points", ha="center", fontsize=8.5)
    axes.set_yticks(y, [value[0] for value in values])
    axes.set_ylim(-0.6, len(values) - 0.3)
    axes.margins(x=0.08)


def _held_out_spans(line: Timeline, seconds: FloatArray) -> list[tuple[float, float]]:
    """Begin and end of each stretch of held-out scans."""
    order = np.argsort(line.stamps, kind="stable")
    held, times = line.held_out[order], seconds[order]
    change = np.flatnonzero(np.diff(np.concatenate([[False], held, [False]]).astype(np.int8)))
    return [(float(times[a]), float(times[b - 1])) for a, b in zip(change[::2], change[1::2], strict=True)]


def _finite_limits(values: FloatArray) -> tuple[float, float]:
    finite = values[np.isfinite(values)]
    if len(finite) == 0:
        return -1.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    margin = max(0.08 * (high - low), 0.05)
    return low - 2.2 * margin, high + margin


def _timeline_alt(line: Timeline, seconds: FloatArray) -> str:
    if len(seconds) == 0:
        return "No scan to show."
    worst = int(np.argmin(line.log_likelihood))
    return (
        f"Log-likelihood per beam of {len(seconds)} scans over {seconds.max():.0f} s; median "
        f"{np.median(line.log_likelihood):.2f} nats, lowest {line.log_likelihood[worst]:.2f} nats at "
        f"{seconds[worst]:.0f} s."
    )
