"""Groups of beams with nearly the same expected range, as in Figures 6.5 and 6.6."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.beam_table import BeamTable
from beamfield.geometry import FloatArray

# The chapter takes 2.9 m to 3.1 m; far beams are rarer, so their groups are wider.
HALF_WIDTH = 0.1
HALF_WIDTH_SHARE = 0.03
# Typical expected ranges: these quantiles.
QUANTILES = (0.08, 0.35, 0.65, 0.92)
FEWEST_READINGS = 30


@dataclass(frozen=True, eq=False)
class RangeBin:
    """Beams with nearly the same expected range.

    Parameters
    ----------
    centre, half_width
        The expected ranges are within centre +- half_width, metres.
    rows
        Rows of the beam table, in the order of the readings.
    """

    centre: float
    half_width: float
    rows: NDArray[np.int64]


def typical_bins(table: BeamTable) -> list[RangeBin]:
    """Return up to four groups around typical expected ranges, near to far; they do not overlap.

    Beams whose ray hits nothing are left out.
    """
    usable = np.flatnonzero(~table.hits_nothing)
    expected = table.expected_ranges[usable]
    bins: list[RangeBin] = []
    for quantile in np.quantile(expected, QUANTILES) if len(usable) else ():
        centre, half_width = _round_centre(float(quantile))
        if bins and centre - half_width < bins[-1].centre + bins[-1].half_width:
            continue
        rows = usable[np.abs(expected - centre) <= half_width]
        if len(rows) >= FEWEST_READINGS:
            bins.append(RangeBin(centre, half_width, rows))
    if not bins and len(usable):
        # So few beams that no typical group has enough: show all of them.
        low, high = float(expected.min()), float(expected.max())
        bins.append(RangeBin((low + high) / 2, max((high - low) / 2, HALF_WIDTH), usable))
    return bins


def bin_at(table: BeamTable, centre: float) -> RangeBin:
    """Return the beams near one expected range, metres."""
    half_width = max(HALF_WIDTH, HALF_WIDTH_SHARE * centre)
    near = np.abs(table.expected_ranges - centre) <= half_width
    return RangeBin(centre, half_width, np.flatnonzero(near & ~table.hits_nothing))


def telling_bin(bins: list[RangeBin]) -> RangeBin:
    """Return the farthest group with many readings: far from zero, short readings have room to show."""
    most = max(len(group.rows) for group in bins)
    return max((group for group in bins if 4 * len(group.rows) >= most), key=lambda group: group.centre)


def thinned(rows: NDArray[np.int64], most: int) -> NDArray[np.int64]:
    """Return at most so many of the rows, drawn at random (always the same ones) and in their order.

    Equal steps would pick the same beams of every scan where the step divides the number of beams.
    """
    if len(rows) <= most:
        return rows
    return rows[np.sort(np.random.default_rng(0).choice(len(rows), most, replace=False))]


def range_step(ranges: FloatArray) -> float:
    """Return the step between the values that the sensor reports in metres; 0 if it is finer than 0.1 mm.

    Histograms need it: bins that hold now one and now two of the values show stripes that are not in the data.
    """
    values = np.unique(np.round(ranges[:20_000], 5))
    if len(values) < 2:
        return 0.0
    gaps = np.diff(values)
    step = float(np.quantile(gaps, 0.05))
    return step if step > 1e-4 and len(values) < 0.5 * min(len(ranges), 20_000) else 0.0


def _round_centre(quantile: float) -> tuple[float, float]:
    """Centre and half width with few digits."""
    half_width = round(max(HALF_WIDTH, HALF_WIDTH_SHARE * quantile), 1 if quantile > 3.3 else 2)
    step = 0.5 if quantile > 2.0 else 0.1
    return max(round(round(quantile / step) * step, 3), half_width), half_width
