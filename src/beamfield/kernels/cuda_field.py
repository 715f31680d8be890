"""Look-ups in likelihood fields on a GPU, one pose a thread, by functions and the table of codes of the CPU."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import cuda

from beamfield.kernels import field
from beamfield.kernels.cuda_target import allocate, download, launch, on_device, upload

to_table, cell_of = on_device(field.to_table), on_device(field.cell_of)

# Poses that are in the GPU's memory at a time, with their sums: 128 MB.
POSES_TOGETHER = 2**22


def fill_scan_sums(poses: field.Floats, frame: field.FrameView, ends: field.Singles, codes: Any,
                   shape: tuple[int, int], low: float, step: float, out: field.Floats) -> None:  # fmt: skip
    """Do what `field.fill_scan_sums` does at finite poses; sums with an IMPOSSIBLE code are -inf.

    `codes` are on the device, flat, and `shape` is their number of rows and columns.
    """
    beams = upload(ends)
    for start in range(0, len(poses), POSES_TOGETHER):
        part = upload(poses[start : start + POSES_TOGETHER])
        sums = allocate(len(part))
        launch(_add_codes, len(part), part, frame, beams, codes, shape, low, step, sums)
        download(sums, out[start : start + len(part)])


@cuda.jit
def _add_codes(poses, frame, beams, codes, shape, low, step, out):  # type: ignore[no-untyped-def]
    """Fill out (n,) with the sums over beams at poses (n, 3); codes are added exactly."""
    i = cuda.grid(1)
    if i < out.size:
        x, y, c, s = to_table(poses[i], frame)
        x, y, c, s = np.float32(x), np.float32(y), np.float32(c), np.float32(s)
        total, possible = np.int64(0), True
        for j in range(beams.shape[1]):
            code = codes[cell_of(x, y, c, s, beams[0, j], beams[1, j], shape)]
            possible = possible and code >= 0
            total += np.int64(code)
        out[i] = beams.shape[1] * low + step * total if possible else -np.inf
