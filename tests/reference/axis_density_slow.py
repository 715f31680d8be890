"""A likelihood field along the axis of a beam, (6.33) and (6.34), by a k-d tree and a fine sum; nothing shared."""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree


class SlowMap:
    """Distances from the cells of a map, and of a margin around it, to the nearest occupied one."""

    def __init__(self, occupied, resolution, origin, margin_cells=120):
        rows, cols = (np.arange(-margin_cells, n + margin_cells) for n in occupied.shape)
        cells = np.stack(np.meshgrid(rows, cols, indexing="ij"), axis=-1)
        self.distances = cKDTree(np.argwhere(occupied)).query(cells)[0] * resolution
        self.resolution, self.origin, self.margin_cells = resolution, origin, margin_cells

    def at(self, x, y):
        """The distance of the cell that holds each point."""
        x, y = x - self.origin[0], y - self.origin[1]
        c, s = math.cos(self.origin[2]), math.sin(self.origin[2])
        col = np.floor((c * x + s * y) / self.resolution).astype(int) + self.margin_cells
        row = np.floor((c * y - s * x) / self.resolution).astype(int) + self.margin_cells
        return self.distances[row, col]


class SlowAxis:
    """Distances to obstacles at the midpoints of small pieces of one beam's axis."""

    def __init__(self, world, sensor, min_range, max_range, pieces_per_cell=20):
        n = math.ceil((max_range - min_range) / world.resolution * pieces_per_cell)
        self.span, self.piece = max_range - min_range, (max_range - min_range) / n
        self.ranges = min_range + (np.arange(n) + 0.5) * self.piece
        x, y = (sensor[i] + self.ranges * f(sensor[2]) for i, f in ((0, math.cos), (1, math.sin)))
        self.distances = world.at(x, y)

    def hit(self, sigma):
        """p_hit of (6.33), normalised along the axis; at the midpoints."""
        height = np.exp(-0.5 * (self.distances / sigma) ** 2)
        return height / (height.sum() * self.piece)

    def density(self, hit_share, sigma):
        """(6.34) given that the reading is a range."""
        return hit_share * self.hit(sigma) + (1.0 - hit_share) / self.span

    def draw(self, hit_share, sigma, rng):
        """One range from that density."""
        total = np.cumsum(self.density(hit_share, sigma))
        piece = int(np.searchsorted(total / total[-1], rng.random()))
        return self.ranges[piece] + (rng.random() - 0.5) * self.piece
