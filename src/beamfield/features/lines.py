"""Lines in a scan (6.6.1)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from beamfield.arguments import checked, require
from beamfield.errors import InvalidInputError
from beamfield.features.partition import straight_pieces
from beamfield.features.straight_line import Line, fit_line
from beamfield.features.sweep import RangeNoise, Sweep, split_at_gaps, sweeps
from beamfield.sensors import Scan

# Two pieces are one wall unless chance makes them differ so much once in a thousand times (two degrees of freedom).
SAME_LINE = float(chdtri(2, 1e-3))
# How many pieces ahead the other half of a wall is looked for.
NEXT_PIECES = 3
# Curved surfaces are not lines: a fit this bad happens to a straight wall once in a million times.
BAD_FIT = 1e-6


@checked
def find_lines(
    scan: Scan, noise: RangeNoise, *, min_points: int = 6, min_length: float = 0.3, max_gap: float = 0.5
) -> list[Line]:
    """Return the straight walls in a scan, in order of bearing for each of its sweeps.

    The end points are split at gaps, each run is cut into straight pieces at the least total cost, and close
    pieces of one line are joined (behind a pole, or on both sides of a wrong reading).

    Parameters
    ----------
    scan
        Ranges of any finder. NaN, too short readings and those without return are passed over.
    noise
        Of single readings: the only scale there is. Too small, and walls come in pieces; too large, and flat corners
        are lost.
    min_points
        Fewest beams of a line, at least 3.
    min_length
        Shortest line, metres.
    max_gap
        Widest hole in a wall that is bridged, metres.

    Raises
    ------
    InvalidInputError
        If a limit makes no sense.

    Examples
    --------
    >>> import numpy as np
    >>> from beamfield.sensors import RangeFinder, Scan
    >>> finder = RangeFinder.from_bearings(np.linspace(-0.5, 0.5, 30), max_range=10.0)
    >>> [wall] = find_lines(Scan(2.0 / np.cos(finder.bearings), finder), RangeNoise(0.01))
    >>> bool(np.allclose(wall.measurement, [2.0, 0.0, 4.0 * np.tan(0.5)]))
    True
    """
    if min_points < 3:
        raise InvalidInputError(f"min_points: expected at least 3, got {min_points}")
    require(min_length >= 0.0, "min_length", "a number of metres >= 0", min_length)
    lines = []
    for number, sweep in enumerate(sweeps(scan)):
        runs = split_at_gaps(sweep, noise, max_gap=max_gap)
        if sweep.closed and runs and np.hypot(*(sweep.points[runs[0][0]] - sweep.points[runs[-1][-1]])) <= max_gap:
            runs = mend_start(sweep, runs, noise, min_points)
        pieces = [piece for run in runs for piece in straight_pieces(sweep, run, noise, min_points=min_points)]
        lines += join_pieces(sweep, pieces, noise, max_gap, number)
    return [line for line in lines if line.length >= min_length and fits(line)]


def mend_start(
    sweep: Sweep, runs: list[NDArray[np.int64]], noise: RangeNoise, min_points: int
) -> list[NDArray[np.int64]]:
    """Return the runs of a full turn without the cut at its start, which leaves too few points of a wall on one side.

    A single run around the whole room is cut where a first pass finds the end of a wall.
    """
    if len(runs) > 1:
        return [*runs[1:-1], np.concatenate([runs[-1], runs[0]])]
    pieces = straight_pieces(sweep, runs[0], noise, min_points=min_points)
    if not pieces:
        return runs
    return [np.roll(runs[0], -1 - int(np.searchsorted(runs[0], pieces[0][-1])))]


def join_pieces(
    sweep: Sweep, pieces: list[NDArray[np.int64]], noise: RangeNoise, max_gap: float, number: int
) -> list[Line]:
    """Return one line per wall: close pieces are joined while they agree and the hole between them is small."""
    places, lines = list(pieces), [fit_line(sweep, piece, noise, number=number) for piece in pieces]
    here = 0
    while here < len(places):
        for after in following(here, len(places), sweep.closed):
            if np.hypot(*(lines[after].start - lines[here].end)) > max_gap:
                continue
            joined = same_wall(sweep, places[here], places[after], lines[here], lines[after], noise)
            if joined is not None:
                places[here], lines[here] = np.concatenate([places[here], places[after]]), joined
                del places[after], lines[after]
                # Across the start of a full turn the joined wall stays the last one, and all places move up.
                here -= after < here
                break
        else:
            here += 1
    return lines


def following(here: int, count: int, closed: bool) -> list[int]:
    """Return the next few pieces: something small in front of a wall may lie between its halves."""
    ahead = range(here + 1, here + 1 + min(NEXT_PIECES, count - 1))
    return [after % count for after in ahead if after < count or closed]


def same_wall(
    sweep: Sweep, first: NDArray[np.int64], second: NDArray[np.int64], one: Line, two: Line, noise: RangeNoise
) -> Line | None:
    """Return the common line of two pieces, or None if it explains them worse than chance allows."""
    joined = fit_line(sweep, np.concatenate([first, second]), noise, number=one.sweep)
    return joined if joined.chi_square - one.chi_square - two.chi_square < SAME_LINE else None


def fits(line: Line) -> bool:
    """Return whether the residuals are those of a straight wall."""
    return line.chi_square <= float(chdtri(len(line.beams) - 2, BAD_FIT))
