"""Maps of lines: one form for each line, end points on it, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.maps.lines import LineMap


def test_both_pairs_of_a_line_become_one():
    one, other = LineMap([[2.0, 0.3]]), LineMap([[-2.0, 0.3 - np.pi]])
    np.testing.assert_allclose(one.lines, other.lines, atol=1e-15)
    assert LineMap([[-0.0, 1.0]]).lines.tolist() == [[0.0, 1.0]]


def test_segments_lie_on_their_lines_whichever_end_comes_first(rng):
    ends = rng.uniform(-20.0, 20.0, (50, 4))
    walls, turned = LineMap.from_segments(ends), LineMap.from_segments(ends[:, [2, 3, 0, 1]])
    np.testing.assert_allclose(walls.lines, turned.lines, atol=1e-12)
    normal = np.column_stack([np.cos(walls.lines[:, 1]), np.sin(walls.lines[:, 1])])
    for point in (ends[:, :2], ends[:, 2:]):
        np.testing.assert_allclose((normal * point).sum(axis=1), walls.lines[:, 0], atol=1e-12)
    assert (walls.lines[:, 0] >= 0.0).all()


def test_extents_are_places_along_the_line():
    walls = LineMap.from_segments([[2.0, 5.0, 2.0, -1.0]])
    np.testing.assert_allclose(walls.lines, [[2.0, 0.0]], atol=1e-15)
    np.testing.assert_allclose(walls.extents(), [[-1.0, 5.0]])
    assert LineMap([[1.0, 0.0]]).extents().tolist() == [[-np.inf, np.inf]]


def test_ids_lead_to_indices():
    walls = LineMap([[1.0, 0.0], [2.0, 0.0]], ids=[7, 3])
    assert walls.indices_of([3, 7, 3]).tolist() == [1, 0, 1]
    with pytest.raises(InvalidInputError, match="ids: expected ids of the map, got 4"):
        walls.indices_of([4])


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: LineMap([]), r"lines: expected shape \(n, 2\)"),
        (lambda: LineMap([[1.0, np.nan]]), r"lines: expected finite numbers, got nan at index \(0, 1\)"),
        (
            lambda: LineMap.from_segments([[0.0, 1.7e308, 1.0, 1.7e308]]),
            r"expected numbers up to 1e\+09, got 1.7e\+308",
        ),
        (lambda: LineMap([[1.0, 0.0]] * 2, ids=[4, 4]), "ids: expected each id once, got 4 2 times"),
        (lambda: LineMap([[1.0, 0.0]], ids=[-1]), "ids: expected at least 0"),
        (
            lambda: LineMap([[1.0, 0.0]], segments=[[1.0, 0.0, 1.1, 2.0]]),
            "expected end points on their line, got 0.1 m",
        ),
        (lambda: LineMap([[1.0, 0.0]], segments=[[1.0, 0.0, 1.0, 2.0]] * 2), r"segments: expected shape \(1, 4\)"),
        (lambda: LineMap.from_segments([[1.0, 2.0, 1.0, 2.0]]), "segments: expected two different ends, got"),
        (lambda: LineMap.from_segments(None), "segments: expected an array of numbers, got None"),
        (lambda: LineMap.from_segments([[1.0, 2.0, 1.0]]), r"segments: expected shape \(n, 4\)"),
    ],
    ids=["none", "nan", "far", "twice", "negative", "off", "count", "point", "no segments", "three numbers"],
)
def test_bad_maps_are_refused(build, message):
    with pytest.raises(InvalidInputError, match=message):
        build()
