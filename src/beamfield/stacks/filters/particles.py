"""What particle filters do with particles: draw them, and take their mean and covariance."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from beamfield.arguments import require
from beamfield.geometry import FloatArray, transform_points
from beamfield.kernels.particles import fill_moments, find_points
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.stacks.emulation.parameter_checks import check_counts

# As for our own filter.
MOST_PARTICLES = 10_000_000
# Of larger numbers no exponential fits into a double.
LARGEST = 700.0
# Groups of particles: none.
EVERY = np.empty(0, np.int64)


def check_particle_counts(parameters: Any, *names: str) -> None:
    """Refuse numbers of particles that are no counts, or more than memory has room for."""
    check_counts(parameters, **dict.fromkeys(names, 1))
    for name in names:
        value = getattr(parameters, name)
        require(value <= MOST_PARTICLES, name, f"at most {MOST_PARTICLES}", value)


def uniform_poses(seen: OccupancyGrid, n: int, rng: np.random.Generator) -> FloatArray:
    """Return n poses (n, 3) at the centres of free cells, with any heading."""
    rows, cols = np.nonzero(seen.free)
    drawn = rng.integers(len(rows), size=n)
    centres = (np.column_stack([cols[drawn], rows[drawn]]) + 0.5) * seen.resolution
    return np.column_stack([transform_points(seen.origin, centres), rng.uniform(-np.pi, np.pi, n)])


def reweighed(weights: FloatArray, log_weights: FloatArray) -> tuple[FloatArray, float]:
    """Return weights (n,) times others, normalised, and what they summed up to.

    Where that is 0, as weights may be too small for a double, the particles become equal.
    """
    too_much = max(float(log_weights.max()) - LARGEST, 0.0)
    with np.errstate(under="ignore", over="ignore"):
        product = weights * np.exp(log_weights - too_much)
        total = float(product.sum())
        sum_of_all = float(total * np.exp(too_much))
    return (product / total if total > 0.0 else np.full(len(weights), 1.0 / len(weights))), sum_of_all


def normalised(log_weights: FloatArray) -> FloatArray:
    """Return weights (n,) that sum to 1 from their logarithms, however small; where all are 0, equal ones."""
    most = log_weights.max()
    if most == -np.inf:
        return np.full(len(log_weights), 1.0 / len(log_weights))
    with np.errstate(under="ignore"):
        weights = np.exp(log_weights - most)
    return np.asarray(weights / weights.sum())


def n_effective(weights: FloatArray) -> float:
    """Return the effective number of particles with weights (n,) that sum to 1."""
    return 1.0 / float(weights @ weights)


def draw_by_weight(weights: FloatArray, n: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Return n indices of particles, each drawn for itself by their weights, which sum to 1."""
    return at_points(weights, rng.random(n))


def at_points(weights: FloatArray, points: FloatArray) -> NDArray[np.int64]:
    """Return the particle at each of some numbers in [0, 1) on the summed weights (n,), which sum to 1."""
    drawn = np.empty(len(points), np.int64)
    find_points(np.cumsum(weights), points, drawn)
    return drawn


def particle_moments(
    poses: FloatArray, weights: FloatArray, groups: NDArray[np.int64] = EVERY, which: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Return the mean pose (3,) and covariance (3, 3) of poses (n, 3) with weights (n,), or of one of `groups` (n,).

    The mean's heading is that of the mean direction.
    """
    mean, covariance = np.zeros(3), np.zeros((3, 3))
    fill_moments(poses, weights, groups, which, mean, covariance)
    return mean, covariance
