from __future__ import annotations

import numpy as np
import pytest
from benchmarks.rooms import Room, l_shaped_room
from scipy.stats import chi2

from beamfield.errors import InvalidInputError
from beamfield.features.corners import find_corners
from beamfield.features.feature import stack_features
from beamfield.features.lines import find_lines
from beamfield.features.straight_line import fit_line
from beamfield.features.sweep import RangeNoise, sweeps
from beamfield.geometry import invert, transform_points, wrap_angle
from beamfield.sensors import RangeFinder, Scan

FINDER = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 720, endpoint=False), 12.0, mount=(0.2, -0.1, 0.4))
NOISE = RangeNoise(0.01)


def corner_in_view(pose, place) -> np.ndarray:
    x, y = transform_points(invert(pose), place)
    return np.array([np.hypot(x, y), np.arctan2(y, x)])


def test_corners_of_an_exact_scan_are_those_of_the_room():
    pose = np.array([2.7, 3.1, 0.3])
    found = find_corners(find_lines(Scan(l_shaped_room().cast(pose, FINDER)[0], FINDER), NOISE))
    expected = [(0, 0, np.pi / 2), (8, 4, np.pi / 2), (5, 4, 3 * np.pi / 2), (0, 6, np.pi / 2), (5, 6, np.pi / 2)]
    measurements, _ = stack_features(found)
    for x, y, opening in expected:
        truth = np.array([*corner_in_view(pose, (x, y)), opening])
        error = measurements - truth
        error[:, 1] = wrap_angle(error[:, 1])
        if (x, y) == (0, 0):
            # A pole hides a piece of one of its walls.
            assert np.abs(error).max(axis=1).min() > 0.1
        else:
            assert np.abs(error).max(axis=1).min() < 1e-3, (x, y)


@pytest.mark.parametrize("pose", [(1.0, 1.5, 0.2), (2.5, 0.8, 3.0)], ids=["left", "right"])
def test_covariance_of_a_corner_is_that_of_its_errors(rng, pose):
    room = Room.from_outlines([(0, 0), (4, 0), (4.5, 3), (0, 3)])
    ranges, hit = room.cast(pose, FINDER)
    truth = np.array([*corner_in_view(np.array(pose), (4, 0)), np.pi - np.arctan2(3, 0.5)])
    squares, n = [], 300
    for _ in range(n):
        scan = Scan(ranges + rng.normal(0, 0.01, FINDER.n_beams), FINDER)
        [sweep] = sweeps(scan)
        # Which beam sees which wall is known here, so that only the noise of the corner is tested.
        walls = [fit_line(sweep, places_of(sweep, hit, wall), NOISE) for wall in (0, 1)]
        [corner] = find_corners(walls)
        error = corner.measurement - truth
        error[1] = wrap_angle(error[1])
        squares.append(error @ np.linalg.solve(corner.covariance, error))
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 3 * n) / n
    assert low < np.mean(squares) < high


def places_of(sweep, hit, wall):
    """Return the places of a wall's beams in walking order, also across the start of the sweep."""
    places = np.flatnonzero(hit[sweep.beams] == wall)
    jump = np.flatnonzero(np.diff(places) > 1)
    return np.roll(places, -(jump[0] + 1)) if len(jump) else places


def test_extracted_corners_have_honest_covariances(rng):
    room = Room.from_outlines([(0, 0), (4, 0), (4.5, 3), (0, 3)])
    squares = []
    for _ in range(30):
        pose = np.array([*rng.uniform([0.8, 0.8], [3.2, 2.2]), rng.uniform(-3, 3)])
        ranges = room.cast(pose, FINDER)[0] + rng.normal(0, 0.01, FINDER.n_beams)
        corners = find_corners(find_lines(Scan(ranges, FINDER), NOISE))
        assert len(corners) == 4
        for corner in corners:
            places = np.array([corner_in_view(pose, (x, y)) for x, y in ((0, 0), (4, 0), (4.5, 3), (0, 3))])
            error = corner.measurement[:2] - places
            error[:, 1] = wrap_angle(error[:, 1])
            error = error[np.argmin(np.abs(error).sum(axis=1))]
            squares.append(error @ np.linalg.solve(corner.covariance[:2, :2], error))
    # Which points belong to which wall is chosen by the same data: a little more error than with known walls.
    assert np.mean(squares) == pytest.approx(2.0, abs=0.6)
    assert np.mean(np.array(squares) < chi2.ppf(0.95, 2)) > 0.9


def test_walls_that_only_hide_each_other_have_no_corner():
    room = Room(np.array([[2.0, -2.0, 2.0, 0.0], [3.0, 0.0, 3.0, 3.0], [4.0, -3.0, 4.0, 3.0]]), np.zeros((0, 3)))
    lines = find_lines(Scan(room.cast((0, 0, 0), FINDER)[0], FINDER), NOISE)
    assert len(lines) >= 2
    assert find_corners(lines) == []


def test_no_lines_have_no_corners():
    assert find_corners([]) == []


@pytest.mark.parametrize(
    "option", [{"max_distance": 0.0}, {"min_turn": 0.0}, {"min_turn": 2.0}], ids=["distance", "no turn", "wide turn"]
)
def test_senseless_limits_are_refused(option):
    with pytest.raises(InvalidInputError, match=next(iter(option))):
        find_corners([], **option)


def test_what_are_no_features_cannot_be_stacked():
    with pytest.raises(InvalidInputError, match="features: expected a sequence, got None"):
        stack_features(None)
