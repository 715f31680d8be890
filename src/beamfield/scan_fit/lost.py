"""Is the robot lost? A filter with two states over the evidence of successive scans."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from beamfield.arguments import check_fields, require
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.scan_fit.likelihood_ratio import LostEvidence, evidence_weights


@dataclass(frozen=True)
class LostRates:
    """How often a robot gets lost and is found again, before any scan is seen; 1/s, positive and finite."""

    lose: float = 1.0 / 600.0
    find: float = 1.0 / 60.0

    def __post_init__(self) -> None:
        check_fields(self)
        for name in ("lose", "find"):
            require(0.0 < getattr(self, name) < np.inf, name, "a positive rate in 1/s", getattr(self, name))

    @property
    def prior(self) -> float:
        """Share of time that such a robot is lost: the probability before the first scan."""
        return self.lose / (self.lose + self.find)


# Log odds of 1e-12, which no scan can pass.
LARGEST = math.log(1e12)


def lost_probability(
    surprise: ArrayLike, stamps: ArrayLike, evidence: LostEvidence, rates: LostRates | None = None
) -> FloatArray:
    """Return the running probability that the robot is lost, given the scans so far.

    A Bayes filter with the states "ok" and "lost": between scans the state changes with the given rates, each scan adds
    its log likelihood ratio, weighed by how much of it is new (successive scans see the same scene).

    Parameters
    ----------
    surprise
        (t,) statistic of each scan, `FitStatistics.surprise`; NaN adds no evidence.
    stamps
        (t,) seconds, not decreasing.
    evidence
        What the statistic says, `ScanFitReference.evidence`.
    rates
        None: lost once in ten minutes, found again after one.

    Returns
    -------
    (t,) probabilities in (0, 1).

    Raises
    ------
    InvalidInputError
        If the shapes differ or the stamps decrease or are not finite.

    Examples
    --------
    Evidence that favours "lost" by e^3 for surprising scans, and "ok" for others; the robot is kidnapped after a
    second:

    >>> from beamfield.scan_fit.likelihood_ratio import LostEvidence
    >>> evidence = LostEvidence([0.0, 1.0], [-3.0, 3.0], correlation_s=0.0)
    >>> lost_probability([0.0, 0.0, 1.0, 1.0], [0.0, 0.5, 1.0, 1.5], evidence).round(2).tolist()
    [0.0, 0.0, 0.02, 0.32]
    """
    rates = rates or LostRates()
    values, when = np.asarray(surprise, dtype=np.float64), np.asarray(stamps, dtype=np.float64)
    if values.ndim != 1 or values.shape != when.shape:
        raise InvalidInputError(f"surprise and stamps: expected one shape (t,), got {values.shape} and {when.shape}")
    steps = np.diff(when)
    if not (np.isfinite(when).all() and (steps >= 0.0).all()):
        raise InvalidInputError("stamps: expected finite seconds that do not decrease")
    gains = _gains(values, when, evidence)
    keep = np.exp(-(rates.lose + rates.find) * np.concatenate([np.zeros(min(len(values), 1)), steps]))
    result = []
    lost = prior = rates.prior
    # Plain floats: NumPy takes ten times as long for single numbers, and a reference is learned from 100 runs.
    for share, gain in zip(keep.tolist(), gains.tolist(), strict=True):
        lost = prior + (lost - prior) * share
        log_odds = math.log(lost) - math.log1p(-lost) + gain
        lost = 1.0 / (1.0 + math.exp(-min(max(log_odds, -LARGEST), LARGEST)))
        result.append(lost)
    return np.array(result, dtype=np.float64)


def _gains(values: FloatArray, when: FloatArray, evidence: LostEvidence) -> FloatArray:
    """Log likelihood ratio of each scan times its share of news; silent scans do not count as neighbours."""
    gains: FloatArray = np.zeros(len(values))
    speaks = ~np.isnan(values)
    gains[speaks] = evidence(values[speaks]) * evidence_weights(when[speaks], evidence.correlation_s)
    return gains


@dataclass(frozen=True)
class ReliabilityRow:
    """Scans with about one predicted probability: its mean, how often the robot was lost, and their number."""

    predicted: float
    observed: float
    n: int


EDGES = np.array([0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98, 1.0])


def reliability_table(predicted: ArrayLike, lost: ArrayLike) -> tuple[ReliabilityRow, ...]:
    """Compare probabilities (n,) with how often the robot was lost, in bins that have scans, from low to high."""
    p, truth = np.asarray(predicted, dtype=np.float64), np.asarray(lost, dtype=np.float64)
    index = np.clip(np.searchsorted(EDGES, p, side="right") - 1, 0, len(EDGES) - 2)
    rows = ((index == b) for b in range(len(EDGES) - 1))
    return tuple(ReliabilityRow(float(p[r].mean()), float(truth[r].mean()), int(r.sum())) for r in rows if r.any())


# Rates of the kidnappings that the filter is tested with: as many seconds lost as not.
TEST_RATES = LostRates(1.0 / 20.0, 1.0 / 20.0)


def kidnapped_series(
    good: FloatArray, wrong: FloatArray, stamps: FloatArray, rng: np.random.Generator
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return a series (t,) that changes between right and wrong poses at random times, and when it is wrong.

    The statistic is known at the right and at wrong poses; stamps are in seconds.
    """
    lost = np.zeros(len(stamps), dtype=bool)
    rates = TEST_RATES
    state = bool(rng.random() < rates.prior)
    chance = rng.random(len(stamps))
    for i in range(len(stamps)):
        if i > 0:
            gone = 1.0 - np.exp(-(rates.lose + rates.find) * (stamps[i] - stamps[i - 1]))
            leaves = gone * (1.0 - rates.prior if state else rates.prior)
            state ^= bool(chance[i] < leaves)
        lost[i] = state
    return np.where(lost, wrong, good), lost


def tune_correlation(
    evidence: LostEvidence, series: list[tuple[FloatArray, FloatArray, NDArray[np.bool_]]]
) -> LostEvidence:
    """Return the evidence with the correlation time whose probabilities score best on held-out kidnappings.

    Of each series: statistic, stamps, lost. The time is 1/8 to 4 times that measured from the series, which the
    evidence has.
    """
    factors = (0.125, 0.25, 0.5, 1.0, 2.0, 4.0)
    trials = [replace(evidence, correlation_s=evidence.correlation_s * factor) for factor in factors]
    return max(trials, key=lambda trial: _log_score(trial, series))


def _log_score(evidence: LostEvidence, series: list[tuple[FloatArray, FloatArray, NDArray[np.bool_]]]) -> float:
    total = 0.0
    for values, stamps, lost in series:
        p = lost_probability(values, stamps, evidence, TEST_RATES)
        total += float(np.log(np.where(lost, p, 1.0 - p)).mean())
    return total
