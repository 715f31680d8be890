"""The situation of Figures 6.8 and 6.9: a robot, a few obstacles and one beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beamfield.geometry import FloatArray, compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.sensors import RangeFinder, Scan, usable_ranges


@dataclass(frozen=True, eq=False)
class ObstacleScene:
    """One beam among obstacles.

    Parameters
    ----------
    grid
        The map, or the part of it that is shown.
    pose
        (3,) the robot's.
    finder
        The sensor.
    beam
        Index of the beam.
    parameters
        Of the likelihood field.
    """

    grid: OccupancyGrid
    pose: FloatArray
    finder: RangeFinder
    beam: int
    parameters: LikelihoodFieldParameters

    @property
    def ray(self) -> FloatArray:
        """(3,) where the beam starts and points, in the map frame."""
        return compose(self.pose, self.finder.mounts[self.beam])


def three_obstacles() -> ObstacleScene:
    """Return three round and square obstacles of our own that a beam passes one after the other."""
    s = 0.02
    rows, cols = 500, 460
    y, x = (np.indices((rows, cols)) + 0.5) * s
    pillar = np.hypot(x - 3.5, y - 3.3) < 0.75
    tilted = np.abs(x - 6.05) + np.abs(y - 5.6) < 0.85
    far = (np.abs(x - 3.3) < 1.3) & (np.abs(y - 8.3) < 0.55)
    grid = OccupancyGrid((pillar | tilted | far).astype(np.float32), s)
    finder = RangeFinder.from_bearings([0.0], max_range=10.0)
    pose = np.array([4.5, 0.6, np.radians(88.0)])
    return ObstacleScene(grid, pose, finder, 0, LikelihoodFieldParameters(z_hit=0.8, z_rand=0.15, sigma_hit=0.35))


def scene_of_scan(grid: OccupancyGrid, scan: Scan, pose: FloatArray) -> ObstacleScene:
    """Return the part of a map around a scan, and the beam with the longest measured range."""
    z = usable_ranges(scan.ranges, scan.finder)
    measured = np.where(z < scan.finder.max_range, z, -1.0)
    beam = int(np.argmax(measured))
    reach = float(measured[beam]) + 2.0
    robot = grid.to_cells(pose[:2])
    low = np.clip(np.floor(robot - reach / grid.resolution), 0, None).astype(int)
    high = np.minimum(np.ceil(robot + reach / grid.resolution), grid.shape[::-1]).astype(int)
    part = grid.probability[low[1] : high[1], low[0] : high[0]]
    if part.size:
        corner = compose(grid.origin, np.array([*(low * grid.resolution), 0.0]))
        grid = OccupancyGrid(part, grid.resolution, corner, grid.occupied_thresh, grid.free_thresh)
    sigma = max(0.25, 2.0 * grid.resolution)
    return ObstacleScene(grid, pose, scan.finder, beam, LikelihoodFieldParameters(0.8, 0.15, sigma))
