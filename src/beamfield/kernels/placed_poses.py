"""Poses in the frame of a grid, in cells: where rays begin."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.elementary import MANY_TURNS, cos_sin
from beamfield.kernels.jit import integer, kernel, shared

Floats = NDArray[np.float64]

# Poses that are placed at a time, and rays that walk in lockstep. Measured: 128 are 5% slower, 512 no faster. A power
# of 2.
BLOCK = integer(256)
# Length of a float64 row: BLOCK numbers, and room for a vector that is stored beyond them.
STRIDE = BLOCK + 8


@shared
def place(
    poses: Floats, frame: tuple[float, float, float], resolution: float, first: int, count: int, placed: Floats
) -> None:
    """Fill rows x, y, cos, sin of `placed` with `count` poses in the grid's frame, from number `first` on, in cells."""
    frame_x, frame_y, yaw = frame
    frame_c, frame_s = math.cos(yaw), math.sin(yaw)
    many = 0
    # Flat, and no index negative: LLVM would not vectorise else.
    numbers, n, begin = poses.reshape(-1), np.uintp(count), np.uintp(3 * first)
    y, c, s = np.uintp(STRIDE), np.uintp(2 * STRIDE), np.uintp(3 * STRIDE)
    for b in range(n):
        pose = begin + np.uintp(3) * b
        dx, dy = numbers[pose] - frame_x, numbers[pose + np.uintp(1)] - frame_y
        heading = numbers[pose + np.uintp(2)] - yaw
        placed[b] = (frame_c * dx + frame_s * dy) / resolution
        placed[y + b] = (frame_c * dy - frame_s * dx) / resolution
        placed[c + b] = heading
        many += 1 if abs(heading) > MANY_TURNS else 0
    for b in range(n):
        placed[c + b], placed[s + b] = cos_sin(placed[c + b])
    if many > 0:
        for b in range(n):
            heading = numbers[begin + np.uintp(3) * b + np.uintp(2)] - yaw
            if abs(heading) > MANY_TURNS:
                placed[c + b], placed[s + b] = math.cos(heading), math.sin(heading)


@kernel
def place_poses(poses: Floats, frame: tuple[float, float, float], resolution: float, out: Floats) -> None:
    """Fill out (n, 4) with x, y, cos and sin of poses (n, 3) in the grid's frame, in cells."""
    placed = np.zeros(4 * STRIDE)
    for first in range(0, poses.shape[0], BLOCK):
        count = min(BLOCK, poses.shape[0] - first)
        place(poses, frame, resolution, first, count, placed)
        for b in range(count):
            for row in range(4):
                out[first + b, row] = placed[row * STRIDE + b]
