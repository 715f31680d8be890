"""The likelihood field of scans (Figure 6.11).

Measured surfaces are the line elements of `kernels.surfaces`. Distances to them are exact, there is no grid of
distances: a scan is used for a few alignments only, and a grid would cost more than all of them. Buckets of cells find
the elements near a point.

Free space is what a beam has passed: per origin of beams, their bearings in order and the ranges. Notation: (nx, ny) is
an element's normal, its tangent is (-ny, nx).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel, shared

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

INV_SQRT_2PI = 0.3989422804014327

# As in `kernels.surfaces`, whose elements these are: constants of other files would not renew a cached kernel.
X, Y, NX, NY, BACK, AHEAD, PULL, COUNT, FITTED, OFF, COLUMNS = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10
POINT, NONE = 0.0, -1.0
ELEMENT, SHORTEST_ELEMENT = 0.25, 0.05
# An element that stands for several end points reaches this far from its middle.
LONGEST_HALF = 0.5 * ELEMENT + SHORTEST_ELEMENT


class FieldView(NamedTuple):
    """What the kernels need to know of a field: elements in buckets, beams by origin, and the densities."""

    elements: Floats
    bucket_start: Integers
    bucket_items: Integers
    left: float
    bottom: float
    bucket: float
    rows: int
    cols: int
    origins: Floats
    beam_start: Integers
    bearings: Floats
    passed: Floats
    half_width: Floats
    joined: NDArray[np.bool_]
    z_hit: float
    z_rand: float
    unseen_density: float
    random_density: float


@kernel
def fill_buckets(
    elements: Floats, left: float, bottom: float, bucket: float, cols: int, start: Integers, items: Integers
) -> None:
    """Sort elements (m, COLUMNS) into buckets: bucket b is items[start[b] : start[b + 1]]; start is all 0 before."""
    for i in range(elements.shape[0]):
        start[_bucket_of(elements, i, left, bottom, bucket, cols) + 1] += 1
    for b in range(1, start.size):
        start[b] += start[b - 1]
    for i in range(elements.shape[0] - 1, -1, -1):
        # start[b + 1] is the end of bucket b, and moves down to its start.
        b = _bucket_of(elements, i, left, bottom, bucket, cols)
        start[b + 1] -= 1
        items[start[b + 1]] = i
    for b in range(start.size - 1):
        start[b] = start[b + 1]
    start[-1] = elements.shape[0]


@kernel
def _bucket_of(elements: Floats, i: int, left: float, bottom: float, bucket: float, cols: int) -> int:
    """Return the bucket of an element."""
    return int((elements[i, Y] - bottom) / bucket) * cols + int((elements[i, X] - left) / bucket)


@kernel
def nearest_element(x: float, y: float, reach: float, view: FieldView) -> tuple[int, float]:
    """Return the element nearest to a point and the squared distance to it; -1 and inf if none is within reach."""
    best, best_square = -1, reach * reach
    radius = reach + LONGEST_HALF
    first_col = max(math.floor((x - radius - view.left) / view.bucket), 0)
    last_col = min(math.floor((x + radius - view.left) / view.bucket), view.cols - 1)
    first_row = max(math.floor((y - radius - view.bottom) / view.bucket), 0)
    last_row = min(math.floor((y + radius - view.bottom) / view.bucket), view.rows - 1)
    for row in range(first_row, last_row + 1):
        # The buckets of a row follow one another.
        if last_col < first_col:
            break
        for m in range(
            view.bucket_start[row * view.cols + first_col], view.bucket_start[row * view.cols + last_col + 1]
        ):
            i = view.bucket_items[m]
            dx, dy = x - view.elements[i, X], y - view.elements[i, Y]
            across = dx * view.elements[i, NX] + dy * view.elements[i, NY]
            along = dy * view.elements[i, NX] - dx * view.elements[i, NY]
            beyond = max(max(along - view.elements[i, AHEAD], -along - view.elements[i, BACK]), 0.0)
            square = across * across + beyond * beyond
            if square < best_square:
                best, best_square = i, square
    return best, best_square if best >= 0 else math.inf


@kernel
def free_share(x: float, y: float, width: float, view: FieldView) -> float:
    """Return 0 where no beam has passed, 1 where one has passed and gone on for `width` metres, smoothly between."""
    share = 0.0
    for g in range(view.origins.shape[0]):
        dx, dy = x - view.origins[g, 0], y - view.origins[g, 1]
        limit = _passed(math.atan2(dy, dx), view.beam_start[g], view.beam_start[g + 1], view)
        t = (limit - math.hypot(dx, dy)) / width
        if t > 0.0:
            t = min(t, 1.0)
            share = max(share, t * t * (3.0 - 2.0 * t))
    return share


@kernel
def _passed(bearing: float, first: int, stop: int, view: FieldView) -> float:
    """Return how far the beams of one origin have seen in a direction; 0 if none looked there."""
    low, high = first, stop
    while low < high:
        middle = (low + high) // 2
        if view.bearings[middle] < bearing:
            low = middle + 1
        else:
            high = middle
    after = low if low < stop else first
    before = low - 1 if low > first else stop - 1
    to_after = (view.bearings[after] - bearing) % (2.0 * math.pi)
    to_before = (bearing - view.bearings[before]) % (2.0 * math.pi)
    if view.joined[before] and before != after:
        # Along a straight wall the inverse range is a sine of the bearing: over one step, nearly linear.
        share = to_before / (to_before + to_after)
        inverse = (1.0 - share) / max(view.passed[before], 1e-6) + share / max(view.passed[after], 1e-6)
        return float(1.0 / inverse)
    if to_before <= to_after:
        return view.passed[before] if to_before <= view.half_width[before] else 0.0
    return view.passed[after] if to_after <= view.half_width[after] else 0.0


@shared
def point_density(square: float, free: float, sigma: float, view: FieldView) -> tuple[float, float]:
    """Return the density at a point and the share in it of the nearest surface."""
    hit = view.z_hit * INV_SQRT_2PI / sigma * math.exp(-0.5 * square / (sigma * sigma)) if square < math.inf else 0.0
    p = hit + free * view.random_density + (1.0 - free) * view.unseen_density
    return p, hit / p


@kernel
def fill_field(points: Floats, reach: float, width: float, sigma: float, view: FieldView,
               density: Floats, distance: Floats, free: Floats) -> None:  # fmt: skip
    """Fill density, distance (inf beyond reach) and free share (n,) at points (n, 2)."""
    for i in range(points.shape[0]):
        _, square = nearest_element(points[i, 0], points[i, 1], reach, view)
        free[i] = free_share(points[i, 0], points[i, 1], width, view)
        density[i], _ = point_density(square, free[i], sigma, view)
        distance[i] = math.sqrt(square)


@kernel
def fill_scores(points: Floats, poses: Floats, reach: float, width: float, sigma: float, view: FieldView,
                out: Floats) -> None:  # fmt: skip
    """Fill out (n,) with the sum of log densities of the end points (k, 2) seen from poses (n, 3)."""
    for i in range(poses.shape[0]):
        cos, sin = math.cos(poses[i, 2]), math.sin(poses[i, 2])
        total = 0.0
        for j in range(points.shape[0]):
            x = poses[i, 0] + cos * points[j, 0] - sin * points[j, 1]
            y = poses[i, 1] + sin * points[j, 0] + cos * points[j, 1]
            _, square = nearest_element(x, y, reach, view)
            p, _ = point_density(square, free_share(x, y, width, view), sigma, view)
            total += math.log(p)
        out[i] = total
