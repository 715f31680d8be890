"""Which robots differ from the others, with a bound on false discoveries."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr
from scipy.stats import false_discovery_control

from beamfield.arguments import checked
from beamfield.fleet.learning import FleetFit, GroupFit
from beamfield.fleet.transformed import NAMES, UNKNOWN, transformed
from beamfield.geometry import FloatArray

# Accepted share of false ones among the differences found, in the mean over many fleets.
FALSE_DISCOVERIES = 0.05
# With fewer robots than this nobody knows what is usual.
FEWEST_ROBOTS = 5
# A site with so many has a centre of its own: of two robots nobody knows which one is odd.
FEWEST_AT_SITE = 3
COMPARISON_TAKES = f"{FEWEST_ROBOTS} robots at sites with {FEWEST_AT_SITE} or more, or {FEWEST_ROBOTS} sites"
# Corrections of Qn for 2 to 9 values (Croux and Rousseeuw).
_SMALL = (0.399, 0.994, 0.512, 0.844, 0.611, 0.857, 0.669, 0.872)
# Huber's bound, standard deviations: 95% efficient on normal data.
_HUBER = 1.345


@dataclass(frozen=True)
class Difference:
    """A parameter of a robot against those of the others.

    Parameters
    ----------
    robot, site
        Whose.
    parameter
        Name of `BeamParameters`.
    value, usual
        The robot's, and the median of those it is compared with.
    low, high
        95% interval of the robot's own value.
    p_value, q_value
        Chance of such a difference in a robot like the others; the least rate of false discoveries at which it counts.
    differs
        Whether the q-value is at most 0.05.
    """

    robot: str
    site: str
    parameter: str
    value: float
    usual: float
    low: float
    high: float
    p_value: float
    q_value: float
    differs: bool


@checked
def compare_robots(fit: FleetFit) -> tuple[Difference, ...]:
    """Compare each robot's parameters with those of the others that have sensors of equal limits.

    Parameters
    ----------
    fit
        Of ``learn(by="robot")``.

    Returns
    -------
    One row per robot and learned parameter, the least likely first; none for robots of groups of fewer than 5.

    Raises
    ------
    InvalidInputError
        If the fit is not one by robot.

    Notes
    -----
    Robots are not alike to the last digit, and with enough beams every difference shows. A robot *differs* if it does
    so by more than the others do among each other: see `unlike_others`. All rows are judged together: of those that
    differ, 5% are false in the mean over many fleets.

    References
    ----------
    Benjamini and Hochberg, "Controlling the false discovery rate", Journal of the Royal Statistical Society B 57, 1995.
    """
    rows = [row for robots in fit.robots_by_limits() for row in _rows(robots)]
    q_values = adjusted([p for *_, p in rows])
    found = []
    for (item, name, usual, p), q in zip(rows, q_values, strict=True):
        value, (low, high) = getattr(item.parameters, name), item.intervals.intervals[name]
        differs = q <= FALSE_DISCOVERIES
        found.append(Difference(item.robot or "", item.site or "", name, value, usual, low, high, p, q, differs))
    return tuple(sorted(found, key=lambda row: row.p_value))


def adjusted(p_values: list[float]) -> list[float]:
    """Return the q-values of Benjamini and Hochberg."""
    return [float(q) for q in false_discovery_control(p_values)] if p_values else []


class Unlike(NamedTuple):
    """How far robots are from the others; NaN where there are too few to compare with.

    Parameters
    ----------
    centres
        Of the robots that each is compared with, (n,).
    errors
        Standard errors of the differences, which hold how much robots differ among each other, (n,).
    p_values
        Two-sided, (n,).
    dof
        Degrees of freedom of Student's distribution behind them, (n,).
    """

    centres: FloatArray
    errors: FloatArray
    p_values: FloatArray
    dof: FloatArray


def unlike_others(values: FloatArray, variances: FloatArray, sites: Sequence[str] = ()) -> Unlike:
    """Return how far each of n robots is from the others, and the chance of that.

    Parameters
    ----------
    values, variances
        Estimates, and their error variances, shape (n,), n >= 5.
    sites
        Each robot's, where sites may differ: robots are then compared with the centre of their site, if it has 3
        robots, and judged by how much all robots of such sites (5 at least) differ from theirs. Robots of smaller sites
        are compared with one robot of each site (5 at least): what is the robot's cannot be told from what is the
        site's, and both vary.

    Notes
    -----
    Centres are Huber's. How much robots differ is Qn, which up to half of them cannot spoil: that variance between
    robots with which Qn of the standardised values is 1, at least 0. The tail is Student's with n - 1 - 2 c degrees of
    freedom for c centres of m robots each, and the variance is taken m / (m - 1) times as large. In simulated normal
    fleets of 5 to 60 robots in up to 8 sites, which differ by up to 30 times as much as robots, p-values down to 0.0003
    come at most 1.1 times as often as they say.

    References
    ----------
    Rousseeuw and Croux, "Alternatives to the median absolute deviation", JASA 88, 1993.
    Huber, "Robust estimation of a location parameter", Annals of Mathematical Statistics 35, 1964.

    Examples
    --------
    >>> values = np.array([1.0, 1.1, 0.9, 1.05, 0.95, 1.02, 0.98, 3.0])
    >>> p = unlike_others(values, np.full(8, 0.01)).p_values
    >>> int(p.argmin()), bool(p.min() < 1e-3), bool(np.sort(p)[1] > 0.1)
    (7, True, True)
    """
    _, first, group, counts = np.unique(
        np.asarray(sites or [""] * len(values)), return_index=True, return_inverse=True, return_counts=True
    )
    found = Unlike(*np.full((4, len(values)), np.nan))
    large = np.flatnonzero(counts[group] >= FEWEST_AT_SITE)
    small = np.flatnonzero(counts[group] < FEWEST_AT_SITE)
    if len(large) >= FEWEST_ROBOTS:
        within = _judged(values[large], variances[large], np.unique(group[large], return_inverse=True)[1])
        for column, of_large in zip(found, within, strict=True):
            column[large] = of_large
    if len(small) and len(first) >= FEWEST_ROBOTS:
        # The first of each site stands for it: a mean of several would vary less than a robot does.
        across = _judged(values[first], variances[first], np.zeros(len(first), np.int64))
        total = across.errors[0] ** 2 - variances[first[0]] * len(first) / (len(first) - 1.0)
        found.centres[small], found.dof[small] = across.centres[0], across.dof[0]
        found.errors[small] = np.sqrt(total + variances[small] * len(first) / (len(first) - 1.0))
        t = np.abs(values[small] - found.centres[small]) / found.errors[small]
        found.p_values[small] = 2.0 * stdtr(found.dof[small], -t)
    return found


def _judged(values: FloatArray, variances: FloatArray, group: NDArray[np.int64]) -> Unlike:
    """Compare robots with the centre of their group, 0 to c - 1, and judge them by how all differ from theirs."""
    n_groups, n = int(group.max()) + 1, len(values)
    medians = np.array([np.median(values[group == k]) for k in range(n_groups)])
    scale = _qn(values - medians[group]) ** 2 + variances
    centres = np.array([_huber(values[group == k], scale[group == k]) for k in range(n_groups)])[group]
    members = np.bincount(group)[group]
    total = (variances + _variance_between(values - centres, variances)) * members / (members - 1.0)
    dof = max(n - 1.0 - 2.0 * n_groups, 1.0)
    p_values = 2.0 * stdtr(dof, -np.abs(values - centres) / np.sqrt(total))
    return Unlike(centres, np.sqrt(total), np.asarray(p_values), np.full(n, dof))


def _rows(group: Sequence[GroupFit]) -> list[tuple[GroupFit, str, float, float]]:
    """Return fit, parameter, the usual value and the p-value for each robot and parameter."""
    estimates = [transformed(item) for item in group]
    rows = []
    for i, name in enumerate(NAMES):
        known = [k for k, (_, variances) in enumerate(estimates) if variances[i] < UNKNOWN]
        if len(known) < FEWEST_ROBOTS:
            continue
        values, variances = (np.array([estimates[k][j][i] for k in known]) for j in range(2))
        p_values = unlike_others(values, variances).p_values
        own = np.array([getattr(group[k].parameters, name) for k in known])
        for j, k in enumerate(known):
            rows.append((group[k], name, float(np.median(np.delete(own, j))), float(p_values[j])))
    return rows


def _variance_between(deviations: FloatArray, variances: FloatArray) -> float:
    low, high = 0.0, _qn(deviations) ** 2
    if _qn(deviations / np.sqrt(variances)) <= 1.0:
        return 0.0
    for _ in range(30):
        middle = 0.5 * (low + high)
        if _qn(deviations / np.sqrt(variances + middle)) > 1.0:
            low = middle
        else:
            high = middle
    return high


def _huber(values: FloatArray, variances: FloatArray) -> float:
    centre, scale = float(np.median(values)), np.sqrt(variances)
    for _ in range(10):
        weights = np.minimum(1.0, _HUBER * scale / np.maximum(np.abs(values - centre), 1e-300)) / variances
        centre = float(np.sum(weights * values) / np.sum(weights))
    return centre


def _qn(values: FloatArray) -> float:
    """Return Rousseeuw and Croux's Qn, which is the standard deviation where the values are normal."""
    n = len(values)
    distances = np.sort(np.abs(values[:, None] - values)[np.triu_indices(n, 1)])
    h = n // 2 + 1
    small = _SMALL[n - 2] if n < 10 else n / (n + (1.4 if n % 2 else 3.8))
    return float(2.2219 * small * distances[h * (h - 1) // 2 - 1])
