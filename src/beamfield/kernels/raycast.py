"""Exact ray casting in a grid by jumps over free rectangles, many rays in lockstep.

All lengths are in cells, all cells in the order (column, row). A ray is reflected so that it runs towards growing
columns and rows; then it is followed by the *edges* it crosses: column edge X at the length tx(X) = (X - x) / cos, row
edge Y at ty(Y) = (Y - y) / sin. The cells of the ray are the merge of these two sorted sequences, so the path depends
on the ray alone and not on how it is followed. Two edges within `TIE` of each other are a corner.

`free_rectangles` stores for every cell and direction quadrant the side of the largest free square that starts there; a ray
that enters a cell may jump to the exit of its square. `trace_ray` follows one ray so, in float64. `_cast_block` follows
many at once in float32, keeps for each the closest approach to any corner, and hands every ray for which float32 cannot
decide an exit to `trace_ray`. The range is computed in float64 from the edges of the cell that was hit: it does not
depend on which of the two found the cell.
"""

from __future__ import annotations

import numpy as np

from beamfield.kernels.jit import kernel

# Crossings of a column and a row edge closer than this, in cells, are one crossing of a corner.
TIE = 1e-9
# Coordinates closer than this to a cell border, in cells, are on it.
SNAP = 1e-9
# Direction components smaller than this are 0: cos(pi / 2) is 6e-17.
PARALLEL = 1e-12
# Rays that start farther away than this, in cells, see nothing.
FAR = 1e12
# Stands for 1 / 0; its product with 0 is 0.
HUGE = 1e300
# Stands for the slope 1 / 0 in float32; its product with any distance in a grid is finite.
STEEP = 1e30

# Rays that walk in lockstep. Measured: ...
BLOCK = 256
# A row of a buffer: BLOCK rays, and room for a vector that is stored beyond them.
STRIDE = BLOCK + 8
# Jumps before a block hands its unfinished rays to the pool, and jumps of the pool between two clearances.
FIRST_STEPS = 5
MORE_STEPS = 3
# The state of each ray: rows of ONE float32 buffer, because LLVM vectorises only loops whose arrays it can prove apart.
FX, FY, SLOPE, INVERSE_SLOPE, COL, ROW, DOUBT, LAST_COL, LAST_ROW, LIMIT = (np.intp(i * BLOCK) for i in range(10))
STATE_ROWS = 10
# The same rays in float64: start, direction, and offset in the cell and inverse direction after the reflection.
X, Y, C, S, OX, OY, IC, IS = (np.intp(i * STRIDE) for i in range(8))
RAY_ROWS = 8

ZERO, ONE, HALF = np.float32(0), np.float32(1), np.float32(0.5)


@kernel
def free_rectangles(stops, rectangles):
    """Fill the table of free rectangles.

    Parameters
    ----------
    stops
        (rows, cols) bool: cells that stop a ray.
    rectangles
        (4, rows + 2, cols + 2) uint16, overwritten: width + 256 height (each at most 255) of a large rectangle without a
        stop that starts at the cell and extends in the direction of the quadrant; 0 in stops and in the frame around
        the map. Quadrant 1 is mirrored in x, 2 in y, 3 in both, so that each extends to growing indices.
    """
    rows, cols = stops.shape
    rectangles[:] = 0
    free_above = np.zeros(cols + 2, np.int32)
    for quadrant in range(4):
        table = rectangles[quadrant]
        free_above[:] = 0
        for r in range(rows, 0, -1):
            source = stops[rows - r if quadrant & 2 else r - 1]
            here, above = table[r], table[r + 1]
            width, height, free_right = np.int32(0), np.int32(0), np.int32(0)
            for c in range(cols, 0, -1):
                if source[cols - c if quadrant & 1 else c - 1]:
                    width, height, free_right, free_above[c] = np.int32(0), np.int32(0), np.int32(0), np.int32(0)
                    continue
                free_right = np.int32(free_right + 1)
                free_above[c] = np.int32(free_above[c] + 1)
                # The right neighbour's rectangle made wider, or that of the cell above made higher: the one with
                # the larger w h / (w + h), which a ray leaves later on the average over directions. Measured: 2.4
                # jumps per ray; the larger area 2.6, adding the largest square as a third choice 2.3, that alone 4.3.
                wide_w, wide_h = min(width + 1, 255), max(min(height, free_above[c]), 1)
                high_w, high_h = max(min(above[c] & 255, free_right), 1), min((above[c] >> 8) + 1, 255)
                wide = wide_w * wide_h * (high_w + high_h) >= high_w * high_h * (wide_w + wide_h)
                width, height = np.int32(wide_w if wide else high_w), np.int32(wide_h if wide else high_h)
                here[c] = np.uint16(width | height << 8)


@kernel
def cast_fan(poses, fan, rectangles, max_cells, ranges):
    """Cast the beams of a sensor from many poses.

    Parameters
    ----------
    poses
        (n, 4) x, y in cells, cos and sin of the heading, in the grid's frame.
    fan
        (4, k + 8) x, y in cells, cos and sin of each beam in the robot frame; the last 8 columns are never used, but read.
    rectangles
        Table of `free_rectangles`.
    max_cells
        Longest range, in cells.
    ranges
        (n * k,) float64, overwritten: ranges in cells, at most `max_cells`.
    """
    n, k = poses.shape[0], fan.shape[1] - 8
    fan_x, fan_y, fan_c, fan_s = fan[0], fan[1], fan[2], fan[3]
    table, rows, cols = rectangles.reshape(-1), rectangles.shape[1] - 2, rectangles.shape[2] - 2
    work = _allocate()
    ray = work[0]
    filled, done, n_free, doubts = 0, 0, BLOCK, 0
    for i in range(n):
        x, y, c, s = poses[i, 0], poses[i, 1], poses[i, 2], poses[i, 3]
        first = 0
        while first < k:
            count = min(k - first, BLOCK - filled)
            # Whole vectors of 8 beams: what they write too much is overwritten by the next pose.
            for part in range(0, count, 8):
                to, b = filled + part, first + part
                for v in range(8):
                    ray[X + to + v] = x + c * fan_x[b + v] - s * fan_y[b + v]
                    ray[Y + to + v] = y + s * fan_x[b + v] + c * fan_y[b + v]
                    ray[C + to + v] = c * fan_c[b + v] - s * fan_s[b + v]
                    ray[S + to + v] = s * fan_c[b + v] + c * fan_s[b + v]
            first += count
            filled += count
            if filled == BLOCK:
                n_free, doubts = _cast_block(work, n_free, doubts, table, rows, cols, max_cells, BLOCK, done, ranges)
                done += BLOCK
                filled = 0
    n_free, doubts = _cast_block(work, n_free, doubts, table, rows, cols, max_cells, filled, done, ranges)
    doubts = _finish(work, n_free, doubts, table, rows, cols, max_cells, ranges)
    if doubts > 0:
        for r in range(n * k):
            if ranges[r] < 0:
                i = r // k
                b = r - i * k
                x, y, c, s = poses[i, 0], poses[i, 1], poses[i, 2], poses[i, 3]
                t, _, _ = trace_ray(
                    x + c * fan_x[b] - s * fan_y[b],
                    y + s * fan_x[b] + c * fan_y[b],
                    c * fan_c[b] - s * fan_s[b],
                    s * fan_c[b] + c * fan_s[b],
                    table,
                    rows,
                    cols,
                    max_cells,
                )
                ranges[r] = min(t, max_cells)


@kernel
def cast_rays(x, y, c, s, rectangles, max_cells, ranges):
    """Cast single rays: starts (n,) in cells and directions (n,) as cos and sin; the rest as for `cast_fan`."""
    n = x.shape[0]
    table, rows, cols = rectangles.reshape(-1), rectangles.shape[1] - 2, rectangles.shape[2] - 2
    work = _allocate()
    ray = work[0]
    n_free, doubts = BLOCK, 0
    for done in range(0, n, BLOCK):
        count = min(BLOCK, n - done)
        for j in range(count):
            ray[X + j], ray[Y + j], ray[C + j], ray[S + j] = x[done + j], y[done + j], c[done + j], s[done + j]
        n_free, doubts = _cast_block(work, n_free, doubts, table, rows, cols, max_cells, count, done, ranges)
    doubts = _finish(work, n_free, doubts, table, rows, cols, max_cells, ranges)
    if doubts > 0:
        for r in range(n):
            if ranges[r] < 0:
                t, _, _ = trace_ray(x[r], y[r], c[r], s[r], table, rows, cols, max_cells)
                ranges[r] = min(t, max_cells)


@kernel
def trace_rays(x, y, c, s, rectangles, max_cells, ranges, cells):
    """Do what `cast_rays` does, one ray after the other in float64: its reference and its fallback."""
    rows, cols = rectangles.shape[1] - 2, rectangles.shape[2] - 2
    table = rectangles.reshape(-1)
    for j in range(x.shape[0]):
        t, col, row = trace_ray(x[j], y[j], c[j], s[j], table, rows, cols, max_cells)
        ranges[j] = min(t, max_cells)
        if cells.shape[0] > 0:
            cells[j, 0], cells[j, 1] = row, col


@kernel
def trace_ray(x, y, c, s, table, rows, cols, max_cells):
    """Return the length to the first stop and its (col, row); (inf, -1, -1) if there is none before `max_cells`."""
    nothing = np.inf, -1, -1
    if not (abs(x) < FAR and abs(y) < FAR):
        return nothing
    ox, start_col, inv_c, c_abs = _reflect(x, c, cols)
    oy, start_row, inv_s, s_abs = _reflect(y, s, rows)
    quadrant = (1 if c <= -PARALLEL else 0) + (2 if s <= -PARALLEL else 0)
    base = quadrant * (rows + 2) * (cols + 2) + cols + 3
    if start_col >= cols or start_row >= rows:
        return nothing
    # i, j count cells from the start; outside the map only the last cell before it matters.
    i, j = 0.0, 0.0
    if start_col < 0 or start_row < 0:
        tx = (-start_col - ox) * inv_c if start_col < 0 else -1.0
        ty = (-start_row - oy) * inv_s if start_row < 0 else -1.0
        if max(tx, ty) >= max_cells:
            return nothing
        if abs(tx - ty) <= TIE:
            i, j = -start_col - 1, -start_row - 1
        elif tx > ty:
            i, j = -start_col - 1, _edges_before(tx, oy, s_abs, inv_s, 0.0, np.inf)
        else:
            i, j = _edges_before(ty, ox, c_abs, inv_c, 0.0, np.inf), -start_row - 1
    while start_col + i < cols and start_row + j < rows:
        if start_col + i >= 0 and start_row + j >= 0:
            free = table[base + np.int64(start_row + j) * (cols + 2) + np.int64(start_col + i)]
            if free == 0:
                t = max(max((i - ox) * inv_c, (j - oy) * inv_s), 0.0)
                return _hit(t, start_col + i, start_row + j, quadrant, rows, cols, max_cells)
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
            # A corner: it blocks if both cells beside it stop the ray, as does the cell behind it.
            col, row = start_col + i, start_row + j
            if (
                0 <= row
                and 0 <= col
                and row + 1 < rows
                and col + 1 < cols
                and table[base + np.int64(row) * (cols + 2) + np.int64(col + 1)] == 0
                and table[base + np.int64(row + 1) * (cols + 2) + np.int64(col)] == 0
            ):
                return _hit(max(tx, ty), col + 1, row, quadrant, rows, cols, max_cells)
            i, j = i + 1, j + 1
        elif tx < ty:
            i += 1
        else:
            j += 1
    return nothing


@kernel
def _reflect(x, c, n_cells):
    """Return offset in the cell, cell, 1 / |c| and |c| of one axis, reflected so that the ray does not run backwards."""
    nearest = np.floor(x + 0.5)
    x = nearest if abs(x - nearest) <= SNAP else x
    cell = np.floor(x)
    offset = x - cell
    speed = abs(c) if abs(c) >= PARALLEL else 0.0
    inverse = 1.0 / speed if speed > 0 else HUGE
    backwards = c <= -PARALLEL
    return 1.0 - offset if backwards else offset, n_cells - 1 - cell if backwards else cell, inverse, speed


@kernel
def _edges_before(t, offset, speed, inverse, low, high):
    """Return how many edges of one axis a ray has crossed before t, given that it is from low to high."""
    k = min(max(np.floor(offset + t * speed), low), high)
    while k > low and (k - offset) * inverse >= t - TIE:
        k -= 1
    while k < high and (k + 1 - offset) * inverse < t - TIE:
        k += 1
    return k


@kernel
def _hit(t, col, row, quadrant, rows, cols, max_cells):
    """Return the length and the cell (col, row) before the reflection."""
    if t >= max_cells:
        return np.inf, -1, -1
    col, row = np.int64(col), np.int64(row)
    return t, cols - 1 - col if quadrant & 1 else col, rows - 1 - row if quadrant & 2 else row


@kernel
def _allocate():
    """Return scratch: the block's rays, their state and base; the pool's; look-ups."""
    free = np.zeros(BLOCK, np.int64)
    for m in range(BLOCK):
        free[m] = m
    return (
        np.zeros(RAY_ROWS * STRIDE, np.float64),
        np.zeros(STATE_ROWS * BLOCK, np.float32),
        np.zeros(BLOCK, np.int32),
        np.zeros(RAY_ROWS * STRIDE, np.float64),
        np.zeros(STATE_ROWS * BLOCK, np.float32),
        np.zeros(BLOCK, np.int32),
        np.full(BLOCK, -1, np.int64),
        free,
        np.zeros(BLOCK, np.int64),
        np.zeros(BLOCK, np.uint32),
        np.zeros(BLOCK, np.uint16),
        np.zeros(BLOCK, np.uint8),
    )


@kernel
def _cast_block(work, n_free, doubts, table, rows, cols, max_cells, count, done, ranges):
    """Cast the first `count` rays of the block; results from index `done` on, now or when the pool finishes them."""
    ray, state, base, pool_ray, pool, pool_base, owner, free, chosen, index, size, alive = work
    _start(ray, state, base, rows, cols, max_cells)
    _walk(state, base, index, size, alive, table, cols + 2, FIRST_STEPS)
    doubtful = 0
    for j in range(count):
        t = max((state[COL + j] - ray[OX + j]) * ray[IC + j], (state[ROW + j] - ray[OY + j]) * ray[IS + j])
        past = (state[COL + j] > state[LAST_COL + j]) | (state[ROW + j] > state[LAST_ROW + j])
        doubt = state[DOUBT + j] > state[LIMIT + j]
        t = max_cells if past else min(max(t, 0.0), max_cells)
        ranges[done + j] = -1.0 if doubt else t
        doubtful += doubt
    doubts += doubtful
    left = 0
    for j in range(count):
        chosen[left] = j
        left += alive[j]
    for i in range(left):
        if n_free == 0:
            n_free, doubts = _advance(work, doubts, table, cols, max_cells, ranges)
        n_free -= 1
        m, j = free[n_free], chosen[i]
        owner[m] = done + j
        pool_base[m] = base[j]
        pool[FX + m], pool[FY + m], pool[COL + m], pool[ROW + m] = (
            state[FX + j],
            state[FY + j],
            state[COL + j],
            state[ROW + j],
        )
        pool[SLOPE + m], pool[INVERSE_SLOPE + m] = state[SLOPE + j], state[INVERSE_SLOPE + j]
        pool[DOUBT + m], pool[LIMIT + m] = state[DOUBT + j], state[LIMIT + j]
        pool[LAST_COL + m], pool[LAST_ROW + m] = state[LAST_COL + j], state[LAST_ROW + j]
        pool_ray[OX + m], pool_ray[OY + m], pool_ray[IC + m], pool_ray[IS + m] = (
            ray[OX + j],
            ray[OY + j],
            ray[IC + j],
            ray[IS + j],
        )
    return n_free, doubts


@kernel
def _finish(work, n_free, doubts, table, rows, cols, max_cells, ranges):
    """Finish the rays in the pool."""
    while n_free < BLOCK:
        n_free, doubts = _advance(work, doubts, table, cols, max_cells, ranges)
    return doubts


@kernel
def _advance(work, doubts, table, cols, max_cells, ranges):
    """Let the rays of the pool jump until one is finished; return the number of free places and of doubtful rays."""
    ray, state, base, owner, free, chosen, index, size, alive = (
        work[3],
        work[4],
        work[5],
        work[6],
        work[7],
        work[8],
        work[9],
        work[10],
        work[11],
    )
    n_free = 0
    while n_free == 0:
        _walk(state, base, index, size, alive, table, cols + 2, MORE_STEPS)
        for m in range(BLOCK):
            free[n_free] = m
            n_free += 1 - alive[m]
    for i in range(n_free):
        j = free[i]
        if owner[j] >= 0:
            t = max((state[COL + j] - ray[OX + j]) * ray[IC + j], (state[ROW + j] - ray[OY + j]) * ray[IS + j])
            past = (state[COL + j] > state[LAST_COL + j]) | (state[ROW + j] > state[LAST_ROW + j])
            doubt = state[DOUBT + j] > state[LIMIT + j]
            t = max_cells if past else min(max(t, 0.0), max_cells)
            ranges[owner[j]] = -1.0 if doubt else t
            doubts += doubt
            owner[j] = -1
            base[j] = 0
            state[COL + j], state[ROW + j] = ZERO, ZERO
    return n_free, doubts


@kernel
def _start(ray, state, base, rows, cols, max_cells):
    """Set up all rays of a block."""
    reach = min(max_cells, np.float64(rows + cols)) + 2.0
    for j in range(BLOCK):
        c, s = ray[C + j], ray[S + j]
        ox, col, inv_c, c_abs = _reflect(ray[X + j], c, cols)
        oy, row, inv_s, s_abs = _reflect(ray[Y + j], s, rows)
        inside = (col >= 0) & (col < cols) & (row >= 0) & (row < rows)
        quadrant = (1 if c <= -PARALLEL else 0) + (2 if s <= -PARALLEL else 0)
        corner = (quadrant * (rows + 2) + row + 1) * (cols + 2) + col + 1
        base[j] = np.int32(corner if inside else 0.0)
        ray[OX + j], ray[OY + j], ray[IC + j], ray[IS + j] = ox, oy, inv_c, inv_s
        # A parallel ray never crosses an edge of the other axis: anywhere inside the cell is right for it.
        state[FX + j] = np.float32(ox) if c_abs > 0 else HALF
        state[FY + j] = np.float32(oy) if s_abs > 0 else HALF
        slope, inverse_slope = min(s_abs * inv_c, STEEP), min(c_abs * inv_s, STEEP)
        state[SLOPE + j], state[INVERSE_SLOPE + j] = np.float32(slope), np.float32(inverse_slope)
        steepest = max(slope if c_abs > 0 else 0.0, inverse_slope if s_abs > 0 else 0.0)
        state[LIMIT + j] = np.float32(0.5 - (reach + steepest) * 4.76837158203125e-07) if inside else -ONE
        state[LAST_COL + j] = np.float32(min(1.0 + reach * c_abs * 1.000001, cols - col - 0.5))
        state[LAST_ROW + j] = np.float32(min(1.0 + reach * s_abs * 1.000001, rows - row - 0.5))
        state[COL + j] = ZERO
        state[ROW + j] = ZERO
        state[DOUBT + j] = ZERO


@kernel
def _walk(state, base, index, size, alive, table, width, steps):
    """Jump `steps` times; say which rays are still under way."""
    for j in range(BLOCK):
        index[j] = base[j] + np.int32(state[ROW + j]) * np.int32(width) + np.int32(state[COL + j])
    for j in range(BLOCK):
        size[j] = table[index[j]]
    for _ in range(steps):
        for j in range(BLOCK):
            col, row = state[COL + j], state[ROW + j]
            edge_x, edge_y = col + np.float32(size[j] & 255), row + np.float32(size[j] >> 8)
            fx, fy = state[FX + j], state[FY + j]
            at_x = (edge_x - fx) * state[SLOPE + j] + fy
            at_y = (edge_y - fy) * state[INVERSE_SLOPE + j] + fx
            x_first = at_x < edge_y
            other = at_x if x_first else at_y
            cell = np.floor(other)
            go = size[j] > 0
            col = (edge_x if x_first else cell) if go else col
            row = (cell if x_first else edge_y) if go else row
            state[COL + j] = col
            state[ROW + j] = row
            state[DOUBT + j] = max(state[DOUBT + j], abs(other - cell - HALF))
            index[j] = base[j] + np.int32(row) * np.int32(width) + np.int32(col)
        for j in range(BLOCK):
            size[j] = table[index[j]]
    for j in range(BLOCK):
        alive[j] = (
            (size[j] > 0)
            & (state[COL + j] <= state[LAST_COL + j])
            & (state[ROW + j] <= state[LAST_ROW + j])
            & (state[DOUBT + j] <= state[LIMIT + j])
        )
