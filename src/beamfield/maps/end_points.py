"""Where beams end, equation (6.32): in the robot's frame or, at a pose, in the map's."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from beamfield.geometry import FloatArray, compose
from beamfield.sensors import RangeFinder, usable_ranges


def end_points(ranges: ArrayLike, finder: RangeFinder, poses: ArrayLike | None = None) -> FloatArray:
    """Return where beams end, equation (6.32).

    Parameters
    ----------
    ranges
        (..., k) metres in the conventions of `Scan`.
    finder
        The sensor.
    poses
        (..., 3) pose of the robot for each scan; may be NaN. None gives points in the robot's frame.

    Returns
    -------
    (..., k, 2) metres in the frame of the poses; NaN where nothing was measured or the pose is unknown.

    Examples
    --------
    >>> finder = RangeFinder.from_bearings([0.0, np.pi / 2], max_range=8.0)
    >>> end_points([2.0, np.inf], finder, [1.0, 0.0, 0.0]).tolist()
    [[3.0, 0.0], [nan, nan]]
    """
    z = usable_ranges(ranges, finder)
    z[z >= finder.max_range] = np.nan
    beams = finder.mounts
    if poses is not None:
        beams = compose(np.asarray(poses, dtype=np.float64)[..., None, :], beams)
    return points_along(beams, z)


def points_along(rays: FloatArray, distances: FloatArray) -> FloatArray:
    """Return the points (..., 2) at distances (...) along rays (..., 3), each from a place in a direction."""
    direction = np.stack([np.cos(rays[..., 2]), np.sin(rays[..., 2])], axis=-1)
    return np.asarray(rays[..., :2] + distances[..., None] * direction)


def hit_points(ranges: ArrayLike, finder: RangeFinder, poses: ArrayLike | None = None) -> FloatArray:
    """Return the end points of the readings below max_range alone, scan by scan.

    Parameters
    ----------
    ranges, finder, poses
        As for `end_points`; a pose of NaN leaves a scan out.

    Returns
    -------
    (n, 2) metres in the frame of the poses, none of them NaN.

    Examples
    --------
    >>> finder = RangeFinder.from_bearings([0.0, np.pi / 2], max_range=8.0)
    >>> hit_points([2.0, np.inf], finder, [1.0, 0.0, 0.0]).tolist()
    [[3.0, 0.0]]
    """
    points = end_points(ranges, finder, poses)
    return np.asarray(points[np.isfinite(points).all(axis=-1)])
