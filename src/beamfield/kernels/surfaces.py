"""The surfaces that a scan measured, as rows of small line elements ("surfels").

One element stands for an end point and its neighbours on the same surface, more where two neighbouring end points lie
far apart. Notation: (nx, ny) is an element's normal, its tangent is (-ny, nx).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel

Floats = NDArray[np.float64]

# Columns of an element: a point on it, its normal, how far it reaches against and along its tangent, how it pulls, how
# many end points it stands for, to how many it was fitted (1 for a point), and the deviation of those across it (NaN
# for a point, and in gaps). `kernels.scan_field` has the same numbers.
X, Y, NX, NY, BACK, AHEAD, PULL, COUNT, FITTED, OFF, COLUMNS = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10
# A line pulls across, a point from all sides. A lone end point does not pull at all: where surfaces are seen sparsely
# (the far end of a corridor), the next scan meets them elsewhere; and random and short readings are lone end points.
LINE, POINT, NONE = 1.0, 0.0, -1.0

# End points of neighbouring beams lie on one surface if their gap is at most this long ...
LONGEST_GAP = 1.0
# ... and not seen more grazingly than this (sine of 8 degrees), which is how edges of what stands in front look ...
SMALLEST_SINE = 0.139
# ... or if they are this close anyway, or this many deviations of the noise: it turns short gaps into any direction.
# Both are at most as long as the longest gap: callers have room for the elements that fill that one.
NOISY_GAP, NOISY_GAP_DEVIATIONS = 0.1, 6.0
# A line is fitted to the end points of one surface within this distance, or to the neighbours if they are further.
FIT_RADIUS = 0.15
# The distance is doubled, up to this one, while the end points lie off the line by no more than their noise does.
WIDEST_FIT = 0.7
NOISE_FACTOR, NOISE_MARGIN = 1.3, 0.003
# The end points around a line scatter across it by less than this share of their scatter along it.
FLATNESS = 0.2
# Longer stretches between end points get elements of their own, about this long.
ELEMENT = 0.25
# End points of one surface that lie closer to each other than this share an element.
SHORTEST_ELEMENT = 0.05

# Beams see free space as far as halfway to their neighbours, but never further aside than this (3 degrees).
WIDEST_BEAM = 0.0524


@kernel
def find_surfaces(
    mounts: Floats, ranges: Floats, opening: float, noise: float, joined: NDArray[np.bool_], half_width: Floats
) -> None:
    """Fill joined (k,): beam i and the next lie on one surface; and half_width (k,): how far aside beam i sees.

    `mounts` (k, 3) of one origin in the order of their directions, the last next to the first; `ranges` (k,), NaN
    without end point; their `noise`, 0 if unknown.
    """
    noisy_gap = min(max(NOISY_GAP, NOISY_GAP_DEVIATIONS * noise), LONGEST_GAP)
    k = ranges.size
    for i in range(k):
        j = (i + 1) % k
        h = (i - 1) % k
        ahead = (mounts[j, 2] - mounts[i, 2]) % (2.0 * math.pi)
        behind = (mounts[i, 2] - mounts[h, 2]) % (2.0 * math.pi)
        nearest = min(ahead, behind) if k > 2 else ahead
        half_width[i] = max(min(0.5 * nearest if k > 1 else 0.0, WIDEST_BEAM), 0.5 * opening)
        joined[i] = False
        if k > 1 and ahead < 4.0 * WIDEST_BEAM and ranges[i] >= 0.0 and ranges[j] >= 0.0:
            dx = ranges[j] * math.cos(ahead) - ranges[i]
            dy = ranges[j] * math.sin(ahead)
            gap = math.hypot(dx, dy)
            # The gap's angle with the beam halfway between the two.
            sine = abs(dy * math.cos(0.5 * ahead) - dx * math.sin(0.5 * ahead))
            joined[i] = gap <= noisy_gap or (gap <= LONGEST_GAP and sine >= SMALLEST_SINE * gap)


def range_noise(bearings: Floats, ranges: Floats, joined: NDArray[np.bool_]) -> float:
    """Return the standard deviation of a scan's ranges, metres: how far they lie off the line of both neighbours.

    Bearings (k,) in order; 0 if fewer than three end points have neighbours on both sides.
    """
    off = np.empty(joined.size)
    n = fill_deviations(bearings, ranges, joined, off)
    # The median absolute deviation: corners and edges do not count. NumPy's own: Numba's takes a second to compile.
    return float(np.median(off[:n]) / 0.6745) if n >= 3 else 0.0


@kernel
def fill_deviations(bearings: Floats, ranges: Floats, joined: NDArray[np.bool_], out: Floats) -> int:
    """Fill out (k,) with how far end points lie off the line of both neighbours, metres; return how many have both."""
    k = joined.size
    n = 0
    for i in range(k):
        h, j = (i - 1) % k, (i + 1) % k
        if k < 3 or not (joined[h] and joined[i]):
            continue
        ahead = (bearings[j] - bearings[i]) % (2.0 * math.pi)
        behind = (bearings[i] - bearings[h]) % (2.0 * math.pi)
        if ahead + behind <= 0.0:
            continue
        # Along a line, the inverse range is a sine of the bearing.
        a = math.sin(behind) / math.sin(ahead + behind)
        b = math.sin(ahead) / math.sin(ahead + behind)
        expected = 1.0 / (a / max(ranges[j], 1e-6) + b / max(ranges[h], 1e-6))
        out[n] = abs(ranges[i] - expected) / math.sqrt(1.0 + a * a + b * b)
        n += 1
    return n


@kernel
def fit_elements(points: Floats, ranges: Floats, joined: NDArray[np.bool_], noise: float, out: Floats) -> int:
    """Fill out (>= 5 k, COLUMNS) with the elements of the end points (k, 2) of one origin; return how many there are.

    `noise` is that of `range_noise`. Where beams are dense, it makes a wall's nearest end points look like a cloud that
    has no direction, or any; a line through more of them has the wall's.
    """
    allowed = NOISE_FACTOR * noise + NOISE_MARGIN
    k = ranges.size
    n, kept = 0, -1
    # Begin with the begin of a surface, so that turning the sensor changes no element.
    first = 0
    while first < k - 1 and joined[first - 1]:
        first += 1
    for m in range(k):
        i = (first + m) % k
        if not joined[i - 1]:
            kept = -1
        if not ranges[i] >= 0.0:
            continue
        h, j = (i - 1) % k, (i + 1) % k
        gap_ahead = _gap(points, i, j) if joined[i] else 0.0
        if kept >= 0 and joined[i] and _gap(points, i, kept) < SHORTEST_ELEMENT and gap_ahead <= ELEMENT:
            # The line through the neighbour's surroundings is the same: let it reach further.
            dx, dy = points[i, 0] - out[n - 1, X], points[i, 1] - out[n - 1, Y]
            along = dy * out[n - 1, NX] - dx * out[n - 1, NY]
            out[n - 1, AHEAD] = along + 0.5 * gap_ahead
            out[n - 1, COUNT] += 1.0
            continue
        gap_behind = _gap(points, h, i) if k > 1 and joined[h] else 0.0
        radius = max(FIT_RADIUS, 1.01 * max(gap_ahead, gap_behind))
        cx, cy, nx, ny, fitted, off = _fit_line(points, joined, i, radius)
        across = off
        while off <= allowed and 2.0 * radius <= WIDEST_FIT:
            radius *= 2.0
            wide_x, wide_y, wide_nx, wide_ny, wide_fitted, off = _fit_line(points, joined, i, radius)
            if off <= allowed:
                cx, cy, nx, ny, fitted, across = wide_x, wide_y, wide_nx, wide_ny, wide_fitted, off
        flat = fitted > 0.0
        # The tangent points along the beams' order, so that AHEAD is towards the next end point.
        a, b = (i, j) if joined[i] else (h, i)
        if (points[b, 0] - points[a, 0]) * -ny + (points[b, 1] - points[a, 1]) * nx < 0.0:
            nx, ny = -nx, -ny
        along = (points[i, 0] - cx) * -ny + (points[i, 1] - cy) * nx
        out[n, X] = cx - ny * along if flat else points[i, 0]
        out[n, Y] = cy + nx * along if flat else points[i, 1]
        out[n, NX], out[n, NY] = nx, ny
        reach_ahead, reach_behind = min(0.5 * gap_ahead, 0.5 * ELEMENT), min(0.5 * gap_behind, 0.5 * ELEMENT)
        # At the end of a surface the true end lies somewhere before the next beam.
        out[n, AHEAD] = (reach_ahead if joined[i] else reach_behind) if flat else 0.0
        out[n, BACK] = (reach_behind if gap_behind > 0.0 else reach_ahead) if flat else 0.0
        dense = (joined[i] or joined[h]) and max(gap_ahead, gap_behind) <= FIT_RADIUS
        out[n, PULL] = LINE if flat else POINT if dense else NONE
        out[n, COUNT] = 1.0
        out[n, FITTED] = fitted if flat else 1.0
        out[n, OFF] = across if flat else math.nan
        n += 1
        kept = i if flat else -1
        if gap_ahead > ELEMENT:
            n = _fill_gap(points, i, j, gap_ahead, n, out)
            kept = -1
    return n


@kernel
def _gap(points: Floats, i: int, j: int) -> float:
    """Return the distance of two end points."""
    return math.hypot(points[j, 0] - points[i, 0], points[j, 1] - points[i, 1])


@kernel
def _fit_line(
    points: Floats, joined: NDArray[np.bool_], i: int, radius: float
) -> tuple[float, float, float, float, float, float]:
    """Return mean, normal, number (0 if they are not flat) and deviation of i's surface's end points within a radius.

    The deviation, across the line, is inf for fewer than three.
    """
    k = points.shape[0]
    x0, y0 = points[i, 0], points[i, 1]
    count, sx, sy, sxx, sxy, syy = 1.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for direction in (1, -1):
        j = i
        for _ in range(k - 1):
            if not joined[j if direction == 1 else (j - 1) % k]:
                break
            j = (j + direction) % k
            dx, dy = points[j, 0] - x0, points[j, 1] - y0
            if dx * dx + dy * dy > radius * radius:
                break
            count += 1.0
            sx += dx
            sy += dy
            sxx += dx * dx
            sxy += dx * dy
            syy += dy * dy
    mx, my = sx / count, sy / count
    cxx, cxy, cyy = sxx / count - mx * mx, sxy / count - mx * my, syy / count - my * my
    half_trace, half_difference = 0.5 * (cxx + cyy), 0.5 * (cxx - cyy)
    root = math.hypot(half_difference, cxy)
    small, large = half_trace - root, half_trace + root
    angle = 0.5 * math.atan2(2.0 * cxy, cxx - cyy)
    flat = count >= 3.0 and small <= FLATNESS * FLATNESS * large
    off = math.sqrt(max(small, 0.0) * count / (count - 2.0)) if count > 2.0 else math.inf
    return x0 + mx, y0 + my, -math.sin(angle), math.cos(angle), count if flat else 0.0, off


@kernel
def _fill_gap(points: Floats, i: int, j: int, gap: float, n: int, out: Floats) -> int:
    """Append elements between two end points of one surface; return the new number of elements."""
    pieces = math.ceil(gap / ELEMENT)
    dx, dy = points[j, 0] - points[i, 0], points[j, 1] - points[i, 1]
    for m in range(1, pieces):
        out[n, X] = points[i, 0] + dx * m / pieces
        out[n, Y] = points[i, 1] + dy * m / pieces
        out[n, NX], out[n, NY] = dy / gap, -dx / gap
        out[n, AHEAD] = out[n, BACK] = 0.5 * gap / pieces
        out[n, PULL] = LINE
        # It rests on the two end points beside the gap, which have elements of their own.
        out[n, COUNT] = 0.0
        # (1 - t)^2 + t^2 on average.
        out[n, FITTED] = 1.5
        out[n, OFF] = math.nan
        n += 1
    return n
