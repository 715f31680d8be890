"""What one statistic says about "lost": a monotone likelihood ratio, and how long its values depend on each other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from beamfield.arguments import check_fields, keep, restore
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray

N_BINS = 40


@dataclass(frozen=True, eq=False)
class LostEvidence:
    """log p(statistic | lost) - log p(statistic | ok), never falling as the statistic grows.

    Parameters
    ----------
    knots
        (b,) values of the statistic, increasing.
    log_ratio
        (b,) nats, not decreasing; between knots it is interpolated, beyond them it stays.
    correlation_s
        Seconds over which values depend on each other.

    Raises
    ------
    InvalidInputError
        If the knots do not increase, the ratios decrease or a number is not finite.

    Examples
    --------
    >>> LostEvidence([0.0, 1.0], [-3.0, 3.0], correlation_s=0.0)([0.5, 9.0, np.nan]).tolist()
    [0.0, 3.0, 0.0]
    """

    knots: FloatArray
    log_ratio: FloatArray
    correlation_s: float

    __setstate__ = restore

    def __post_init__(self) -> None:
        check_fields(self)
        knots, ratio = (np.array(v, dtype=np.float64) for v in (self.knots, self.log_ratio))
        if knots.ndim != 1 or knots.shape != ratio.shape or len(knots) == 0:
            raise InvalidInputError(f"evidence: expected knots and ratios (b,), got {knots.shape} and {ratio.shape}")
        if not (np.isfinite(knots).all() and np.isfinite(ratio).all() and np.isfinite(self.correlation_s)):
            raise InvalidInputError("evidence: expected finite numbers")
        if (np.diff(knots) <= 0.0).any() or (np.diff(ratio) < 0.0).any() or self.correlation_s < 0.0:
            raise InvalidInputError("evidence: expected increasing knots, ratios that do not fall, correlation_s >= 0")
        keep(self, knots=knots, log_ratio=ratio)

    def __call__(self, values: ArrayLike) -> FloatArray:
        """Return nats in favour of "lost", 0 for NaN."""
        x = np.asarray(values, dtype=np.float64)
        return np.asarray(np.where(np.isnan(x), 0.0, np.interp(np.nan_to_num(x), self.knots, self.log_ratio)))


def learn_evidence(
    good: ArrayLike, lost: ArrayLike, *, n_good: float, n_lost: float, correlation_s: float
) -> LostEvidence:
    """Learn the likelihood ratio of "lost" from values of good scans and of scans at wrong poses.

    Shares of both in bins of the statistic, made monotone by pooling neighbours that disagree (isotonic regression).
    Half a count is added on both sides, so that no value is evidence stronger than that many independent scans (n_good,
    n_lost) can give. Values depend on each other over `correlation_s` seconds; NaN are left out.

    The log ratio at the middles of the pooled bins does not fall; it is 0 everywhere if one side has no value.
    """
    ok, bad = (np.asarray(v, dtype=np.float64) for v in (good, lost))
    ok, bad = ok[~np.isnan(ok)], bad[~np.isnan(bad)]
    if len(ok) == 0 or len(bad) == 0:
        return LostEvidence(np.zeros(1), np.zeros(1), correlation_s)
    levels = np.linspace(0.0, 1.0, N_BINS + 1)
    edges = np.unique(np.concatenate([np.quantile(ok, levels), np.quantile(bad, levels)]))
    if len(edges) < 2:
        return LostEvidence(edges, np.zeros(1), correlation_s)
    ok_count = np.histogram(ok, edges)[0] / len(ok) * n_good
    bad_count = np.histogram(bad, edges)[0] / len(bad) * n_lost
    groups = _pool(ok_count / n_good, bad_count / n_lost)
    sums = np.array([(ok_count[a:b].sum(), bad_count[a:b].sum()) for a, b in groups])
    ratio = np.log((sums[:, 1] + 0.5) / (n_lost + 1.0)) - np.log((sums[:, 0] + 0.5) / (n_good + 1.0))
    centres = np.array([0.5 * (edges[a] + edges[b]) for a, b in groups])
    return LostEvidence(centres, np.maximum.accumulate(ratio), correlation_s)


def _pool(ok: FloatArray, bad: FloatArray) -> list[tuple[int, int]]:
    """Return bins (first, one past the last) joined until the share of `bad` rises from each to the next."""
    # Pool adjacent violators; scipy.optimize, which has it too, takes 0.4 s to import.
    groups: list[tuple[int, int, float, float]] = []
    for i in range(len(ok)):
        first, good, lost = i, ok[i], bad[i]
        while groups and _share(good, lost) <= _share(*groups[-1][2:]) + 1e-12:
            first, _, more_good, more_lost = groups.pop()
            good, lost = good + more_good, lost + more_lost
        groups.append((first, i + 1, good, lost))
    return [(first, stop) for first, stop, *_ in groups]


def _share(ok: float, bad: float) -> float:
    return bad / max(ok + bad, 1e-300)


def correlation_time(stamps: ArrayLike, values: ArrayLike) -> float:
    """Return the integrated correlation time of a series (t,), seconds: 0 if neighbours are independent.

    The lag-one correlation over all neighbouring pairs within ten median steps gives rho = exp(-step / time). NaN are
    left out; 0 too for fewer than 3 values.
    """
    when, x = np.asarray(stamps, dtype=np.float64), np.asarray(values, dtype=np.float64)
    order = np.argsort(when, kind="stable")
    order = order[~np.isnan(x[order])]
    # Ranks: a few wild values would hide the correlation of the others.
    ranks = np.empty(len(order))
    ranks[np.argsort(x[order], kind="stable")] = np.arange(len(order))
    when = when[order]
    if len(when) < 3:
        return 0.0
    centred = ranks - ranks.mean()
    step = float(np.median(np.diff(when)))
    if step <= 0.0:
        return 0.0
    times = []
    for lag in (1, 2, 4, 8, 16, 32):
        if lag >= len(when) - 2:
            break
        rho = float(np.mean(centred[lag:] * centred[:-lag]) / np.mean(centred**2))
        apart = float(np.median(when[lag:] - when[:-lag]))
        if rho <= 2.0 / np.sqrt(len(when)):
            break
        times.append(-apart / np.log(min(rho, 1.0 - 1e-6)))
    return max(times, default=0.0)


def effective_number(stamps: ArrayLike, correlation_s: float) -> float:
    """Return how many independent values a series is worth, if correlation falls as exp(-dt / correlation_s).

    Stamps (t,) are in any order. The number is in [1, t]; 0 without values, t if correlation_s is 0.

    Examples
    --------
    >>> effective_number([0.0, 1.0, 2.0], 0.0), round(effective_number([0.0, 1.0, 2.0], 10.0), 1)
    (3.0, 1.1)
    """
    when = np.sort(np.asarray(stamps, dtype=np.float64))
    if len(when) == 0:
        return 0.0
    return float(1.0 + evidence_weights(when, correlation_s)[1:].sum())


def evidence_weights(stamps: ArrayLike, correlation_s: float) -> FloatArray:
    """Return the share of each scan that is new: tanh(dt / (2 correlation_s)), 1 for the first.

    The mean of n values with correlation exp(-dt / correlation_s) is worth n tanh(dt / (2 correlation_s)) independent
    ones; so each counts for that much. Stamps (t,) do not decrease; a scan of the same time as the one before it has 0.
    """
    when = np.asarray(stamps, dtype=np.float64)
    weights = np.ones(len(when))
    if correlation_s > 0.0 and len(when) > 1:
        weights[1:] = np.tanh(np.maximum(np.diff(when), 0.0) / (2.0 * correlation_s))
    return weights
