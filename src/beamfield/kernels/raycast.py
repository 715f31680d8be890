"""Exact ray casting in a grid by jumps over free rectangles, many rays in lockstep.

`exact_rays` says which cells a ray meets, and follows one in float64; `free_rectangles` stores for every cell and
direction quadrant a large free rectangle that starts there, to whose exit a ray that enters the cell may jump. Here
`_cast_block` follows many at once in float32, keeps for each how close it came to a corner, and leaves every ray for
which float32 cannot decide where it went to `trace_fan`. The range is computed in float64 from the edges of the cell
that was hit, so it does not depend on which of the two found that cell.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.elementary import PARALLEL, split
from beamfield.kernels.exact_rays import Terrain, trace_fan
from beamfield.kernels.jit import inlined_kernel, integer, kernel, wide_vectors
from beamfield.kernels.placed_poses import BLOCK, STRIDE, place

# Stands for 0 below a fraction in float32: the product of 1 / FLAT with any distance in a grid is finite.
FLAT = np.float32(1e-30)
# PARALLEL in float32, less what rounding could add: rays between the two are too steep for float32, thus in doubt.
PARALLEL_32 = np.float32(0.999 * PARALLEL)
# From so many columns or rows on float32 cannot number them all.
WIDE = 2**24
# Bound of the float32 error of the coordinate at which a ray crosses an edge: DOUBT_PER_CELL (reach + slope); see "The
# bound of doubt" in docs/evidence/raycasting.md.
DOUBT_PER_CELL = np.float32(12.0 * 2.0**-24)

NOTHING = integer(0)
# Loops over multiples of so many rays are vectorised to their end.
LANES = integer(32)
# Jumps before a block hands its unfinished rays (10%) to the pool, and jumps of the pool between two clearances.
FIRST_STEPS = integer(4)
MORE_STEPS = integer(3)
# State of each ray in float32: rows of ONE buffer, because LLVM vectorises only loops whose arrays it can prove apart.
FX, FY, SLOPE, INVERSE_SLOPE, COL, ROW, DOUBT, LAST_COL, LAST_ROW, LIMIT = (np.intp(i * BLOCK) for i in range(10))
STATE_ROWS = 10
# The same rays in float64: start cell and offset in it, direction.
CELL_X, CELL_Y, OFFSET_X, OFFSET_Y, COS, SIN = (np.intp(i * STRIDE) for i in range(6))
RAY_ROWS = 6

ZERO, HALF, ONE, TWO = np.float32(0), np.float32(0.5), np.float32(1), np.float32(2)

Floats = NDArray[np.float64]


class Lanes(NamedTuple):
    """Rays in lockstep."""

    ray: NDArray[np.float64]  # RAY_ROWS rows of STRIDE
    state: NDArray[np.float32]  # STATE_ROWS rows of BLOCK
    base: NDArray[np.int32]  # index of the start cell in the table


class Scratch(NamedTuple):
    """Working memory of one thread."""

    block: Lanes
    pool: Lanes
    owner: NDArray[np.int64]  # index of the result of each ray in the pool, -1 for a free place
    free: NDArray[np.int64]  # stack of free places in the pool
    chosen: NDArray[np.int64]  # rays that go from the block to the pool
    looked_up: NDArray[np.uint32]  # where each ray looks into the table
    size: NDArray[np.uint16]  # and what it finds there
    alive: NDArray[np.uint8]  # whether it is still under way


@kernel
def cast_fan(
    poses: Floats, frame: tuple[float, float, float], fan: Floats, same_mount: bool, terrain: Terrain, ranges: Floats
) -> None:
    """Cast the beams of a sensor from many poses.

    Parameters
    ----------
    poses
        (n, 3) robot poses in the map frame, metres and radians.
    frame
        (x, y, yaw) of the grid's origin in the map frame.
    fan
        (4, k + 8) x, y in cells, cos and sin of each beam in the robot frame; the last 8 columns are read, never used.
    same_mount
        Whether all beams start at the same point of the robot.
    terrain
        The grid.
    ranges
        (n * k,) float64, overwritten: ranges in metres, at most `terrain.max_range`.
    """
    n, k = poses.shape[0], fan.shape[1] - 8
    scratch = _allocate()
    ray = scratch.block.ray
    placed = np.zeros(4 * STRIDE)
    filled, done, n_free, doubts = NOTHING, NOTHING, BLOCK, NOTHING
    for start in range(0, n, BLOCK):
        n_placed = min(BLOCK, n - start)
        place(poses, frame, terrain.resolution, start, n_placed, placed)
        if k == 1:
            _aim_one(ray, n_placed, placed, fan)
            n_free, doubts = _cast_block(scratch, n_free, doubts, terrain, n_placed, start, ranges)
            continue
        pose, beam = NOTHING, NOTHING
        while pose < n_placed:
            pose, beam, filled = _aim(ray, filled, placed, pose, n_placed, fan, beam, same_mount)
            if filled == BLOCK:
                n_free, doubts = _cast_block(scratch, n_free, doubts, terrain, BLOCK, done, ranges)
                done += BLOCK
                filled = 0
    if filled > 0:
        n_free, doubts = _cast_block(scratch, n_free, doubts, terrain, filled, done, ranges)
    doubts += _finish_pool(scratch, n_free, terrain, ranges)
    if doubts > 0:
        trace_fan(poses, frame, fan, terrain, ranges, np.empty((0, 2), np.int32), True)


@inlined_kernel
def _aim_one(ray: Floats, count: int, placed: Floats, fan: Floats) -> None:
    """Fill start and direction of the one beam of `count` placed poses into the block: loops over poses vectorise."""
    x, y, fan_c, fan_s = fan[0, 0], fan[1, 0], fan[2, 0], fan[3, 0]
    for b in range(count):
        c, s = placed[2 * STRIDE + b], placed[3 * STRIDE + b]
        ray[COS + b], ray[SIN + b] = c * fan_c - s * fan_s, s * fan_c + c * fan_s
        ray[CELL_X + b], ray[OFFSET_X + b] = split(placed[b] + (c * x - s * y))
        ray[CELL_Y + b], ray[OFFSET_Y + b] = split(placed[STRIDE + b] + (s * x + c * y))


@inlined_kernel
def _aim(ray: Floats, filled: int, placed: Floats, pose: int, n_placed: int, fan: Floats, beam: int, same_mount: bool
         ) -> tuple[int, int, int]:  # fmt: skip
    """Fill starts and directions into the block from `filled` on, until it is full or no placed pose is left.

    The first is that of beam number `beam` of placed pose number `pose`; return both, and `filled`, as they are after
    the last. Numba counts who holds an array at each call and each slice: to do so for each pose would take as long as
    30 beams.
    """
    k = fan.shape[1] - 8
    while pose < n_placed and filled < BLOCK:
        x, y, c, s = placed[pose], placed[STRIDE + pose], placed[2 * STRIDE + pose], placed[3 * STRIDE + pose]
        count = min(k - beam, BLOCK - filled)
        # Whole vectors of 8 beams: what they write too much is never read, or overwritten by the next pose. LLVM
        # vectorises only if it knows that no index is negative.
        n, first = np.uintp((count + 7) // 8 * 8), np.uintp(beam)
        to_c, to_s = np.uintp(COS + filled), np.uintp(SIN + filled)
        for b in range(n):
            ray[to_c + b] = c * fan[2, first + b] - s * fan[3, first + b]
            ray[to_s + b] = s * fan[2, first + b] + c * fan[3, first + b]
        cell_x, offset_x = np.uintp(CELL_X + filled), np.uintp(OFFSET_X + filled)
        cell_y, offset_y = np.uintp(CELL_Y + filled), np.uintp(OFFSET_Y + filled)
        if same_mount:
            column, beyond_column = split(x + (c * fan[0, 0] - s * fan[1, 0]))
            row, beyond_row = split(y + (s * fan[0, 0] + c * fan[1, 0]))
            for b in range(n):
                ray[cell_x + b], ray[offset_x + b] = column, beyond_column
                ray[cell_y + b], ray[offset_y + b] = row, beyond_row
        else:
            for b in range(n):
                fan_x, fan_y = fan[0, first + b], fan[1, first + b]
                ray[cell_x + b], ray[offset_x + b] = split(x + (c * fan_x - s * fan_y))
                ray[cell_y + b], ray[offset_y + b] = split(y + (s * fan_x + c * fan_y))
        beam += count
        filled += count
        if beam == k:
            pose, beam = pose + 1, NOTHING
    return pose, beam, filled


@kernel
def _allocate() -> Scratch:
    """Return working memory; all places in the pool are free."""
    # Filled here: np.full and np.arange take longer to compile than these lines.
    owner, free = np.empty(BLOCK, np.int64), np.empty(BLOCK, np.int64)
    for i in range(BLOCK):
        owner[i], free[i] = -1, BLOCK - 1 - i
    return Scratch(
        Lanes(np.zeros(RAY_ROWS * STRIDE), np.zeros(STATE_ROWS * BLOCK, np.float32), np.zeros(BLOCK, np.int32)),
        Lanes(np.zeros(RAY_ROWS * STRIDE), np.zeros(STATE_ROWS * BLOCK, np.float32), np.zeros(BLOCK, np.int32)),
        owner,
        free,
        np.empty(BLOCK, np.int64),
        np.empty(BLOCK, np.uint32),
        np.empty(BLOCK, np.uint16),
        np.empty(BLOCK, np.uint8),
    )


@kernel
def _cast_block(
    scratch: Scratch, n_free: int, doubts: int, terrain: Terrain, count: int, done: int, ranges: Floats
) -> tuple[int, int]:
    """Cast the first `count` rays of the block; their results go to `done` on, now or when the pool finishes them.

    Doubtful rays get the range -1. Returns the number of free places in the pool and the number of doubtful rays.
    """
    wide_vectors()
    block, pool, owner, free, chosen, index, size, alive = scratch
    ray, state, base = block
    n = _whole_vectors(count)
    _start(block, terrain, n)
    _walk(state, base, index, size, alive, terrain.table, terrain.cols + 2, FIRST_STEPS, n)
    doubtful = 0
    for j in range(count):
        result = _result(ray, state, j, terrain)
        ranges[done + j] = result
        doubtful += 1 if result < 0 else 0
    doubts += doubtful
    left = 0
    for j in range(count):
        chosen[left] = j
        left += 1 if alive[j] else 0
    to_ray, to_state, to_base = pool
    for i in range(left):
        if n_free == 0:
            n_free, more = _advance_pool(scratch, terrain, ranges)
            doubts += more
        n_free -= 1
        # The mask tells LLVM that the indices are not negative.
        m, j = free[n_free] & (BLOCK - 1), chosen[i] & (BLOCK - 1)
        owner[m] = done + j
        to_base[m] = base[j]
        to_state[FX + m], to_state[FY + m] = state[FX + j], state[FY + j]
        to_state[SLOPE + m], to_state[INVERSE_SLOPE + m] = state[SLOPE + j], state[INVERSE_SLOPE + j]
        to_state[COL + m], to_state[ROW + m] = state[COL + j], state[ROW + j]
        to_state[DOUBT + m], to_state[LIMIT + m] = state[DOUBT + j], state[LIMIT + j]
        to_state[LAST_COL + m], to_state[LAST_ROW + m] = state[LAST_COL + j], state[LAST_ROW + j]
        to_ray[OFFSET_X + m], to_ray[OFFSET_Y + m] = ray[OFFSET_X + j], ray[OFFSET_Y + j]
        to_ray[COS + m], to_ray[SIN + m] = ray[COS + j], ray[SIN + j]
    return n_free, doubts


@kernel
def _whole_vectors(n: int) -> int:
    """Return how many rays the vectors have that n rays need."""
    return (n + LANES - 1) // LANES * LANES


@kernel
def _finish_pool(scratch: Scratch, n_free: int, terrain: Terrain, ranges: Floats) -> int:
    """Finish the rays in the pool; return how many are doubtful."""
    doubts = 0
    while n_free < BLOCK:
        n_free, more = _advance_pool(scratch, terrain, ranges)
        doubts += more
    return doubts


@kernel
def _advance_pool(scratch: Scratch, terrain: Terrain, ranges: Floats) -> tuple[int, int]:
    """Let the rays of the pool jump until there is a free place; return the number of these and of doubtful rays."""
    _, pool, owner, free, _, index, size, alive = scratch
    ray, state, base = pool
    # No further than the last ray in the pool, for calls of few rays.
    used = BLOCK
    while owner[used - 1] < 0:
        used -= 1
    n = _whole_vectors(used)
    n_free = 0
    while n_free == 0:
        _walk(state, base, index, size, alive, terrain.table, terrain.cols + 2, MORE_STEPS, n)
        for m in range(BLOCK):
            free[n_free % BLOCK] = m
            n_free += 0 if (m < n) & (alive[m] > 0) else 1
    doubts = 0
    for i in range(n_free):
        m = free[i] & (BLOCK - 1)
        if owner[m] >= 0:
            result = _result(ray, state, m, terrain)
            ranges[owner[m]] = result
            doubts += 1 if result < 0 else 0
            # A free place stands in the frame of the table, where no ray moves.
            owner[m], base[m], state[COL + m], state[ROW + m] = -1, 0, ZERO, ZERO
    return n_free, doubts


@inlined_kernel
def _result(ray: Floats, state: NDArray[np.float32], j: int, terrain: Terrain) -> float:
    """Return the range of a finished ray in metres, -1 if it is doubtful."""
    col, row = state[COL + j], state[ROW + j]
    # As `_reflect` has them, but for a parallel axis: its edges lie at no positive length, whatever its numbers.
    c, s, ox, oy = ray[COS + j], ray[SIN + j], ray[OFFSET_X + j], ray[OFFSET_Y + j]
    inv_c, inv_s = 1.0 / max(abs(c), PARALLEL), 1.0 / max(abs(s), PARALLEL)
    ox, oy = (1.0 - ox if c < 0.0 else ox), (1.0 - oy if s < 0.0 else oy)
    # The ray entered its last cell where it crossed the later of the cell's two edges.
    t = max((col - ox) * inv_c, (row - oy) * inv_s)
    past = (col > state[LAST_COL + j]) | (row > state[LAST_ROW + j])
    metres = min(max(t, 0.0) * terrain.resolution, terrain.max_range)
    return -1.0 if state[DOUBT + j] > state[LIMIT + j] else (terrain.max_range if past else metres)


@kernel
def _start(lanes: Lanes, terrain: Terrain, n: int) -> None:
    """Set up the state of the first n rays of a block, in float32; see DOUBT_PER_CELL."""
    wide_vectors()
    ray, state, base = lanes
    # A loop of its own: with float64 in it, the next would have half as many lanes in a vector.
    for j in range(n):
        state[SLOPE + j], state[INVERSE_SLOPE + j] = np.float32(ray[COS + j]), np.float32(ray[SIN + j])
        state[FX + j], state[FY + j] = np.float32(ray[OFFSET_X + j]), np.float32(ray[OFFSET_Y + j])
        state[COL + j], state[ROW + j] = np.float32(ray[CELL_X + j]), np.float32(ray[CELL_Y + j])
    # In a map too wide for float32 no ray starts inside.
    narrow = max(terrain.rows, terrain.cols) < WIDE
    rows, cols = np.float32(terrain.rows if narrow else 0), np.float32(terrain.cols if narrow else 0)
    width = np.int32(terrain.cols + 2)
    plane = np.int32(width * (terrain.rows + 2))
    reach = np.float32(min(terrain.max_cells, np.float64(terrain.rows + terrain.cols)) + 2.0)
    for j in range(n):
        c, s = state[SLOPE + j], state[INVERSE_SLOPE + j]
        west, south = c < ZERO, s < ZERO
        c, s = abs(c), abs(s)
        x, y, col, row = state[FX + j], state[FY + j], state[COL + j], state[ROW + j]
        x, y = (ONE - x if west else x), (ONE - y if south else y)
        col, row = (cols - ONE - col if west else col), (rows - ONE - row if south else row)
        # Also false for what is not a number, in cell or direction, which must never become an index.
        inside = (col >= ZERO) & (col < cols) & (row >= ZERO) & (row < rows) & (c + s > ZERO)
        # The frame's first cell for all others. Chosen in float32: LLVM would choose among integers of 64 bits.
        first_col, first_row = (col + ONE if inside else ZERO), (row + ONE if inside else ZERO)
        quadrant = (ONE if west & inside else ZERO) + (TWO if south & inside else ZERO)
        base[j] = np.int32(quadrant) * plane + np.int32(first_row) * width + np.int32(first_col)
        # A parallel ray never crosses an edge of the other axis: anywhere inside the cell is right for it.
        along_x, along_y = c >= PARALLEL_32, s >= PARALLEL_32
        state[FX + j] = x if inside & along_x else HALF
        state[FY + j] = y if inside & along_y else HALF
        slope, inverse_slope = s / max(c, FLAT), c / max(s, FLAT)
        state[SLOPE + j], state[INVERSE_SLOPE + j] = slope, inverse_slope
        steepest = max(slope if along_x else ZERO, inverse_slope if along_y else ZERO)
        # Rays that start off the map are doubtful from the start.
        state[LIMIT + j] = HALF - (reach + steepest) * DOUBT_PER_CELL if inside else -ONE
        # From these cells on the ray is longer than max_range, or off the map. The first has a margin for float32.
        state[LAST_COL + j] = min(ONE + reach * c, cols - col - HALF)
        state[LAST_ROW + j] = min(ONE + reach * s, rows - row - HALF)
        state[COL + j] = ZERO
        state[ROW + j] = ZERO
        state[DOUBT + j] = ZERO


@kernel
def _walk(state: NDArray[np.float32], base: NDArray[np.int32], index: NDArray[np.uint32], size: NDArray[np.uint16],
          alive: NDArray[np.uint8], table: NDArray[np.uint16], width: int, steps: int,
          n: int) -> None:  # fmt: skip
    """Let the first n rays jump `steps` times; say which are still under way."""
    wide_vectors()
    for j in range(n):
        index[j] = base[j] + np.int32(state[ROW + j]) * np.int32(width) + np.int32(state[COL + j])
    for j in range(n):
        size[j] = table[index[j]]
    for _ in range(steps):
        for j in range(n):
            col, row = state[COL + j], state[ROW + j]
            edge_x, edge_y = col + np.float32(size[j] & 255), row + np.float32(size[j] >> 8)
            at_x = (edge_x - state[FX + j]) * state[SLOPE + j] + state[FY + j]
            # The bound keeps a ray in the table that rounding has sent the wrong way; it is in doubt then.
            at_y = min((edge_y - state[FY + j]) * state[INVERSE_SLOPE + j] + state[FX + j], edge_x)
            x_first = at_x < edge_y
            other = at_x if x_first else at_y
            cell = np.floor(other)
            go = size[j] > 0
            col = (edge_x if x_first else cell) if go else col
            row = (cell if x_first else edge_y) if go else row
            # Without the zeros LLVM stores under a mask, which takes AMD's Zen 1 to 3 about as long as all the rest.
            state[COL + j] = col + ZERO
            state[ROW + j] = row + ZERO
            state[DOUBT + j] = max(state[DOUBT + j], abs(other - cell - HALF)) + ZERO
            index[j] = base[j] + np.int32(row) * np.int32(width) + np.int32(col)
        for j in range(n):
            size[j] = table[index[j]]
    # A ray in doubt is finished: what it does next could be wrong, and need not end.
    for j in range(n):
        alive[j] = (
            (size[j] > 0)
            & (state[COL + j] <= state[LAST_COL + j])
            & (state[ROW + j] <= state[LAST_ROW + j])
            & (state[DOUBT + j] <= state[LIMIT + j])
        )
