"""Odometry as wheels report it: the true motion with slip and with wheels whose size is not quite known."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import check_fields, require
from beamfield.geometry import FloatArray, as_poses, between, chained, wrap_angle


@dataclass(frozen=True)
class OdometryNoise:
    """How odometry goes wrong.

    Random errors are sums of independent small ones, so their variance grows with the path length and the angle turned,
    however often the odometry is read. (The alphas of the chapter on motion make the standard deviation of one step
    grow with its length; that noise depends on the rate.)

    Parameters
    ----------
    distance
        Standard deviation of the distance after one metre, metres; grows with the root of the distance.
    drift
        Standard deviation of the heading after one metre driven, radians; grows with the root of the distance.
    turn
        Standard deviation of the heading after one radian turned, radians; grows with the root of the angle.
    distance_scale, turn_scale
        Relative error of every distance and every turn: wheels larger, or further apart, than assumed.

    Raises
    ------
    InvalidInputError
        If a standard deviation is negative, a scale below -1, or a number not finite.
    """

    distance: float = 0.01
    drift: float = 0.008
    turn: float = 0.015
    distance_scale: float = 0.005
    turn_scale: float = -0.006

    def __post_init__(self) -> None:
        check_fields(self)
        for item in fields(self):
            value = getattr(self, item.name)
            low = -1.0 if item.name.endswith("scale") else 0.0
            require((np.isfinite(value) and value >= low), item.name, f"a finite number >= {low:g}", value)


def noisy_odometry(poses: ArrayLike, rng: np.random.Generator, noise: OdometryNoise | None = None) -> FloatArray:
    """Return what odometry says along a true drive (t, 3), in a frame that starts at (0, 0, 0).

    A robot that stands still adds no error. InvalidInputError if the poses are not finite (t, 3). Wheels one percent
    larger than assumed, and no other error:

    >>> noise = OdometryNoise(distance=0.0, drift=0.0, turn=0.0, distance_scale=0.01, turn_scale=0.0)
    >>> noisy_odometry([[0.0, 0.0, 0.0], [10.0, 0.0, 0.0]], np.random.default_rng(0), noise).round(6).tolist()
    [[0.0, 0.0, 0.0], [10.1, 0.0, 0.0]]
    """
    truth = as_poses(poses)
    require(truth.ndim == 2, "poses", "shape (t, 3)", truth.shape)
    noise = noise or OdometryNoise()
    if len(truth) < 2:
        return np.zeros(truth.shape)
    step = between(truth[:-1], truth[1:])
    distance, angle = np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2])
    error = rng.standard_normal((len(step), 3))
    stretch = 1.0 + noise.distance_scale + noise.distance * error[:, 0] / np.sqrt(np.maximum(distance, 1e-12))
    step[:, :2] *= stretch[:, None]
    step[:, 2] *= 1.0 + noise.turn_scale
    step[:, 2] += noise.drift * np.sqrt(distance) * error[:, 1] + noise.turn * np.sqrt(angle) * error[:, 2]
    odometry = chained(np.zeros(3), step)
    odometry[:, 2] = wrap_angle(odometry[:, 2])
    return odometry
