"""Check a map by pairs of opposite beams: their sum hardly depends on the pose."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.calibration.beam_table import BeamTable
from beamfield.calibration.block_errors import jackknife_error
from beamfield.finding import Finding
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.sensors import SensorLog
from beamfield.short_repr import short_repr

# Beams count as opposite within this many radians of a half turn and with origins this close together (metres).
OPPOSITE_TOLERANCE = 0.02
SAME_ORIGIN = 0.05
# A reading is taken to come from the mapped wall if it is this close to it (metres, plus a share of the range): wide
# enough for walls drawn several cells thick and for a map at a scale a few percent wrong.
NEAR_WALL = 0.6
NEAR_WALL_SHARE = 0.08
# Tukey's constant. With the usual 4.685 readings that a crowd cuts short, more at near walls, tilt the line.
TUKEY = 2.5
FEWEST_PAIRS = 200
# A scale wrong by less moves a wall 5 m away by less than a cell.
MOST_SCALE_ERROR = 0.01
# More pairs are thinned: they see the same walls again.
MOST_PAIRS = 20_000


@dataclass(frozen=True)
class OppositeBeams:
    """Measured against mapped width between walls on two opposite sides, which hardly depends on the pose.

    The measured width is modelled as ``scale * mapped width + widening``.

    Parameters
    ----------
    n_pairs
        Pairs of opposite beams that both see a mapped wall.
    median_difference
        Median of measured minus mapped width, metres, of the pairs that the line holds for.
    scale, scale_se
        Slope and its standard error (from blocks of time).
    widening, widening_se
        Intercept and its standard error, metres: walls drawn too thick by half of this on either side.
    """

    n_pairs: int
    median_difference: float
    scale: float
    scale_se: float
    widening: float
    widening_se: float

    __repr__ = short_repr


def opposite_beams(log: SensorLog, table: BeamTable, blocks: NDArray[np.int64]) -> OppositeBeams | None:
    """Compare sums of opposite beams with the sums of their expected ranges; standard errors are by block of time (n,).

    None if the sensor has no opposite beams or too few see a mapped wall. The table was built from the log, whose
    finder says which beams are opposite.
    """
    first, second = opposite_pairs(log, table)
    n_pairs = len(first)
    if n_pairs < FEWEST_PAIRS:
        return None
    if n_pairs > MOST_PAIRS:
        chosen = np.linspace(0, n_pairs - 1, MOST_PAIRS).astype(np.int64)
        first, second = first[chosen], second[chosen]
    measured = table.ranges[first] + table.ranges[second]
    mapped = table.expected_ranges[first] + table.expected_ranges[second]
    scale, widening, of_walls = _robust_line(mapped, measured)
    # Jackknife over blocks of time: pairs of neighbouring scans see the same walls.
    replicates = []
    for block in np.unique(blocks[first]):
        rest = blocks[first] != block
        if rest.sum() >= FEWEST_PAIRS // 2:
            replicates.append(_robust_line(mapped[rest], measured[rest])[:2])
    scale_se, widening_se = jackknife_error(np.array(replicates)) if len(replicates) > 1 else (np.nan, np.nan)
    difference = float(np.median((measured - mapped)[of_walls]))
    return OppositeBeams(n_pairs, difference, scale, float(scale_se), widening, float(widening_se))


def opposite_pairs(log: SensorLog, table: BeamTable) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the rows (p,) and (p,) of the table that are opposite beams of one scan and both see a mapped wall."""
    partner = _opposite(log.finder.mounts)
    row_of = np.full((len(log), log.finder.n_beams), -1, dtype=np.int64)
    row_of[table.scan, table.beam] = np.arange(len(table))
    near = np.abs(table.ranges - table.expected_ranges) < NEAR_WALL + NEAR_WALL_SHARE * table.expected_ranges
    near &= (table.ranges < table.max_range) & ~table.hits_nothing
    first = np.flatnonzero(near & (partner[table.beam] > table.beam))
    second = row_of[table.scan[first], partner[table.beam[first]]]
    both = (second >= 0) & near[second]
    return first[both], second[both]


def _opposite(mounts: FloatArray) -> NDArray[np.int64]:
    """(k,) index of the beam that points the opposite way from the same place; -1 if there is none."""
    turn = np.abs(wrap_angle(mounts[:, None, 2] - mounts[None, :, 2] + np.pi))
    apart = np.hypot(mounts[:, None, 0] - mounts[None, :, 0], mounts[:, None, 1] - mounts[None, :, 1])
    turn[apart > SAME_ORIGIN] = np.inf
    best = turn.argmin(axis=1)
    # Mutual partners only, so that each pair counts once.
    good = (turn[np.arange(len(best)), best] < OPPOSITE_TOLERANCE) & (best[best] == np.arange(len(best)))
    return np.where(good, best, -1)


def _robust_line(x: FloatArray, y: FloatArray) -> tuple[float, float, NDArray[np.bool_]]:
    """Slope, intercept and which points (n,) count, by iteratively reweighted least squares with Tukey's weights."""
    difference = y - x
    widest = 1.4826 * float(np.median(np.abs(difference - np.median(difference))))
    slope, intercept = 1.0, float(np.median(difference))
    for _ in range(20):
        residual = y - slope * x - intercept
        # People shorten readings, those of near walls most: how far noise reaches shows beyond the line alone.
        beyond = float(np.median(residual[residual > 0.0])) if (residual > 0.0).any() else 0.0
        spread = max(min(widest, 1.4826 * beyond), 1e-3)
        weight = np.clip(1.0 - (residual / (TUKEY * spread)) ** 2, 0.0, None) ** 2
        total = weight.sum()
        if total <= 0:
            break
        mx, my = (weight * x).sum() / total, (weight * y).sum() / total
        sxx = (weight * (x - mx) ** 2).sum()
        if sxx <= 1e-9 * total:
            break
        slope = float((weight * (x - mx) * (y - my)).sum() / sxx)
        intercept = float(my - slope * mx)
    return slope, intercept, weight > 0.0


def map_findings(pairs: OppositeBeams | None, resolution: float, *, drawn: bool = False) -> Iterator[Finding]:
    """Report walls that are drawn too thick, or a wrong scale of the map.

    If the map was drawn from the log itself, its cells are as large as they are said to be.
    """
    if pairs is None:
        return
    values = {
        "n_pairs": float(pairs.n_pairs),
        "median_difference": pairs.median_difference,
        "scale": pairs.scale,
        "scale_se": pairs.scale_se,
        "widening": pairs.widening,
        "widening_se": pairs.widening_se,
    }
    # At a scale surely wrong by more than 1%; by less, the walls' thickness is the larger error.
    if abs(pairs.scale - 1.0) > max(MOST_SCALE_ERROR + 2.0 * pairs.scale_se, 4.0 * pairs.scale_se):
        yield Finding(
            "map-scale",
            "warning",
            f"The map seems to have the wrong scale: distances between opposite walls measure {pairs.scale:.3f} "
            f"times the mapped ones (standard error {pairs.scale_se:.3f}).",
            values,
            why="Every expected range is wrong by this factor, far ones most.",
            do="The map is drawn from this log, so the poses drift: give better ones, or a map."
            if drawn
            else f"Check the map's resolution: {resolution * pairs.scale:.5g} m instead of {resolution:.5g} m would "
            f"fit. If the distances of the odometry fit the map, the ranges are {abs(pairs.scale - 1.0):.1%} too "
            f"{'long' if pairs.scale > 1.0 else 'short'} instead.",
        )
    elif abs(pairs.median_difference) > max(1.5 * resolution, 0.06):
        narrow = pairs.median_difference > 0
        yield Finding(
            "walls-too-thick" if narrow else "walls-too-thin",
            "warning",
            f"The lidar measures {abs(pairs.median_difference):.2f} m {'more' if narrow else 'less'} between "
            f"opposite walls than the map shows ({pairs.n_pairs} pairs of opposite beams; this hardly depends on "
            f"the pose). The map's walls are drawn too {'thick' if narrow else 'thin'}, by "
            f"{abs(pairs.median_difference) / 2:.2f} m on each side.",
            values,
            why="sigma_hit and range_offset then describe the map, not the sensor.",
            do="For the sensor's own noise redraw the map with finer cells; to localize in this map, go on.",
        )
