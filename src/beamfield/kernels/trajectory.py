"""What scans and odometry say about a trajectory: end points against a map's walls, steps against the wheels.

The table of signed distances to the walls' surfaces has metres in single precision, interpolated between cell centres:
positive in front of a wall, negative deep inside. End points off the table say nothing.

A reading's weight is the probability that it is a hit, w = h / (h + clutter) with h = exp(-r^2 / (2 sigma^2)); its cost
is -log((h + clutter) / (1 + clutter)), at most that of a reading that has nothing to do with the map.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.chain import invert_3x3
from beamfield.kernels.jit import inlined_kernel, integer, kernel

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]
Integers = NDArray[np.int64]

# Steps of the correction of one pose while tracking, and sigmas further that it may go.
TRACK_STEPS = integer(4)
# The face that a beam met is looked for so far before its end, metres.
BEHIND = 0.3


class Walls(NamedTuple):
    """Signed distances to the walls, and where the table lies."""

    distance: Singles
    """(rows, cols) metres."""
    x: float
    y: float
    yaw: float
    """Pose of the table's lower-left corner in the map."""
    resolution: float
    deepest: float
    """Hits lie no deeper behind the first painted cells, metres."""


class HitNoise(NamedTuple):
    """How end points of hits lie about the walls."""

    sigma: float
    """Standard deviation, metres."""
    clutter: float
    """How likely a reading is that has nothing to do with the map, relative to a hit on the wall."""
    low: float
    high: float
    """Hits lie between these signed distances, metres, wherever the wall's surface is in its painted cells."""


class StepNoise(NamedTuple):
    """Variances of odometry per metre driven and per radian turned, and of one step whatever its length."""

    along: float
    aside: float
    drift: float
    turn: float
    turn_aside: float
    floor: float


@inlined_kernel
def distance_at(x: float, y: float, walls: Walls) -> tuple[float, float, float]:
    """Return the signed distance at a point and its gradient, NaN and 0 off the table."""
    rows, cols = walls.distance.shape
    wc, ws = math.cos(walls.yaw), math.sin(walls.yaw)
    per_cell = 1.0 / walls.resolution
    dx, dy = x - walls.x, y - walls.y
    u = (dx * wc + dy * ws) * per_cell - 0.5
    v = (dy * wc - dx * ws) * per_cell - 0.5
    if not (u >= 0.0 and v >= 0.0 and u < cols - 1.0 and v < rows - 1.0):
        return math.nan, 0.0, 0.0
    col, row = int(u), int(v)
    a, b = u - col, v - row
    d00, d01 = np.float64(walls.distance[row, col]), np.float64(walls.distance[row, col + 1])
    d10, d11 = np.float64(walls.distance[row + 1, col]), np.float64(walls.distance[row + 1, col + 1])
    low, high = d00 + a * (d01 - d00), d10 + a * (d11 - d10)
    along = ((d01 - d00) + b * ((d11 - d10) - (d01 - d00))) * per_cell
    across = (high - low) * per_cell
    return low + b * (high - low), along * wc - across * ws, along * ws + across * wc


@inlined_kernel
def hit_distance(x: float, y: float, beam_x: float, beam_y: float, walls: Walls, on_faces: bool
                 ) -> tuple[float, float, float]:  # fmt: skip
    """Return the signed distance of an end point and its gradient; if hits lie on faces, of the face that the beam met.

    A reading that is too long ends in a thin wall, or behind it, where the nearest face is the wrong one.
    """
    signed, gx, gy = distance_at(x, y, walls)
    face = 0.5 * walls.resolution
    if not on_faces or not (signed < BEHIND) or (signed > face and gx * beam_x + gy * beam_y <= 0.0):
        return signed, gx, gy
    step, inside = face, signed <= face
    back = step
    while back < BEHIND + face:
        before, nx, ny = distance_at(x - back * beam_x, y - back * beam_y, walls)
        if before <= face:
            inside = True
        elif inside:
            facing = nx * beam_x + ny * beam_y
            if facing < 0.0:
                return before + back * facing, nx, ny
        back += step
    return signed, gx, gy


@kernel
def sum_scan(points: Floats, pose: Floats, walls: Walls, noise: HitNoise, gradient: Floats, information: Floats
             ) -> float:  # fmt: skip
    """Fill in gradient (6,) and Gauss-Newton information (3, 3) of a scan's cost; return the cost.

    End points (k, 4) are x, y and the beam's direction, cos and sin, in the robot's frame. The last three numbers of
    the gradient are by how much its first three fall if all hits lie one metre further in front of the walls.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    precision = 1.0 / (noise.sigma * noise.sigma)
    miss = -math.log(noise.clutter / (1.0 + noise.clutter))
    cost = x = y = turn = by_x = by_y = by_turn = 0.0
    xx = xy = xt = yy = yt = tt = 0.0
    for j in range(points.shape[0]):
        rx = c * points[j, 0] - s * points[j, 1]
        ry = s * points[j, 0] + c * points[j, 1]
        beam_x, beam_y = c * points[j, 2] - s * points[j, 3], s * points[j, 2] + c * points[j, 3]
        signed, gx, gy = hit_distance(pose[0] + rx, pose[1] + ry, beam_x, beam_y, walls, noise.low == noise.high)
        residual = max(signed - noise.high, 0.0) + min(signed - noise.low, 0.0)
        exponent = 0.5 * residual * residual * precision
        if not exponent <= 30.0:
            cost += miss
            continue
        hit = math.exp(-exponent)
        weight = hit / (hit + noise.clutter)
        cost -= math.log((hit + noise.clutter) / (1.0 + noise.clutter))
        gt = gy * rx - gx * ry
        pull = weight * residual * precision
        weight *= precision if residual != 0.0 else 0.0
        x += pull * gx
        y += pull * gy
        turn += pull * gt
        by_x += weight * gx
        by_y += weight * gy
        by_turn += weight * gt
        xx += weight * gx * gx
        xy += weight * gx * gy
        xt += weight * gx * gt
        yy += weight * gy * gy
        yt += weight * gy * gt
        tt += weight * gt * gt
    gradient[0], gradient[1], gradient[2], gradient[3], gradient[4], gradient[5] = x, y, turn, by_x, by_y, by_turn
    information[0, 0], information[0, 1], information[0, 2] = xx, xy, xt
    information[1, 0], information[1, 1], information[1, 2] = xy, yy, yt
    information[2, 0], information[2, 1], information[2, 2] = xt, yt, tt
    return cost


@kernel
def sum_scans(points: Floats, first: Integers, poses: Floats, walls: Walls, noise: HitNoise, gradients: Floats,
              infos: Floats, costs: Floats) -> None:  # fmt: skip
    """Do `sum_scan` for many: the end points of scan i are points[first[i]:first[i + 1]]."""
    for i in range(poses.shape[0]):
        costs[i] = sum_scan(points[first[i] : first[i + 1]], poses[i], walls, noise, gradients[i], infos[i])


@kernel
def fill_residuals(points: Floats, first: Integers, poses: Floats, walls: Walls, on_faces: bool, out: Floats
                   ) -> None:  # fmt: skip
    """Fill out (m,) with the signed distance at each end point, NaN off the table."""
    for i in range(poses.shape[0]):
        c, s = math.cos(poses[i, 2]), math.sin(poses[i, 2])
        for j in range(first[i], first[i + 1]):
            rx = c * points[j, 0] - s * points[j, 1]
            ry = s * points[j, 0] + c * points[j, 1]
            beam_x, beam_y = c * points[j, 2] - s * points[j, 3], s * points[j, 2] + c * points[j, 3]
            out[j] = hit_distance(poses[i, 0] + rx, poses[i, 1] + ry, beam_x, beam_y, walls, on_faces)[0]


@kernel
def step_variances(x: float, y: float, heading: float, noise: StepNoise, out: Floats) -> None:
    """Fill out (3,) with the variances of a step of odometry, in the frame where it begins."""
    distance, turn = math.hypot(x, y), abs(heading)
    out[0] = noise.along * distance + noise.turn_aside * turn + noise.floor
    out[1] = noise.aside * distance + noise.turn_aside * turn + noise.floor
    out[2] = noise.drift * distance + noise.turn * turn + noise.floor


@kernel
def track(points: Floats, first: Integers, steps: Floats, walls: Walls, noise: HitNoise, judged: HitNoise,
          step_noise: StepNoise, independent: float, start: int, direction: int, poses: Floats, covariance: Floats,
          costs: Floats) -> None:  # fmt: skip
    """Follow a pose through a log: odometry's step, then a correction towards the walls, as an extended Kalman filter.

    Parameters
    ----------
    points, first
        End points of all scans.
    steps
        (n - 1, 3) odometry from each scan to the next, in the frame of the first of them.
    walls, noise, step_noise
        The map, and how wrong both sensors are.
    judged
        How wrong end points are when costs are counted, so that hypotheses that different noise follows compare.
    independent
        How many independent end points a scan is worth.
    start
        Scan at which `poses[start]` and `covariance` are given.
    direction
        1 for forwards, -1 for backwards.
    covariance
        (7, 7) of the first pose and of systematic errors of the odometry, used up: of its distances and its turns,
        relative, radians that the robot turns per metre without its noticing, and radians between where it heads and
        where it drives. All are 0 at first.
    poses, costs
        (n, 3) and (n,) overwritten from the start to the end of the log in that direction: where the robot is then
        thought to be, and the cost in nats of the scan and of the correction.
    """
    n = first.size - 1
    variances, information, prior, inverse = np.empty(3), np.empty((3, 3)), np.empty((3, 3)), np.empty((3, 3))
    gradient, predicted, difference, pull = np.empty(6), np.empty(3), np.empty(3), np.empty(3)
    systematic, motion, rows = np.zeros(4), np.zeros((3, 7)), np.empty((3, 7))
    i = start
    while True:
        pose = poses[i]
        for j in range(3):
            predicted[j] = pose[j]
            for k in range(3):
                inverse[j, k] = covariance[j, k]
        if not invert_3x3(inverse, prior):
            for j in range(3):
                for k in range(7):
                    covariance[j, k] = covariance[k, j] = 1.0 if j == k else 0.0
                for k in range(3):
                    prior[j, k] = 1.0 if j == k else 0.0
        ends = points[first[i] : first[i + 1]]
        share = independent / max(1, ends.shape[0])
        for _ in range(TRACK_STEPS):
            sum_scan(ends, pose, walls, noise, gradient, information)
            _add_prior(share, prior, information)
            for j in range(3):
                difference[j] = pose[j] - predicted[j]
            for j in range(3):
                pull[j] = share * gradient[j] + _dot(prior[j], difference)
            if not invert_3x3(information, inverse):
                break
            moved = 0.0
            for j in range(3):
                move = _dot(inverse[j], pull)
                pose[j] -= move
                moved += abs(move)
            if moved < 1e-4:
                break
        costs[i] = share * sum_scan(ends, pose, walls, judged, gradient, information)
        sum_scan(ends, pose, walls, noise, gradient, information)
        _add_prior(share, prior, information)
        for j in range(3):
            difference[j] = pose[j] - predicted[j]
        for j in range(3):
            costs[i] += 0.5 * difference[j] * _dot(prior[j], difference)
        if invert_3x3(information, inverse):
            _learn_systematic(difference, prior, inverse, covariance, systematic)
        following = i + direction
        if following < 0 or following >= n:
            return
        step = steps[i] if direction > 0 else steps[following]
        c, s = (1.0 + systematic[0]) * math.cos(systematic[3]), (1.0 + systematic[0]) * math.sin(systematic[3])
        ux, uy = c * step[0] - s * step[1], s * step[0] + c * step[1]
        ut = (1.0 + systematic[1]) * step[2] + systematic[2] * step[0]
        if direction < 0:
            c, s = math.cos(ut), math.sin(ut)
            ux, uy, ut = -c * ux - s * uy, s * ux - c * uy, -ut
        c, s = math.cos(pose[2]), math.sin(pose[2])
        x, y = c * ux - s * uy, s * ux + c * uy
        poses[following, 0], poses[following, 1], poses[following, 2] = pose[0] + x, pose[1] + y, pose[2] + ut
        # Derivatives of the next pose by this one and by the systematic errors.
        motion[0, 0] = motion[1, 1] = motion[2, 2] = 1.0
        motion[0, 2], motion[1, 2] = -y, x
        motion[0, 3], motion[1, 3] = x / (1.0 + systematic[0]), y / (1.0 + systematic[0])
        motion[2, 4], motion[2, 5] = direction * step[2], direction * step[0]
        motion[0, 6], motion[1, 6] = -y, x
        if direction < 0:
            for j in range(4, 6):
                motion[0, j], motion[1, j] = -y * motion[2, j], x * motion[2, j]
        step_variances(ux, uy, ut, step_noise, variances)
        _propagate(motion, rows, covariance)
        covariance[0, 0] += c * c * variances[0] + s * s * variances[1]
        covariance[0, 1] += c * s * (variances[0] - variances[1])
        covariance[1, 0] += c * s * (variances[0] - variances[1])
        covariance[1, 1] += s * s * variances[0] + c * c * variances[1]
        covariance[2, 2] += variances[2]
        i = following


@kernel
def _propagate(motion: Floats, rows: Floats, covariance: Floats) -> None:
    """Replace the covariance of pose and systematic errors by that after a move; motion (3, 7) has its derivatives."""
    for j in range(3):
        for k in range(7):
            rows[j, k] = 0.0
            for m in range(7):
                rows[j, k] += motion[j, m] * covariance[m, k]
    for j in range(3):
        for k in range(7):
            covariance[j, k] = rows[j, k]
    for j in range(3):
        for k in range(7):
            rows[j, k] = 0.0
            for m in range(7):
                rows[j, k] += motion[j, m] * covariance[k, m]
    for j in range(3):
        for k in range(7):
            covariance[k, j] = rows[j, k]


@kernel
def _learn_systematic(difference: Floats, prior: Floats, corrected: Floats, covariance: Floats, systematic: Floats
                      ) -> None:  # fmt: skip
    """Take from a pose's correction what it says about the odometry's systematic errors.

    `prior` is the inverse of the pose's covariance before, `corrected` its covariance after the correction.
    """
    gain = np.empty((4, 3))
    for j in range(4):
        for k in range(3):
            gain[j, k] = 0.0
            for m in range(3):
                gain[j, k] += covariance[3 + j, m] * prior[m, k]
            systematic[j] += gain[j, k] * difference[k]
    # Odometry of the other sign is another matter.
    for j in range(2):
        systematic[j] = min(max(systematic[j], -0.5), 1.0)
    for j in range(3):
        for k in range(3):
            change = corrected[j, k] - covariance[j, k]
            for m in range(4):
                for n in range(4):
                    covariance[3 + m, 3 + n] += gain[m, j] * change * gain[n, k]
    for k in range(3):
        for j in range(3):
            covariance[j, k] = corrected[j, k]
        for j in range(4):
            covariance[3 + j, k] = 0.0
            for m in range(3):
                covariance[3 + j, k] += gain[j, m] * corrected[m, k]
            covariance[k, 3 + j] = covariance[3 + j, k]


@inlined_kernel
def _add_prior(share: float, prior: Floats, information: Floats) -> None:
    """Turn a scan's information into that of the pose: of its share of independent end points, and of the prior."""
    for j in range(3):
        for k in range(3):
            information[j, k] = share * information[j, k] + prior[j, k]


@inlined_kernel
def _dot(a: Floats, b: Floats) -> float:
    product: float = a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
    return product
