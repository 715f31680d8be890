"""The two families of distributions that one step of the field's motion models has."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from beamfield.geometry import FloatArray, between, wrap_angle, wrapped
from beamfield.kernels.motion import EXACT, fill_gaussian_samples, fill_rotation_log_densities, fill_rotation_samples


@dataclass(frozen=True, eq=False)
class GaussianStep:
    """A normal step: mean + transform @ (deviations * standard normals), seen from the pose before.

    Parameters
    ----------
    mean
        (3,) ahead, left, turn.
    transform
        (3, 3) of determinant 1 or -1.
    deviations
        (3,) standard deviations, 0 for no noise.

    Notes
    -----
    The heading's normal is wrapped round the circle once to either side. What is left out is below 1e-3 of the density
    for standard deviations of the heading below 2.8 rad.
    """

    mean: FloatArray
    transform: FloatArray
    deviations: FloatArray

    @classmethod
    def from_covariance(cls, mean: FloatArray, covariance: FloatArray) -> GaussianStep:
        """Return the step with this covariance (3, 3), which may be singular."""
        turn = float(covariance[2, 2])
        lever = covariance[:2, 2] / turn if turn > 0.0 else np.zeros(2)
        variances, directions = np.linalg.eigh(covariance[:2, :2] - turn * np.outer(lever, lever))
        transform = np.eye(3)
        transform[:2, :2], transform[:2, 2] = directions, lever
        # Below this, what is left of a variance of 0 is rounding.
        variances[variances <= max(EXACT**2, 1e-14 * float(np.trace(covariance[:2, :2])))] = 0.0
        return cls(mean, transform, np.sqrt([*variances, turn]))

    def sample(self, poses: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw where each of the poses (n, 3) is after the step; takes n rows of 3 standard normals."""
        out = np.empty_like(poses)
        normals = rng.standard_normal(poses.shape)
        fill_gaussian_samples(poses, normals, self.mean, self.transform * self.deviations, out)
        return out

    def log_density(self, after: FloatArray, before: FloatArray) -> FloatArray:
        """Return the log density of `after`, given `before`, both (n, 3)."""
        residual = between(before, after) - self.mean
        residual[:, 2] = wrap_angle(residual[:, 2])
        inverse = np.linalg.inv(self.transform)
        log_densities = []
        for k in (-1.0, 0.0, 1.0):
            values = (residual + np.array([0.0, 0.0, 2.0 * np.pi * k])) @ inverse.T
            parts = [log_normal(column, float(sigma)) for column, sigma in zip(values.T, self.deviations, strict=True)]
            log_densities.append(np.sum(parts, axis=0))
        return np.asarray(np.logaddexp.reduce(log_densities))

    def covariance(self) -> FloatArray:
        """Return the covariance (3, 3) of ahead, left, turn."""
        root = self.transform * self.deviations
        return np.asarray(root @ root.T)


@dataclass(frozen=True)
class RotationTranslationRotation:
    """A rotation, a translation and a rotation with independent normal noise (Table 5.6).

    Parameters
    ----------
    rotation_1, translation, rotation_2
        Their means, radians and metres.
    deviation_1, deviation_translation, deviation_2
        Their standard deviations.
    added_position, added_heading
        Standard deviations of noise added to x, y and to the heading at the end, metres and radians.

    Notes
    -----
    A noisy translation may be negative, so an end point is reached in two ways: forwards, or turned by a half turn
    and backwards. The density is the sum of both, each the product of the three normals over the distance, which is
    the determinant of polar coordinates: at the starting point itself it has an integrable pole, cut off at 1e-9 m.
    Normals of angles are wrapped round the circle once to either side. With `added_position` there is no closed form:
    the kernel integrates over the first rotation.
    """

    rotation_1: float
    translation: float
    rotation_2: float
    deviation_1: float
    deviation_translation: float
    deviation_2: float
    added_position: float = 0.0
    added_heading: float = 0.0

    def sample(self, poses: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw where each of the poses (n, 3) is after the step.

        Takes n rows of standard normals: for rotation 1, translation, rotation 2; and where there is added noise, three
        more for x, y and heading.
        """
        out = np.empty_like(poses)
        n_normals = 6 if self.added_position > 0.0 or self.added_heading > 0.0 else 3
        fill_rotation_samples(poses, rng.standard_normal((len(poses), n_normals)), self._as_array(), out)
        return out

    def log_density(self, after: FloatArray, before: FloatArray) -> FloatArray:
        """Return the log density of `after`, given `before`, both (n, 3)."""
        out = np.empty(len(after))
        fill_rotation_log_densities(before, after, self._as_array(), out)
        return out

    def covariance(self) -> FloatArray:
        """Return the covariance (3, 3) of ahead, left, turn, to first order in the noise."""
        cos, sin = math.cos(self.rotation_1), math.sin(self.rotation_1)
        root = np.array(
            [[-self.translation * sin, cos, 0.0], [self.translation * cos, sin, 0.0], [1.0, 0.0, 1.0]]
        ) * [self.deviation_1, self.deviation_translation, self.deviation_2]  # fmt: skip
        added = np.diag([self.added_position, self.added_position, self.added_heading])
        return np.asarray(root @ root.T + added**2)

    def _as_array(self) -> FloatArray:
        return np.array(
            [self.rotation_1, self.translation, self.rotation_2,
             self.deviation_1, self.deviation_translation, self.deviation_2,
             self.added_position, self.added_heading]
        )  # fmt: skip


def log_normal(values: FloatArray, sigma: float) -> FloatArray:
    """Return the log density of a normal of mean 0; without noise, the log of its mass: 0 within 1e-9, else -inf."""
    if sigma == 0.0:
        return np.where(np.abs(values) <= EXACT, 0.0, -np.inf)
    return np.asarray(-0.5 * (values / sigma) ** 2 - math.log(sigma * math.sqrt(2.0 * math.pi)))


def log_angle(angles: FloatArray, sigma: float) -> FloatArray:
    """Return `log_normal` of angles, wrapped round the circle once to either side."""
    angles = wrap_angle(angles)
    return np.asarray(np.logaddexp.reduce([log_normal(angles + 2.0 * np.pi * k, sigma) for k in (-1.0, 0.0, 1.0)]))


def rotations_and_translation(odometry: FloatArray, shortest: float) -> tuple[float, float, float]:
    """Return the rotation, translation and rotation between two odometry poses (2, 3), radians in (-pi, pi] and metres.

    Below the distance `shortest` the first rotation is 0: the bearing of so short a step says nothing.
    """
    before, after = odometry
    dx, dy = float(after[0] - before[0]), float(after[1] - before[1])
    translation = math.hypot(dx, dy)
    bearing = math.atan2(dy, dx) - float(before[2])
    rotation_1 = 0.0 if translation < shortest else wrapped(bearing)
    return rotation_1, translation, wrapped(float(after[2] - before[2]) - rotation_1)


def from_line(rotation: float) -> float:
    """Return the angle between a rotation and the nearer of straight ahead and straight back, 0 to pi / 2.

    Driving backwards is a first rotation of a half turn; it is not to be as noisy as one.
    """
    angle = abs(wrapped(rotation))
    return min(angle, math.pi - angle)
