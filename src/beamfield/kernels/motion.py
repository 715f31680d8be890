"""Loops over particles of motion models: draws from given standard normals, and densities of single steps.

A rotation-translation-rotation comes as (rotation_1, translation, rotation_2, their three standard deviations, and the
standard deviations of position and heading noise that is added at the end).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import inlined_kernel, kernel

Floats = NDArray[np.float64]

# A component without noise is met if it is met this closely, metres or radians; the pole of the polar coordinates is
# cut off at this distance.
EXACT = 1e-9
_LOG_SQRT_2PI = 0.5 * math.log(2.0 * math.pi)


@kernel
def fill_gaussian_samples(poses: Floats, normals: Floats, mean: Floats, root: Floats, out: Floats) -> None:
    """Move each pose by mean + root @ normals, in its own frame: (n, 3), (n, 3), (3,), (3, 3) -> (n, 3)."""
    for i in range(poses.shape[0]):
        a, b, c = normals[i, 0], normals[i, 1], normals[i, 2]
        ahead = mean[0] + root[0, 0] * a + root[0, 1] * b + root[0, 2] * c
        left = mean[1] + root[1, 0] * a + root[1, 1] * b + root[1, 2] * c
        turn = mean[2] + root[2, 0] * a + root[2, 1] * b + root[2, 2] * c
        cos, sin = math.cos(poses[i, 2]), math.sin(poses[i, 2])
        out[i, 0] = poses[i, 0] + cos * ahead - sin * left
        out[i, 1] = poses[i, 1] + sin * ahead + cos * left
        out[i, 2] = poses[i, 2] + turn


@kernel
def fill_rotation_samples(poses: Floats, normals: Floats, step: Floats, out: Floats) -> None:
    """Rotate, translate and rotate each pose: (n, 3), (n, 3) or (n, 6), (8,) -> (n, 3)."""
    for i in range(poses.shape[0]):
        rotation_1 = step[0] + step[3] * normals[i, 0]
        translation = step[1] + step[4] * normals[i, 1]
        rotation_2 = step[2] + step[5] * normals[i, 2]
        bearing = poses[i, 2] + rotation_1
        out[i, 0] = poses[i, 0] + translation * math.cos(bearing)
        out[i, 1] = poses[i, 1] + translation * math.sin(bearing)
        out[i, 2] = bearing + rotation_2
    if normals.shape[1] == 6:
        for i in range(poses.shape[0]):
            out[i, 0] += step[6] * normals[i, 3]
            out[i, 1] += step[6] * normals[i, 4]
            out[i, 2] += step[7] * normals[i, 5]


@kernel
def wrap_rotations(before: Floats, after: Floats, rotation_1: float) -> None:
    """Change the headings (n, 3) after a step by full turns: to before + rotation 1 + rotation 2, each in (-pi, pi].

    `rotation_1` is the mean of the first; each pose's own follows from where it went.
    """
    for i in range(before.shape[0]):
        heading = before[i, 2]
        first = math.atan2(after[i, 1] - before[i, 1], after[i, 0] - before[i, 0]) - heading
        # A noisy translation may be negative.
        if math.cos(first - rotation_1) < 0.0:
            first += math.pi
        first -= math.tau * math.ceil((first - math.pi) / math.tau)
        second = after[i, 2] - heading - first
        second -= math.tau * math.ceil((second - math.pi) / math.tau)
        after[i, 2] = heading + first + second


@kernel
def fill_rotation_log_densities(before: Floats, after: Floats, step: Floats, out: Floats) -> None:
    """Fill in the log density of each step from `before` to `after`: (n, 3), (n, 3), (8,) -> (n,)."""
    for i in range(before.shape[0]):
        dx, dy = after[i, 0] - before[i, 0], after[i, 1] - before[i, 1]
        distance = math.sqrt(dx * dx + dy * dy)
        bearing = math.atan2(dy, dx) - before[i, 2] if distance > 0.0 else 0.0
        turn = after[i, 2] - before[i, 2]
        if step[6] > 0.0:
            out[i] = _log_blurred(distance, bearing, turn, step)
        elif step[4] == 0.0 and abs(step[1]) <= EXACT:
            # No translation and no doubt about it: the two rotations are one.
            both = math.sqrt(step[3] * step[3] + step[5] * step[5] + step[7] * step[7])
            rotation = _log_angle(turn - step[0] - step[2], both)
            out[i] = rotation if distance <= EXACT else -math.inf
        else:
            out[i] = _log_polar(distance, bearing, turn, step)


@inlined_kernel
def _log_polar(distance: float, bearing: float, turn: float, step: Floats) -> float:
    """Return the log density where the end point tells rotation and translation: forwards, or turned round and back."""
    spread = math.sqrt(step[5] * step[5] + step[7] * step[7])
    forwards = (
        _log_angle(bearing - step[0], step[3])
        + _log_normal(distance - step[1], step[4])
        + _log_angle(turn - bearing - step[2], spread)
    )
    backwards = (
        _log_angle(bearing + math.pi - step[0], step[3])
        + _log_normal(-distance - step[1], step[4])
        + _log_angle(turn - bearing - math.pi - step[2], spread)
    )
    # d(x, y) = |translation| d(rotation_1) d(translation); a component without noise is not integrated over.
    pole = math.log(max(distance, EXACT)) if step[3] > 0.0 else 0.0
    return _log_sum(forwards, backwards) - pole


@inlined_kernel
def _log_blurred(distance: float, bearing: float, turn: float, step: Floats) -> float:
    """Return the log density where noise is added to the end point, by integrating over the first rotation r.

    Given r, the end point's noise along and across the direction driven, and the heading's, are normal and independent.
    Nodes lie where the narrowest factor is: about the rotation said, the one that the heading leaves, or the direction
    of the end point or its opposite.
    """
    along = math.sqrt(step[4] * step[4] + step[6] * step[6])
    spread = math.sqrt(step[5] * step[5] + step[7] * step[7])
    if step[3] == 0.0:
        return _log_given_rotation(step[0], distance, bearing, turn, along, spread, step)
    width = step[6] / max(distance, step[6])
    finest = min(step[3], width, spread) if spread > 0.0 else min(step[3], width)
    centre, period = bearing, math.pi
    if finest == step[3]:
        centre, period = step[0], math.inf
    elif finest == spread:
        centre, period = turn - step[2], math.tau
    reach = min(9.0 * finest, 0.5 * period)
    nodes = math.ceil(4.0 * reach / finest)
    pitch = 2.0 * reach / nodes
    first, last = 0, 0
    if period < math.inf:
        first = math.ceil((step[0] - 9.0 * step[3] - centre - reach) / period)
        last = math.floor((step[0] + 9.0 * step[3] - centre + reach) / period)
    total = -math.inf
    for k in range(first, last + 1):
        middle = centre + k * period if k != 0 else centre
        for j in range(nodes):
            r = middle - reach + (j + 0.5) * pitch
            value = _log_given_rotation(r, distance, bearing, turn, along, spread, step)
            total = _log_sum(total, value + _log_normal(r - step[0], step[3]))
    return total + math.log(pitch)


@inlined_kernel
def _log_given_rotation(
    r: float, distance: float, bearing: float, turn: float, along: float, spread: float, step: Floats
) -> float:
    """Return the log density of the end point if the first rotation is r."""
    return (
        _log_normal(distance * math.cos(bearing - r) - step[1], along)
        + _log_normal(distance * math.sin(bearing - r), step[6])
        + _log_angle(turn - r - step[2], spread)
    )


@inlined_kernel
def _log_angle(angle: float, sigma: float) -> float:
    """Return the log density of a normal that is wrapped round the circle once to either side."""
    angle -= 2.0 * math.pi * math.floor(angle / (2.0 * math.pi) + 0.5)
    value = _log_normal(angle, sigma)
    if sigma > 0.5:
        other = _log_sum(_log_normal(angle - 2.0 * math.pi, sigma), _log_normal(angle + 2.0 * math.pi, sigma))
        value = _log_sum(value, other)
    return value


@inlined_kernel
def _log_normal(x: float, sigma: float) -> float:
    """Return the log density; without noise the log of the mass: 0 where it is met, else -inf."""
    if sigma == 0.0:
        return 0.0 if abs(x) <= EXACT else -math.inf
    z = x / sigma
    return -0.5 * z * z - math.log(sigma) - _LOG_SQRT_2PI


@inlined_kernel
def _log_sum(a: float, b: float) -> float:
    high, low = max(a, b), min(a, b)
    return high if low == -math.inf else high + math.log1p(math.exp(low - high))
