"""Maps of landmarks: what they hold and what they refuse."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.maps.landmarks import LandmarkMap

TWO = [[0.0, 1.0], [2.0, 3.0]]


def test_ids_are_counted_from_one_if_none_are_given():
    landmarks = LandmarkMap(TWO)
    assert landmarks.ids.tolist() == [1, 2]
    assert len(landmarks) == 2
    assert landmarks.kind == "none"


def test_the_shape_of_the_signatures_tells_their_kind():
    assert LandmarkMap(TWO, signatures=[1.0, 2.0]).kind == "number"
    assert LandmarkMap(TWO, signatures=[[1.0, 2.0], [3.0, 4.0]]).kind == "vector"
    assert LandmarkMap(TWO, signatures=[0, 1], kind="type").kind == "type"


def test_ids_lead_to_indices_in_any_order():
    landmarks = LandmarkMap([[0, 0], [1, 0], [2, 0]], ids=[9, 2, 5])
    assert landmarks.indices_of([5, 9, 2, 5]).tolist() == [2, 0, 1, 2]
    assert landmarks.indices_of([]).tolist() == []


def test_the_map_keeps_its_own_copy():
    positions = np.array(TWO)
    landmarks = LandmarkMap(positions)
    positions[0, 0] = 99.0
    assert landmarks.positions[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        landmarks.positions[0, 0] = 1.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: LandmarkMap([[0.0, 1.0], [np.nan, 3.0]]), r"positions: .* finite numbers, got nan at index \(1, 0\)"),
        (lambda: LandmarkMap([[np.inf, 1.0]]), r"positions: expected finite numbers, got inf at index \(0, 0\)"),
        (lambda: LandmarkMap(np.empty((0, 2))), r"positions: expected shape \(n, 2\) with n >= 1, got \(0, 2\)"),
        (lambda: LandmarkMap(TWO, ids=[4, 4]), "ids: expected each id once, got 4 2 times"),
        (lambda: LandmarkMap(TWO, ids=[4, -1]), "ids: expected at least 0, got -1"),
        (lambda: LandmarkMap(TWO).indices_of([1, 3]), "ids: expected ids of the map, got 3"),
        (lambda: LandmarkMap(TWO, signatures=[1.0, np.nan]), "signatures: expected finite numbers, got nan"),
        (lambda: LandmarkMap(TWO, signatures=[1.0] * 3), r"signatures: expected shape \(2,\) or \(2, d\), got \(3,\)"),
        (lambda: LandmarkMap(TWO, None, [0.0, 0.5], "type"), r"signatures: expected types 0, 1, 2, \.\.\., got 0\.5"),
        (lambda: LandmarkMap(TWO, None, [0.0, 0.5], "vector"), r"kind: expected one of .* got 'vector'"),
        (lambda: LandmarkMap(TWO, kind="type"), "kind: expected 'none' without signatures, got 'type'"),
    ],
)
def test_what_is_no_map_is_refused(make, message):
    with pytest.raises(InvalidInputError, match=message):
        make()
