"""Round objects that stand free: tree trunks, poles, pillars (6.6.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtri

from beamfield.errors import InvalidInputError
from beamfield.features.feature import Feature, polar_jacobian
from beamfield.features.straight_line import fit_line
from beamfield.features.sweep import RangeNoise, Sweep, split_at_gaps, sweeps
from beamfield.geometry import FloatArray
from beamfield.sensors import Scan

MAX_ITERATIONS = 30
# Beams that touch the side of a trunk (small cosine of incidence) gain no more weight than this: their ranges are far
# from linear in the circle. With 0.1 a pole of 0.1 m has a mean chi-square of 4.7 instead of 3, and no smaller errors.
LEAST_INCIDENCE = 0.5
# A fit this bad happens to a round thing once in a thousand times.
BAD_FIT = 1e-3
# A flat board explains the points as well unless the circle is better by this much chi-square.
ROUNDER = 6.0


@dataclass(frozen=True, eq=False)
class Pole(Feature):
    """A round object: the measurement is (range, bearing) of its centre and its diameter in metres.

    Parameters
    ----------
    chi_square
        Of the circle, silhouette included; n - 1 degrees of freedom with n beams.
    """

    chi_square: float

    @property
    def diameter(self) -> float:
        """Metres."""
        return float(self.measurement[2])


def find_poles(
    scan: Scan,
    noise: RangeNoise,
    *,
    min_points: int = 4,
    max_diameter: float = 0.6,
    clearance: float = 0.2,
    max_gap: float = 0.2,
) -> list[Pole]:
    """Return the round objects that stand free before what is behind them.

    A circle is fitted to the end points (weighted as lines are) and to the silhouette: the trunk ends between the
    last beam that hits it and the next, which is uniform there. The silhouette is what fixes the diameter of thin
    poles. A thing that a flat board explains as well is no pole.

    Parameters
    ----------
    scan
        Ranges of any finder.
    noise
        Of single readings.
    min_points
        Fewest beams on a pole, at least 3.
    max_diameter
        Largest diameter, metres.
    clearance
        How much farther the beams on both sides must reach, metres; no return is far enough.
    max_gap
        As for `split_at_gaps`, metres.

    Raises
    ------
    InvalidInputError
        If a limit makes no sense.
    """
    if min_points < 3:
        raise InvalidInputError(f"min_points: expected at least 3, got {min_points}")
    if not max_diameter > 0.0:
        raise InvalidInputError(f"max_diameter: expected a positive number of metres, got {max_diameter}")
    if not clearance > 0.0:
        raise InvalidInputError(f"clearance: expected a positive number of metres, got {clearance}")
    poles = []
    for sweep in sweeps(scan):
        for run in split_at_gaps(sweep, noise, max_gap=max_gap):
            wide = np.hypot(*(sweep.points[run[-1]] - sweep.points[run[0]])) > max_diameter
            sides = None if wide or len(run) < min_points else silhouette(sweep, run, clearance)
            pole = None if sides is None else fit_pole(sweep, run, sides, noise)
            if pole is not None and pole.diameter <= max_diameter:
                poles.append(pole)
    return poles


def silhouette(sweep: Sweep, run: NDArray[np.int64], clearance: float) -> FloatArray | None:
    """Return (2, 2) angle of each side (right, left) and the width of what is not known of it, or None if hidden."""
    if run[0] == run[-1] or len(sweep) < len(run) + 2:
        return None
    sides = []
    for edge, step in ((int(run[0]), -1), (int(run[-1]), 1)):
        beyond = edge + step
        if not 0 <= beyond < len(sweep) and not sweep.closed:
            return None
        beyond %= len(sweep)
        if sweep.returned[beyond] and sweep.ranges[beyond] < sweep.ranges[edge] + clearance:
            return None
        width = np.mod(step * (sweep.angles[beyond] - sweep.angles[edge]), 2.0 * np.pi)
        sides.append([sweep.angles[edge] + step * width / 2.0, width])
    return np.array(sides)


def fit_pole(sweep: Sweep, run: NDArray[np.int64], sides: FloatArray, noise: RangeNoise) -> Pole | None:
    """Return the circle through a run, or None if it is none or a board does as well."""
    points, directions = sweep.points[run], sweep.directions[run]
    radius = max(np.hypot(*(points[-1] - points[0])) / 2.0, 1e-3)
    middle = directions.mean(axis=0) / np.hypot(*directions.mean(axis=0))
    circle = np.array([*(points[np.argmin(sweep.ranges[run])] + radius * middle), radius])
    cost = np.inf
    damping = 1e-3
    for _ in range(MAX_ITERATIONS):
        residual, jacobian = linearise(circle, sweep, run, sides, noise)
        cost = float(residual @ residual)
        normal = jacobian.T @ jacobian
        step = -np.linalg.solve(normal + damping * np.diag(np.diag(normal)), jacobian.T @ residual)
        trial = circle + step
        better = trial[2] > 0.0 and np.sum(linearise(trial, sweep, run, sides, noise)[0] ** 2) <= cost
        damping = damping / 10.0 if better else damping * 10.0
        if better:
            circle = trial
        if np.abs(step).max() < 1e-9:
            break
    residual, jacobian = linearise(circle, sweep, run, sides, noise)
    cost = float(residual @ residual)
    board = fit_line(sweep, run, noise).chi_square
    if cost > float(chdtri(len(run) - 1, BAD_FIT)) or board - cost < ROUNDER:
        return None
    covariance: FloatArray = np.asarray(np.linalg.inv(jacobian.T @ jacobian), dtype=np.float64)
    return describe(circle, covariance, sweep.beams[run], cost)


def linearise(
    circle: FloatArray, sweep: Sweep, run: NDArray[np.int64], sides: FloatArray, noise: RangeNoise
) -> tuple[FloatArray, FloatArray]:
    """Return normalised residuals (n + 2,) of points and sides, and their derivatives (n + 2, 3) in (x, y, radius)."""
    centre, radius = circle[:2], circle[2]
    outward = sweep.points[run] - centre
    distance = np.hypot(*outward.T)
    normal = outward / np.maximum(distance, 1e-12)[:, None]
    facing = np.abs(np.sum(sweep.directions[run] * normal, axis=1))
    sideways = noise.sigma_bearing**2 * sweep.ranges[run] ** 2 * (1.0 - facing**2)
    sigma = np.sqrt((noise.sigma_range * np.maximum(facing, LEAST_INCIDENCE)) ** 2 + sideways)
    residual = [(distance - radius) / sigma]
    jacobian = [np.column_stack([-normal, -np.ones(len(run))]) / sigma[:, None]]
    for (angle, width), edge, sign in zip(sides, (run[0], run[-1]), (1.0, -1.0), strict=True):
        from_origin = centre - sweep.origins[edge]
        left = sign * np.array([-np.sin(angle), np.cos(angle)])
        # Uniform over the gap between two beams; also the noise of the bearing moves the side.
        spread = np.hypot(*from_origin) * np.sqrt(max(width, 1e-6) ** 2 / 12.0 + noise.sigma_bearing**2)
        residual.append(np.array([(left @ from_origin - radius) / spread]))
        jacobian.append(np.array([[*left, -1.0]]) / spread)
    return np.concatenate(residual), np.vstack(jacobian)


def describe(circle: FloatArray, covariance: FloatArray, beams: NDArray[np.int64], chi_square: float) -> Pole:
    """Put a circle (x, y, radius) into (range, bearing, diameter)."""
    jacobian = np.zeros((3, 3))
    jacobian[:2, :2] = polar_jacobian(circle[:2])
    jacobian[2, 2] = 2.0
    measurement = np.array([np.hypot(circle[0], circle[1]), np.arctan2(circle[1], circle[0]), 2.0 * circle[2]])
    return Pole(measurement, jacobian @ covariance @ jacobian.T, beams, chi_square)
