"""The likelihood field of scans (Figure 6.11) and the ascent on it that aligns a scan.

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

from beamfield.kernels.jit import kernel

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

INV_SQRT_2PI = 0.3989422804014327

# As in `kernels.surfaces`, whose elements these are: constants of other files would not renew a cached kernel.
X, Y, NX, NY, BACK, AHEAD, PULL, COUNT, FITTED, COLUMNS = 0, 1, 2, 3, 4, 5, 6, 7, 8, 9
POINT, NONE = 0.0, -1.0
ELEMENT, SHORTEST_ELEMENT = 0.25, 0.05
# An element that stands for several end points reaches this far from its middle.
LONGEST_HALF = 0.5 * ELEMENT + SHORTEST_ELEMENT
# A patch of surface has at least this many end points, so that its noise shows what their mean may be off.
FEWEST_IN_PATCH = 4.0
# What is summed per element: pulls (3), pulls of an offset of one metre (3), weighted squared residuals, weights.
SUMS = 8


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


# --- indexing ---------------------------------------------------------------------------------------------------------


@kernel
def fill_buckets(
    elements: Floats, left: float, bottom: float, bucket: float, cols: int, start: Integers, items: Integers
) -> None:
    """Sort the elements (m, 9) into buckets: bucket b is items[start[b] : start[b + 1]]; start is all 0 before."""
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


# --- looking up -------------------------------------------------------------------------------------------------------


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


@kernel
def _point_density(square: float, free: float, sigma: float, view: FieldView) -> tuple[float, float]:
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
        density[i], _ = _point_density(square, free[i], sigma, view)
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
            p, _ = _point_density(square, free_share(x, y, width, view), sigma, view)
            total += math.log(p)
        out[i] = total


# --- ascending --------------------------------------------------------------------------------------------------------


@kernel
def linearise(points: Floats, pose: Floats, stride: int, sigma: float, reach: float, view: FieldView,
              gradient: Floats, information: Floats) -> tuple[float, float, float, float]:  # fmt: skip
    """Fill gradient (3,) and Gauss-Newton information (3, 3) of the score at a pose, both times sigma squared.

    Only every stride-th end point counts. The score is the sum of log(density / unseen density): an end point in unseen
    space adds nothing. Each end point's pull on its nearest element has the weight of `_point_density`'s share. The
    free share is taken to be constant. Returns the score, the sum of the weights, the weighted sum of squared distances
    and the number of end points in seen space.
    """
    gradient[:] = 0.0
    information[:] = 0.0
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    score, weight, squares, seen = 0.0, 0.0, 0.0, 0.0
    for j in range(0, points.shape[0], stride):
        rx = cos * points[j, 0] - sin * points[j, 1]
        ry = sin * points[j, 0] + cos * points[j, 1]
        x, y = pose[0] + rx, pose[1] + ry
        i, square = nearest_element(x, y, reach, view)
        free = free_share(x, y, 2.0 * sigma, view)
        p, share = _point_density(square, free, sigma, view)
        score += math.log(p / view.unseen_density)
        seen += max(share, free)
        if i < 0 or view.elements[i, PULL] == NONE:
            continue
        weight += share
        nx, ny = view.elements[i, NX], view.elements[i, NY]
        dx, dy = x - view.elements[i, X], y - view.elements[i, Y]
        across = dx * nx + dy * ny
        squares += share * across * across
        _add(nx, ny, across, share, rx, ry, gradient, information)
        if view.elements[i, PULL] == POINT:
            along = dy * nx - dx * ny
            squares += share * along * along
            _add(-ny, nx, along, share, rx, ry, gradient, information)
    for a in range(3):
        for b in range(a):
            information[a, b] = information[b, a]
    return score, weight, squares, seen


@kernel
def _add(nx: float, ny: float, residual: float, weight: float, rx: float, ry: float,
         gradient: Floats, information: Floats) -> None:  # fmt: skip
    """Add one residual along (nx, ny), which turning moves by the lever (-ry, rx)."""
    turn = rx * ny - ry * nx
    gradient[0] -= weight * residual * nx
    gradient[1] -= weight * residual * ny
    gradient[2] -= weight * residual * turn
    information[0, 0] += weight * nx * nx
    information[0, 1] += weight * nx * ny
    information[0, 2] += weight * nx * turn
    information[1, 1] += weight * ny * ny
    information[1, 2] += weight * ny * turn
    information[2, 2] += weight * turn * turn


@kernel
def ascend(points: Floats, pose: Floats, stride: int, sigma: float, lever: float, threshold: float, tolerance: float,
           steps: int, view: FieldView) -> tuple[float, bool, int]:  # fmt: skip
    """Move the pose (3,) uphill at one sigma by damped Gauss-Newton steps; return score, whether it converged, steps.

    Steps shorter than `tolerance` (metres, a turn times the lever) end the ascent. Directions that less than
    `threshold` of the weight determines are left alone. `lever` (metres) makes turning comparable with moving.
    """
    gradient, information = np.zeros(3), np.zeros((3, 3))
    reach = 4.0 * sigma
    score, weight, _, _ = linearise(points, pose, stride, sigma, reach, view, gradient, information)
    trial, move, g, h = np.empty(3), np.empty(3), np.zeros(3), np.zeros((3, 3))
    scale = np.array([1.0, 1.0, 1.0 / lever])
    damping = 1e-3
    for step in range(steps):
        if weight < 1e-9:
            return score, False, step
        size = _newton_step(gradient, information, weight, scale, threshold, damping, move)
        if size < tolerance:
            return score, True, step
        for a in range(3):  # not in one assignment: Numba would compile the text of its error, for a second
            trial[a] = pose[a] + move[a]
        trial_score, trial_weight, _, _ = linearise(points, trial, stride, sigma, reach, view, g, h)
        if trial_score >= score:
            score, weight = trial_score, trial_weight
            for a in range(3):
                pose[a], gradient[a] = trial[a], g[a]
                for b in range(3):
                    information[a, b] = h[a, b]
            damping = max(0.3 * damping, 1e-4)
        else:
            damping = max(10.0 * damping, 0.05)
            if damping > 1e4:
                return score, True, step
    return score, False, steps


@kernel
def settle(points: Floats, pose: Floats, sigma: float, lever: float, threshold: float, tolerance: float, steps: int,
           view: FieldView) -> None:  # fmt: skip
    """Move the pose (3,) near an optimum to where the end points' pulls balance, by undamped Gauss-Newton steps.

    The score has small steps where end points change from element to element, and the ascent stops at them; the pulls
    average over them. A step longer than sigma ends this without being taken.
    """
    gradient, information, move = np.zeros(3), np.zeros((3, 3)), np.empty(3)
    scale = np.array([1.0, 1.0, 1.0 / lever])
    for _ in range(steps):
        _, weight, _, _ = linearise(points, pose, 1, sigma, 4.0 * sigma, view, gradient, information)
        if weight < 1e-9:
            return
        size = _newton_step(gradient, information, weight, scale, threshold, 0.0, move)
        if size > sigma:
            return
        for a in range(3):
            pose[a] += move[a]
        if size < tolerance:
            return


@kernel
def _newton_step(gradient: Floats, information: Floats, weight: float, scale: Floats, threshold: float, damping: float,
                 move: Floats) -> float:  # fmt: skip
    """Fill move (3,) with a damped step along the determined directions; return its length in metres of end points."""
    values, vectors = np.linalg.eigh(information * np.outer(scale, scale) / weight)
    move[:] = 0.0
    square = 0.0
    for v in range(3):
        if values[v] < threshold:
            continue
        slope = 0.0
        for a in range(3):
            slope += vectors[a, v] * gradient[a] * scale[a]
        length = slope / weight / (values[v] + damping)
        square += length * length
        for a in range(3):
            move[a] += length * vectors[a, v] * scale[a]
    return math.sqrt(square)


# --- how far the pulls scatter ----------------------------------------------------------------------------------------


@kernel
def sum_patches(points: Floats, pose: Floats, sigma: float, reach: float, patch: float, view: FieldView,
                sums: Floats, pulls: Floats, noise: Floats) -> None:  # fmt: skip
    """Fill pulls and noise (3, 3): two ways to say how `linearise`'s gradient scatters.

    `noise` holds if residuals err independently: squared pulls of the end points, and per patch of surface what the
    mean error of the field's own end points there pulls, if they err like the residuals. `pulls` sums the squares of
    whole patches' pulls, whatever makes them agree. A patch is a stretch of elements that follow one another, `patch`
    metres long or longer where there are few end points. `sums` (m, SUMS) is work space, one row per element.
    """
    sums[:] = 0.0
    pulls[:] = 0.0
    noise[:] = 0.0
    cos, sin = math.cos(pose[2]), math.sin(pose[2])
    for j in range(points.shape[0]):
        rx = cos * points[j, 0] - sin * points[j, 1]
        ry = sin * points[j, 0] + cos * points[j, 1]
        x, y = pose[0] + rx, pose[1] + ry
        i, square = nearest_element(x, y, reach, view)
        if i < 0 or view.elements[i, PULL] == NONE:
            continue
        _, share = _point_density(square, free_share(x, y, 2.0 * sigma, view), sigma, view)
        nx, ny = view.elements[i, NX], view.elements[i, NY]
        dx, dy = x - view.elements[i, X], y - view.elements[i, Y]
        # A residual has the element's noise too, an end point's over the number fitted; patches count that below.
        own = view.elements[i, FITTED] / (1.0 + view.elements[i, FITTED])
        _add_pull(i, nx, ny, dx * nx + dy * ny, share, own, rx, ry, sums, noise)
        if view.elements[i, PULL] == POINT:
            _add_pull(i, -ny, nx, dy * nx - dx * ny, share, own, rx, ry, sums, noise)
    total = np.zeros(SUMS)
    first, last, count = 0, 0, 0.0
    for i in range(sums.shape[0]):
        if view.elements[i, PULL] == NONE:
            continue
        long = _apart(view.elements, first, i) > patch and count >= FEWEST_IN_PATCH
        if long or _apart(view.elements, last, i) > patch:
            _add_patch(total, count, pulls, noise)
            total[:] = 0.0
            first, count = i, 0.0
        last = i
        count += view.elements[i, COUNT]
        for a in range(SUMS):
            total[a] += sums[i, a]
    _add_patch(total, count, pulls, noise)


@kernel
def _add_pull(i: int, nx: float, ny: float, residual: float, weight: float, own: float, rx: float, ry: float,
              sums: Floats, noise: Floats) -> None:  # fmt: skip
    """Add one residual along (nx, ny) to the sums of its element, and `own` of its squared pull to the noise."""
    pull = (weight * nx, weight * ny, weight * (rx * ny - ry * nx))
    for a in range(3):
        sums[i, a] += residual * pull[a]
        sums[i, 3 + a] += pull[a]
        for b in range(3):
            noise[a, b] += own * residual * residual * pull[a] * pull[b]
    sums[i, 6] += weight * own * residual * residual
    sums[i, 7] += weight


@kernel
def _apart(elements: Floats, i: int, j: int) -> float:
    """Return the distance of two elements."""
    return math.hypot(elements[j, X] - elements[i, X], elements[j, Y] - elements[i, Y])


@kernel
def _add_patch(total: Floats, count: float, pulls: Floats, noise: Floats) -> None:
    """Add one patch, in which the field has `count` end points."""
    if total[7] <= 0.0:
        return
    variance = total[6] / total[7] / max(count, 1.0)
    for a in range(3):
        for b in range(3):
            pulls[a, b] += total[a] * total[b]
            noise[a, b] += variance * total[3 + a] * total[3 + b]
