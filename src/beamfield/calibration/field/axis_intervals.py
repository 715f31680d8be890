"""Intervals of a likelihood field learned along the axes of beams, from blocks of time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import expit, logit

from beamfield.calibration.block_errors import block_interval
from beamfield.calibration.field.axis_density import DensityFit, Mixture, density_gradient, share_bounds, sigma_bounds
from beamfield.calibration.field.axis_table import AxisTable
from beamfield.calibration.field.findings import has_no_hits
from beamfield.geometry import FloatArray

# How far the derivatives of the likelihood are apart whose difference is its curvature, in logit and logarithm.
_STEP = 0.01


def axis_intervals(
    table: AxisTable, fit: DensityFit, blocks: NDArray[np.int64]
) -> tuple[dict[str, tuple[float, float]], int]:
    """Return 95% intervals of z_hit, z_rand and sigma_hit, and the number of blocks they rest on.

    What each block of time adds to an estimate is, to first order, the inverse of the curvature times the sum of its
    readings' gradients; the spread of that is what a jackknife over blocks finds. Blocks (t,) are those of each scan of
    the log.

    (low, high) by name; (0, inf) where a parameter is undetermined: at a bound, without hits, or in a single block.
    """
    _, block = np.unique(blocks[np.concatenate([table.scan, table.no_return_scan])], return_inverse=True)
    n_blocks = int(block.max()) + 1
    if n_blocks == 1:
        return dict.fromkeys(("z_hit", "z_rand", "sigma_hit"), (0.0, np.inf)), 1
    n, m = (np.bincount(part, minlength=n_blocks) for part in np.split(block, [len(table)]))
    total = float(n.sum() + m.sum())
    share, sigma = fit.mixture
    returned = float(n.sum()) / total
    moved = _moved_by_block(table, fit, block[: len(table)], n_blocks)
    share_moved, returned_moved = share * (1.0 - share) * moved[:, 0], (n - returned * (n + m)) / total
    estimates = {
        "z_hit": (share * returned, returned * share_moved + share * returned_moved),
        "z_rand": ((1.0 - share) * returned, (1.0 - share) * returned_moved - returned * share_moved),
        "sigma_hit": (sigma, sigma * moved[:, 1]),
    }
    return {name: _interval(name, *estimate) for name, estimate in estimates.items()}, n_blocks


def _moved_by_block(table: AxisTable, fit: DensityFit, block: NDArray[np.int64], n_blocks: int) -> FloatArray:
    """Return how far each block moves the logit of the share of hits and log sigma, (b, 2); 0 what is undetermined."""
    share, sigma = fit.mixture
    (least, most), (low, high) = share_bounds(len(table)), sigma_bounds(table)
    free = np.array([least < share < most, low * 1.001 < sigma < high / 1.001])
    free[1] &= not has_no_hits(table, fit)
    gradient = density_gradient(table, fit.mixture)
    per_block = np.stack([np.bincount(block, weights=column, minlength=n_blocks) for column in gradient.T], axis=1)
    moved = np.zeros((n_blocks, 2))
    moved[:, free] = per_block[:, free] @ np.linalg.pinv(_curvature(table, fit.mixture)[np.ix_(free, free)])
    return moved


def _curvature(table: AxisTable, mixture: Mixture) -> FloatArray:
    """Return minus the second derivatives (2, 2) of the log-likelihood by the logit of the share and log sigma."""

    def gradient(by_logit: float, by_log_sigma: float) -> FloatArray:
        share = float(expit(logit(mixture.hit_share) + by_logit))
        moved = Mixture(share, mixture.sigma * float(np.exp(by_log_sigma)))
        return np.asarray(density_gradient(table, moved).sum(axis=0))

    rows = [gradient(-_STEP, 0.0) - gradient(_STEP, 0.0), gradient(0.0, -_STEP) - gradient(0.0, _STEP)]
    hessian = np.array(rows) / (2.0 * _STEP)
    return np.asarray(0.5 * (hessian + hessian.T))


def _interval(name: str, value: float, moved: FloatArray) -> tuple[float, float]:
    n = len(moved)
    error = float(np.sqrt(n / (n - 1.0) * np.square(moved - moved.mean()).sum()))
    if error == 0.0:  # at a bound
        return 0.0, np.inf
    return block_interval(value, error, n, most=np.inf if name == "sigma_hit" else 1.0)
