"""Which places of a lattice rays cross, each place once per ray."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel

Floats = NDArray[np.float64]
# Stands for the length at which a ray along an axis leaves its row or column.
NEVER = 1e300


@kernel
def count_crossings(rays: Floats, lengths: Floats, labels: NDArray[np.int32], counts: NDArray[np.int64]) -> None:
    """Count the rays that cross each place, start and end included.

    Parameters
    ----------
    rays
        (n, 3) start in cells (x, y) from the corner of the lattice, and direction, radians.
    lengths
        (n,) how far each ray goes, cells; a ray of length 0 or less crosses nothing.
    labels
        (rows, cols) number of the place that each cell belongs to; negative for none. Off the lattice there is none.
    counts
        (number of places,) to which the rays are added; a ray counts once for a place, however many of its cells it
        crosses.

    Notes
    -----
    The lattice is walked edge by edge. A ray through the corner of four cells may count for one of the cells beside it.
    """
    rows, cols = labels.shape
    last = np.full(len(counts), -1, np.int64)
    for n in range(len(rays)):
        length = lengths[n]
        if not length > 0.0:
            continue
        x, y, c, s = rays[n, 0], rays[n, 1], math.cos(rays[n, 2]), math.sin(rays[n, 2])
        col, row = math.floor(x), math.floor(y)
        right, up = c >= 0.0, s >= 0.0
        across, along = (1.0 / abs(c) if c != 0.0 else NEVER), (1.0 / abs(s) if s != 0.0 else NEVER)
        # Lengths at which the ray leaves its column and its row.
        next_col = ((col + 1.0 - x) if right else (x - col)) * across if c != 0.0 else NEVER
        next_row = ((row + 1.0 - y) if up else (y - row)) * along if s != 0.0 else NEVER
        while True:
            if 0 <= row < rows and 0 <= col < cols:
                place = np.int64(labels[row, col])
                if place >= 0 and last[place] != n:
                    last[place] = n
                    counts[place] += 1
            if min(next_col, next_row) >= length:
                break
            if next_col < next_row:
                col += 1 if right else -1
                next_col += across
            else:
                row += 1 if up else -1
                next_row += along
