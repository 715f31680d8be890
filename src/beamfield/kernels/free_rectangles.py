"""The table of free rectangles through which rays jump."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from beamfield.kernels.jit import kernel


@kernel
def free_rectangles(stops: NDArray[np.bool_], rectangles: NDArray[np.uint16]) -> None:
    """Fill the table of free rectangles.

    Parameters
    ----------
    stops
        (rows, cols) bool: cells that stop a ray.
    rectangles
        (4, rows + 2, cols + 2) uint16, overwritten: width + 256 height (each at most 255) of a large rectangle without
        stops that starts at the cell and extends in the direction of the quadrant; 0 in stops and in the frame around
        the map. Quadrant 1 is mirrored in x, 2 in y, 3 in both, so that each extends to growing indices.
    """
    rows, cols = stops.shape
    rectangles[:] = 0
    free_above = np.empty(cols + 2, np.int32)
    for quadrant in range(4):
        table = rectangles[quadrant]
        free_above[:] = 0
        for r in range(rows, 0, -1):
            source = stops[rows - r if quadrant & 2 else r - 1]
            here, above = table[r], table[r + 1]
            width, height, free_right = 0, 0, 0
            for c in range(cols, 0, -1):
                if source[cols - c if quadrant & 1 else c - 1]:
                    width, height, free_right, free_above[c] = 0, 0, 0, 0
                    continue
                free_right += 1
                free_above[c] += 1
                # The right neighbour's rectangle made wider, or that of the cell above made higher: the one with
                # the larger w h / (w + h), which a ray leaves later on the average over directions. Measured: 2.4
                # jumps per ray; choosing by area 2.6, the largest square as a third choice 2.3, that alone 4.3.
                wide_w, wide_h = min(width + 1, 255), max(min(height, int(free_above[c])), 1)
                over = int(np.int64(above[c]))
                high_w, high_h = max(min(over & 255, free_right), 1), min((over >> 8) + 1, 255)
                wide = wide_w * wide_h * (high_w + high_h) >= high_w * high_h * (wide_w + wide_h)
                width, height = wide_w if wide else high_w, wide_h if wide else high_h
                here[c] = width + 256 * height
