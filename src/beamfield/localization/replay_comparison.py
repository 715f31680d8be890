"""Filters, or their parameters, compared over logs and seeds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, stdtrit

from beamfield.arguments import check_fields, checked
from beamfield.data_frame import data_frame
from beamfield.errors import InvalidInputError
from beamfield.geometry import FloatArray
from beamfield.localization.replay import MEASURES, ReplayErrors
from beamfield.short_repr import short_repr

# Fewer seeds say nothing for sure: one lost run among them moves the mean more than any parameter.
FEWEST_SEEDS = 10
# Samples of seeds that an interval is taken from, and the share of intervals that hold the difference in the long run.
REPLICATES, LEVEL = 4000, 0.95
# No sample goes beyond the outermost difference: of fewer seeds, the widest interval holds the truth less often.
FEWEST_DRAWN = 6
# What is compared between filters, with its unit.
COMPARED = {
    "mean": ("mean position error", "m"),
    "p95": ("95% of position errors", "m"),
    "yaw_mean_deg": ("mean heading error", "deg"),
    "inside": ("share inside", ""),
    "lost": ("share of lost runs", ""),
}


@dataclass(frozen=True, eq=False)
class ReplayTrials:
    """The runs of one filter on one log; InvalidInputError if there is none, or not one seed for each."""

    log: str
    seeds: tuple[int, ...]
    errors: tuple[ReplayErrors, ...]

    __repr__ = short_repr

    def __post_init__(self) -> None:
        check_fields(self)
        if not self.seeds or len(self.seeds) != len(self.errors):
            raise InvalidInputError(
                f"seeds, errors: expected one seed for each run, got {len(self.seeds)} and {len(self.errors)}"
            )

    def __len__(self) -> int:
        return len(self.seeds)

    def column(self, measure: str) -> FloatArray:
        """Return one number of all runs, in the order of the seeds: a field of `ReplayErrors`, else InvalidInputError.

        NaN where the processor time was not taken.
        """
        if measure not in MEASURES:
            raise InvalidInputError(f"measure: expected one of {', '.join(MEASURES)}, got {measure!r}")
        return np.array([getattr(one, measure) for one in self.errors], dtype=np.float64)

    def mean(self, measure: str) -> float:
        """Return the mean over runs of a field of `ReplayErrors`."""
        return float(self.column(measure).mean())

    @property
    def n_lost(self) -> int:
        """How many runs were lost."""
        return sum(one.lost for one in self.errors)

    def summary(self) -> str:
        """Return one line for people: means over the runs."""
        return (
            f"{self.log}: {self.mean('mean'):.3f} m mean position error (median run "
            f"{np.median(self.column('mean')):.3f}, 95% of scans {self.mean('p95'):.3f}), heading "
            f"{self.mean('yaw_rmse_deg'):.2f} deg, inside {self.mean('inside'):.0%}, NEES "
            f"{self.mean('nees_median'):.2f}, {self.n_lost} of {len(self)} runs lost"
        )

    def to_dataframe(self) -> Any:
        """Return a pandas DataFrame with a row per run: log, seed and the fields of `ReplayErrors`; needs pandas."""
        own = {"log": np.array([self.log] * len(self)), "seed": np.array(self.seeds)}
        return data_frame({**own, **{name: self.column(name) for name in MEASURES}})


@dataclass(frozen=True, kw_only=True)
class ReplayComparison:
    """The difference in one number, a field of `ReplayErrors`, between two filters over the same logs and seeds.

    `before` and `after` are its means over runs, and over logs, `low` and `high` the 95% interval of after - before,
    and `n_seeds` the least number of seeds of a log.
    """

    measure: str
    before: float
    after: float
    low: float
    high: float
    n_seeds: int

    @property
    def difference(self) -> float:
        """After - before."""
        return self.after - self.before

    @property
    def is_sure(self) -> bool:
        """Whether there is a difference for sure: the interval excludes 0, from at least 10 seeds per log."""
        return self.n_seeds >= FEWEST_SEEDS and (self.low > 0.0 or self.high < 0.0)

    @property
    def is_lower(self) -> bool:
        """Whether `after` is lower for sure."""
        return self.is_sure and self.high < 0.0

    @property
    def is_higher(self) -> bool:
        """Whether `after` is higher for sure."""
        return self.is_sure and self.low > 0.0

    def summary(self) -> str:
        """Return one line for people."""
        sure = "lower" if self.is_lower else "higher" if self.is_higher else "no sure difference"
        label, unit = COMPARED.get(self.measure, (self.measure, ""))
        unit = unit and f" {unit}"
        return (
            f"{label}: {self.before:.3f} -> {self.after:.3f}{unit}, difference {self.difference:+.3f}{unit} "
            f"({LEVEL:.0%} interval {self.low:+.3f} to {self.high:+.3f}): {sure}"
        )


@dataclass(frozen=True, kw_only=True)
class ReplayVerdict:
    """Whether one filter is better than another for sure.

    Parameters
    ----------
    is_better
        Whether the mean position error over all logs is lower for sure, on no log higher for sure, and no more runs
        are lost, nor all of them.
    overall
        The mean position error over all logs.
    by_log
        The mean position error on each log, by its name.
    lost_before, lost_after
        Lost runs, over all logs.
    """

    is_better: bool
    overall: ReplayComparison
    by_log: dict[str, ReplayComparison]
    lost_before: int
    lost_after: int

    def summary(self) -> str:
        """Return the decision and its reasons, a line per log."""
        lines = [f"{log}: {one.summary()}" for log, one in self.by_log.items()]
        if len(lines) > 1:
            lines.append(f"all logs: {self.overall.summary()}")
        decision = "better for sure" if self.is_better else "not better for sure"
        return "\n".join([*lines, f"lost runs: {self.lost_before} -> {self.lost_after}; {decision}"])


@checked
def compare_trials(
    before: Sequence[ReplayTrials], after: Sequence[ReplayTrials], measure: str = "mean"
) -> ReplayComparison:
    """Compare two filters by one number, run for run.

    The 95% interval is a bootstrap percentile interval of the mean paired difference: seeds are drawn within each log,
    and logs count alike. It speaks of these logs, and of all seeds. Percentiles are moved outwards as far as Student's
    t is wider than the normal distribution, because they are too narrow for few seeds. Below 6 it is Student's.

    Parameters
    ----------
    before, after
        The runs on each log, with the same logs and seeds in the same order.
    measure
        A field of `ReplayErrors`.

    Returns
    -------
    The comparison, always the same for the same runs. With a single seed the interval is -inf to inf.

    Raises
    ------
    InvalidInputError
        If logs or seeds differ, or there is no such field.

    References
    ----------
    Efron and Tibshirani, An Introduction to the Bootstrap, 1993, chapter 13; Hesterberg, "What teachers should know
    about the bootstrap", The American Statistician 69, 2015, on expanded percentiles.

    Examples
    --------
    >>> from dataclasses import replace
    >>> worse = ReplayErrors(mean=0.2, median=0.2, p95=0.3, end=0.2, lost=False, yaw_mean_deg=1.0, yaw_median_deg=1.0,
    ...     yaw_p95_deg=2.0, yaw_rmse_deg=1.2, nees_median=2.4, inside=0.95, inside_noisy=0.96, sd_position=0.1,
    ...     particles=500.0, updates=100)
    >>> before = ReplayTrials("hall", tuple(range(10)), tuple(replace(worse, mean=0.2 + 0.01 * i) for i in range(10)))
    >>> after = ReplayTrials("hall", before.seeds, tuple(replace(worse, mean=0.1 + 0.02 * i) for i in range(10)))
    >>> compare_trials([before], [after]).is_lower
    True
    """
    _check_pairs(before, after)
    rng = np.random.default_rng(0)
    gains = [b.column(measure) - a.column(measure) for a, b in zip(before, after, strict=True)]
    n = min(map(len, gains))
    low, high = -np.inf, np.inf
    if 1 < n < FEWEST_DRAWN:
        error = np.sqrt(sum(one.var(ddof=1) / len(one) for one in gains)) / len(gains)
        middle, reach = np.mean([one.mean() for one in gains]), stdtrit(n - 1, 0.5 + 0.5 * LEVEL) * error
        low, high = float(middle - reach), float(middle + reach)
    elif n > 1:
        sums = np.mean([_means_of_samples(one, rng) for one in gains], axis=0)
        tail = float(ndtr(np.sqrt(n / (n - 1)) * stdtrit(n - 1, 0.5 - 0.5 * LEVEL)))
        low, high = np.quantile(sums, [tail, 1.0 - tail]).tolist()
    means = [float(np.mean([one.mean(measure) for one in trials])) for trials in (before, after)]
    return ReplayComparison(measure=measure, before=means[0], after=means[1], low=low, high=high, n_seeds=n)


@checked
def judge_change(before: Sequence[ReplayTrials], after: Sequence[ReplayTrials]) -> ReplayVerdict:
    """Decide whether one filter is better than another for sure; see `ReplayVerdict`.

    Parameters
    ----------
    before, after
        The runs on each log, with the same logs and seeds in the same order.

    Raises
    ------
    InvalidInputError
        If logs or seeds differ, or two logs have one name.
    """
    overall = compare_trials(before, after)
    names = [one.log for one in before]
    if len(set(names)) < len(names):
        raise InvalidInputError(f"before, after: expected logs with names of their own, got {names}")
    by_log = {a.log: compare_trials([a], [b]) for a, b in zip(before, after, strict=True)}
    lost = [sum(one.n_lost for one in trials) for trials in (before, after)]
    # How far a robot is off that is lost in every run is nothing to choose by.
    all_lost = lost[1] == sum(len(one.seeds) for one in after)
    harmless = not any(one.is_higher for one in by_log.values()) and lost[1] <= lost[0] and not all_lost
    return ReplayVerdict(
        is_better=overall.is_lower and harmless, overall=overall, by_log=by_log, lost_before=lost[0], lost_after=lost[1]
    )


def _check_pairs(before: Sequence[ReplayTrials], after: Sequence[ReplayTrials]) -> None:
    if not before or [(one.log, one.seeds) for one in before] != [(one.log, one.seeds) for one in after]:
        raise InvalidInputError("before, after: expected runs on the same logs with the same seeds, in the same order")


def _means_of_samples(values: FloatArray, rng: np.random.Generator) -> FloatArray:
    drawn: NDArray[np.int64] = rng.integers(len(values), size=(REPLICATES, len(values)))
    return np.asarray(values[drawn].mean(axis=1))
