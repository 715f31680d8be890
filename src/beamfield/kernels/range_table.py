"""Tables of pre-cached ranges (6.3.4): where their rays start, how ranges are stored, and the look-up.

All lengths are in cells of the map unless they are said to be metres. The table's cells are squares of the map's frame;
`places` says for each which row of the codes is its own:

- i >= 0: row i; all of the cell is free, and its rays start at its middle;
- -2 - i: row i; something in it is not free, or it reaches over the edge of the map, and its rays start at `starts[i]`;
- -1: none, because nothing in it is free.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.elementary import SNAP, cos_sin
from beamfield.kernels.jit import integer, kernel

# The code of a ray that meets nothing; others are whole quanta.
NOTHING = 65535
# Less of a map's cell than this, in cells, is rounding: 0.15 / 0.05 is not 3.
SLIVER = 1e-6
# Two neighbouring directions whose ranges differ by less, in metres, are taken to meet one wall.
SAME_WALL = np.float32(0.5)
# A point nearer than this, in metres, may be seen in any direction from beside. More radians than this are not sought:
# measured, a wider search finds no more.
CLOSE, MOST_TURN = np.float32(0.05), 0.1
# Rays, and groups of them, at a time.
BLOCK, LANES = integer(256), np.uintp(256)
# State of each ray in float32: rows of ONE buffer, because LLVM vectorises only loops whose arrays it can prove apart.
DIRECTION, FORWARD, SIDEWAYS, MOST, SHARE, RESULT = (np.uintp(i * BLOCK) for i in range(6))
STATE_ROWS = 6
# State of each group of rays in float64, likewise: start, heading (in turns, then in headings of the table), where
# the codes of its place begin, how far its start is from theirs, and its longest range: 0 in a wall, -1 off the places.
X, Y, COS, SIN, HEADING, BASE, AHEAD, ASIDE, LONGEST = (np.uintp(i * BLOCK) for i in range(9))
GROUP_ROWS = 9
FAN_COS, FAN_SIN, FAN_HEADING = np.uintp(2), np.uintp(3), np.uintp(4)

NONE, SINGLE = integer(0), integer(1)
ZERO, ONE, HALF = np.float32(0), np.float32(1), np.float32(0.5)
# Times this, a number of single precision is the next larger one, or that after it.
NEXT = np.float32(1.0 + 2.0**-23)

Floats = NDArray[np.float64]


class Table(NamedTuple):
    """What is looked up, and in which map."""

    codes: NDArray[np.uint16]  # (places, headings), flat
    places: NDArray[np.int32]  # (rows, cols)
    starts: NDArray[np.float32]  # (places, 2) column and row
    stops: NDArray[np.uint16]  # (map rows + 2, map columns + 2), 0 where rays stop
    side: float  # of the table's cells
    headings: int
    quantum: float  # metres per code
    resolution: float  # metres per cell of the map


class Rays(NamedTuple):
    """Rays in lockstep."""

    state: NDArray[np.float32]  # rows of BLOCK
    base: NDArray[np.uint32]  # where the codes of each ray's place begin
    here: NDArray[np.uint32]  # which codes it reads: in one direction, and in the next
    beside: NDArray[np.uint32]
    code: NDArray[np.uint16]  # and what stands there
    next_code: NDArray[np.uint16]


@kernel
def find_places(free: NDArray[np.bool_], side: float, places: NDArray[np.int32], starts: NDArray[np.float32]) -> int:
    """Number the table's cells in which something is free, and find where their rays start.

    Parameters
    ----------
    free
        (map rows, map columns) bool.
    side
        Of the table's cells.
    places
        (rows, cols), overwritten.
    starts
        (rows * cols, 2), of which the first are overwritten: the cell's middle if it is free; else the middle of that
        part of a free cell of the map that is nearest to it.

    Returns
    -------
    The number of places.
    """
    map_rows, map_cols = free.shape
    n = 0
    for row in range(places.shape[0]):
        low_y, high_y = row * side, min((row + 1) * side, float(map_rows))
        first_row, last_row = int(np.floor(low_y + SLIVER)), int(np.ceil(high_y - SLIVER))
        for col in range(places.shape[1]):
            low_x, high_x = col * side, min((col + 1) * side, float(map_cols))
            first_col, last_col = int(np.floor(low_x + SLIVER)), int(np.ceil(high_x - SLIVER))
            middle_x, middle_y = (col + 0.5) * side, (row + 0.5) * side
            whole, nearest = True, np.inf
            for r in range(first_row, last_row):
                for c in range(first_col, last_col):
                    if not free[r, c]:
                        whole = False
                        continue
                    left, right = max(low_x, float(c)), min(high_x, c + 1.0)
                    bottom, top = max(low_y, float(r)), min(high_y, r + 1.0)
                    x, y = 0.5 * (left + right), 0.5 * (bottom + top)
                    if left <= middle_x < right and bottom <= middle_y < top:
                        x, y = middle_x, middle_y
                    away = (x - middle_x) ** 2 + (y - middle_y) ** 2
                    if away < nearest:
                        nearest = away
                        starts[n, 0], starts[n, 1] = x, y
            if nearest == np.inf:
                places[row, col] = -1
                continue
            whole &= (row + 1) * side <= map_rows + SLIVER and (col + 1) * side <= map_cols + SLIVER
            places[row, col] = n if whole else -2 - n
            n += 1
    return n


@kernel
def encode(ranges: Floats, quantum: float, reach: float, codes: NDArray[np.uint16]) -> None:
    """Fill codes (n,) with ranges (n,) in metres: the nearest quantum, `NOTHING` for those that reach the end."""
    for i in range(len(ranges)):
        codes[i] = NOTHING if ranges[i] >= reach else np.uint16(ranges[i] / quantum + 0.5)


@kernel
def look_up_fan(poses: Floats, frame: tuple[float, float, float], fan: Floats, same_mount: bool, table: Table,
                max_range: float, ranges: Floats) -> int:  # fmt: skip
    """Look up the range of every beam at every pose.

    Parameters
    ----------
    poses
        (n, 3) robot poses in the map frame.
    frame
        Pose of the map's lower-left corner.
    fan
        (5, k): x and y of the mounts in cells, cos and sin of their directions, and these directions in headings of the
        table, in [0, headings).
    same_mount
        Whether all beams start at one point.
    table
        The table.
    max_range
        Longest range, metres.
    ranges
        (n * k,) float64, overwritten: metres; -1 for beams that start where the table has no place.

    Returns
    -------
    How many beams start there.
    """
    # Beams that start together are a group: all of a pose, or each by itself.
    beams = fan.shape[1] if same_mount else SINGLE
    n_groups = poses.shape[0] * (fan.shape[1] // beams)
    rays, groups = _allocate(), np.empty(GROUP_ROWS * BLOCK)
    # In single precision, a number that is no less.
    above = np.float64(np.float32(max_range) * NEXT)
    missing = NONE
    for first in range(0, n_groups, BLOCK):
        count = min(BLOCK, n_groups - first)
        _find_starts(poses, frame, fan, same_mount, table, first, count, above, groups)
        for start in range(0, count * beams, BLOCK):
            filled = min(BLOCK, count * beams - start)
            _aim(rays.state, rays.base, groups, fan, same_mount, table.headings, start, filled)
            missing += _read(rays, table, filled, first * beams + start, max_range, ranges)
    return missing


@kernel
def _allocate() -> Rays:
    """Return working memory of one thread: rays that all read the first code."""
    return Rays(
        np.zeros(STATE_ROWS * BLOCK, np.float32),
        np.zeros(BLOCK, np.uint32),
        np.zeros(BLOCK, np.uint32),
        np.zeros(BLOCK, np.uint32),
        np.zeros(BLOCK, np.uint16),
        np.zeros(BLOCK, np.uint16),
    )


@kernel
def _find_starts(poses: Floats, frame: tuple[float, float, float], fan: Floats, same_mount: bool, table: Table,
                 first: int, count: int, max_range: float, groups: Floats) -> None:  # fmt: skip
    """Fill the state of `count` groups from number `first` on: where they start and head, and the codes of that place.

    The heading is the pose's if a group is all its beams, and the beam's if it is one.
    """
    places, starts, stops = table.places, table.starts, table.stops
    side, resolution, headings = table.side, table.resolution, float(table.headings)
    frame_x, frame_y, yaw = frame
    frame_c, frame_s = math.cos(yaw), math.sin(yaw)
    per_pose = 1 if same_mount else fan.shape[1]
    for g in range(count):
        i = (first + g) // per_pose
        x, y = poses[i, 0] - frame_x, poses[i, 1] - frame_y
        groups[X + g] = (frame_c * x + frame_s * y) / resolution
        groups[Y + g] = (frame_c * y - frame_s * x) / resolution
        turns = (poses[i, 2] - yaw) / (2.0 * math.pi)
        groups[HEADING + g] = turns - np.floor(turns)
    for g in range(count):
        groups[COS + g], groups[SIN + g] = cos_sin(groups[HEADING + g] * (2.0 * math.pi))
    for g in range(count):
        b = (first + g) % per_pose
        c, s, heading = groups[COS + g], groups[SIN + g], groups[HEADING + g] * headings
        # Just below the border of a cell is on it, as for the ray caster.
        x = groups[X + g] + (c * fan[0, b] - s * fan[1, b]) + SNAP
        y = groups[Y + g] + (s * fan[0, b] + c * fan[1, b]) + SNAP
        if not same_mount:
            c, s = c * fan[2, b] - s * fan[3, b], s * fan[2, b] + c * fan[3, b]
            heading += fan[4, b]
        groups[HEADING + g] = heading - headings if heading >= headings else heading
        base, most, dx, dy = 0.0, -1.0, 0.0, 0.0
        col, row = np.floor(x / side), np.floor(y / side)
        # Also false for what is not a number.
        if col >= 0 and row >= 0 and col < places.shape[1] and row < places.shape[0]:
            place = np.int64(places[np.int64(row), np.int64(col)])
            if place >= 0:
                base, most, dx, dy = place * headings, max_range, x - (col + 0.5) * side, y - (row + 0.5) * side
            else:
                at_col, at_row = np.int64(x), np.int64(y)
                if at_col < stops.shape[1] - 2 and at_row < stops.shape[0] - 2:
                    if stops[at_row + 1, at_col + 1] == 0:
                        most = 0.0
                    elif place < -1:
                        place = -2 - place
                        base, most, dx, dy = place * headings, max_range, x - starts[place, 0], y - starts[place, 1]
        groups[BASE + g], groups[LONGEST + g] = base, most
        groups[AHEAD + g], groups[ASIDE + g] = (dx * c + dy * s) * resolution, (dy * c - dx * s) * resolution


@kernel
def _aim(state: NDArray[np.float32], bases: NDArray[np.uint32], groups: Floats, fan: Floats, same_mount: bool,
         headings: int, start: int, count: int) -> None:  # fmt: skip
    """Set up the state of `count` rays of the groups, from the ray with number `start` on."""
    beams, turn = fan.shape[1] if same_mount else SINGLE, float(headings)
    g, first, to = np.uintp(start // beams), np.uintp(start % beams), np.uintp(0)
    # Unsigned indices: LLVM vectorises only if none can be negative.
    while to < np.uintp(count):
        n = min(np.uintp(beams) - first, np.uintp(count) - to)
        ahead, aside, heading = groups[AHEAD + g], groups[ASIDE + g], groups[HEADING + g]
        base, most = np.uint32(groups[BASE + g]), np.float32(groups[LONGEST + g])
        for j in range(n):
            c, s, turned = 1.0, 0.0, heading
            if same_mount:
                c, s, turned = fan[FAN_COS, first + j], fan[FAN_SIN, first + j], heading + fan[FAN_HEADING, first + j]
            state[DIRECTION + to + j] = np.float32(turned - turn if turned >= turn else turned)
            state[FORWARD + to + j] = np.float32(ahead * c + aside * s)
            state[SIDEWAYS + to + j] = np.float32(aside * c - ahead * s)
            state[MOST + to + j] = most
            bases[to + j] = base
        to += n
        g += np.uintp(1)
        first = np.uintp(0)


@kernel
def _read(rays: Rays, table: Table, count: int, done: int, max_range: float, ranges: Floats) -> int:
    """Read the ranges of a block; those of its first `count` rays go to `done` on. Return how many have none.

    The point that a ray hits is seen from where the rays of its place start in a slightly other direction. A first look
    into the table says in which; there the ranges of two neighbouring directions are interpolated if they meet one
    wall. The range from beside is longer or shorter by how far its start is ahead.
    """
    state, base, here, beside, code, next_code = rays
    codes, quantum = table.codes, np.float32(table.quantum)
    headings, per_radian = np.float32(table.headings), np.float32(table.headings / (2.0 * math.pi))
    widest = np.float32(MOST_TURN) * per_radian
    for j in range(LANES):
        nearest = np.floor(state[DIRECTION + j] + HALF)
        nearest = nearest if nearest < headings else ZERO
        here[j] = base[j] + np.uint32(np.int32(nearest))
    for j in range(LANES):
        code[j] = codes[here[j]]
    for j in range(LANES):
        turn = state[SIDEWAYS + j] * per_radian / max(np.float32(code[j]) * quantum, CLOSE)
        direction = state[DIRECTION + j] + min(max(turn, -widest), widest)
        direction = direction + headings if direction < ZERO else direction
        direction = direction - headings if direction >= headings else direction
        before = np.floor(direction)
        after = before + ONE
        state[SHARE + j] = direction - before
        here[j] = base[j] + np.uint32(np.int32(before))
        beside[j] = base[j] + np.uint32(np.int32(after if after < headings else ZERO))
    for j in range(LANES):
        code[j] = codes[here[j]]
        next_code[j] = codes[beside[j]]
    for j in range(LANES):
        share, most = state[SHARE + j], state[MOST + j]
        metres, other = np.float32(code[j]) * quantum, np.float32(next_code[j]) * quantum
        one_wall = abs(other - metres) < SAME_WALL
        nearest_code = code[j] if share < HALF else next_code[j]
        metres = metres + share * (other - metres) if one_wall else np.float32(nearest_code) * quantum
        metres = min(max(metres - state[FORWARD + j], ZERO), most)
        state[RESULT + j] = most if nearest_code == NOTHING else metres
    missing = NONE
    for j in range(np.uintp(count)):
        ranges[np.uintp(done) + j] = min(np.float64(state[RESULT + j]), max_range)
        missing += 1 if state[RESULT + j] < ZERO else 0
    return missing
