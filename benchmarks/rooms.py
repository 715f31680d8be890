"""Rooms of straight walls and round poles whose scans and features are known exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beamfield.geometry import compose
from beamfield.sensors import RangeFinder


@dataclass(frozen=True, eq=False)
class Room:
    """Walls (m, 4) as x1, y1, x2, y2 and poles (j, 3) as x, y, radius, in metres of the map frame."""

    walls: np.ndarray
    poles: np.ndarray

    @classmethod
    def from_outlines(cls, *outlines: np.ndarray, poles: object = ()) -> Room:
        """Build a room from closed polygons (n, 2) and poles."""
        walls = [np.hstack([corners, np.roll(corners, -1, axis=0)]) for corners in map(np.asarray, outlines)]
        return cls(np.vstack(walls).astype(float), np.asarray(poles, dtype=float).reshape(-1, 3))

    def cast(self, pose: object, finder: RangeFinder) -> tuple[np.ndarray, np.ndarray]:
        """Return exact ranges (k,), inf for none, and what was hit (k,): a wall, then a pole, by number."""
        rays = compose(np.asarray(pose, dtype=float), finder.mounts)
        distances = np.hstack([self.to_walls(rays), self.to_poles(rays)])
        hit = np.argmin(distances, axis=1)
        ranges = distances[np.arange(len(rays)), hit]
        ranges[ranges >= finder.max_range] = np.inf
        return ranges, hit

    def to_walls(self, rays: np.ndarray) -> np.ndarray:
        """Return (k, m) where each ray meets each wall."""
        start, along = self.walls[:, :2], self.walls[:, 2:] - self.walls[:, :2]
        ray = np.column_stack([np.cos(rays[:, 2]), np.sin(rays[:, 2])])
        offset = start[None] - rays[:, None, :2]
        cross = ray[:, None, 0] * along[None, :, 1] - ray[:, None, 1] * along[None, :, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = (offset[..., 0] * along[None, :, 1] - offset[..., 1] * along[None, :, 0]) / cross
            place = (offset[..., 0] * ray[:, None, 1] - offset[..., 1] * ray[:, None, 0]) / cross
        return np.where((distance > 0) & (place >= 0) & (place <= 1), distance, np.inf)

    def to_poles(self, rays: np.ndarray) -> np.ndarray:
        """Return (k, j) where each ray enters each pole."""
        ray = np.column_stack([np.cos(rays[:, 2]), np.sin(rays[:, 2])])
        offset = self.poles[None, :, :2] - rays[:, None, :2]
        along = np.sum(offset * ray[:, None], axis=-1)
        aside = np.sum(offset**2, axis=-1) - along**2
        half = self.poles[None, :, 2] ** 2 - aside
        distance = along - np.sqrt(np.maximum(half, 0.0))
        return np.where((half > 0) & (distance > 0), distance, np.inf)


def l_shaped_room() -> Room:
    """Return 8 m x 6 m with a corner cut out, a box and three poles of 0.10, 0.16 and 0.30 m diameter."""
    outline = [(0, 0), (8, 0), (8, 4), (5, 4), (5, 6), (0, 6)]
    box = [(6.0, 1.0), (6.8, 1.2), (6.6, 2.0), (5.8, 1.8)]
    return Room.from_outlines(outline, box, poles=[(1.5, 4.5, 0.05), (3.2, 1.2, 0.08), (2.0, 1.8, 0.15)])
