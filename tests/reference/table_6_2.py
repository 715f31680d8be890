"""Table 6.2, learn_intrinsic_parameters, taken literally: what the chapter prints, not what maximises the likelihood.

Written from the table alone; nothing of beamfield is used.
"""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr


def learn_intrinsic_parameters(z, z_star, max_range, sigma_hit, lambda_short, n_iterations):
    """Return Theta = (z_hit, z_short, z_max, z_rand, sigma_hit, lambda_short) after each iteration, shape (n, 6)."""
    thetas = []
    for _ in range(n_iterations):
        # Lines 3 to 9: no mixture weights. (6.4) has 0 <= z <= z_max, (6.7) has 0 <= z <= z*, (6.11) has z < z_max.
        mass = ndtr((max_range - z_star) / sigma_hit) - ndtr(-z_star / sigma_hit)
        hit = np.exp(-0.5 * ((z - z_star) / sigma_hit) ** 2) / np.sqrt(2.0 * np.pi * sigma_hit**2) / mass
        eta_short = 1.0 / -np.expm1(-lambda_short * z_star)
        short = np.where(z <= z_star, eta_short * lambda_short * np.exp(-lambda_short * z), 0.0)
        no_return = np.where(z == max_range, 1.0, 0.0)
        rand = np.where(z < max_range, 1.0 / max_range, 0.0)
        eta = 1.0 / (hit + short + no_return + rand)
        e_hit, e_short, e_max, e_rand = eta * hit, eta * short, eta * no_return, eta * rand
        # Lines 10 to 15.
        weights = [e_hit.mean(), e_short.mean(), e_max.mean(), e_rand.mean()]
        sigma_hit = np.sqrt(np.sum(e_hit * (z - z_star) ** 2) / np.sum(e_hit))
        lambda_short = np.sum(e_short) / np.sum(e_short * z)
        thetas.append([*weights, sigma_hit, lambda_short])
    return np.array(thetas)


def log_likelihood(z, z_star, max_range, theta):
    """Log of (6.13) per beam for the mixture (6.12): a density on [0, max_range) and a mass at max_range."""
    z_hit, z_short, z_max, z_rand, sigma_hit, lambda_short = theta
    mass = ndtr((max_range - z_star) / sigma_hit) - ndtr(-z_star / sigma_hit)
    hit = np.exp(-0.5 * ((z - z_star) / sigma_hit) ** 2) / np.sqrt(2.0 * np.pi * sigma_hit**2) / mass
    if lambda_short > 0.0:
        short = lambda_short * np.exp(-lambda_short * z) / -np.expm1(-lambda_short * z_star)
    else:
        short = 1.0 / z_star
    density = z_hit * hit + z_short * np.where(z <= z_star, short, 0.0) + z_rand / max_range
    return float(np.mean(np.log(np.where(z < max_range, density, z_max))))
