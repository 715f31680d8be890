"""How likely it is that places differ by chance: runs are counted, over robots and days."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc

from beamfield.geometry import FloatArray
from beamfield.scan_fit.place_visits import MOST_PASSING, Visits
from beamfield.short_repr import short_repr

# Days from which on a place may differ that are tried, at most.
MOST_STARTS = 30


@dataclass(frozen=True, eq=False)
class PlaceTest:
    """The most telling day of each place, and the chance of what was seen since then where nothing lasts.

    Parameters
    ----------
    p_value
        (n,) adjusted for the days that were tried; 1 for places that no run saw.
    since
        (n,) number of the first day.
    """

    p_value: FloatArray
    since: NDArray[np.int64]

    __repr__ = short_repr


def judge_places(visits: Visits, robot: NDArray[np.int64], day: NDArray[np.int64], n_places: int) -> PlaceTest:
    """Test whether places differ from the map for good, from some day on.

    Parameters
    ----------
    visits
        Runs at places, by number, and whether the place differed.
    robot, day
        (runs,) number of each run's robot and day, from 0.
    n_places
        How many places there are.

    Notes
    -----
    If k of the v runs from a day on differ, the chance is at most P(K >= k) with K binomial (v, 0.2), as people
    and doors make a run differ with that probability at most (`MOST_PASSING`). The largest
    such chance over leaving out any one robot (if there are several) and any one day counts: what a single robot or a
    single day shows is no evidence. This is a partial conjunction of at least two robots and at least two days. The
    smallest over the starting days is multiplied by their number.

    Examples
    --------
    Three robots find a new thing on each of four days; another place differs for one robot alone:

    >>> run = np.arange(12)
    >>> place, differs = np.repeat([0, 1], 12), np.concatenate([np.ones(12, bool), run % 3 == 0])
    >>> found = judge_places(Visits(place, np.tile(run, 2), differs), run % 3, run // 3, 2)
    >>> found.p_value.round(5).tolist(), found.since.tolist()
    ([1e-05, 1.0], [0, 0])
    """
    at_robot, at_day = robot[visits.visit], day[visits.visit]
    n_robots, n_days = int(robot.max(initial=-1)) + 1, int(day.max(initial=-1)) + 1
    starts = np.unique(np.linspace(0, n_days - 1, min(n_days, MOST_STARTS)).astype(np.int64))
    best, since = np.ones(n_places), np.zeros(n_places, np.int64)
    # Two runs or more that differ are needed for any chance below 1.
    differing, _ = visits.counts(n_places)
    places = np.flatnonzero(differing >= 2)
    number = np.full(n_places, -1)
    number[places] = np.arange(len(places))
    mine = number[visits.place] >= 0
    place, differs = number[visits.place[mine]], visits.differs[mine]
    at_robot, at_day = at_robot[mine], at_day[mine]
    for start in starts.tolist():
        later = at_day >= start
        groups = [(at_day, n_days)] + ([(at_robot, n_robots)] if n_robots > 1 else [])
        chance = np.zeros(len(places))
        for group, n_groups in groups:
            cell, shape = place * n_groups + group, (len(places), n_groups)
            seen, changed = (
                np.bincount(cell[rows], minlength=shape[0] * n_groups).reshape(shape)
                for rows in (later, later & differs)
            )
            k = changed.sum(axis=1, keepdims=True) - changed
            v = seen.sum(axis=1, keepdims=True) - seen
            chance = np.maximum(chance, _at_least(k, v).max(axis=1, initial=0.0))
        better = chance < best[places]
        best[places[better]], since[places[better]] = chance[better], start
    return PlaceTest(np.minimum(best * len(starts), 1.0), since)


def _at_least(k: NDArray[np.int64], n: NDArray[np.int64]) -> FloatArray:
    """Return the probability that k or more of n runs differ where nothing lasts."""
    return np.where(k > 0, betainc(np.maximum(k, 1), np.maximum(n - k + 1, 1), MOST_PASSING), 1.0)
