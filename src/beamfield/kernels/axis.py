"""How much of each beam's axis is how far from obstacles: what (6.33), normalised along the axis, is summed over."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel


@kernel
def count_along_axes(starts: NDArray[np.float64], classes: NDArray[np.uint8], off: int, first: float, spacing: float,
                     n: int, counts: NDArray[np.float64]) -> None:  # fmt: skip
    """Count the classes of the cells at the midpoints of n equal pieces of each axis.

    Parameters
    ----------
    starts
        (b, 4) where the axes begin, column and row, and the cosine and sine of their directions; in cells of the field.
    classes
        (rows, cols) class of each cell.
    off
        Class of what lies off the field.
    first, spacing
        Where on the axis the first piece begins, and the length of a piece; in cells.
    n
        Number of pieces.
    counts
        (b, c) overwritten: midpoints per class.
    """
    rows, cols = classes.shape
    for i in range(starts.shape[0]):
        counts[i, :] = 0.0
        x, y, dx, dy = starts[i, 0], starts[i, 1], starts[i, 2], starts[i, 3]
        entered = False
        for k in range(n):
            t = first + (k + 0.5) * spacing
            col, row = math.floor(x + dx * t), math.floor(y + dy * t)
            if 0 <= row < rows and 0 <= col < cols:
                counts[i, classes[row, col]] += 1.0
                entered = True
            elif entered:
                # A straight line does not come back.
                counts[i, off] += n - k
                break
            else:
                counts[i, off] += 1.0
