"""How far the weights of two models differ, computed by the formulas themselves on a sample of scans and poses."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from beamfield.geometry import FloatArray
from beamfield.stacks.formula import Formula

# The sample: one scan at so many poses.
N_POSES, N_BEAMS = 500, 30
# Files hold six digits, which is worth less than this over a scan.
TOLERANCE = 1e-3
# The part of a scan that hits no wall at any pose, and how far poses are off at most, in sigmas.
ELSEWHERE, FARTHEST = 0.2, 4.0


@dataclass(frozen=True)
class ChapterField:
    """Parameters of `beamfield.models.likelihood_field.LikelihoodFieldModel`, and the scans' max_range, metres."""

    z_hit: float
    z_rand: float
    sigma_hit: float
    max_distance: float
    max_range: float

    def longest_range(self, _max_range: float | None) -> float:
        """Return what random readings are divided by, metres."""
        return self.max_range

    def field_weights(self, distances: FloatArray, _limit: float, _cell: float | None = None) -> FloatArray:
        """Return the log-weights (n,) of the chapter's field (Table 6.3): the product of p over beams."""
        hit = np.exp(-0.5 * (np.minimum(distances, self.max_distance) / self.sigma_hit) ** 2)
        density = hit / (math.sqrt(2.0 * math.pi) * self.sigma_hit)
        with np.errstate(divide="ignore"):
            return np.asarray(np.log(self.z_hit * density + self.z_rand / self.max_range).sum(axis=1))


@dataclass(frozen=True)
class Comparison:
    """Log-weights of the same scan at the same poses by two models.

    Parameters
    ----------
    difference
        The largest difference of the logarithm of the ratio of two poses' weights, nats: a common factor of all weights
        changes nothing. inf if one model gives a pose the weight 0 and the other does not.
    spread, other_spread
        The largest logarithm of such a ratio by either model, nats.
    """

    difference: float
    spread: float
    other_spread: float

    @property
    def is_same(self) -> bool:
        """Whether relative weights are the same but for the digits of a file."""
        return self.difference <= TOLERANCE


def compare(log_weights: FloatArray, others: FloatArray) -> Comparison:
    """Return how far log-weights (n,) of the same poses differ."""
    both = np.isfinite(log_weights) & np.isfinite(others)
    alike = np.array_equal(np.isfinite(log_weights), np.isfinite(others))
    if not both.any():
        return Comparison(0.0 if alike else math.inf, 0.0, 0.0)
    difference = float(np.ptp(log_weights[both] - others[both])) if alike else math.inf
    return Comparison(difference, float(np.ptp(log_weights[both])), float(np.ptp(others[both])))


def sample_distances(sigma: float, max_distance: float) -> FloatArray:
    """Return distances (n, k) from end points to obstacles, metres: of poses that fit and poses that do not."""
    rng = np.random.default_rng(0)
    widths = sigma * rng.uniform(0.2, FARTHEST, (N_POSES, 1))
    distances = np.abs(rng.normal(0.0, widths, (N_POSES, N_BEAMS)))
    elsewhere = rng.random(distances.shape) < ELSEWHERE
    distances[elsewhere] = rng.uniform(0.0, 1.3 * max_distance, int(elsewhere.sum()))
    return distances


def sample_ranges(sigma: float, typical_range: float, max_range: float) -> tuple[FloatArray, FloatArray]:
    """Return readings (k,) and expected ranges (n, k), metres: of poses that fit and poses that do not.

    All readings return: what else they may be (too short, of nothing) counts for all poses. Expected ranges have the
    root mean square `typical_range`, but for those cut at `max_range`.
    """
    rng = np.random.default_rng(0)
    truth = np.minimum(rng.rayleigh(typical_range / math.sqrt(2.0), N_BEAMS), 0.95 * max_range)
    readings = truth + rng.normal(0.0, sigma, N_BEAMS)
    elsewhere = rng.random(N_BEAMS) < ELSEWHERE
    readings[elsewhere] = rng.uniform(0.1, 1.0, int(elsewhere.sum())) * truth[elsewhere]
    readings = np.clip(readings, 0.02 * max_range, 0.98 * max_range)
    widths = sigma * rng.uniform(0.2, FARTHEST, (N_POSES, 1))
    expected = np.clip(truth + rng.normal(0.0, widths, (N_POSES, N_BEAMS)), 0.02 * max_range, max_range)
    return readings, expected


def compare_fields(
    one: Formula, other: Formula | ChapterField, distances: FloatArray, limits: tuple[float, float], cell: float | None
) -> Comparison:
    """Compare the weights of two fields by the distances (n, k) from end points to obstacles, metres.

    Distances are from `sample_distances`; the limits are the ranges that the fields divide by. Some programs cut
    distances off at a whole number of the map's cells; None leaves them as they are.
    """
    seen = distances if cell is None else between_cells(distances, cell)
    return compare(*(of.field_weights(seen, limit, cell) for of, limit in zip((one, other), limits, strict=True)))


def between_cells(distances: FloatArray, cell: float) -> FloatArray:
    """Return distances as they are between cells: their squares are whole numbers of cells.

    The side of a cell is taken in single precision, as it comes in the map's message.
    """
    side = float(np.float32(cell))
    return np.asarray(np.sqrt(np.round((distances / side) ** 2)) * side)
