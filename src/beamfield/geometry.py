"""SE(2): planar poses (x, y, theta) in metres and radians, as arrays of shape (..., 3)."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import as_floats, as_writeable, checked, require
from beamfield.errors import InvalidInputError

FloatArray = NDArray[np.float64]
# Headings and bearings may be rounded up to so much more than a full turn, radians.
TURN_TOLERANCE = 1e-3
# OpenBLAS computes dot products of up to 10,000 numbers without further threads.
BLAS_ALONE = 9_000
# Single poses as plain numbers: a step of arrays of one pose takes 50 us, and a filter makes several for each scan.
Pose = tuple[float, float, float]


def as_poses(poses: ArrayLike, name: str = "poses") -> FloatArray:
    """Return poses as float64 of shape (..., 3); raise if they are not valid.

    Parameters
    ----------
    poses
        (..., 3) x, y in metres, theta in radians.
    name
        How to call them in the error.

    Returns
    -------
    (..., 3) the numbers given, unchanged: headings are not wrapped. No copy of an array of doubles.

    Raises
    ------
    InvalidInputError
        If the last axis is not 3 long or a value is not finite.

    Examples
    --------
    >>> as_poses([[0, 1, 0.5]]).shape
    (1, 3)
    >>> as_poses([0.0, np.nan, 0.0])
    Traceback (most recent call last):
    beamfield.errors.InvalidInputError: poses: expected finite numbers, got nan at index (1,)
    """
    array = as_unchecked_poses(poses, name)
    if not math.isfinite(_sum_of_something(array)) and not np.isfinite(array).all():
        where = np.argwhere(~np.isfinite(array))[0]
        raise InvalidInputError(
            f"{name}: expected finite numbers, got {array[tuple(where)]} at index {tuple(where.tolist())}"
        )
    return array


def as_pose(pose: ArrayLike, name: str = "pose") -> FloatArray:
    """Return one pose as a new array (3,); raise if it is none."""
    array = np.array(as_poses(pose, name))
    require(array.shape == (3,), name, "shape (3,)", array.shape)
    return array


def as_mount(mount: ArrayLike) -> FloatArray:
    """Return the pose of a sensor on the robot as a new array (3,); raise if it is none, or in degrees."""
    pose = as_pose(mount, "mount")
    require_radians("heading of mount", pose[2])
    return pose


def require_radians(name: str, angles: ArrayLike) -> None:
    """Refuse angles of more than a full turn, which degrees are, nearly always."""
    farthest = np.max(np.abs(angles), initial=0.0)
    if 2.0 * np.pi + TURN_TOLERANCE < farthest < np.inf:
        raise InvalidInputError(
            f"{name}: expected radians, at most a full turn, got {farthest:g}; np.radians(...) converts degrees"
        )


def as_unchecked_poses(poses: ArrayLike, name: str = "poses") -> FloatArray:
    """Do as `as_poses` where a kernel tells whether the numbers are finite: looking twice takes 3 us for 2000 poses."""
    return _rows(poses, 3, name)


def pose_rows(poses: FloatArray) -> FloatArray:
    """Return poses (..., 3) as writeable rows (n, 3): one array type, so that kernels are compiled once."""
    return as_writeable(poses.reshape(-1, 3))


def _rows(values: ArrayLike, length: int, name: str) -> FloatArray:
    array = as_floats(values, name)
    if array.ndim == 0 or array.shape[-1] != length:
        raise InvalidInputError(f"{name}: expected shape (..., {length}), got {array.shape}")
    return array


def _sum_of_something(array: FloatArray) -> float:
    """Return a number that is finite only if all numbers are, quicker than asking each; it may overflow."""
    if array.size <= BLAS_ALONE:
        return float(np.vdot(array, array))
    # BLAS would give so many to threads of its own, which then spin for milliseconds on the processor that the kernels'
    # second thread needs: two threads took as long as one.
    with np.errstate(over="ignore", invalid="ignore"):
        return float(np.add.reduce(array, axis=None))


def wrap_angle(angle: ArrayLike) -> FloatArray:
    """Return the angle in (-pi, pi].

    Parameters
    ----------
    angle
        Radians, of any shape.

    Returns
    -------
    Radians, of the same shape; NaN where the angle is NaN or infinite.

    Examples
    --------
    >>> float(wrap_angle(-np.pi)) == np.pi
    True
    """
    angle = as_floats(angle, "angle")
    with np.errstate(invalid="ignore"):
        wrapped = np.pi - np.mod(np.pi - angle, 2.0 * np.pi)
    return np.asarray(wrapped)


def compose(a_from_b: ArrayLike, b_from_c: ArrayLike) -> FloatArray:
    """Return a_from_c, the pose of c in a; the arguments broadcast.

    Parameters
    ----------
    a_from_b, b_from_c
        (..., 3) poses, metres and radians.

    Returns
    -------
    (..., 3) poses, the heading in (-pi, pi]; NaN where an argument is.

    Raises
    ------
    InvalidInputError
        If the last axis of an argument is not 3 long.

    Examples
    --------
    >>> compose([1.0, 0.0, np.pi / 2], [1.0, 0.0, 0.0]).round(12).tolist()
    [1.0, 1.0, 1.570796326795]
    """
    a, b = _rows(a_from_b, 3, "a_from_b"), _rows(b_from_c, 3, "b_from_c")
    with np.errstate(over="ignore", invalid="ignore"):
        cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
        x, y = a[..., 0] + cos * b[..., 0] - sin * b[..., 1], a[..., 1] + sin * b[..., 0] + cos * b[..., 1]
        return np.stack([x, y, wrap_angle(a[..., 2] + b[..., 2])], axis=-1)


def invert(a_from_b: ArrayLike) -> FloatArray:
    """Return b_from_a, the inverse of each pose.

    Parameters
    ----------
    a_from_b
        (..., 3) poses, metres and radians.

    Returns
    -------
    (..., 3) poses, the heading in (-pi, pi]; NaN where the argument is.

    Examples
    --------
    >>> a_from_b = [1.0, 2.0, np.pi / 2]
    >>> compose(a_from_b, invert(a_from_b)).round(12).tolist()
    [0.0, 0.0, 0.0]
    """
    a = _rows(a_from_b, 3, "a_from_b")
    with np.errstate(over="ignore", invalid="ignore"):
        cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
        x, y = -cos * a[..., 0] - sin * a[..., 1], sin * a[..., 0] - cos * a[..., 1]
        return np.stack([x, y, wrap_angle(-a[..., 2])], axis=-1)


def between(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Return the pose of b seen from a.

    Parameters
    ----------
    a, b
        (..., 3) poses in one frame, metres and radians; they broadcast.

    Returns
    -------
    (..., 3) a_from_b, the heading in (-pi, pi]; NaN where an argument is.

    Examples
    --------
    >>> between([1.0, 1.0, np.pi / 2], [1.0, 3.0, np.pi / 2]).round(12).tolist()
    [2.0, 0.0, 0.0]
    """
    return compose(invert(_rows(a, 3, "a")), _rows(b, 3, "b"))


def chained(start: FloatArray, steps: FloatArray) -> FloatArray:
    """Return the poses (t, 3) that steps (t - 1, 3) lead to; headings are not wrapped."""
    heading = start[2] + np.concatenate([[0.0], np.cumsum(steps[:, 2])])
    cos, sin = np.cos(heading[:-1]), np.sin(heading[:-1])
    poses = np.empty((len(steps) + 1, 3))
    poses[0] = start
    poses[1:, 0] = start[0] + np.cumsum(cos * steps[:, 0] - sin * steps[:, 1])
    poses[1:, 1] = start[1] + np.cumsum(sin * steps[:, 0] + cos * steps[:, 1])
    poses[:, 2] = heading
    return poses


def transform_points(a_from_b: ArrayLike, points: ArrayLike) -> FloatArray:
    """Return points of frame b in frame a; the arguments broadcast.

    Parameters
    ----------
    a_from_b
        (..., 3) poses, metres and radians.
    points
        (..., 2) metres, in frame b.

    Returns
    -------
    (..., 2) metres, in frame a; NaN where an argument is.

    Examples
    --------
    >>> transform_points([1.0, 0.0, np.pi / 2], [2.0, 0.0]).round(12).tolist()
    [1.0, 2.0]
    """
    a, p = _rows(a_from_b, 3, "a_from_b"), _rows(points, 2, "points")
    with np.errstate(over="ignore", invalid="ignore"):
        cos, sin = np.cos(a[..., 2]), np.sin(a[..., 2])
        x, y = a[..., 0] + cos * p[..., 0] - sin * p[..., 1], a[..., 1] + sin * p[..., 0] + cos * p[..., 1]
        return np.stack([x, y], axis=-1)


@checked
def interpolate_poses(stamps: ArrayLike, poses: ArrayLike, at: ArrayLike, *, max_gap: float = np.inf) -> FloatArray:
    """Return poses at other times: positions and headings interpolated linearly, headings the short way round.

    Parameters
    ----------
    stamps
        (t,) seconds, not decreasing.
    poses
        (t, 3) metres and radians.
    at
        (n,) seconds.
    max_gap
        Longest time in seconds between the two neighbours that are interpolated.

    Returns
    -------
    (n, 3) poses; NaN outside the stamps, in gaps longer than `max_gap`, and beside a pose that is NaN.

    Raises
    ------
    InvalidInputError
        If an array has another shape.

    Examples
    --------
    >>> interpolate_poses([0.0, 1.0], [[0.0, 0.0, 3.0], [1.0, 2.0, -3.0]], [0.5, 2.0]).round(3).tolist()
    [[0.5, 1.0, 3.142], [nan, nan, nan]]
    """
    times, track = as_floats(stamps, "stamps"), _rows(poses, 3, "poses")
    when = np.atleast_1d(as_floats(at, "at"))
    n = len(track)
    for name, array, shape in (("poses", track, (n, 3)), ("stamps", times, (n,)), ("at", when, (when.size,))):
        require(array.shape == shape, name, f"shape {shape}", array.shape)
    result: FloatArray = np.full((len(when), 3), np.nan)
    if len(times) == 0:
        return result
    inside = (when >= times[0]) & (when <= times[-1])
    when = np.where(inside, when, times[0])
    after = np.clip(np.searchsorted(times, when, side="left"), 1, max(1, len(times) - 1))
    before = after - 1
    after = np.minimum(after, len(times) - 1)
    gap = times[after] - times[before]
    fraction = np.divide(when - times[before], gap, out=np.zeros_like(when), where=gap > 0)
    exact = (when == times[before]) | (when == times[after])
    good = inside & ((gap <= float(max_gap)) | exact)
    turn = wrap_angle(track[after, 2] - track[before, 2])
    result[:, :2] = track[before, :2] + fraction[:, None] * (track[after, :2] - track[before, :2])
    result[:, 2] = wrap_angle(track[before, 2] + fraction * turn)
    result[~good] = np.nan
    return result


def yaw_from_quaternion(x: Any, y: Any, z: Any, w: Any) -> FloatArray:
    """Return the heading of quaternions: what their rotation turns about z.

    Parameters
    ----------
    x, y, z, w
        Of one shape, w the scalar part. They need not have length 1; all zeros give 0.

    Returns
    -------
    Radians in [-pi, pi], of that shape.

    Examples
    --------
    >>> float(yaw_from_quaternion(0.0, 0.0, 1.0, 0.0)) == np.pi
    True
    """
    x, y, z, w = (as_floats(value, name) for name, value in zip("xyzw", (x, y, z, w), strict=True))
    with np.errstate(over="ignore", invalid="ignore"):
        return np.asarray(np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z))


def step_between(a: Pose, b: Pose) -> Pose:
    """Return the pose of b seen from a, as `between` does, of single poses."""
    dx, dy, cos, sin = b[0] - a[0], b[1] - a[1], math.cos(a[2]), math.sin(a[2])
    return cos * dx + sin * dy, cos * dy - sin * dx, wrapped(b[2] - a[2])


def after_step(a: Pose, step: Pose) -> Pose:
    """Return the pose that is reached from a by a step, as `compose` does, of single poses."""
    cos, sin = math.cos(a[2]), math.sin(a[2])
    return a[0] + cos * step[0] - sin * step[1], a[1] + sin * step[0] + cos * step[1], wrapped(a[2] + step[2])


def wrapped(angle: float) -> float:
    """Return an angle in (-pi, pi], as `wrap_angle` does, of a single one."""
    return math.pi - (math.pi - angle) % (2.0 * math.pi)
