"""Look-ups in likelihood fields on a GPU, one pose a thread: `field.cell_of` and the table of codes of the CPU."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import cuda
from numpy.typing import NDArray

from beamfield.kernels import field
from beamfield.kernels.cuda_target import launch, on_device
from beamfield.kernels.threads import run_in_blocks

cell_of = on_device(field.cell_of)

# Poses whose places and sums are in the GPU's memory at a time: 192 MB.
POSES_TOGETHER = 2**23
# Poses are placed that much quicker than rays are cast on the CPU.
PLACED_PER_WORK_UNIT = 4


def fill_scan_sums(poses: field.Floats, frame: field.FrameView, ends: field.Singles, codes: Any,
                   shape: tuple[int, int], low: float, step: float, out: field.Floats) -> None:  # fmt: skip
    """Do what `field.fill_scan_sums` does; sums with an IMPOSSIBLE code are -inf.

    `codes` are on the device, flat, and `shape` is their number of rows and columns.
    """
    beams = cuda.to_device(ends)
    for start in range(0, len(poses), POSES_TOGETHER):
        part = poses[start : start + POSES_TOGETHER]
        placed = cuda.to_device(_placed(part, frame))
        sums = cuda.device_array(len(part), np.float64)
        launch(_add_codes, len(part), placed, beams, codes, shape, low, step, sums)
        sums.copy_to_host(out[start : start + len(part)])


def _placed(poses: field.Floats, frame: field.FrameView) -> NDArray[np.float32]:
    """Return x, y, cos and sin (4, n) of finite poses in the table."""
    placed = np.empty((4, len(poses)), np.float32)
    x, y, c, s = placed

    def work(a: int, b: int) -> None:
        field.place(poses[a:b], frame, x[a:b], y[a:b], c[a:b], s[a:b])

    run_in_blocks(work, len(poses), work_per_row=1.0 / PLACED_PER_WORK_UNIT)
    return placed


@cuda.jit
def _add_codes(placed, beams, codes, shape, low, step, out):  # type: ignore[no-untyped-def]
    """Fill out (n,) with the sums over beams, for n placed poses; codes are added exactly."""
    i = cuda.grid(1)
    if i < out.size:
        x, y, c, s = placed[0, i], placed[1, i], placed[2, i], placed[3, i]
        total, possible = np.int64(0), True
        for j in range(beams.shape[1]):
            code = codes[cell_of(x, y, c, s, beams[0, j], beams[1, j], shape)]
            possible = possible and code >= 0
            total += np.int64(code)
        out[i] = beams.shape[1] * low + step * total if possible else -np.inf
