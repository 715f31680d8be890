"""Learn a likelihood field as a density along the axis of each beam: (6.33), (6.34) by maximum likelihood."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from beamfield.calibration.field.axis_table import AxisTable
from beamfield.geometry import FloatArray

# sigma_hit is searched from this share of a cell, below which all distances but 0 are out of reach, up to metres that
# no hit is off by.
SMALLEST_SIGMA_CELLS = 0.25
LARGEST_SIGMA = 1.0
# A share below half a reading cannot be told from none, and no random readings at all would make poses impossible.
FEWEST_OF_A_CAUSE = 0.5
# Climbs start at these shares of the way, in logarithms, from the smallest sigma to the largest.
STARTS = (0.25, 0.5, 0.75)
SCREENING_READINGS = 2_000
TOLERANCE = 1e-9
MOST_ITERATIONS = 500
_MOST_HALVINGS = 20
# A Newton step that promises less than this, nats per reading, is lost in rounding.
_NO_GAIN = 1e-13


class Mixture(NamedTuple):
    """Two parameters: the share of hits among the readings that are a range, and sigma_hit in metres."""

    hit_share: float
    sigma: float


@dataclass(frozen=True)
class DensityFit:
    """Where a climb of the likelihood along the axes ended, and how many readings are hits, in the mean.

    The trace is the log-likelihood after each iteration, nats per reading; it never falls. Converged: the last one
    gained less than 1e-9.
    """

    mixture: Mixture
    trace: tuple[float, ...]
    converged: bool
    n_hits: float


def log_axis_density(table: AxisTable, mixture: Mixture) -> FloatArray:
    """Return the log density (n,) of each reading along its axis, given that it is a range; nats.

    ``p(z) = w exp(-d(z)^2 / 2 sigma^2) / integral of the same over the axis + (1 - w) / span``: (6.33) normalised along
    the axis, and (6.34) without "no return".
    """
    hit = np.exp(_Hits.at(table, mixture.sigma).log_density)
    # Where all readings are hits, far ones are impossible.
    with np.errstate(divide="ignore"):
        return np.asarray(np.log(mixture.hit_share * hit + (1.0 - mixture.hit_share) / table.span))


def fit_axis_density(table: AxisTable) -> DensityFit:
    """Return the mixture under which the readings are most likely.

    Notes
    -----
    Expectation maximisation. Given the responsibilities of (6.12) with two causes, the share of hits has its usual
    maximiser, and the expected log-likelihood is concave in 1 / sigma^2, for the density along an axis is an
    exponential family: one Newton step in it, halved until it climbs. Several climbs on a part of the readings say
    where to start.
    """
    return climb(table, _best_start(table))


def climb(table: AxisTable, start: Mixture) -> DensityFit:
    """Return where expectation maximisation ends that starts at a mixture."""
    mixture, hits = start, _Hits.at(table, start.sigma)
    log_likelihood, share = _expectation(table, hits, mixture.hit_share)
    trace = [log_likelihood / len(table)]
    converged = False
    for _ in range(MOST_ITERATIONS):
        hit_share = float(np.clip(share.mean(), *share_bounds(len(table))))
        sigma, hits = _better_sigma(table, share, mixture.sigma, hits)
        mixture = Mixture(hit_share, sigma)
        log_likelihood, share = _expectation(table, hits, hit_share)
        trace.append(log_likelihood / len(table))
        if trace[-1] - trace[-2] < TOLERANCE:
            converged = True
            break
    return DensityFit(mixture, tuple(trace), converged, float(share.sum()))


def density_gradient(table: AxisTable, mixture: Mixture) -> FloatArray:
    """Return the derivative of each reading's log density by the logit of the share of hits and log sigma, (n, 2)."""
    hits = _Hits.at(table, mixture.sigma)
    _, share = _expectation(table, hits, mixture.hit_share)
    squares = np.where(share > 0.0, table.squares, 0.0)
    return np.column_stack([share - mixture.hit_share, share * (squares - hits.mean_square) / mixture.sigma**2])


def sigma_bounds(table: AxisTable) -> tuple[float, float]:
    """Return between which values sigma_hit is searched, metres."""
    low = SMALLEST_SIGMA_CELLS * table.resolution
    return low, max(LARGEST_SIGMA, 2.0 * low)


def share_bounds(n_readings: float) -> tuple[float, float]:
    """Return the smallest and the largest share of hits that so many readings can show."""
    least = FEWEST_OF_A_CAUSE / max(n_readings, 1.0)
    return least, 1.0 - least


@dataclass(frozen=True, eq=False)
class _Hits:
    """The log density of hits along each axis at one sigma, (n,), and the mean and variance of the squared distance."""

    log_density: FloatArray
    mean_square: FloatArray
    variance: FloatArray

    @classmethod
    def at(cls, table: AxisTable, sigma: float) -> _Hits:
        precision = 1.0 / sigma**2
        squares = np.append(table.class_squares[:-1], 0.0)
        height = np.exp(-0.5 * precision * table.class_squares)
        mass, first, second = (table.counts @ np.column_stack([height, height * squares, height * squares**2])).T
        mean = first / mass
        log_density = -0.5 * precision * table.squares - np.log(mass * table.spacing)
        return cls(log_density, mean, np.maximum(second / mass - mean**2, 0.0))


def _best_start(table: AxisTable) -> Mixture:
    few, low, high = table.select(np.arange(0, len(table), 1 + len(table) // SCREENING_READINGS)), *sigma_bounds(table)
    starts = [Mixture(0.7, low * (high / low) ** share) for share in STARTS]
    return max((climb(few, start) for start in starts), key=lambda fit: fit.trace[-1]).mixture


def _expectation(table: AxisTable, hits: _Hits, hit_share: float) -> tuple[float, FloatArray]:
    """Return the log-likelihood, and how probably each reading is a hit (n,)."""
    hit = hit_share * np.exp(hits.log_density)
    density = hit + (1.0 - hit_share) / table.span
    return float(np.log(density).sum()), hit / density


def _better_sigma(table: AxisTable, shares: FloatArray, sigma: float, hits: _Hits) -> tuple[float, _Hits]:
    """Return a sigma under which the hits' expected log-likelihood is not less, and the hits there."""
    low, high = sigma_bounds(table)
    may_hit = shares > 0.0  # beyond FARTHEST the squares are inf
    squares = np.where(may_hit, table.squares, 0.0)
    gradient = 0.5 * float(shares @ (hits.mean_square - squares))
    curvature = 0.25 * float(shares @ hits.variance)
    precision = 1.0 / sigma**2
    step = gradient / curvature if curvature > 0.0 else np.sign(gradient) * precision
    # At most half or twice the sigma at a time: the quadratic knows no more.
    wanted = float(np.clip(precision + step, precision / 4.0, precision * 4.0))
    wanted = float(np.clip(wanted, 1.0 / high**2, 1.0 / low**2))
    if abs(gradient * (wanted - precision)) < _NO_GAIN * float(shares.sum()):
        return sigma, hits
    now = _expected(hits, shares)
    for _ in range(_MOST_HALVINGS):
        trial = float(1.0 / np.sqrt(wanted))
        found = _Hits.at(table, trial)
        if _expected(found, shares) >= now:
            return trial, found
        wanted = 0.5 * (wanted + precision)
    return sigma, hits


def _expected(hits: _Hits, shares: FloatArray) -> float:
    """Return the expected log-likelihood of the hits; what is none may have a log density of -inf."""
    return float(shares @ np.where(shares > 0.0, hits.log_density, 0.0))
