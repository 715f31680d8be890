"""What other programs do cell by cell: brushfire distances, Bresenham rays and look-ups of end points.

Cells are in the order (row, col); a point with the coordinates u, v in cells lies in the cell (floor(v), floor(u)).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import inlined_kernel, integer, kernel

Floats = NDArray[np.float64]
# Coordinates are held within this many cells, so that they fit an integer; no map is so large.
FAR = 1e9
KNOWN, UNKNOWN, OFF_MAP = np.int8(0), np.int8(1), np.int8(2)
NOTHING = integer(0)
# What a cell does to a ray.
PASSES, STOPS, EDGE = np.uint8(0), np.uint8(1), np.uint8(2)


@kernel
def brushfire(obstacles: NDArray[np.bool_], limit: float, neighbours: NDArray[np.int64], columns_first: bool,
              remove_last: bool, settle_beyond: bool, squared: NDArray[np.int32]) -> None:  # fmt: skip
    """Fill squared distances in cells to the obstacle that a brushfire finds first, -1 where it ends before.

    Cells catch fire from a neighbour and take over its obstacle, nearest first. A cell's own nearest obstacle need not
    be that of a neighbour, and a cell is never looked at again, so that some distances are too long. Which, depends on
    the order among equals; the options are those orders.

    Parameters
    ----------
    obstacles
        (rows, cols).
    limit
        The fire ends where the squared distance exceeds this, in square cells.
    neighbours
        (4, 2) steps (row, col) in the order in which a cell sets fire.
    columns_first
        Obstacles catch fire column by column, not row by row.
    remove_last
        A cell leaves the binary heap after it has set fire to its neighbours, not before.
    settle_beyond
        A cell that the fire reaches from the limit on is done with; otherwise (beyond the limit) it may still be
        reached from another neighbour.
    squared
        (rows, cols) int32, overwritten.
    """
    rows, cols = obstacles.shape
    size = rows * cols
    source = np.empty(size, np.int32)
    key = np.empty(size + 1, np.int32)
    cell = np.empty(size + 1, np.int32)
    settled = np.zeros(size, np.bool_)
    flat = squared.reshape(size)
    flat[:] = -1
    n = NOTHING
    for t in range(size):
        r, c = (t % rows, t // rows) if columns_first else (t // cols, t % cols)
        if obstacles[r, c]:
            i = r * cols + c
            flat[i], source[i], settled[i] = 0, i, True
            n = _push(key, cell, n, NOTHING, i)
    while n > 0:
        i = np.int64(cell[0])
        if not remove_last:
            n = _pop(key, cell, n)
        r, c = i // cols, i % cols
        origin_r, origin_c = source[i] // cols, source[i] % cols
        for q in range(4):
            row, col = r + neighbours[q, 0], c + neighbours[q, 1]
            if row < 0 or col < 0 or row >= rows or col >= cols:
                continue
            j = row * cols + col
            if settled[j]:
                continue
            distance = (row - origin_r) ** 2 + (col - origin_c) ** 2
            if settle_beyond and distance >= limit:
                settled[j] = True
                continue
            if distance > limit:
                continue
            flat[j], source[j], settled[j] = distance, source[i], True
            n = _push(key, cell, n, distance, j)
        if remove_last:
            n = _pop(key, cell, n)


@kernel
def _push(key: NDArray[np.int32], cell: NDArray[np.int32], n: int, distance: int, index: int) -> int:
    """Add an element to a binary heap of n, nearest on top."""
    _rise(key, cell, n, distance, index)
    return n + 1


@kernel
def _pop(key: NDArray[np.int32], cell: NDArray[np.int32], n: int) -> int:
    """Remove the top: the gap sinks to the bottom along nearer children (right if equal), the last element rises."""
    n -= 1
    distance, index = key[n], cell[n]
    place = 0
    child = 2
    while child < n:
        if key[child] > key[child - 1]:
            child -= 1
        key[place], cell[place] = key[child], cell[child]
        place = child
        child = 2 * place + 2
    if child == n:
        key[place], cell[place] = key[n - 1], cell[n - 1]
        place = n - 1
    _rise(key, cell, place, distance, index)
    return n


@kernel
def _rise(key: NDArray[np.int32], cell: NDArray[np.int32], place: int, distance: int, index: int) -> None:
    """Let an element rise from a gap past parents that are strictly farther."""
    while place > 0:
        parent = (place - 1) // 2
        if key[parent] <= distance:
            break
        key[place], cell[place] = key[parent], cell[parent]
        place = parent
    key[place], cell[place] = distance, index


@kernel
def look_up_ends(poses: Floats, frame: tuple[float, float, float], resolution: float, ends: Floats,
                 distance: NDArray[np.floating], unknown: NDArray[np.bool_], distances: NDArray[np.floating],
                 places: NDArray[np.int8]) -> None:  # fmt: skip
    """Look up the cell of every beam's end point.

    Parameters
    ----------
    poses
        (n, 3) robot poses in the map frame, metres and radians.
    frame
        (x, y, yaw) of the grid's corner in the map frame.
    resolution
        Metres per cell.
    ends
        (2, k) end points in the robot frame, metres.
    distance, unknown
        (rows, cols) what each cell holds.
    distances
        (n, k) overwritten, of the same type: the cell's distance, +inf off the map.
    places
        (n, k) int8, overwritten: known, unknown or off the map.
    """
    rows, cols = distance.shape
    cos_frame, sin_frame = math.cos(frame[2]), math.sin(frame[2])
    for i in range(len(poses)):
        x, y, _, c, s = _in_frame(poses[i, 0], poses[i, 1], poses[i, 2], frame, cos_frame, sin_frame)
        for b in range(ends.shape[1]):
            u = (x + (c * ends[0, b] - s * ends[1, b])) / resolution
            v = (y + (s * ends[0, b] + c * ends[1, b])) / resolution
            # Compared before they become integers, which might not hold them.
            if u >= 0.0 and v >= 0.0 and u < cols and v < rows:
                row, col = math.floor(v), math.floor(u)
                distances[i, b] = distance[row, col]
                places[i, b] = UNKNOWN if unknown[row, col] else KNOWN
            else:
                distances[i, b] = np.inf
                places[i, b] = OFF_MAP


@kernel
def sum_ends(poses: Floats, frame: tuple[float, float, float], resolution: float, shape: tuple[int, int],
             ends: Floats, terms: Floats, sums: Floats) -> None:  # fmt: skip
    """Add up what the cells of all beams' end points hold.

    Parameters
    ----------
    poses, frame, resolution, ends
        As for `look_up_ends`, which finds the same cells.
    shape
        (rows, cols) of the grid, fewer than 2^31 cells.
    terms
        (rows * cols + 1,) what each cell adds, row by row; the last is that of an end point off the map.
    sums
        (n,) overwritten.
    """
    cells = np.empty(ends.shape[1], np.int32)
    right, top, width, off_map = float(shape[1]), float(shape[0]), np.int32(shape[1]), np.int32(len(terms) - 1)
    cos_frame, sin_frame = math.cos(frame[2]), math.sin(frame[2])
    for i in range(len(poses)):
        x, y, _, c, s = _in_frame(poses[i, 0], poses[i, 1], poses[i, 2], frame, cos_frame, sin_frame)
        # A loop of its own, which is vectorised; with the sum in it, all takes 2 to 3 times as long.
        for b in range(len(cells)):
            u = (x + (c * ends[0, b] - s * ends[1, b])) / resolution
            v = (y + (s * ends[0, b] + c * ends[1, b])) / resolution
            inside = (u >= 0.0) & (v >= 0.0) & (u < right) & (v < top)
            col, row = np.int32(u if inside else 0.0), np.int32(v if inside else 0.0)
            cells[b] = row * width + col if inside else off_map
        total = 0.0
        for b in range(len(cells)):
            total += terms[cells[b]]
        sums[i] = total


@kernel
def cast_bresenham(poses: Floats, frame: tuple[float, float, float], resolution: float, starts: Floats,
                   bearings: Floats, max_range: float, cells: NDArray[np.uint8], edge_stops: bool, overshoot: int,
                   ties_turn: bool, ranges: Floats) -> None:  # fmt: skip
    """Follow Bresenham's line from the cell of each beam's start to the cell max_range away.

    Parameters
    ----------
    poses, frame, resolution
        As for `look_up_ends`.
    starts
        (2, k) start of each beam in the robot frame, metres.
    bearings
        (k,) direction of each beam in the robot frame, radians.
    max_range
        Metres.
    cells
        (rows + 2, cols + 2): what each cell does to a ray, PASSES or STOPS, in a frame of EDGE.
    edge_stops
        Whether the first cell off the map stops a ray; otherwise the ray then meets nothing.
    overshoot
        How many cells past the last one the line goes.
    ties_turn
        Whether the line changes rows (or columns) already where it passes midway between two cells.
    ranges
        (n, k) overwritten: metres between the centres of the first and the stopping cell; max_range if there is none.
    """
    lines = np.empty((len(bearings), 4), np.int64)
    cos_frame, sin_frame = math.cos(frame[2]), math.sin(frame[2])
    for i in range(len(poses)):
        x, y, heading, c, s = _in_frame(poses[i, 0], poses[i, 1], poses[i, 2], frame, cos_frame, sin_frame)
        for b in range(len(bearings)):
            from_x, from_y = x + (c * starts[0, b] - s * starts[1, b]), y + (s * starts[0, b] + c * starts[1, b])
            along = heading + bearings[b]
            to_x, to_y = from_x + max_range * math.cos(along), from_y + max_range * math.sin(along)
            lines[b, 0], lines[b, 1] = _cell(from_x / resolution), _cell(from_y / resolution)
            lines[b, 2], lines[b, 3] = _cell(to_x / resolution), _cell(to_y / resolution)
        # A loop of its own: where a line ends, a processor that guessed otherwise begins anew with what follows.
        for b in range(len(bearings)):
            x0, y0, x1, y1 = lines[b, 0], lines[b, 1], lines[b, 2], lines[b, 3]
            distance = _follow(x0, y0, x1, y1, cells, edge_stops, overshoot, ties_turn)
            ranges[i, b] = distance * resolution if distance >= 0.0 else max_range


@inlined_kernel
def _in_frame(
    x: float, y: float, theta: float, frame: tuple[float, float, float], cos_frame: float, sin_frame: float
) -> tuple[float, float, float, float, float]:
    """Return x, y and heading of a pose in the grid's frame, with the heading's cos and sin."""
    dx, dy, heading = x - frame[0], y - frame[1], theta - frame[2]
    u, v = cos_frame * dx + sin_frame * dy, cos_frame * dy - sin_frame * dx
    return u, v, heading, math.cos(heading), math.sin(heading)


@inlined_kernel
def _cell(coordinate: float) -> int:
    return math.floor(min(max(coordinate, -FAR), FAR))


@inlined_kernel
def _follow(
    x0: int, y0: int, x1: int, y1: int, cells: NDArray[np.uint8], edge_stops: bool, overshoot: int, ties_turn: bool
) -> float:
    """Return the distance in cells from the first to the stopping cell of a line, -1 if nothing stops it."""
    rows, cols = cells.shape
    if x0 < 0 or y0 < 0 or x0 >= cols - 2 or y0 >= rows - 2:
        return 0.0 if edge_stops else -1.0
    flat, at = cells.reshape(-1), (y0 + 1) * cols + x0 + 1
    dx, dy = abs(x1 - x0), abs(y1 - y0)
    along, across = (1 if x0 < x1 else -1), (cols if y0 < y1 else -cols)
    if dy > dx:
        along, across = across, along
    # One cell per step along the long axis, and one across where `error` is not negative.
    long, short = max(dx, dy), min(dx, dy)
    error, back = 2 * short - long - (0 if ties_turn else 1), 2 * (short - long)
    for _ in range(long + 1 + overshoot):
        here = flat[np.uintp(at)]
        if here != PASSES:
            dx, dy = at % cols - 1 - x0, at // cols - 1 - y0
            return -1.0 if here == EDGE and not edge_stops else math.sqrt(dx * dx + dy * dy)
        # No branch, which processors would guess wrong at every other turn: -1 where it goes straight on, else 0.
        straight = error >> 63
        at += along + (across & ~straight)
        error += back + (2 * long & straight)
    return -1.0
