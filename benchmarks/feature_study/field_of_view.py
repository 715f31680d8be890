"""Which corners of a map can be seen from where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from beamfield.geometry import FloatArray, wrap_angle
from beamfield.maps.landmarks import LandmarkMap
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder

# A ray towards a corner that ends so much before it still shows it: cells are squares, poses are rounded. Metres.
BEFORE = 0.25
# Corners farther away are never in view, metres.
FARTHEST = 15.0


@dataclass(frozen=True)
class FieldOfView:
    """The bearings that a sensor covers.

    Parameters
    ----------
    centre, half
        Middle and half width of the covered interval, robot frame, radians.
    """

    centre: float
    half: float

    @classmethod
    def of(cls, finder: RangeFinder) -> FieldOfView:
        """Return the bearings of a finder's beams: all but their widest gap, if that is wider than the others."""
        bearings = np.sort(np.mod(finder.bearings, 2.0 * np.pi))
        gaps = np.diff(bearings, append=bearings[0] + 2.0 * np.pi)
        widest, usual = int(np.argmax(gaps)), float(np.median(gaps))
        if gaps[widest] <= 2.0 * usual or len(bearings) == 1:
            return cls(0.0, np.pi)
        first, span = bearings[(widest + 1) % len(bearings)], 2.0 * np.pi - gaps[widest]
        return cls(float(wrap_angle(first + 0.5 * span)), float(min(np.pi, 0.5 * (span + usual))))

    def holds(self, bearings: FloatArray) -> NDArray[np.bool_]:
        """Return whether bearings in the robot frame are covered, same shape."""
        return np.asarray(np.abs(wrap_angle(bearings - self.centre)) <= self.half)


def corners_in_sight(grid: OccupancyGrid, corners: LandmarkMap, positions: FloatArray) -> NDArray[np.bool_]:
    """Return whether nothing of the map hides each corner from each position, (c, N), whatever the heading.

    Parameters
    ----------
    grid
        The map that hides.
    corners
        The N corners.
    positions
        (c, 2) of the robot, metres. The sensor's own place on it is not considered.
    """
    caster, along = RayCaster(grid), RangeFinder.from_bearings(np.zeros(1), FARTHEST)
    seen = np.zeros((len(positions), len(corners)), dtype=np.bool_)
    for j, corner in enumerate(corners.positions):
        away = corner - positions
        distance = np.hypot(away[:, 0], away[:, 1])
        near = np.flatnonzero(distance < FARTHEST)
        rays = np.column_stack([positions[near], np.arctan2(away[near, 1], away[near, 0])])
        if len(near):
            seen[near, j] = caster.expected_ranges(rays, along)[:, 0] > distance[near] - BEFORE
    return seen
