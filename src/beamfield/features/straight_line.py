"""One straight line through end points, by total least squares weighted with the noise of each beam."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.errors import InvalidInputError
from beamfield.features.feature import Feature
from beamfield.features.sweep import RangeNoise, Sweep
from beamfield.geometry import FloatArray, wrap_angle

MAX_ITERATIONS = 20
# A beam closer to parallel with the wall than this (its sine) gains no more weight: rays that graze tell nothing
# sure about a wall, and a line through the sensor would have weights without bound.
LEAST_INCIDENCE = 0.02


@dataclass(frozen=True, eq=False)
class Line(Feature):
    """A straight piece of wall.

    The measurement is (rho, alpha, length): distance of the line from the robot's origin, bearing of that nearest
    point, and metres of wall between the first and last beam. x cos(alpha) + y sin(alpha) = rho, rho >= 0.

    Parameters
    ----------
    start, end
        (2,) first and last end point, put on the line; robot frame, metres, in order of bearing.
    spacing
        (2,) metres between the first two and between the last two end points: the wall may go on so far unseen.
    heading
        Direction from start to end, radians: the sensor is on its left.
    chi_square
        Sum of squared normalised residuals; n - 2 degrees of freedom.
    sweep
        Which of the scan's sweeps it is from.
    """

    start: FloatArray
    end: FloatArray
    spacing: FloatArray
    heading: float
    chi_square: float
    sweep: int = 0

    @property
    def rho(self) -> float:
        """Distance of the line from the robot's origin, metres."""
        return float(self.measurement[0])

    @property
    def alpha(self) -> float:
        """Bearing of the point of the line nearest to the robot's origin, radians."""
        return float(self.measurement[1])

    @property
    def length(self) -> float:
        """Metres from start to end."""
        return float(self.measurement[2])


def fit_line(sweep: Sweep, places: ArrayLike, noise: RangeNoise, *, number: int = 0) -> Line:
    """Fit a line to end points: maximum likelihood for noise along the beams.

    The distance d_i of a point from the line has deviation s_i, which is sigma_range times the cosine of incidence
    (plus the share of sigma_bearing); Gauss-Newton minimises the sum of (d_i / s_i)^2 over (rho, alpha), and the
    covariance is the inverse of its normal matrix. The length depends on the first and last reading, which also enter
    the line: its covariance with (rho, alpha) is kept.

    `places` (n,) tells which end points of the sweep, in the order of the wall; `number` is kept as the line's `sweep`.
    InvalidInputError if there are fewer than 2 places, or they all are one point.

    K. O. Arras and R. Siegwart, "Feature extraction and scene interpretation for map-based navigation and map
    building", SPIE Mobile Robotics XII, 1997 (lines in polar form, with covariance).
    """
    chosen = np.asarray(places, dtype=np.int64)
    if chosen.ndim != 1 or len(chosen) < 2:
        raise InvalidInputError(f"places: expected at least 2 in one row, got shape {chosen.shape}")
    rays = Rays(sweep.origins[chosen], sweep.directions[chosen], sweep.ranges[chosen])
    rho, alpha = principal_axis(rays)
    for _ in range(MAX_ITERATIONS):
        residual, jacobian, sigma = linearise(rays, rho, alpha, noise)
        normal = jacobian.T @ (jacobian / sigma[:, None] ** 2)
        step = -np.linalg.solve(normal, jacobian.T @ (residual / sigma**2))
        rho, alpha = rho + step[0], alpha + step[1]
        if abs(step[0]) < 1e-9 and abs(step[1]) < 1e-9:
            break
    return describe(sweep, chosen, rays, rho, alpha, noise, number)


@dataclass(frozen=True, eq=False)
class Rays:
    """Origins (n, 2), directions (n, 2) and ranges (n,) of the beams of a line."""

    origins: FloatArray
    directions: FloatArray
    ranges: FloatArray

    @property
    def points(self) -> FloatArray:
        """(n, 2) end points."""
        return self.origins + self.ranges[:, None] * self.directions


def principal_axis(rays: Rays) -> tuple[float, float]:
    """Return (rho, alpha) by plain total least squares, the normal pointing away from the sensor."""
    points = rays.points
    centre = points.mean(axis=0)
    spread = points - centre
    if not np.any(np.abs(spread) > 1e-12):
        raise InvalidInputError(f"points: expected different points, got {len(points)} times {centre.tolist()}")
    normal = np.linalg.eigh(spread.T @ spread)[1][:, 0]
    if normal @ (centre - rays.origins.mean(axis=0)) < 0.0:
        normal = -normal
    return float(normal @ centre), float(np.arctan2(normal[1], normal[0]))


def linearise(rays: Rays, rho: float, alpha: float, noise: RangeNoise) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the distances (n,) from the line, their derivatives (n, 2) in (rho, alpha), and their deviations (n,)."""
    normal, tangent = axes(alpha)
    residual = rays.points @ normal - rho
    facing, along = rays.directions @ normal, rays.directions @ tangent
    clear = np.where(facing < 0.0, -1.0, 1.0) * np.maximum(np.abs(facing), LEAST_INCIDENCE)
    # Where the beam meets the line, not where the noise put the point: the noise would bias the slope.
    place = rays.points @ tangent - residual * along / clear
    jacobian = np.column_stack([-np.ones_like(place), place])
    variance = (noise.along(rays.ranges) * clear) ** 2 + (noise.sigma_bearing * rays.ranges * along) ** 2
    return residual, jacobian, np.sqrt(variance)


def axes(alpha: float) -> tuple[FloatArray, FloatArray]:
    """Return the unit normal and tangent of a line."""
    cos, sin = np.cos(alpha), np.sin(alpha)
    return np.array([cos, sin]), np.array([-sin, cos])


def describe(
    sweep: Sweep, chosen: NDArray[np.int64], rays: Rays, rho: float, alpha: float, noise: RangeNoise, number: int
) -> Line:
    """Put the fitted line into polar form with rho >= 0, with the joint covariance of rho, alpha and length."""
    normal, tangent = axes(alpha)
    residual, jacobian, sigma = linearise(rays, rho, alpha, noise)
    covariance = np.zeros((3, 3))
    covariance[:2, :2] = np.linalg.inv(jacobian.T @ (jacobian / sigma[:, None] ** 2))
    facing, along = rays.directions @ normal, rays.directions @ tangent
    # Noise of a point along the line, and how it goes with the noise across it.
    across_beam = (noise.sigma_bearing * rays.ranges) ** 2
    along_beam = noise.along(rays.ranges) ** 2
    lengthwise = along_beam * along**2 + across_beam * facing**2
    shared = (along_beam - across_beam) * facing * along
    pull = -covariance[:2, :2] @ (jacobian * (shared / sigma**2)[:, None]).T
    covariance[:2, 2] = covariance[2, :2] = pull[:, -1] - pull[:, 0]
    covariance[2, 2] = lengthwise[0] + lengthwise[-1]
    ends = rays.points[[0, -1]] - residual[[0, -1], None] * normal
    forward = float(tangent @ (ends[1] - ends[0]))
    if forward < 0.0:
        covariance[:2, 2] *= -1.0
        covariance[2, :2] *= -1.0
    if rho < 0.0:
        covariance[0, :] *= -1.0
        covariance[:, 0] *= -1.0
    flipped = alpha + np.pi if rho < 0.0 else alpha
    return Line(
        measurement=np.array([abs(rho), float(wrap_angle(flipped)), abs(forward)]),
        covariance=covariance,
        beams=sweep.beams[chosen],
        start=ends[0],
        end=ends[1],
        spacing=np.hypot(*(rays.points[[1, -1]] - rays.points[[0, -2]]).T),
        heading=float(np.arctan2(*(ends[1] - ends[0])[::-1])),
        chi_square=float(np.sum((residual / sigma) ** 2)),
        sweep=number,
    )
