"""Rooms of straight walls and round poles whose scans and features are known exactly."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from matplotlib.path import Path

from beamfield.geometry import compose
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.lines import LineMap
from beamfield.maps.occupancy import OccupancyGrid
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


def drawn_room(outline: object, resolution: float = 0.1) -> tuple[OccupancyGrid, LineMap, LandmarkMap]:
    """Return a room without furniture as a grid, as walls and as corners with opening angles, all exactly the same.

    The sides of the outline (n, 2), counter-clockwise, go along x or y through multiples of the resolution, so that the
    surfaces of the grid's cells are the walls. Corners have the opening angle as their signature.
    """
    corners = np.asarray(outline, dtype=float)
    low = corners.min(axis=0) - 2 * resolution
    size = np.round((corners.max(axis=0) - low) / resolution).astype(int) + 2
    rows, cols = np.indices(size[::-1])
    centres = low + (np.stack([cols, rows], axis=-1).reshape(-1, 2) + 0.5) * resolution
    inside = Path(np.vstack([corners, corners[:1]])).contains_points(centres).reshape(rows.shape)
    walls = np.hstack([corners, np.roll(corners, -1, axis=0)])
    ahead, behind = np.roll(corners, -1, axis=0) - corners, corners - np.roll(corners, 1, axis=0)
    turns_left = behind[:, 0] * ahead[:, 1] - behind[:, 1] * ahead[:, 0] > 0.0
    opening = np.where(turns_left, 0.5 * np.pi, 1.5 * np.pi)
    grid = OccupancyGrid(np.where(inside, 0.0, 1.0), resolution, np.array([*low, 0.0]))
    return grid, LineMap.from_segments(walls), LandmarkMap(corners, signatures=opening)


def l_shaped_room() -> Room:
    """Return 8 m x 6 m with a corner cut out, a box and three poles of 0.10, 0.16 and 0.30 m diameter."""
    outline = [(0, 0), (8, 0), (8, 4), (5, 4), (5, 6), (0, 6)]
    box = [(6.0, 1.0), (6.8, 1.2), (6.6, 2.0), (5.8, 1.8)]
    return Room.from_outlines(outline, box, poles=[(1.5, 4.5, 0.05), (3.2, 1.2, 0.08), (2.0, 1.8, 0.15)])
