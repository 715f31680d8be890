"""The one interface of motion models p(x_t | u_t, x_{t-1}), and what those that read two odometry poses share."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, checked, require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray, as_poses, pose_rows, step_between

# A step beyond what a robot does (metres, m/s, radians, rad/s) is no motion: the odometry was reset, or is wrong.
JUMP, JUMP_SPEED, JUMP_TURN, JUMP_RATE = 1.0, 3.0, 1.0, 3.0


class MotionModel(Protocol):
    """p(x_t | u_t, x_{t-1}), where u_t is what odometry says: its pose before and after."""

    def sample(self, poses: ArrayLike, odometry: ArrayLike, rng: np.random.Generator) -> FloatArray:
        """Draw where each robot is after the step.

        Parameters
        ----------
        poses
            (n, 3) before the step, in the map frame, metres and radians.
        odometry
            (2, 3) poses in the odometry frame, before and after.
        rng
            Source of randomness.

        Returns
        -------
        (n, 3) poses after the step, one for each given; headings go on from those given and are not wrapped, so that
        particles around a heading of pi stay together.

        Raises
        ------
        InvalidInputError
            If an array has another shape or is not finite.
        """
        ...

    def log_density(self, after: ArrayLike, before: ArrayLike, odometry: ArrayLike) -> FloatArray:
        """Return log p(after | odometry, before), per square metre and radian.

        Parameters
        ----------
        after, before
            (..., 3) poses in the map frame; they broadcast.
        odometry
            (2, 3) poses in the odometry frame, before and after.

        Returns
        -------
        (...) nats; -inf where impossible, never NaN. A component that the model gives no noise contributes a mass, not
        a density: 0 where it is met within 1e-9, else -inf.

        Raises
        ------
        InvalidInputError
            If an array has another shape or is not finite.
        """
        ...


class Step(Protocol):
    """The distribution of one step, seen from the pose before it."""

    def sample(self, poses: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw where each of the poses (n, 3) is after the step."""
        ...

    def log_density(self, after: FloatArray, before: FloatArray) -> FloatArray:
        """Return the log density of `after`, given `before`, both (n, 3)."""
        ...

    def covariance(self) -> FloatArray:
        """Return the covariance (3, 3) of ahead, left, turn, at least to first order in the noise."""
        ...


class OdometryMotion(ABC):
    """A motion model that turns an odometry step into a distribution, which is then the same for all particles."""

    def __post_init__(self) -> None:
        check_fields(self)

    @abstractmethod
    def step(self, odometry: FloatArray) -> Step:
        """Return the distribution of the step between two odometry poses (2, 3), which are finite."""

    @checked
    def sample(self, poses: ArrayLike, odometry: ArrayLike, rng: np.random.Generator) -> FloatArray:
        """Draw where each robot is after the step; see `MotionModel`."""
        start = as_poses(poses)
        require(start.ndim == 2, "poses", "shape (n, 3)", start.shape)
        return self.step(as_odometry(odometry)).sample(pose_rows(start), rng)

    @checked
    def log_density(self, after: ArrayLike, before: ArrayLike, odometry: ArrayLike) -> FloatArray:
        """Return log p(after | odometry, before); see `MotionModel`."""
        ends, starts = as_poses(after, "after"), as_poses(before, "before")
        try:
            shape = np.broadcast_shapes(ends.shape, starts.shape)
        except ValueError:
            raise InvalidInputError(
                f"after: expected a shape that broadcasts with before's {starts.shape}, got {ends.shape}"
            ) from None
        rows = [pose_rows(np.broadcast_to(poses, shape)) for poses in (ends, starts)]
        return self.step(as_odometry(odometry)).log_density(*rows).reshape(shape[:-1])


def as_odometry(odometry: ArrayLike) -> FloatArray:
    """Return two odometry poses as float64; raise if they are not finite (2, 3)."""
    poses = as_poses(odometry, "odometry")
    require(poses.shape == (2, 3), "odometry", "shape (2, 3), the poses before and after", poses.shape)
    return poses


def odometry_step(odometry: FloatArray) -> FloatArray:
    """Return the pose after, seen from the pose before: (3,)."""
    return np.array(step_between(*odometry.tolist()))


def odometry_jumps(steps: FloatArray, seconds: FloatArray) -> NDArray[np.bool_]:
    """Return which steps (n, 3), taken in so many seconds (n,), no robot makes."""
    far = np.hypot(steps[:, 0], steps[:, 1]) > JUMP + JUMP_SPEED * seconds
    return np.asarray(far | (np.abs(steps[:, 2]) > JUMP_TURN + JUMP_RATE * seconds))


def check_not_negative(model: object, *names: str) -> None:
    """Refuse fields of a dataclass that are not finite numbers >= 0."""
    for name in names:
        value = getattr(model, name)
        require(0.0 <= value < np.inf, name, "a finite number >= 0", value)
