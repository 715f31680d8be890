"""The figure of the randomised PIT, which judges the whole distribution on held-out beams."""

from __future__ import annotations

import numpy as np

from beamfield.calibration.calibrate import Calibration
from beamfield.calibration.evaluation import Z95, block_standard_error
from beamfield.calibration.time_split import time_blocks
from beamfield.report.colours import DATA, FIT, QUIET
from beamfield.report.drawing import WIDE, filled_steps, legend, new_axes
from beamfield.report.panel import ReportFigure, one_picture

PIT_BINS = 20


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
