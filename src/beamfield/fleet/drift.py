"""Robots that changed from one day on, and robots that are unlike the others from their first day."""

from __future__ import annotations

import datetime
import math
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np
from scipy.special import polygamma, psi, stdtr, stdtrit

from beamfield.arguments import checked
from beamfield.fleet.comparison import FEWEST_ROBOTS, adjusted, unlike_others
from beamfield.fleet.daily import DailySeries, FaultKind
from beamfield.geometry import FloatArray

# False alarms that are expected in one report, of all robots, faults and days together.
FALSE_ALARMS = 0.05
# One odd day is no change: it takes so many on either side.
FEWEST_DAYS = 2
# What other robots tell of a robot's noise counts as so many days at most: robots are not all alike.
_MOST_PRIOR_DOF = 6.0
# Other sectors belong to a smear if they changed at this level, and the worst of them tells its size; a robot's days
# after such a change do not count for how it was at first.
_BESIDE = 0.001
# How a positive and a negative size are said, and of what.
_WORDS: dict[FaultKind, tuple[str, str, str]] = {
    "turned-mount": ("left", "right", "the direction of motion is turned"),
    "range-bias": ("too long", "too short", "ranges are"),
    "wheel-scale": ("too short", "too long", "distances of the odometry are"),
}

Sector = tuple[float, float]
T = TypeVar("T")


@dataclass(frozen=True)
class Drift:
    """A fault that a robot shows, or does not.

    Parameters
    ----------
    robot, site, fault
        Which robot, and what.
    since
        First day with the fault; None: from the robot's first day on, by comparison with the other robots.
    size, low, high
        How much the number changed, or how far it is from that of the other robots, with its 95% interval.
    before, after
        The number before that day (that of the other robots, where `since` is None) and from it on.
    unit
        "share", "rad", "m" or "1".
    bearings
        (from, to) of the dirty sector, radians in the robot frame, `to` beyond pi where it spans the back; None for
        other faults. `before` and `after` are those of its worst 30 degrees.
    cause
        "max" (no return) or "short" (before the wall) for a dirty lens, else "".
    p_value
        Bound on the chance of such a series in a robot without the fault, whichever day (and sector) stands out.
    q_value
        The least rate of false discoveries, among all robots and faults, at which it counts.
    alarm
        Whether it counts: of all robots, faults and days of one report, at most 0.05 false alarms are expected.
    """

    robot: str
    site: str
    fault: FaultKind
    since: datetime.date | None
    size: float
    low: float
    high: float
    before: float
    after: float
    unit: str
    bearings: Sector | None
    cause: str
    p_value: float
    q_value: float = 1.0
    alarm: bool = False

    @property
    def sentence(self) -> str:
        """What was seen, for people."""
        when = "from its first day on" if self.since is None else f"since {self.since}"
        return f"{self.robot} ({self.site}): {when}, {self._share() if self.bearings else self._deviation()}"

    def _share(self) -> str:
        start, end = (round(math.degrees(bearing)) for bearing in self.bearings or (0.0, 0.0))
        what = "have no return" if self.cause == "max" else "end before the wall"
        against = "of the other robots" if self.since is None else "before"
        low, high = (100.0 * (self.before + change) for change in (self.low, self.high))
        return (
            f"{100.0 * self.after:.2g}% (95%: {low:.2g} to {high:.2g}) of the readings at bearings from {start} "
            f"to {end} degrees {what}, {against} {100.0 * self.before:.2g}%: is the lens dirty there?"
        )

    def _deviation(self) -> str:
        scale, unit = {"rad": (180.0 / math.pi, " degrees"), "m": (100.0, " cm")}.get(self.unit, (100.0, " %"))
        sign = 1.0 if self.size > 0.0 else -1.0
        low, high = sorted((sign * scale * self.low, sign * scale * self.high))
        more, less, what = _WORDS[self.fault]
        against = "the other robots" if self.since is None else "the days before"
        amount = f"{abs(self.size) * scale:.2g}{unit} {more if sign > 0.0 else less}"
        return f"{what} {amount} (95%: {low:.2g} to {high:.2g}) against {against}."


@checked
def find_drift(series: Sequence[DailySeries]) -> tuple[Drift, ...]:
    """Look for the day on which a robot changed, and for robots that are unlike the others from their first day on.

    Parameters
    ----------
    series
        Of `daily_series`.

    Returns
    -------
    For each robot and fault the most likely day of a change, and its difference from the other robots (where there are
    5 and more); the least likely by chance first. Those with `alarm` count.

    Notes
    -----
    A change is the largest Student's t of the means after and before a day, over all days with 2 on either side; for a
    lens also over all sectors, and only where more readings are lost. Its p-value is Bonferroni's bound over days and
    sectors. The noise is how a robot's own days vary, moderated by how those of the other robots do (Smyth), and no
    less than how blocks of time within its days vary. Days count as independent, and as normal about the mean before or
    after.

    From the first day: the mean of a robot's days (those before its change, if it has one) against that of the others,
    by `unlike_others`: of its site where that has 3 robots, so that a map's bias is no robot's; else of 5 sites.

    One change per series is found, the largest. The bound holds for one report: who reads one every day about the same
    days sees mostly the same alarms, and who reads 365 new ones may see 365 times as many.

    References
    ----------
    Hawkins, "Testing a sequence of observations for a shift in location", JASA 72, 1977.
    Smyth, "Linear models and empirical Bayes methods for assessing differential expression in microarray experiments",
    Statistical Applications in Genetics and Molecular Biology 3, 2004.
    Benjamini and Hochberg, "Controlling the false discovery rate", Journal of the Royal Statistical Society B 57, 1995.
    """
    families: dict[tuple[FaultKind, str], list[DailySeries]] = {}
    for item in series:
        families.setdefault((item.fault, item.cause), []).append(item)
    rows: list[Drift] = []
    for family in families.values():
        noise = _usual_noise(family)
        changes = [_change(item, noise) for item in family]
        rows += _changed(family, changes)
        rows += _unlike_from_first_day(family, changes, noise)
    rows.sort(key=lambda row: row.p_value)
    return tuple(
        replace(row, q_value=q, alarm=row.p_value * len(rows) <= FALSE_ALARMS)
        for row, q in zip(rows, adjusted([row.p_value for row in rows]), strict=True)
    )


class _Noise(NamedTuple):
    """Variance of days that the robots share, and how many degrees of freedom it is worth."""

    variance: float
    dof: float


class _Change(NamedTuple):
    """The most likely change of a series: index of its first day, size in contrasts, error and chance."""

    day: int
    size: float
    error: float
    dof: float
    p_value: float


def _usual_noise(family: list[DailySeries]) -> _Noise:
    """Fit Smyth's prior to the series' variances; by median and quartiles, so that changes do not count."""
    known = [item for item in family if len(item.days) > 2 and np.ptp(item.contrasts) > 0.0]
    if len(known) < FEWEST_ROBOTS:
        return _Noise(0.0, 0.0)
    half = np.array([0.5 * (len(item.days) - 1) for item in known])
    variances = np.array([max(float(np.var(item.contrasts, ddof=1)), _least_variance(item)) for item in known])
    logs = np.log(variances) - psi(half) + np.log(half)
    low, middle, high = np.quantile(logs, [0.25, 0.5, 0.75])
    excess = ((high - low) / 1.349) ** 2 - float(np.median(polygamma(1, half)))
    grid = np.linspace(1.0, _MOST_PRIOR_DOF, 400)
    dof = float(grid[np.argmin(np.abs(polygamma(1, 0.5 * grid) - max(excess, 0.0)))])
    return _Noise(float(np.exp(middle + psi(0.5 * dof) - math.log(0.5 * dof))), dof)


def _change(series: DailySeries, noise: _Noise) -> _Change | None:
    x, n = series.contrasts, len(series.days)
    dof = noise.dof + n - 2
    if n < 2 * FEWEST_DAYS:
        return None
    x = x - x.mean()
    day = np.arange(FEWEST_DAYS, n - FEWEST_DAYS + 1)
    total = np.cumsum(x)[day - 1]
    before, after = total / day, -total / (n - day)
    squares = np.maximum(np.sum(x**2) - day * before**2 - (n - day) * after**2, 0.0)
    variances = np.maximum((noise.dof * noise.variance + squares) / dof, _least_variance(series))
    sizes, errors = after - before, np.sqrt(variances * (1.0 / day + 1.0 / (n - day)))
    p_values = _tail(sizes / errors, dof, series) * len(day)
    i = int(np.argmin(p_values))
    return _Change(int(day[i]), float(sizes[i]), float(errors[i]), dof, float(p_values[i]))


def _tail(t: FloatArray, dof: float, series: DailySeries) -> FloatArray:
    """Return p-values of Student's t: only more lost readings are dirt, for the rest either sign counts."""
    return np.asarray(stdtr(dof, -t) if series.cause else 2.0 * stdtr(dof, -np.abs(t)))


class _Entry(NamedTuple):
    """A series with its change, or its difference from the other robots, and the number that it is added to."""

    change: _Change
    series: DailySeries
    known: float


def _changed(family: list[DailySeries], changes: list[_Change | None]) -> Iterator[Drift]:
    """Yield the most likely change of each robot."""
    entries = [
        _Entry(change, item, float(item.values[: change.day].mean()))
        for item, change in zip(family, changes, strict=True)
        if change is not None
    ]
    for of_robot in _grouped(entries, lambda entry: (entry.series.site, entry.series.robot)):
        yield _row(of_robot, before_is_known=True)


def _unlike_from_first_day(family: list[DailySeries], changes: list[_Change | None], noise: _Noise) -> Iterator[Drift]:
    """Yield how each robot differs from the others before its change, if it has one."""
    entries = []
    for members in _grouped(list(zip(family, changes, strict=True)), lambda member: member[0].bearings):
        if len(members) < FEWEST_ROBOTS:
            continue
        days = [_first_days(*member) for member in members]
        means = np.array([item.contrasts[:n].mean() for (item, _), n in zip(members, days, strict=True)])
        variances = np.array([_mean_variance(item, n, noise) for (item, _), n in zip(members, days, strict=True)])
        unlike = unlike_others(means, variances, [item.site for item, _ in members])
        for j, (item, _) in enumerate(members):
            size, p = float(means[j] - unlike.centres[j]), float(unlike.p_values[j])
            if math.isnan(p):
                continue
            if item.cause:
                p = 0.5 * p if size > 0.0 else 1.0
            change = _Change(0, size, float(unlike.errors[j]), float(unlike.dof[j]), p)
            entries.append(_Entry(change, item, float(item.values[: days[j]].mean())))
    for of_robot in _grouped(entries, lambda entry: (entry.series.site, entry.series.robot)):
        yield _row(of_robot, before_is_known=False)


def _grouped(items: list[T], key: Callable[[T], Hashable]) -> list[list[T]]:
    """Return items with equal keys together, in their order."""
    groups: dict[Hashable, list[T]] = {}
    for item in items:
        groups.setdefault(key(item), []).append(item)
    return list(groups.values())


def _around(worst: Sector | None, beside: list[Sector | None]) -> Sector | None:
    """Return what the worst sector and those beside it that overlap cover; of the outer ones, their inner half."""
    if worst is None:
        return None
    half, turn = 0.5 * (worst[1] - worst[0]), 2.0 * math.pi
    centres = [0.5 * (sector[0] + sector[1]) for sector in beside if sector is not None]
    reached = []
    for step in (-half, half):
        n = 0
        while n * half < math.pi - half and any(
            abs(math.remainder(worst[0] + half + (n + 1) * step - centre, turn)) < 0.1 * half for centre in centres
        ):
            n += 1
        reached.append(max(n - 1, 0) * half)
    low, high = worst[0] - reached[0], worst[1] + reached[1]
    return (low + turn, high + turn) if low < -math.pi - 0.1 * half else (low, high)


def _row(of_robot: list[_Entry], *, before_is_known: bool) -> Drift:
    """Return the row of a robot: its surest series tells when and how surely, the worst one of the smear how much.

    Sizes of shares are those of their log odds, from or to the known number.
    """
    surest = min(of_robot, key=lambda entry: entry.change.p_value)
    day = surest.change.day
    smear = [
        entry
        for entry in of_robot
        if entry is surest or (abs(entry.change.day - day) <= 1 and entry.change.p_value < _BESIDE)
    ]
    change, item, known = max(smear, key=lambda entry: abs(entry.change.size))
    reach = float(stdtrit(change.dof, 0.975)) * change.error
    sizes = np.array([change.size, change.size - reach, change.size + reach])
    sign = 1.0 if before_is_known else -1.0
    if item.unit == "share":
        log_odds = math.log(max(known, 1e-6) / max(1.0 - known, 1e-6))
        sizes = sign * (1.0 / (1.0 + np.exp(-(log_odds + sign * sizes))) - 1.0 / (1.0 + math.exp(-log_odds)))
    size, low, high = (float(v) for v in sizes)
    before, after = (known, known + size) if before_is_known else (known - size, known)
    return Drift(
        item.robot, item.site, item.fault, item.days[day] if before_is_known else None, size, low, high, before, after,
        item.unit, _around(item.bearings, [entry.series.bearings for entry in smear]), item.cause,
        min(surest.change.p_value * len(of_robot), 1.0),
    )  # fmt: skip


def _first_days(series: DailySeries, change: _Change | None) -> int:
    return change.day if change is not None and change.p_value < _BESIDE else len(series.days)


def _mean_variance(series: DailySeries, n: int, noise: _Noise) -> float:
    squares = float(np.sum((series.contrasts[:n] - series.contrasts[:n].mean()) ** 2))
    moderated = (noise.dof * noise.variance + squares) / max(noise.dof + n - 1, 1.0)
    return max(moderated, _least_variance(series)) / n


def _least_variance(series: DailySeries) -> float:
    return max(float(np.mean(series.contrast_errors**2)), 1e-18)
