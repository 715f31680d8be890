"""Ways of a sound pulse between sensors over straight walls, by mirror images: the loops of `simulation.sonar`.

A wall runs from (ax, ay) in the direction (ux, uy) with free space on its left. A pulse that is mirrored at walls
w1, ..., wn on its way from p to q is as long as the straight line from q to the image of p in all these mirrors, and
there is such a way only if that line passes the walls in turn, inside their ends and with nothing between.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Bools = NDArray[np.bool_]

# What a way of the pulse is, by its place in `out`.
MIRROR, CORNER, EDGE, SECOND, DIFFUSE = 0, 1, 2, 3, 4
N_WAYS = 5
# What is at the end of a wall: nothing that sends sound back, an edge, part of a round surface, or a corner.
PLAIN_END, SHARP_EDGE, ROUND, INNER_CORNER = 0, 1, 2, 3

# A way may pass a wall's end, and touch a wall with its own end, by this share of a length.
SLACK = 1e-9
TOUCH = 1e-7
# Pairs of walls that the rays of one sensor may find.
MAX_PAIRS = 128


class Walls(NamedTuple):
    """Walls as columns (m,); `after_x`, `after_y` is the direction of the wall that goes on at the end, or 0, 0."""

    ax: Floats
    ay: Floats
    ux: Floats
    uy: Floats
    length: Floats
    after_x: Floats
    after_y: Floats
    end: Ints


class Pulse(NamedTuple):
    """Half the opening angle, the longest way, rays per cone, and whether sensors hear each other."""

    half: float
    longest: float
    n_rays: int
    cross_talk: bool


@kernel
def find_ways(sensors: Floats, walls: Walls, pulse: Pulse, out: Floats) -> None:
    """Fill out (t, k, k, N_WAYS): the shortest way of each kind from sensor [.., j] to sensor [.., .., k], or inf.

    `sensors` is (t, k, 3): x, y, theta of every sensor of a ring in the map, per scan. Without cross-talk only the ways
    from a sensor to itself are found.
    """
    for t in range(len(sensors)):
        near = _walls_near(sensors[t], walls, pulse.longest)
        in_view = np.empty((sensors.shape[1], len(near.ax)), np.bool_)
        ends_in_view = np.empty_like(in_view)
        _find_views(sensors[t], near, pulse.half, in_view, ends_in_view)
        for j in range(sensors.shape[1]):
            _ways_of_sensor(sensors[t], j, near, in_view, ends_in_view, pulse, out[t, j])


@kernel
def _find_views(ring: Floats, walls: Walls, half: float, in_view: Bools, ends_in_view: Bools) -> None:
    """Fill the (k, m) views: which walls have their front, and which their end, in the cone of each sensor."""
    for k in range(len(ring)):
        x, y, theta = ring[k, 0], ring[k, 1], ring[k, 2]
        for i in range(len(walls.ax)):
            in_view[k, i] = _nearest_on_wall(x, y, theta, walls, i, half) < math.inf
            end_x, end_y = walls.ax[i] + walls.length[i] * walls.ux[i], walls.ay[i] + walls.length[i] * walls.uy[i]
            ends_in_view[k, i] = walls.end[i] != PLAIN_END and _in_cone(end_x - x, end_y - y, theta, half)


@kernel
def _walls_near(ring: Floats, walls: Walls, longest: float) -> Walls:
    """Return the walls that a pulse of this ring can reach and come back from."""
    x, y = ring[:, 0].mean(), ring[:, 1].mean()
    radius = 0.0
    for i in range(len(ring)):
        radius = max(radius, math.hypot(ring[i, 0] - x, ring[i, 1] - y))
    limit = 0.5 * longest + radius
    chosen = np.empty(len(walls.ax), np.int64)
    n = 0
    for i in range(len(walls.ax)):
        dx, dy = x - walls.ax[i], y - walls.ay[i]
        along = min(max(dx * walls.ux[i] + dy * walls.uy[i], 0.0), walls.length[i])
        if math.hypot(dx - along * walls.ux[i], dy - along * walls.uy[i]) <= limit:
            chosen[n] = i
            n += 1
    index = chosen[:n]
    return Walls(
        walls.ax[index],
        walls.ay[index],
        walls.ux[index],
        walls.uy[index],
        walls.length[index],
        walls.after_x[index],
        walls.after_y[index],
        walls.end[index],
    )


@kernel
def _ways_of_sensor(
    ring: Floats, j: int, walls: Walls, in_view: Bools, ends_in_view: Bools, pulse: Pulse, out: Floats
) -> None:
    """Fill out (k, N_WAYS) with the ways of the pulse that sensor j sends; views are (k, m), per sensor and wall."""
    out[:] = math.inf
    first, last = (0, len(ring)) if pulse.cross_talk else (j, j + 1)
    chain, images, turns = np.empty(3, np.int64), np.empty((4, 2)), np.empty((5, 2))
    for i in range(len(walls.ax)):
        if in_view[j, i]:
            chain[0] = i
            for k in range(first, last):
                if in_view[k, i]:
                    way = _mirrored_way(ring, j, k, chain, 1, walls, pulse, out[k, MIRROR], images, turns)
                    out[k, MIRROR] = min(out[k, MIRROR], way)
        if ends_in_view[j, i]:
            for k in range(first, last):
                if ends_in_view[k, i]:
                    kind, way = _way_over_end(ring, j, k, i, walls, pulse, out[k])
                    if kind >= 0:
                        out[k, kind] = way
    out[j, DIFFUSE] = 2.0 * _nearest_in_cone(ring[j, 0], ring[j, 1], ring[j, 2], walls, pulse.half)
    pairs = np.empty((MAX_PAIRS, 2), np.int64)
    n_pairs = _follow_rays(ring, j, walls, pulse, pairs, out)
    for p in range(n_pairs):
        chain[0], chain[1], chain[2] = pairs[p, 0], pairs[p, 1], pairs[p, 0]
        for k in range(first, last):
            for n in (2, 3):
                if in_view[k, chain[n - 1]]:
                    way = _mirrored_way(ring, j, k, chain, n, walls, pulse, out[k, SECOND], images, turns)
                    out[k, SECOND] = min(out[k, SECOND], way)
    for k in range(first, last):
        for kind in range(N_WAYS):
            if out[k, kind] > pulse.longest:
                out[k, kind] = math.inf


@kernel
def _mirrored_way(
    ring: Floats, j: int, k: int, chain: Ints, n: int, walls: Walls, pulse: Pulse, shortest: float,
    images: Floats, turns: Floats,
) -> float:  # fmt: skip
    """Return the length of the way j -> chain[0] -> ... -> chain[n - 1] -> k; inf if none is below `shortest`.

    `images` (4, 2) and `turns` (5, 2) are room to work in.
    """
    images[0, 0], images[0, 1] = ring[j, 0], ring[j, 1]
    for i in range(n):
        w = chain[i]
        side = _height_over(images[i, 0], images[i, 1], walls, w)
        if side <= 0.0:
            return math.inf
        images[i + 1, 0] = images[i, 0] + 2.0 * side * walls.uy[w]
        images[i + 1, 1] = images[i, 1] - 2.0 * side * walls.ux[w]
    x, y = ring[k, 0], ring[k, 1]
    way = math.hypot(images[n, 0] - x, images[n, 1] - y)
    if way >= shortest or way > pulse.longest:
        return math.inf
    # Backwards from the hearing sensor; its echo comes from the direction of the last image.
    if not _in_cone(images[n, 0] - x, images[n, 1] - y, ring[k, 2], pulse.half):
        return math.inf
    turns[0, 0], turns[0, 1] = x, y
    for i in range(n - 1, -1, -1):
        w = chain[i]
        height = _height_over(x, y, walls, w)
        below = -_height_over(images[i + 1, 0], images[i + 1, 1], walls, w)
        if height < 0.0 or height + below <= 0.0:
            return math.inf
        share = height / (height + below)
        x += share * (images[i + 1, 0] - x)
        y += share * (images[i + 1, 1] - y)
        along = (x - walls.ax[w]) * walls.ux[w] + (y - walls.ay[w]) * walls.uy[w]
        if along < -SLACK or along > walls.length[w] + SLACK:
            return math.inf
        turns[n - i, 0], turns[n - i, 1] = x, y
        # Through the corner itself: that is its own kind of echo.
        if n > 1 and math.hypot(x - turns[n - i - 1, 0], y - turns[n - i - 1, 1]) < 1e-6:
            return math.inf
    turns[n + 1, 0], turns[n + 1, 1] = ring[j, 0], ring[j, 1]
    if not _in_cone(x - ring[j, 0], y - ring[j, 1], ring[j, 2], pulse.half):
        return math.inf
    for i in range(n + 1):
        if _is_blocked(turns[i, 0], turns[i, 1], turns[i + 1, 0], turns[i + 1, 1], walls):
            return math.inf
    return way


@kernel
def _way_over_end(
    ring: Floats, j: int, k: int, i: int, walls: Walls, pulse: Pulse, so_far: Floats
) -> tuple[int, float]:
    """Return kind and length of the way j -> end of wall i -> k; kind -1 if there is none shorter than so far."""
    what = walls.end[i]
    if what == PLAIN_END:
        return -1, math.inf
    kind = MIRROR if what == ROUND else CORNER if what == INNER_CORNER else EDGE
    x, y = walls.ax[i] + walls.length[i] * walls.ux[i], walls.ay[i] + walls.length[i] * walls.uy[i]
    to_j_x, to_j_y = ring[j, 0] - x, ring[j, 1] - y
    to_k_x, to_k_y = ring[k, 0] - x, ring[k, 1] - y
    far_j, far_k = math.hypot(to_j_x, to_j_y), math.hypot(to_k_x, to_k_y)
    way = far_j + far_k
    if way >= so_far[kind] or way > pulse.longest or far_j == 0.0 or far_k == 0.0:
        return -1, math.inf
    if not (_in_cone(-to_j_x, -to_j_y, ring[j, 2], pulse.half) and _in_cone(-to_k_x, -to_k_y, ring[k, 2], pulse.half)):
        return -1, math.inf
    before_j, after_j = _is_before(to_j_x, to_j_y, i, walls)
    before_k, after_k = _is_before(to_k_x, to_k_y, i, walls)
    if what == INNER_CORNER:
        if not (before_j and after_j and before_k and after_k):
            return -1, math.inf
    elif not ((before_j or after_j) and (before_k or after_k)):
        return -1, math.inf
    if what == ROUND:
        # The surface is square to the middle direction somewhere between the two walls' normals.
        middle_x, middle_y = to_j_x / far_j + to_k_x / far_k, to_j_y / far_j + to_k_y / far_k
        along = middle_x * walls.ux[i] + middle_y * walls.uy[i]
        if along < 0.0 or middle_x * walls.after_x[i] + middle_y * walls.after_y[i] > 0.0:
            return -1, math.inf
    if _is_blocked(ring[j, 0], ring[j, 1], x, y, walls) or _is_blocked(x, y, ring[k, 0], ring[k, 1], walls):
        return -1, math.inf
    return kind, way


@kernel
def _is_before(dx: float, dy: float, i: int, walls: Walls) -> tuple[bool, bool]:
    """Whether a place, seen from the end of wall i, is in front of it and of the wall that goes on there."""
    first = dy * walls.ux[i] - dx * walls.uy[i] > 0.0
    second = dy * walls.after_x[i] - dx * walls.after_y[i] > 0.0
    return first, second


@kernel
def _follow_rays(ring: Floats, j: int, walls: Walls, pulse: Pulse, pairs: Ints, out: Floats) -> int:
    """Send rays through the cone of sensor j; list the pairs of walls that they meet first and second.

    Where a ray meets a wall that scatters, the sensors that look there hear it: into out[:, DIFFUSE].
    """
    n_pairs = 0
    x, y = ring[j, 0], ring[j, 1]
    for r in range(pulse.n_rays):
        share = r / (pulse.n_rays - 1) if pulse.n_rays > 1 else 0.5
        angle = ring[j, 2] + (2.0 * share - 1.0) * pulse.half
        dx, dy = math.cos(angle), math.sin(angle)
        first, way = _first_wall(x, y, dx, dy, -1, walls)
        if first < 0 or way > pulse.longest:
            continue
        hit_x, hit_y = x + way * dx, y + way * dy
        if pulse.cross_talk:
            _hear_scattered(ring, j, hit_x, hit_y, way, walls, pulse, out)
        # Mirrored: the part along the normal turns round.
        across = 2.0 * (dy * walls.ux[first] - dx * walls.uy[first])
        dx, dy = dx + across * walls.uy[first], dy - across * walls.ux[first]
        second, more = _first_wall(hit_x, hit_y, dx, dy, first, walls)
        if second < 0 or way + more > pulse.longest:
            continue
        known = False
        for p in range(n_pairs):
            known = known or (pairs[p, 0] == first and pairs[p, 1] == second)
        if not known and n_pairs < MAX_PAIRS:
            pairs[n_pairs, 0], pairs[n_pairs, 1] = first, second
            n_pairs += 1
    return n_pairs


@kernel
def _hear_scattered(
    ring: Floats, j: int, x: float, y: float, way: float, walls: Walls, pulse: Pulse, out: Floats
) -> None:
    """Shorten the scattered ways from sensor j to the others by one over (x, y)."""
    for k in range(len(ring)):
        if k == j:
            continue
        dx, dy = x - ring[k, 0], y - ring[k, 1]
        total = way + math.hypot(dx, dy)
        if (
            total < out[k, DIFFUSE]
            and _in_cone(dx, dy, ring[k, 2], pulse.half)
            and not _is_blocked(ring[k, 0], ring[k, 1], x, y, walls)
        ):
            out[k, DIFFUSE] = total


@kernel
def _first_wall(x: float, y: float, dx: float, dy: float, without: int, walls: Walls) -> tuple[int, float]:
    """Return the first wall that a ray meets from its front, and how far that is; -1, inf if there is none."""
    found, nearest = -1, math.inf
    for i in range(len(walls.ax)):
        facing = dy * walls.ux[i] - dx * walls.uy[i]
        if i == without or facing >= 0.0:
            continue
        way = -_height_over(x, y, walls, i) / facing
        if 0.0 <= way < nearest:
            along = (x + way * dx - walls.ax[i]) * walls.ux[i] + (y + way * dy - walls.ay[i]) * walls.uy[i]
            if -SLACK <= along <= walls.length[i] + SLACK:
                found, nearest = i, way
    return found, nearest


@kernel
def _nearest_in_cone(x: float, y: float, theta: float, walls: Walls, half: float) -> float:
    """Return the distance to the nearest point of any wall in a cone, inf if there is none.

    No wall can hide it: a cone is convex, so that what hides a point lies in the cone, and nearer.
    """
    nearest = math.inf
    for i in range(len(walls.ax)):
        if _height_over(x, y, walls, i) < nearest:
            nearest = min(nearest, _nearest_on_wall(x, y, theta, walls, i, half))
    return nearest


@kernel
def _nearest_on_wall(x: float, y: float, theta: float, walls: Walls, i: int, half: float) -> float:
    """Return the distance to the nearest point of wall i in a cone, inf if there is none or it is seen from behind."""
    height = _height_over(x, y, walls, i)
    if height <= 0.0:
        return math.inf
    # From its foot, the perpendicular on the wall, the wall spans angles: those to its end counter-clockwise. The
    # nearest point is that of the smallest angle in the cone.
    foot = (x - walls.ax[i]) * walls.ux[i] + (y - walls.ay[i]) * walls.uy[i]
    straight = math.atan2(-walls.ux[i], walls.uy[i]) - theta
    straight = math.atan2(math.sin(straight), math.cos(straight))
    low = max(math.atan2(-foot, height), -half - straight)
    high = min(math.atan2(walls.length[i] - foot, height), half - straight)
    if low > high + SLACK:
        return math.inf
    return height / math.cos(min(max(0.0, low), max(low, high)))


@kernel
def _is_blocked(ax: float, ay: float, bx: float, by: float, walls: Walls) -> bool:
    """Whether a wall crosses the line between two places; one that only its ends touch does not."""
    dx, dy = bx - ax, by - ay
    for i in range(len(walls.ax)):
        speed = dy * walls.ux[i] - dx * walls.uy[i]
        if speed == 0.0:
            continue
        share = -_height_over(ax, ay, walls, i) / speed
        if TOUCH < share < 1.0 - TOUCH:
            along = (ax + share * dx - walls.ax[i]) * walls.ux[i] + (ay + share * dy - walls.ay[i]) * walls.uy[i]
            if -SLACK <= along <= walls.length[i] + SLACK:
                return True
    return False


@kernel
def _height_over(x: float, y: float, walls: Walls, i: int) -> float:
    """Return the distance of a place from the line of wall i, positive in front of it."""
    height: float = (y - walls.ay[i]) * walls.ux[i] - (x - walls.ax[i]) * walls.uy[i]
    return height


@kernel
def _in_cone(dx: float, dy: float, theta: float, half: float) -> bool:
    """Whether a direction lies in the cone around theta."""
    turn = math.atan2(dy, dx) - theta
    return abs(math.atan2(math.sin(turn), math.cos(turn))) <= half + SLACK
