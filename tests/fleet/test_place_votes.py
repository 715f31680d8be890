"""Chances of places: binomial tails, with any robot and any day left out, that hold where nothing lasts."""

from __future__ import annotations

import numpy as np
from scipy.stats import binom

from beamfield.fleet.place_votes import judge_places
from beamfield.scan_fit.place_visits import Visits


def slow(differs, robot, day, passing):
    """The smallest over starts of the largest binomial tail without a robot or a day, times the number of starts."""
    best, days = 1.0, np.unique(day)
    for start in days:
        tails = []
        for group in (robot, day):
            for left_out in np.unique(group):
                kept = (group != left_out) & (day >= start)
                tails.append(binom.sf(differs[kept].sum() - 1, kept.sum(), passing))
        best = min(best, max(tails))
    return min(1.0, best * len(days))


def test_chances_are_those_of_the_definition():
    rng = np.random.default_rng(0)
    robot, day = rng.integers(0, 4, 60), np.sort(rng.integers(0, 6, 60))
    rates = rng.uniform(0.0, 1.0, 50)
    differs = rng.random((50, 60)) < np.where(day >= 3, rates[:, None], 0.1)
    place, visit = np.indices(differs.shape)
    found = judge_places(Visits(place.ravel(), visit.ravel(), differs.ravel()), robot, day, 51)
    want = [slow(row, robot, day, 0.2) for row in differs]
    np.testing.assert_allclose(found.p_value[:50], want, rtol=1e-9)
    assert found.p_value[50] == 1.0
    assert found.p_value.min() < 1e-6
    assert (found.since[found.p_value < 1e-4] == 3).mean() > 0.7


def test_where_nothing_lasts_small_chances_are_rare_even_if_a_robot_or_a_day_differs_everywhere():
    rng = np.random.default_rng(1)
    robot, day = np.tile(np.arange(6), 10), np.repeat(np.arange(10), 6)
    differs = rng.random((4000, 60)) < 0.2
    # One robot is dirty, and something stood there on one day.
    differs[:2000, robot == 2] = True
    differs[1000:3000, day == 7] = True
    place, visit = np.indices(differs.shape)
    found = judge_places(Visits(place.ravel(), visit.ravel(), differs.ravel()), robot, day, 4000)
    for level in (0.2, 0.05, 0.01):
        assert (found.p_value[2000:] <= level).mean() <= level, level
        assert (found.p_value[:1000] <= level).mean() <= level, level
