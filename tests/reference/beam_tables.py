"""Table 6.1 and the densities of 6.3.1, written down slowly and independently of beamfield.

Distributions come from SciPy, integrals from quadrature; nothing here knows of edge cases.
"""

from __future__ import annotations

import itertools
import math

import numpy as np
from scipy import stats


def p_hit(z, z_star, sigma_hit, max_range):
    """(6.4) to (6.6)."""
    a, b = (0.0 - z_star) / sigma_hit, (max_range - z_star) / sigma_hit
    return stats.truncnorm.pdf(z, a, b, loc=z_star, scale=sigma_hit) if z < max_range else 0.0


def p_short(z, z_star, lambda_short):
    """(6.7) to (6.9)."""
    if z > z_star:
        return 0.0
    if lambda_short == 0.0:
        return stats.uniform.pdf(z, 0.0, z_star)
    return stats.truncexpon.pdf(z, lambda_short * z_star, scale=1.0 / lambda_short)


def p_max(z, max_range):
    """(6.10)."""
    return 1.0 if z == max_range else 0.0


def p_rand(z, max_range):
    """(6.11)."""
    return stats.uniform.pdf(z, 0.0, max_range) if z < max_range else 0.0


def beam_range_finder_model(z_t, z_star_t, theta, max_range):
    """Table 6.1 with the expected ranges given (its line 4): the product q.

    `theta` is (z_hit, z_short, z_max, z_rand, sigma_hit, lambda_short).
    """
    z_hit, z_short, z_max, z_rand, sigma_hit, lambda_short = theta
    q = 1.0
    for z, z_star in zip(z_t, z_star_t, strict=True):
        p = (
            z_hit * p_hit(z, z_star, sigma_hit, max_range)
            + z_short * p_short(z, z_star, lambda_short)
            + z_max * p_max(z, max_range)
            + z_rand * p_rand(z, max_range)
        )
        q = q * p
    return q


def expected_range_by_small_steps(occupied, resolution, pose, bearing, max_range, step):
    """Line 4 of Table 6.1 without cleverness: walk until an occupied cell; error up to `step`. Origin at (0, 0)."""
    x, y, theta = pose
    for n in range(round(max_range / step)):
        distance = n * step
        col = math.floor((x + distance * math.cos(theta + bearing)) / resolution)
        row = math.floor((y + distance * math.sin(theta + bearing)) / resolution)
        if 0 <= row < occupied.shape[0] and 0 <= col < occupied.shape[1] and occupied[row, col]:
            return distance
    return max_range


def integral(density, low, high, breaks, order=60):
    """Integrate a piecewise smooth function by Gauss-Legendre on the pieces between the breaks."""
    nodes, weights = np.polynomial.legendre.leggauss(order)
    edges = np.unique(np.clip([low, *breaks, high], low, high))
    total = 0.0
    for a, b in itertools.pairwise(edges):
        z = np.minimum(0.5 * (a + b) + 0.5 * (b - a) * nodes, np.nextafter(b, a))
        total += 0.5 * (b - a) * float(np.sum(weights * density(z)))
    return total
