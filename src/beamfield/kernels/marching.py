"""Rays that march in equal steps and fixed-point numbers, and what they find at each."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel

Floats = NDArray[np.float64]
# Coordinates are held within this many cells, so that they fit an integer; no map is so large.
FAR = 1e9
# What a cell holds instead of a number of steps.
OCCUPIED, UNKNOWN = 0, -1


@kernel
def march(poses: Floats, origin: tuple[float, float], resolution: float, starts: Floats, bearings: Floats,
          step: float, bits: int, n_steps: int, cells: NDArray[np.int16], ranges: Floats) -> None:  # fmt: skip
    """Look at every `step` of a ray until it meets an obstacle.

    Parameters
    ----------
    poses
        (n, 3) robot poses.
    origin
        Of the grid, whose axes are the map frame's, metres.
    resolution
        Metres per cell.
    starts
        (2, k) start of each beam in the robot frame, metres.
    bearings
        (k,) direction of each beam in the robot frame, radians.
    step
        Length of a step, cells.
    bits
        Positions and steps along the axes are cut off (towards 0) to whole parts of a cell, of which there are 2^bits.
    n_steps
        How many steps a ray takes at most. Obstacles where it ends are met; off the map or in an unknown cell it meets
        nothing there, too.
    cells
        (rows, cols): OCCUPIED, UNKNOWN or, in a free cell, a number of steps from 1 on before whose last no ray leaves
        the free cells. They are taken at once.
    ranges
        (n, k) cells, overwritten: number of steps to the obstacle times their length, or that of all steps if none of
        them meets one; -1 for rays that leave the map or meet an unknown cell.
    """
    rows, cols = cells.shape
    one = float(1 << bits)
    for i in range(len(poses)):
        x, y, heading = poses[i, 0] - origin[0], poses[i, 1] - origin[1], poses[i, 2]
        c, s = math.cos(heading), math.sin(heading)
        for b in range(len(bearings)):
            u = (x + (c * starts[0, b] - s * starts[1, b])) / resolution
            v = (y + (s * starts[0, b] + c * starts[1, b])) / resolution
            at_u = math.trunc(min(max(u, -FAR), FAR) * one)
            at_v = math.trunc(min(max(v, -FAR), FAR) * one)
            along = heading + bearings[b]
            step_u, step_v = math.trunc(step * math.cos(along) * one), math.trunc(step * math.sin(along) * one)
            ranges[i, b] = n_steps * step
            taken = 0
            while taken <= n_steps:
                col, row = at_u >> bits, at_v >> bits
                if row < 0 or col < 0 or row >= rows or col >= cols:
                    ranges[i, b] = -1.0
                    break
                steps = int(cells[row, col])
                if steps == OCCUPIED:
                    ranges[i, b] = taken * step
                    break
                if steps == UNKNOWN:
                    ranges[i, b] = -1.0
                    break
                taken += steps
                at_u += steps * step_u
                at_v += steps * step_v
