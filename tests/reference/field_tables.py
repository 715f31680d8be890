"""Table 6.3, written down slowly and independently of beamfield; distances by looking at every cell."""

from __future__ import annotations

import math

import numpy as np
from scipy import stats


def distance_to_nearest_obstacle(occupied, resolution, row, col):
    """Line 7 of Table 6.3 between the centres of cells; inf without obstacles. (row, col) may lie off the map."""
    nearest = math.inf
    for r, c in np.argwhere(occupied):
        nearest = min(nearest, resolution * math.hypot(r - row, c - col))
    return nearest


def end_point(pose, mount, z):
    """(6.32)."""
    x, y, theta = pose
    x_sens, y_sens, theta_sens = mount
    return (
        x + math.cos(theta) * x_sens - math.sin(theta) * y_sens + z * math.cos(theta + theta_sens),
        y + math.sin(theta) * x_sens + math.cos(theta) * y_sens + z * math.sin(theta + theta_sens),
    )


def prob(dist, sigma_hit):
    """The normal density of a distance; 0 infinitely far away."""
    return stats.norm.pdf(dist, scale=sigma_hit) if math.isfinite(dist) else 0.0


def likelihood_field_range_finder_model(z_t, mounts, x_t, occupied, resolution, theta, z_max):
    """Table 6.3: the product q, for a map whose corner is the map frame's origin.

    `theta` is (z_hit, z_rand, sigma_hit).
    """
    z_hit, z_rand, sigma_hit = theta
    q = 1.0
    for z, mount in zip(z_t, mounts, strict=True):
        if z != z_max:
            x, y = end_point(x_t, mount, z)
            dist = distance_to_nearest_obstacle(
                occupied, resolution, math.floor(y / resolution), math.floor(x / resolution)
            )
            q = q * (z_hit * prob(dist, sigma_hit) + z_rand / z_max)
    return q
