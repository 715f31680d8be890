"""Occupancy mapping: one exact traversal per beam, each cell changed at most once per scan.

All lengths are in cells, all cells in the order (column, row), with the conventions of the ray caster: coordinates
within 1e-9 cells of a border are on it, crossings within 1e-9 cells of each other are a corner and the ray goes on in
the cell behind it. A reading that ends exactly on the border of a cell has entered it, as the ray caster's range has,
so a perfect reading marks the very cell that the caster hit.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.elementary import HUGE, PARALLEL, TIE, split
from beamfield.kernels.jit import kernel

Floats = NDArray[np.float64]
Cells = NDArray[np.float32]
Kinds = NDArray[np.uint8]
Stamps = NDArray[np.int32]
# Start in cells, cosine and sine of the direction, in the grid's frame.
Ray = tuple[float, float, float, float]

# Distance of the rays that fill a cone, at its end, in cells: few cells of it are missed.
RAY_SPACING = 0.5

# What a reading does to the cells on its way.
SKIP, HIT, PASS = 0, 1, 2


@kernel
def update_log_odds(poses: Floats, fan: Floats, lengths: Floats, kinds: Kinds, steps: Cells, first_stamp: int,
                    log_odds: Cells, stamps: Stamps) -> int:  # fmt: skip
    """Enter scans into a grid of log-odds.

    Parameters
    ----------
    poses
        (t, 4) x, y in cells, cos and sin of the heading, in the grid's frame.
    fan
        (4, k) x, y in cells, cos and sin of each beam in the robot frame.
    lengths
        (t, k) how far each beam is followed, in cells.
    kinds
        (t, k) uint8: SKIP, HIT (the last cell is occupied) or PASS (the last cell is passed like the others).
    steps
        (4,) float32: what a hit adds, what a pass adds, the lowest and the highest value.
    first_stamp
        A number above all stamps so far, minus the values that this call uses: scan i writes first_stamp + 2 i for
        cells that were passed and one more for cells that were hit.
    log_odds
        (rows, cols) float32, changed.
    stamps
        (rows, cols) int32, changed: the last scan that changed a cell; negative where none did.

    Returns
    -------
    Number of beams that leave the grid; they are not entered.
    """
    k = fan.shape[1]
    rows, cols = log_odds.shape
    hit, passed, low, high = steps[0], steps[1], steps[2], steps[3]
    outside = 0
    for i in range(poses.shape[0]):
        pass_stamp = first_stamp + 2 * i
        hit_stamp = pass_stamp + 1
        # Hits first: a cell that one beam hits and another one passes has been hit.
        for b in range(k):
            if kinds[i, b] == HIT:
                col, row = _last_cell(_beam(poses[i], fan, b), lengths[i, b])
                if 0 <= col < cols and 0 <= row < rows and stamps[row, col] != hit_stamp:
                    stamps[row, col] = hit_stamp
                    log_odds[row, col] = min(max(log_odds[row, col] + hit, low), high)
        for b in range(k):
            if kinds[i, b] != SKIP:
                is_pass = kinds[i, b] == PASS
                outside += _pass(
                    _beam(poses[i], fan, b), lengths[i, b], is_pass, pass_stamp, (passed, low, high), log_odds, stamps
                )
    return outside


@kernel
def last_cells(x: Floats, y: Floats, c: Floats, s: Floats, lengths: Floats, cells: NDArray[np.int64]) -> None:
    """Fill cells (n, 2) int64 with the (col, row) in which rays of the given lengths end."""
    for i in range(x.shape[0]):
        cells[i, 0], cells[i, 1] = _last_cell((x[i], y[i], c[i], s[i]), lengths[i])


@kernel
def count_passes(poses: Floats, cones: Floats, half: float, lengths: Floats, kinds: Kinds, first_stamp: int,
                 passes: Cells, stamps: Stamps) -> None:  # fmt: skip
    """Count for each cell the scans in which it lies in a cone, nearer than the cone's reading.

    A cone is filled with rays, less than a cell apart at its end. The cells in which they end, the arc, are not passed
    by any cone of the same scan.

    Parameters
    ----------
    poses
        (t, 4) x, y in cells, cos and sin of the heading, in the grid's frame.
    cones
        (k, 3) x, y in cells and direction of each cone in the robot frame.
    half
        Half the opening angle, radians.
    lengths, kinds, first_stamp, stamps
        As for `update_log_odds`.
    passes
        (rows, cols) float32, changed.
    """
    for i in range(poses.shape[0]):
        pass_stamp = first_stamp + 2 * i
        for b in range(cones.shape[0]):
            if kinds[i, b] == HIT:
                n = _rays_in_cone(half, lengths[i, b])
                for j in range(n):
                    col, row = _last_cell(_ray_in_cone(poses[i], cones[b], half, j, n), lengths[i, b])
                    stamps[row, col] = pass_stamp + 1
        for b in range(cones.shape[0]):
            if kinds[i, b] != SKIP:
                n = _rays_in_cone(half, lengths[i, b])
                for j in range(n):
                    ray = _ray_in_cone(poses[i], cones[b], half, j, n)
                    _pass(ray, lengths[i, b], kinds[i, b] == PASS, pass_stamp, (1.0, 0.0, HUGE), passes, stamps)


@kernel
def share_hits(poses: Floats, cones: Floats, half: float, lengths: Floats, kinds: Kinds, first_mark: int,
               log_odds_of_pass: float, passes: Cells, hits: Cells, marks: Stamps) -> None:  # fmt: skip
    """Share each reading among the cells of its arc: those that were passed least get a hit, others a part of one.

    A cell's part is exp(log_odds_of_pass (passes - fewest passes on the arc)).

    Parameters
    ----------
    poses, cones, half, lengths, kinds
        As for `count_passes`.
    first_mark
        Number of the first reading; each is entered into a cell once.
    log_odds_of_pass
        What a pass adds to a cell's log odds, below 0.
    passes
        (rows, cols) what `count_passes` found over the whole log.
    hits
        (rows, cols) float32, changed.
    marks
        (rows, cols) int32, changed: the last reading that was entered; all lower than first_mark before.
    """
    k = cones.shape[0]
    for i in range(poses.shape[0]):
        for b in range(k):
            if kinds[i, b] != HIT:
                continue
            n = _rays_in_cone(half, lengths[i, b])
            cells = np.empty((n, 2), np.int64)
            fewest = np.float32(np.inf)
            for j in range(n):
                cells[j, 0], cells[j, 1] = _last_cell(_ray_in_cone(poses[i], cones[b], half, j, n), lengths[i, b])
                fewest = min(fewest, passes[cells[j, 1], cells[j, 0]])
            mark = first_mark + i * k + b
            for j in range(n):
                col, row = cells[j, 0], cells[j, 1]
                if marks[row, col] != mark:
                    marks[row, col] = mark
                    hits[row, col] += np.exp(log_odds_of_pass * (passes[row, col] - fewest))


@kernel
def _beam(pose: Floats, fan: Floats, b: int) -> Ray:
    """Return where a beam starts and goes."""
    x, y, c, s = pose[0], pose[1], pose[2], pose[3]
    return (
        x + c * fan[0, b] - s * fan[1, b], y + s * fan[0, b] + c * fan[1, b],
        c * fan[2, b] - s * fan[3, b], s * fan[2, b] + c * fan[3, b],
    )  # fmt: skip


@kernel
def _ray_in_cone(pose: Floats, cone: Floats, half: float, j: int, n: int) -> Ray:
    """Return the j-th of n rays that fill a cone."""
    x, y, c, s = pose[0], pose[1], pose[2], pose[3]
    angle = np.arctan2(s, c) + cone[2] + half * (2.0 * (j + 0.5) / n - 1.0)
    return x + c * cone[0] - s * cone[1], y + s * cone[0] + c * cone[1], np.cos(angle), np.sin(angle)


@kernel
def _rays_in_cone(half: float, length: float) -> int:
    """Return how many rays fill a cone so that they are at most RAY_SPACING apart at its end."""
    return 1 + int(2.0 * half * length / RAY_SPACING)


@kernel
def _last_cell(ray: Ray, length: float) -> tuple[int, int]:
    """Return (col, row) of the cell that a ray has entered last."""
    x, y, c, s = ray
    ox, first_col, inv_c, c_abs = _start(x, c)
    oy, first_row, inv_s, s_abs = _start(y, s)
    n_i, n_j = _edges_until(length, ox, c_abs, inv_c), _edges_until(length, oy, s_abs, inv_s)
    return int(first_col - n_i if c <= -PARALLEL else first_col + n_i), int(
        first_row - n_j if s <= -PARALLEL else first_row + n_j
    )


@kernel
def _pass(ray: Ray, length: float, whole: bool, stamp: int, step: tuple[float, float, float], log_odds: Cells,
          stamps: Stamps) -> int:  # fmt: skip
    """Step the cells of a ray, without the last one unless `whole`, within limits; return 1 if it leaves the grid."""
    x, y, c, s = ray
    passed, low, high = step
    rows, cols = log_odds.shape
    ox, first_col, inv_c, c_abs = _start(x, c)
    oy, first_row, inv_s, s_abs = _start(y, s)
    n_i, n_j = int(_edges_until(length, ox, c_abs, inv_c)), int(_edges_until(length, oy, s_abs, inv_s))
    step_col = -1 if c <= -PARALLEL else 1
    step_row = -1 if s <= -PARALLEL else 1
    col, row = int(first_col), int(first_row)
    end_col, end_row = col + step_col * n_i, row + step_row * n_j
    if min(col, end_col) < 0 or max(col, end_col) >= cols or min(row, end_row) < 0 or max(row, end_row) >= rows:
        return 1
    i, j = 0, 0
    while i < n_i or j < n_j:
        if stamps[row, col] < stamp:
            stamps[row, col] = stamp
            log_odds[row, col] = min(max(log_odds[row, col] + passed, low), high)
        tx = (i + 1 - ox) * inv_c if i < n_i else HUGE
        ty = (j + 1 - oy) * inv_s if j < n_j else HUGE
        if tx <= ty + TIE:
            i += 1
            col += step_col
        if ty <= tx + TIE:
            j += 1
            row += step_row
    if whole and stamps[row, col] < stamp:
        stamps[row, col] = stamp
        log_odds[row, col] = min(max(log_odds[row, col] + passed, low), high)
    return 0


@kernel
def _start(x: float, c: float) -> tuple[float, float, float, float]:
    """Return offset in the cell, cell, 1 / |c| and |c| of one axis; the offset counts in the ray's direction."""
    cell, offset = split(x)
    speed = abs(c) if abs(c) >= PARALLEL else 0.0
    return 1.0 - offset if c <= -PARALLEL else offset, cell, 1.0 / speed if speed > 0 else HUGE, speed


@kernel
def _edges_until(length: float, offset: float, speed: float, inverse: float) -> float:
    """Return how many edges of one axis a ray has crossed at a length; one that it reaches exactly counts."""
    if speed == 0.0:
        return 0.0
    n: float = np.floor(offset + length * speed)
    while n > 0 and (n - offset) * inverse > length + TIE:
        n -= 1
    while (n + 1 - offset) * inverse <= length + TIE:
        n += 1
    return n
