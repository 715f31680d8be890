"""The motion model of MIT's racecar and F1TENTH, with its names and defaults."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from beamfield.calibration.odometry.noise_family import NoiseFamily
from beamfield.calibration.odometry.result import OdometryCalibration
from beamfield.geometry import FloatArray, wrap_angle
from beamfield.models.gaussian_motion import GaussianMotion
from beamfield.models.motion import OdometryMotion, check_not_negative, odometry_step
from beamfield.models.motion_steps import log_normal


@dataclass(frozen=True)
class F1tenthMotion(OdometryMotion):
    """Odometry's step, and noise of the same width for every step, in the axes of the map.

    Parameters
    ----------
    motion_dispersion_x, motion_dispersion_y
        Standard deviations of the map's x and y, metres, whatever the car's heading.
    motion_dispersion_theta
        That of the heading, radians.

    Raises
    ------
    InvalidInputError
        If a number is negative or not finite.

    References
    ----------
    mit-racecar/particle_filter and f1tenth/particle_filter, particle_filter.py: motion_model.

    Examples
    --------
    >>> F1tenthMotion(0.3, 0.1, 0.2).step(np.zeros((2, 3))).covariance().diagonal().round(3).tolist()
    [0.05, 0.05, 0.04]
    """

    motion_dispersion_x: float = 0.05
    motion_dispersion_y: float = 0.025
    motion_dispersion_theta: float = 0.25

    def __post_init__(self) -> None:
        super().__post_init__()
        check_not_negative(self, "motion_dispersion_x", "motion_dispersion_y", "motion_dispersion_theta")

    def step(self, odometry: FloatArray) -> MapAxesStep:
        """Return the distribution of the step between two odometry poses (2, 3)."""
        deviations = self.motion_dispersion_x, self.motion_dispersion_y, self.motion_dispersion_theta
        return MapAxesStep(odometry_step(odometry), np.array(deviations))


@dataclass(frozen=True, eq=False)
class MapAxesStep:
    """A step seen from the pose before it, with normal noise of the map's x, y and of the heading.

    Parameters
    ----------
    mean
        (3,) ahead, left, turn.
    deviations
        (3,) standard deviations, 0 for no noise.
    """

    mean: FloatArray
    deviations: FloatArray

    def sample(self, poses: FloatArray, rng: np.random.Generator) -> FloatArray:
        """Draw where each of the poses (n, 3) is after the step; takes n rows of 3 standard normals."""
        return self._moved(poses) + rng.standard_normal(poses.shape) * self.deviations

    def log_density(self, after: FloatArray, before: FloatArray) -> FloatArray:
        """Return the log density of `after`, given `before`, both (n, 3); the heading is wrapped round once."""
        off = after - self._moved(before)
        x, y = (log_normal(off[:, i], float(self.deviations[i])) for i in (0, 1))
        turns = wrap_angle(off[:, 2]) + 2.0 * np.pi * np.array([[-1.0], [0.0], [1.0]])
        return np.asarray(x + y + np.logaddexp.reduce(log_normal(turns, float(self.deviations[2]))))

    def covariance(self) -> FloatArray:
        """Return the covariance (3, 3) of ahead, left, turn, over all headings before the step."""
        x, y, heading = self.deviations**2
        return np.diag([0.5 * (x + y), 0.5 * (x + y), heading])

    def _moved(self, poses: FloatArray) -> FloatArray:
        cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        ahead, left, turn = self.mean
        return np.asarray(poses + np.column_stack([
            cos * ahead - sin * left, sin * ahead + cos * left, np.full(len(poses), turn),
        ]))  # fmt: skip


# The same noise for x and y, and for the heading.
DISPERSION = NoiseFamily(
    "position and heading of every step",
    (GaussianMotion(0, 0, 0, 0, 0, position_floor=1.0), GaussianMotion(0, 0, 0, 0, 0, heading_floor=1.0)),
    lambda levels: GaussianMotion(
        0, 0, 0, 0, 0, position_floor=float(levels[0] ** 0.5), heading_floor=float(levels[1] ** 0.5)
    ),
)


def dispersions(result: OdometryCalibration) -> dict[str, float]:
    """Return the noise of a step from scan to scan, x and y alike; nothing from odometry calibrated at longer steps."""
    if result.options.update_min_d > 0.0 or result.options.update_min_a > 0.0:
        return {}
    model = result.fit(DISPERSION)
    assert isinstance(model, GaussianMotion)
    position, heading = (float(f"{value:.3g}") for value in (model.position_floor, model.heading_floor))
    return {
        "motion_dispersion_x": position, "motion_dispersion_y": position, "motion_dispersion_theta": heading,
    }  # fmt: skip
