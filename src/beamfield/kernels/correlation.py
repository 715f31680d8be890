"""Comparing a local map with a global one at many poses: sums over the cells that both define, in one pass."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.elementary import SNAP
from beamfield.kernels.jit import fast_kernel, kernel

Floats = NDArray[np.float64]

# Stands for an undefined cell; values are at most 1 in magnitude. A NaN must not reach these loops.
UNDEFINED = np.float32(2.0)
# Cells that are transformed, then looked up, then summed: each step is a loop that LLVM vectorises.
BLOCK = 256


@fast_kernel
def fill_sums(poses: Floats, xs: Floats, ys: Floats, values: NDArray[np.float32], table: NDArray[np.float32], rows: int,
              cols: int, sums: Floats) -> None:  # fmt: skip
    """Sum over the cells that both maps define, for each pose.

    Parameters
    ----------
    poses
        (n, 4) x, y in cells of the global map, cos and sin of the heading, in its frame.
    xs, ys
        (L,) centres of the local map's defined cells in the robot frame, in cells of the global map.
    values
        (L,) float32 value of each.
    table
        ((rows + 2) * (cols + 2),) float32: the global map in a frame of undefined cells; `UNDEFINED` where undefined.
    rows, cols
        Size of the global map.
    sums
        (n, 6) float64, overwritten: number of cells, sum of local values, of global values, of their products, of
        squared local values, of squared global values.
    """
    # As unsigned numbers, and of slices: LLVM then leaves out a test for negative ones, and loads whole vectors.
    index = np.empty(BLOCK, np.uint32)
    found = np.empty(BLOCK, np.float32)
    total = xs.shape[0]
    width = np.int32(cols + 2)
    for i in range(poses.shape[0]):
        x, y, c, s = poses[i, 0] + 1.0 + SNAP, poses[i, 1] + 1.0 + SNAP, poses[i, 2], poses[i, 3]
        n, sum_l, sum_m, sum_lm, sum_ll, sum_mm = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for first in range(0, total, BLOCK):
            count = min(BLOCK, total - first)
            local = slice(first, first + count)
            local_x, local_y, local_values = xs[local], ys[local], values[local]
            for b in range(count):
                lx, ly = local_x[b], local_y[b]
                # Off the map is in the frame.
                col = np.int32(min(max(x + c * lx - s * ly, 0.0), cols + 1.0))
                row = np.int32(min(max(y + s * lx + c * ly, 0.0), rows + 1.0))
                index[b] = np.uint32(row * width + col)
            for b in range(count):
                found[b] = table[index[b]]
            for b in range(count):
                defined = found[b] < 1.5
                m = np.float64(found[b]) if defined else 0.0
                l = np.float64(local_values[b]) if defined else 0.0  # noqa: E741
                n += 1.0 if defined else 0.0
                sum_l += l
                sum_m += m
                sum_lm += l * m
                sum_ll += l * l
                sum_mm += m * m
        sums[i, 0], sums[i, 1], sums[i, 2] = n, sum_l, sum_m
        sums[i, 3], sums[i, 4], sums[i, 5] = sum_lm, sum_ll, sum_mm


@kernel
def fill_histogram_overlap(poses: Floats, xs: Floats, ys: Floats, occupied: NDArray[np.uint8], table: NDArray[np.uint8],
                           rows: int, cols: int, reach: int, out: Floats) -> None:  # fmt: skip
    """Compare histograms of two maps over the cells that both define, for each pose.

    Parameters
    ----------
    poses, xs, ys, rows, cols
        As for `fill_sums`.
    occupied
        (L,) uint8: 1 where the local cell is occupied, 0 where it is free.
    table
        ((rows + 2) * (cols + 2),) uint8: 1 occupied, 0 free, 2 undefined; the map in a frame of undefined cells.
    reach
        No local cell is farther than this from the robot, in cells, along either axis of any heading.
    out
        (n, 2) float64, overwritten: number of cells, and how many of them the histograms share, as the mean of the two
        axes. A histogram counts the free and the occupied cells of each column (row).
    """
    width = cols + 2
    bins = 2 * reach + 3
    # Axis, occupied or not, bin: local count minus global count.
    difference = np.zeros((2, 2, bins), np.int64)
    for i in range(poses.shape[0]):
        x, y, c, s = poses[i, 0] + 1.0 + SNAP, poses[i, 1] + 1.0 + SNAP, poses[i, 2], poses[i, 3]
        difference[:] = 0
        # Poses far off the map: nothing is found there.
        near_x, near_y = min(max(x, -1.0 * bins), cols + 2.0 + bins), min(max(y, -1.0 * bins), rows + 2.0 + bins)
        first_col, first_row = np.int64(np.floor(near_x)) - reach - 1, np.int64(np.floor(near_y)) - reach - 1
        n = 0
        for b in range(xs.shape[0]):
            col = np.int64(min(max(x + c * xs[b] - s * ys[b], 0.0), cols + 1.0))
            row = np.int64(min(max(y + s * xs[b] + c * ys[b], 0.0), rows + 1.0))
            m = table[row * width + col]
            if m < 2:
                n += 1
                l = occupied[b]  # noqa: E741
                difference[0, l, col - first_col] += 1
                difference[0, m, col - first_col] -= 1
                difference[1, l, row - first_row] += 1
                difference[1, m, row - first_row] -= 1
        # What one histogram has more than the other is in the sum of the differences twice.
        apart = 0
        for axis in range(2):
            for kind in range(2):
                for b in range(bins):
                    apart += abs(difference[axis, kind, b])
        out[i, 0] = n
        out[i, 1] = n - 0.25 * apart
