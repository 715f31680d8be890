"""Two slow ways to find the range of a cone that share nothing with the caster, and nothing with each other.

Both work in cells on a boolean grid, for an apex (x, y), an axis and half an opening angle below a quarter turn.
"""

from __future__ import annotations

import numpy as np

from tests.reference.raycast_oracles import intersect_boxes


def clip_cells(x, y, axis, half, occupied, max_cells):
    """Return the distance to the nearest point of an occupied square in one closed sector.

    A square and a sector are convex. The point of the square nearest to the apex either lies in the sector, or the
    nearest point of their intersection lies on one of the sector's two edges: where that edge enters the square.
    """
    best = max_cells
    for row, col in np.argwhere(occupied):
        nearest = np.array([min(max(x, col), col + 1), min(max(y, row), row + 1)]) - [x, y]
        turn = np.angle(np.exp(1j * (np.arctan2(nearest[1], nearest[0]) - axis)))
        if not nearest.any() or abs(turn) <= half:
            best = min(best, np.hypot(*nearest))
        else:
            for edge in (axis - half, axis + half):
                best = min(best, enter_square(x, y, np.cos(edge), np.sin(edge), col, row))
    return best


def enter_square(x, y, dx, dy, col, row):
    """Return the distance at which a ray enters a closed square, inf if it does not (Liang and Barsky, 1984)."""
    near, far = 0.0, np.inf
    for start, direction, low in ((x, dx, col), (y, dy, row)):
        if direction == 0.0:
            if not low <= start <= low + 1:
                return np.inf
            continue
        a, b = sorted([(low - start) / direction, (low + 1 - start) / direction])
        near, far = max(near, a), min(far, b)
    return near if near <= far else np.inf


def fan_out(x, y, axis, half, occupied, max_cells, n_rays):
    """Return the shortest of many rays between the edges of one cone: never less than the cone's range."""
    angles = np.linspace(axis - half, axis + half, n_rays)
    start = np.full(n_rays, x), np.full(n_rays, y)
    return intersect_boxes(*start, np.cos(angles), np.sin(angles), occupied, max_cells).min()
