"""How far the pulls of a scan's end points scatter on the likelihood field of another (Figure 6.11).

Notation: (nx, ny) is the normal of an element of the field, its tangent is (-ny, nx).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel
from beamfield.kernels.scan_field import (
    COUNT,
    FITTED,
    NONE,
    NX,
    NY,
    OFF,
    POINT,
    PULL,
    FieldView,
    X,
    Y,
    free_share,
    nearest_element,
    point_density,
)

Floats = NDArray[np.float64]

# A patch of surface has at least this many end points, so that its noise shows what their mean may be off.
FEWEST_IN_PATCH = 4.0
# What is summed per element: pulls (3), pulls of an offset of one metre (3), weighted squared residuals, weights.
SUMS = 8


@kernel
def sum_patches(points: Floats, pose: Floats, sigma: float, reach: float, patch: float, view: FieldView,
                sums: Floats, pulls: Floats, noise: Floats) -> None:  # fmt: skip
    """Fill pulls and noise (3, 3): two ways to say how `linearise`'s gradient scatters.

    `noise` holds if residuals err independently: squared pulls of the end points, and per patch of surface what the
    mean error of the field's own end points there pulls, by their scatter across the lines fitted to them (where there
    is none, as if they erred like the residuals). `pulls` sums the squares of whole patches' pulls, whatever makes them
    agree. A patch is a stretch of elements that follow one another, `patch`
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
        _, share = point_density(square, free_share(x, y, 2.0 * sigma, view), sigma, view)
        nx, ny = view.elements[i, NX], view.elements[i, NY]
        dx, dy = x - view.elements[i, X], y - view.elements[i, Y]
        # A residual has the element's noise too, an end point's over the number fitted; patches count that below.
        own = view.elements[i, FITTED] / (1.0 + view.elements[i, FITTED])
        _add_pull(i, nx, ny, dx * nx + dy * ny, share, own, rx, ry, sums, noise)
        if view.elements[i, PULL] == POINT:
            _add_pull(i, -ny, nx, dy * nx - dx * ny, share, own, rx, ry, sums, noise)
    total = np.zeros(SUMS)
    first, last, count = 0, 0, 0.0
    squares, fitted = 0.0, 0.0
    for i in range(sums.shape[0]):
        if view.elements[i, PULL] == NONE:
            continue
        long = _apart(view.elements, first, i) > patch and count >= FEWEST_IN_PATCH
        if long or _apart(view.elements, last, i) > patch:
            _add_patch(total, count, squares, fitted, pulls, noise)
            total[:] = 0.0
            first, count, squares, fitted = i, 0.0, 0.0, 0.0
        last = i
        count += view.elements[i, COUNT]
        if view.elements[i, OFF] >= 0.0:
            squares += view.elements[i, COUNT] * view.elements[i, OFF] ** 2
            fitted += view.elements[i, COUNT]
        for a in range(SUMS):
            total[a] += sums[i, a]
    _add_patch(total, count, squares, fitted, pulls, noise)


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
def _add_patch(total: Floats, count: float, squares: float, fitted: float, pulls: Floats, noise: Floats) -> None:
    """Add one patch with `count` of the field's end points; the squares of the `fitted` ones about their lines."""
    if total[7] <= 0.0:
        return
    # The scan may be of a better or worse sensor than the field: its residuals do not tell the field's noise.
    variance = (squares / fitted if fitted > 0.0 else total[6] / total[7]) / max(count, 1.0)
    for a in range(3):
        for b in range(3):
            pulls[a, b] += total[a] * total[b]
            noise[a, b] += variance * total[3 + a] * total[3 + b]
