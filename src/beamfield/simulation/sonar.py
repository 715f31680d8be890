"""Rings of sonars, and what walls that mirror sound do to them."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter

from beamfield.arguments import as_count, checked, require
from beamfield.geometry import FloatArray, as_poses, compose, wrap_angle
from beamfield.maps.cone import ConeCaster
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder

MOST_SENSORS = 360
# Normals are those of walls blurred by so many cells: a wall aslant the grid is a staircase.
BLUR = 2.0
# A wall whose normal at its nearest point differs by more from the way there is not faced.
FACED_WITHIN = np.radians(6.0)


@checked
def sonar_ring(
    n_sensors: int,
    *,
    radius: float = 0.2,
    opening_angle: float = np.radians(30.0),
    max_range: float = 5.0,
) -> RangeFinder:
    """Return a ring of sonars on the robot's rim, evenly spaced, looking outwards, the first one ahead.

    Parameters
    ----------
    n_sensors
        How many; rings of real robots have 8, 16 or 24.
    radius
        Of the rim, metres.
    opening_angle
        Full width of each cone, radians.
    max_range
        Limit of each sensor, metres.

    Returns
    -------
    A finder with `n_sensors` beams that are cones.

    Raises
    ------
    InvalidInputError
        If the number is not 1 to 360, the radius negative, or a limit is out of range.

    Examples
    --------
    >>> sonar_ring(4, radius=0.2).mounts.round(3).tolist()[1]
    [0.0, 0.2, 1.571]
    """
    n_sensors = as_count(n_sensors, "n_sensors", least=1, most=MOST_SENSORS)
    require(0.0 <= radius < np.inf, "radius", "a finite number of metres >= 0", radius)
    bearings = np.arange(n_sensors) * (2.0 * np.pi / n_sensors)
    turned = np.column_stack([np.zeros((n_sensors, 2)), bearings])
    mounts = compose(turned, [radius, 0.0, 0.0])
    return RangeFinder(mounts, max_range, opening_angle=opening_angle, name="sonar")


@checked
def heard_ranges(
    caster: ConeCaster, poses: FloatArray, ring: RangeFinder, roughness: float, rng: np.random.Generator
) -> FloatArray:
    """Return the ranges at which something is heard: the nearest thing in the cone, if its echo comes back.

    A smooth wall is a mirror for sound: it is heard only where the perpendicular on it lies in the cone, which is where
    the angle between the cone's axis and the perpendicular is at most half the opening angle (Figure 6.1b). Else its
    nearest point is on the cone's edge, and the pulse goes elsewhere.

    Parameters
    ----------
    caster
        Of the map.
    poses
        (..., 3) of the robot, metres and radians.
    ring
        The sensors.
    roughness
        Share of pulses that surfaces scatter, so that something comes back from everywhere. 1: every wall is heard, as
        `SonarModel` expects.
    rng
        Decides which pulses are scattered.

    Returns
    -------
    (..., k) metres; max_range where nothing is heard.

    Raises
    ------
    InvalidInputError
        If the poses are not finite (..., 3), or the roughness is no share.

    Notes
    -----
    Late echoes over several walls, and other sensors' pulses, are not simulated: z_rand and z_short stand for them.

    References
    ----------
    Probabilistic Robotics, section 6.1, Figure 6.1; 6.3.1, failures.

    Examples
    --------
    >>> wall = OccupancyGrid(np.repeat([[0.0] * 19 + [1.0]], 40, axis=0), resolution=0.1)
    >>> sonars = RangeFinder.from_bearings([0.1, 0.8], 3.0, opening_angle=0.5)
    >>> heard_ranges(ConeCaster(wall), np.array([[0.9, 2.0, 0.0]]), sonars, 0.0, np.random.default_rng(0)).tolist()
    [[1.0, 3.0]]
    """
    require(0.0 <= roughness <= 1.0, "roughness", "a share in [0, 1]", roughness)
    robots = as_poses(poses)
    ranges = caster.expected_ranges(robots, ring)
    if roughness == 1.0 or ring.opening_angle == 0.0:
        return ranges
    points, _ = caster.expected_points(robots, ring)
    away = points - compose(robots[..., None, :], ring.mounts)[..., :2]
    off_normal = _angles_to_walls(caster.grid, points, away)
    lost = (off_normal > FACED_WITHIN) & (rng.random(ranges.shape) >= roughness)
    return np.where(lost, ring.max_range, ranges)


def _angles_to_walls(grid: OccupancyGrid, points: FloatArray, away: FloatArray) -> FloatArray:
    """Return the angle between each way to a point and the normal of the wall there, (..., k); NaN for no point."""
    direction = np.arctan2(away[..., 1], away[..., 0])
    unit = np.stack([np.cos(direction), np.sin(direction)], axis=-1)
    # Seen from the sensor's side: in the middle of a thin wall there is no slope.
    before = points - BLUR * grid.resolution * unit
    rows, cols = grid.shape
    cells = np.nan_to_num(grid.to_cells(before))
    col, row = np.moveaxis(np.clip(cells, 0, [cols - 1, rows - 1]).astype(np.int64), -1, 0)
    occupied = grid.occupied.astype(np.float64)
    along_x, along_y = (gaussian_filter(occupied, BLUR, order)[row, col] for order in ((0, 1), (1, 0)))
    normal = np.arctan2(along_y, along_x) + grid.origin[2]
    return np.abs(wrap_angle(direction - normal))
