"""The ascent on the likelihood field of scans (Figure 6.11) that aligns a scan.

Notation: (nx, ny) is the normal of an element of the field, its tangent is (-ny, nx).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import integer, kernel
from beamfield.kernels.scan_field import (
    NONE,
    NX,
    NY,
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
# Stride of all end points.
EVERY = integer(1)


@kernel
def linearise(points: Floats, pose: Floats, stride: int, sigma: float, reach: float, view: FieldView,
              gradient: Floats, information: Floats) -> tuple[float, float, float, float]:  # fmt: skip
    """Fill gradient (3,) and Gauss-Newton information (3, 3) of the score at a pose, both times sigma squared.

    Only every stride-th end point counts. The score is the sum of log(density / unseen density): an end point in unseen
    space adds nothing. Each end point's pull on its nearest element has the weight of `point_density`'s share. The
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
        p, share = point_density(square, free, sigma, view)
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
           steps: int, view: FieldView) -> tuple[float, bool]:  # fmt: skip
    """Move the pose (3,) uphill at one sigma by damped Gauss-Newton steps; return the score and whether it converged.

    Steps shorter than `tolerance` (metres, a turn times the lever) end the ascent. Directions that less than
    `threshold` of the weight determines are left alone. `lever` (metres) makes turning comparable with moving.
    """
    gradient, information = np.zeros(3), np.zeros((3, 3))
    reach = 4.0 * sigma
    score, weight, _, _ = linearise(points, pose, stride, sigma, reach, view, gradient, information)
    trial, move, g, h = np.empty(3), np.empty(3), np.zeros(3), np.zeros((3, 3))
    scale = np.array([1.0, 1.0, 1.0 / lever])
    damping = 1e-3
    for _ in range(steps):
        if weight < 1e-9:
            return score, False
        size = _newton_step(gradient, information, weight, scale, threshold, damping, move)
        if size < tolerance:
            return score, True
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
                return score, True
    return score, False


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
        _, weight, _, _ = linearise(points, pose, EVERY, sigma, 4.0 * sigma, view, gradient, information)
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
    scaled = np.empty((3, 3))
    for a in range(3):  # np.outer takes three seconds to compile
        for b in range(3):
            scaled[a, b] = information[a, b] * (scale[a] * scale[b]) / weight
    values, vectors = np.linalg.eigh(scaled)
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
