"""Cut a run of end points into straight pieces, at the least cost over all ways to cut it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.features.sweep import RangeNoise, Sweep
from beamfield.geometry import FloatArray

# In units of chi-square: what one more piece must explain, and an outlier: beyond 3.5 sigma.
PIECE_COST, OUTLIER_COST = 25.0, 12.0


def straight_pieces(
    sweep: Sweep, places: NDArray[np.int64], noise: RangeNoise, *, min_points: int
) -> list[NDArray[np.int64]]:
    """Return the pieces of a run that are straight within the noise of single readings.

    Every point belongs to a piece of at least min_points (3 or more) or is an outlier. The cost is the sum of the
    pieces' chi-squares, `PIECE_COST` for each piece and `OUTLIER_COST` for each outlier; dynamic programming finds the
    least. Split and merge looks for the same cuts but stops at the first that seems good.
    """
    n = len(places)
    sums = cumulated_normal_equations(sweep, places, noise)
    best = np.zeros(n + 1)
    # Where the last piece up to a point starts; -1: the point is an outlier.
    cut = np.full(n + 1, -1, dtype=np.int64)
    for stop in range(1, n + 1):
        best[stop] = best[stop - 1] + OUTLIER_COST
        if stop >= min_points:
            starts = stop - min_points + 1
            total = best[:starts] + chi_squares(sums[stop] - sums[:starts]) + PIECE_COST
            start = int(np.argmin(total))
            if total[start] < best[stop]:
                best[stop], cut[stop] = total[start], start
    pieces = []
    stop = n
    while stop > 0:
        if cut[stop] < 0:
            stop -= 1
        else:
            pieces.append(places[cut[stop] : stop])
            stop = int(cut[stop])
    return pieces[::-1]


def cumulated_normal_equations(sweep: Sweep, places: NDArray[np.int64], noise: RangeNoise) -> FloatArray:
    """Return (n + 1, 6) running sums from which every piece's chi-square follows.

    A line that misses the sensor is g . p = 1. A range error e moves g . p by e / r, so that r (1 - g . p) / sigma is
    the normalised range error: linear in g, and right at every incidence. A bearing error is taken at 45 degrees.
    """
    points = sweep.points[places] - sweep.origins[places].mean(axis=0)
    x, y = points.T
    z = sweep.ranges[places]
    weight = 1.0 / ((noise.along(z) / np.maximum(z, 1e-9)) ** 2 + noise.sigma_bearing**2)
    terms = weight[:, None] * np.column_stack([x * x, x * y, y * y, x, y, np.ones_like(x)])
    return np.vstack([np.zeros(6), np.cumsum(terms, axis=0)])


def chi_squares(sums: FloatArray) -> FloatArray:
    """Return the least sum of squares for each row of differences of running sums; inf where it is undefined."""
    xx, xy, yy, x, y, one = sums.T
    determinant = xx * yy - xy * xy
    explained = yy * x * x - 2.0 * xy * x * y + xx * y * y
    usable = determinant > 1e-14 * xx * yy
    ratio = np.divide(explained, determinant, out=np.full(len(one), -np.inf), where=usable)
    least: FloatArray = np.maximum(one - ratio, 0.0)
    return least
