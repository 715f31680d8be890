"""Which courses are believed though their readings fit the map poorly."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import ArrayLike

from beamfield.localization.course_choice import (
    Judged,
    StartHypothesis,
    are_alike,
    standing_out,
    standing_out_with_jumps,
    starts_apart,
)
from beamfield.localization.trajectory_start import Course

START = np.zeros(3)
LONG, SHORT = 560, 140


def judged(cost: float, agrees: float, n_jumps: int = 0, costs: ArrayLike = (0.0, 0.0)) -> Judged:
    course = Course(
        np.zeros((2, 3)), cost, np.asarray(costs), np.arange(n_jumps, dtype=np.int64), np.zeros(2, np.int64)
    )
    return StartHypothesis(np.zeros(3), cost, agrees, 0.3), course


# Cost and share of agreeing beams of the first course, and of the next.
@pytest.mark.parametrize(
    ("first", "other", "n_scans", "is_believed"),
    [
        # Enough beams agree, more than on the other, which costs more.
        ((7.0, 0.45), (7.9, 0.37), LONG, True),
        ((7.0, 0.44), (7.9, 0.36), LONG, False),
        ((7.0, 0.45), (7.9, 0.38), LONG, False),
        ((7.0, 0.45), (7.8, 0.37), LONG, False),
        # Of a quarter of the scans, almost three times as much is asked.
        ((7.0, 0.55), (9.6, 0.32), SHORT, True),
        ((7.0, 0.55), (9.5, 0.32), SHORT, False),
        ((7.0, 0.55), (9.6, 0.33), SHORT, False),
        # Few agree, since the map is out of date; but far fewer on the other, which costs far more.
        ((12.0, 0.30), (14.5, 0.19), LONG, True),
        ((12.0, 0.30), (14.4, 0.19), LONG, False),
        ((12.0, 0.30), (14.5, 0.21), LONG, False),
        ((12.0, 0.30), (17.0, 0.09), SHORT, True),
        ((12.0, 0.30), (16.9, 0.09), SHORT, False),
        ((12.0, 0.30), (17.0, 0.11), SHORT, False),
    ],
)
def test_a_course_is_believed_by_how_it_stands_out_among_others(first, other, n_scans, is_believed):
    courses = [judged(*first), judged(*other)]
    assert standing_out(courses, None, n_scans) == (courses if is_believed else [])


@pytest.mark.parametrize("first", [(7.0, 0.5), (12.0, 0.4)])
def test_one_with_jumps_that_costs_clearly_less_speaks_against_it(first):
    cost, agrees = first
    steady, other = judged(cost, agrees), judged(cost + 4.0, agrees - 0.2)
    for less, is_believed in ((1.0, True), (1.1, False)):
        courses = [judged(cost - less, agrees - 0.2, n_jumps=1), steady, other]
        assert standing_out(courses, None, LONG) == ([steady, other] if is_believed else [])
    assert standing_out([judged(cost, agrees, n_jumps=1), judged(cost + 4.0, 0.1, n_jumps=1)], None, LONG) == []


# Of a course with jumps, share of agreeing beams, how much more than on the other, and nats less.
@pytest.mark.parametrize(
    ("agrees", "more", "less", "n_jumps", "n_scans", "is_believed"),
    [
        (0.66, 0.21, 4.1, 1, LONG, True),
        (0.64, 0.21, 4.1, 1, LONG, False),
        (0.66, 0.19, 4.1, 1, LONG, False),
        (0.66, 0.21, 3.9, 1, LONG, False),
        (0.66, 0.21, 4.1, 0, LONG, False),
        (0.66, 0.56, 11.4, 1, SHORT, False),
        (0.66, 0.57, 11.4, 2, SHORT, True),
    ],
)
def test_a_robot_that_was_carried_is_believed_if_its_course_stands_out(
    agrees, more, less, n_jumps, n_scans, is_believed
):
    courses = [judged(5.0, agrees, n_jumps), judged(5.0 + less, agrees - more)]
    assert standing_out_with_jumps(courses, n_scans) == (courses if is_believed else [])
    assert standing_out_with_jumps(courses[:1], n_scans) == []


def test_the_only_course_needs_a_start_and_beams_that_agree():
    assert standing_out([judged(7.0, 0.5)], None, LONG) == []
    assert standing_out([judged(7.0, 0.5)], START, LONG) != []
    assert standing_out([judged(7.0, 0.44)], START, LONG) == []


def test_of_courses_that_part_later_the_start_is_named_once():
    best, other, elsewhere = (
        StartHypothesis(np.array(pose), 7.0, agrees, 0.3)
        for pose, agrees in (((9.5, 3.5, 1.5), 0.8), ((9.5, 3.6, 1.5), 0.5), ((9.5, 3.5, -1.5), 0.4))
    )
    assert starts_apart([best, other, elsewhere]) == [best, elsewhere]


# By how much two metres of way, with four scans, cost more on the other course, in turn; and how much it misfits more.
@pytest.mark.parametrize(
    ("more", "misfit", "is_alike"),
    [
        ((8.0, 8.0), 0.0, False),  # surely
        ((18.0, -10.0), 0.0, True),  # by chance
        ((18.0, -10.0), 0.8, False),  # more beams pass its walls
        ((2.0, 2.0), 0.0, True),  # not by much in all
        ((2.0, 2.0), 0.8, False),
    ],
)
def test_courses_are_alike_whose_costs_differ_by_chance(more, misfit, is_alike):
    way, extra = 0.5 * np.arange(40), np.tile(np.repeat(more, 4) / 4.0, 5)
    best, other = judged(3.0, 0.5, costs=np.full(40, 3.0)), judged(3.0 + extra.mean(), 0.5, costs=3.0 + extra)
    shift = (misfit - extra.mean()) / 6.0
    other = (other[0]._replace(through=best[0].through + shift), other[1])
    assert are_alike(way, best, other, None) == is_alike
    assert are_alike(way, best, other, START) == (is_alike and max(more) == 2.0)
