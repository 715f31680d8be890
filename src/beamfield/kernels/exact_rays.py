"""Rays through a grid one by one, in float64: the rule by which `raycast` and a GPU follow them, too.

All lengths are in cells, all cells in the order (column, row). A ray is reflected so that it runs towards growing
columns and rows; then it is followed by the *edges* it crosses: column edge X at the length tx(X) = (X - x) / cos, row
edge Y at ty(Y) = (Y - y) / sin. The cells of the ray are the merge of these two sorted sequences, so the path depends
on the ray alone and not on how it is followed. Two edges within `TIE` of each other are a corner.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.elementary import FAR, HUGE, PARALLEL, TIE, split
from beamfield.kernels.jit import inlined_kernel, integer, kernel
from beamfield.kernels.placed_poses import STRIDE, place

SINGLE = integer(1)

Floats = NDArray[np.float64]
Cells = NDArray[np.int32]


class Terrain(NamedTuple):
    """What rays run through, and how far."""

    table: NDArray[np.uint16]  # free_rectangles, flat
    rows: int
    cols: int
    resolution: float  # metres per cell
    max_range: float  # metres
    max_cells: float  # the same in cells


@kernel
def trace_fan(poses: Floats, frame: tuple[float, float, float], fan: Floats, terrain: Terrain, ranges: Floats,
              cells: Cells, only_doubtful: bool) -> None:  # fmt: skip
    """Do what `cast_fan` does ray by ray in float64.

    With `only_doubtful` just the beams with a negative range; else all, and cells (n * k, 2) are filled with (row, col)
    of the hit or -1.
    """
    k = fan.shape[1] - 8
    fan_x, fan_y, fan_c, fan_s = fan[0], fan[1], fan[2], fan[3]
    placed = np.zeros(4 * STRIDE)
    of_pose = -1
    for r in range(poses.shape[0] * k):
        if only_doubtful and ranges[r] >= 0:
            continue
        i = r // k
        b = r - i * k
        if i != of_pose:
            place(poses, frame, terrain.resolution, i, SINGLE, placed)
            of_pose = i
        x, y, c, s = placed[0], placed[STRIDE], placed[2 * STRIDE], placed[3 * STRIDE]
        cell_x, offset_x = split(x + (c * fan_x[b] - s * fan_y[b]))
        cell_y, offset_y = split(y + (s * fan_x[b] + c * fan_y[b]))
        beam_c, beam_s = c * fan_c[b] - s * fan_s[b], s * fan_c[b] + c * fan_s[b]
        ranges[r], row, col = _trace_ray(cell_x, cell_y, offset_x, offset_y, beam_c, beam_s, terrain)
        if not only_doubtful:
            cells[r, 0], cells[r, 1] = row, col


@kernel
def one_beam() -> Floats:
    """Return the fan of a sensor with one beam, straight ahead: with it, poses are rays."""
    fan = np.zeros((4, 9))
    fan[2, 0] = 1.0
    return fan


@kernel
def _trace_ray(
    cell_x: float, cell_y: float, offset_x: float, offset_y: float, c: float, s: float, terrain: Terrain
) -> tuple[float, int, int]:
    """Follow one ray in float64 from cell and offset in direction c, s; return range in metres and (row, col)."""
    table, rows, cols, max_cells = terrain.table, terrain.rows, terrain.cols, terrain.max_cells
    nothing = terrain.max_range, -1, -1
    if not (abs(cell_x) < FAR and abs(cell_y) < FAR):
        return nothing
    ox, start_col, inv_c, c_abs = _reflect(cell_x, offset_x, c, cols)
    oy, start_row, inv_s, s_abs = _reflect(cell_y, offset_y, s, rows)
    if start_col >= cols or start_row >= rows:
        return nothing
    quadrant = _quadrant(c, s)
    base = quadrant * (rows + 2) * (cols + 2) + cols + 3
    # i, j count the cells from the start. A start off the map jumps to the last cell before the map.
    i, j = 0.0, 0.0
    if start_col < 0 or start_row < 0:
        tx = (-start_col - ox) * inv_c if start_col < 0 else -1.0
        ty = (-start_row - oy) * inv_s if start_row < 0 else -1.0
        if max(tx, ty) >= max_cells:
            return nothing
        if abs(tx - ty) <= TIE:
            i, j = -start_col - 1, -start_row - 1
        elif tx > ty:
            i, j = -start_col - 1, _edges_before(tx, oy, s_abs, inv_s, 0.0, rows - start_row)
        else:
            i, j = _edges_before(ty, ox, c_abs, inv_c, 0.0, cols - start_col), -start_row - 1
    while start_col + i < cols and start_row + j < rows:
        if start_col + i >= 0 and start_row + j >= 0:
            free = np.int64(table[base + np.int64(start_row + j) * (cols + 2) + np.int64(start_col + i)])
            if free == 0:
                t = max((i - ox) * inv_c, (j - oy) * inv_s)
                return _hit(t, start_col + i, start_row + j, quadrant, terrain)
            if free > 257:
                # To the last cell in the rectangle; leaving it is a step like any other.
                last_i, last_j = i + (free & 255) - 1, j + (free >> 8) - 1
                tx, ty = (last_i + 1 - ox) * inv_c, (last_j + 1 - oy) * inv_s
                if abs(tx - ty) <= TIE:
                    i, j = last_i, last_j
                elif tx < ty:
                    i, j = last_i, _edges_before(tx, oy, s_abs, inv_s, j, last_j)
                else:
                    i, j = _edges_before(ty, ox, c_abs, inv_c, i, last_i), last_j
        tx, ty = (i + 1 - ox) * inv_c, (j + 1 - oy) * inv_s
        if min(tx, ty) >= max_cells:
            return nothing
        if abs(tx - ty) <= TIE:
            # A corner: it blocks if both cells beside it do. Cells off the map do not.
            col, row = start_col + i, start_row + j
            if col >= 0 and row >= 0 and col + 1 < cols and row + 1 < rows:
                here = base + np.int64(row) * (cols + 2) + np.int64(col)
                if table[here + 1] == 0 and table[here + cols + 2] == 0:
                    return _hit(max(tx, ty), col + 1, row, quadrant, terrain)
            i, j = i + 1, j + 1
        elif tx < ty:
            i += 1
        else:
            j += 1
    return nothing


@inlined_kernel
def _reflect(cell: float, offset: float, c: float, n_cells: int) -> tuple[float, float, float, float]:
    """Return offset, cell, 1 / |c| and |c| of one axis, reflected so that the ray does not run backwards."""
    speed = abs(c) if abs(c) >= PARALLEL else 0.0
    inverse = 1.0 / speed if speed > 0 else HUGE
    backwards = c <= -PARALLEL
    return (1.0 - offset if backwards else offset), (n_cells - 1 - cell if backwards else cell), inverse, speed


@inlined_kernel
def _quadrant(c: float, s: float) -> int:
    """Return the number of the quadrant, as in the table."""
    return (1 if c <= -PARALLEL else 0) + (2 if s <= -PARALLEL else 0)


@kernel
def _edges_before(t: float, offset: float, speed: float, inverse: float, low: float, high: float) -> float:
    """Return how many edges of one axis a ray has crossed before t, given that it is from low to high."""
    k = min(max(float(np.floor(offset + t * speed)), low), high)
    while k > low and (k - offset) * inverse >= t - TIE:
        k -= 1
    while k < high and (k + 1 - offset) * inverse < t - TIE:
        k += 1
    return k


@kernel
def _hit(t: float, col: float, row: float, quadrant: int, terrain: Terrain) -> tuple[float, int, int]:
    """Return the range in metres and the cell (row, col) before the reflection."""
    metres = max(t, 0.0) * terrain.resolution
    if metres >= terrain.max_range:
        return terrain.max_range, -1, -1
    i, j = int(col), int(row)
    return metres, terrain.rows - 1 - j if quadrant & 2 else j, terrain.cols - 1 - i if quadrant & 1 else i
