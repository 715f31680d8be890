from __future__ import annotations

import numpy as np
import pytest
from benchmarks.rooms import Room
from scipy.stats import chi2

from beamfield.errors import InvalidInputError
from beamfield.features.lines import find_lines
from beamfield.features.minima import find_local_minima
from beamfield.features.poles import Pole, find_poles
from beamfield.features.sweep import RangeNoise
from beamfield.geometry import invert, transform_points, wrap_angle
from beamfield.sensors import RangeFinder, Scan

HALL = [(-6, -6), (6, -6), (6, 6), (-6, 6)]
FINDER = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 720, endpoint=False), 20.0, mount=(0.1, 0.2, -0.3))
NOISE = RangeNoise(0.005)


def four_around(rng: np.random.Generator, farthest: float) -> np.ndarray:
    """Return (4, 2) centres of poles from 1.2 m on, one in each quarter, none of which hides another."""
    directions = rng.uniform(-np.pi, np.pi) + np.pi / 2 * np.arange(4) + rng.uniform(-0.4, 0.4, 4)
    return rng.uniform(1.2, farthest, (4, 1)) * np.column_stack([np.cos(directions), np.sin(directions)])


def nearest(centres: np.ndarray, pole: Pole) -> np.ndarray:
    """Return the centre that a pole was found for."""
    return centres[np.hypot(*(centres - pole.position).T).argmin()]


@pytest.mark.parametrize("diameter", [0.1, 0.3], ids=["thin", "thick"])
def test_covariance_of_a_pole_is_that_of_its_errors(rng, diameter):
    squares = []
    for _ in range(40):
        pose = np.array([*rng.uniform(-0.2, 0.2, 2), rng.uniform(-3, 3)])
        centres = pose[:2] + four_around(rng, 2.2)
        room = Room.from_outlines(HALL, poles=[(*centre, diameter / 2) for centre in centres])
        ranges = room.cast(pose, FINDER)[0] + rng.normal(0, 0.005, 720)
        for pole in find_poles(Scan(ranges, FINDER), NOISE):
            x, y = nearest(transform_points(invert(pose), centres), pole)
            error = pole.measurement - [np.hypot(x, y), np.arctan2(y, x), diameter]
            error[1] = wrap_angle(error[1])
            squares.append(error @ np.linalg.solve(pole.covariance, error))
    assert len(squares) >= 0.85 * 160
    # The silhouette's error is uniform and the edge beams are not linear: near three, not at it.
    assert 2.2 < np.mean(squares) < 3.6
    assert np.mean(np.array(squares) < chi2.ppf(0.95, 3)) > 0.91


@pytest.mark.parametrize(
    ("diameter", "sigma"), [(0.16, 0.03), (0.3, 0.05)], ids=["a fifth of the diameter", "a sixth of the diameter"]
)
def test_ellipses_hold_the_truth_also_where_a_circle_is_far_from_linear(rng, diameter, sigma):
    """The normal equations of a fit give ellipses that hold 61% of the truth at 5 cm."""
    centred = RangeFinder.from_bearings(FINDER.bearings, 20.0)
    squares, scores = [], []
    for _ in range(63):
        centres = four_around(rng, 2.5)
        room = Room.from_outlines(HALL, poles=[(*centre, diameter / 2) for centre in centres])
        ranges = room.cast((0, 0, 0), centred)[0] + rng.normal(0, sigma, 720)
        for pole in find_poles(Scan(ranges, centred), RangeNoise(sigma)):
            x, y = nearest(centres, pole)
            error = pole.measurement - [np.hypot(x, y), np.arctan2(y, x), diameter]
            error[1] = wrap_angle(error[1])
            squares.append(error @ np.linalg.solve(pole.covariance, error))
            scores.append(error / np.sqrt(np.diag(pole.covariance)))
    assert len(squares) > 30
    assert np.mean(np.array(squares) < chi2.ppf(0.95, 3)) > 0.9
    # No bias either: no more than a third of a deviation.
    assert np.abs(np.mean(scores, axis=0)).max() < 0.33


@pytest.mark.parametrize("sigma_bearing", [0.001, 0.004], ids=["a tenth of the spacing", "half the spacing"])
def test_noisy_bearings_are_in_the_ellipse(rng, sigma_bearing):
    centred = RangeFinder.from_bearings(FINDER.bearings, 20.0)
    squares = []
    for _ in range(30):
        direction, distance = rng.uniform(-3, 3), rng.uniform(1.2, 2.5)
        room = Room.from_outlines(HALL, poles=[(distance * np.cos(direction), distance * np.sin(direction), 0.15)])
        # Each beam points a little elsewhere than the finder says.
        turned = RangeFinder.from_bearings(FINDER.bearings + rng.normal(0.0, sigma_bearing, 720), 20.0)
        ranges = room.cast((0, 0, 0), turned)[0] + rng.normal(0, 0.01, 720)
        for pole in find_poles(Scan(ranges, centred), RangeNoise(0.01, sigma_bearing)):
            error = pole.measurement - [distance, direction, 0.3]
            error[1] = wrap_angle(error[1])
            squares.append(error @ np.linalg.solve(pole.covariance, error))
    assert len(squares) >= 28
    low, high = chi2.ppf([1e-4, 1 - 1e-4], 3 * len(squares)) / len(squares)
    assert low < np.mean(squares) < 1.1 * high


@pytest.mark.parametrize("mixed", [[0], [-1], [0, -1]], ids=["first", "last", "both"])
def test_a_board_whose_last_beams_are_mixed_with_the_background_is_no_pole(rng, mixed):
    board = Room(np.vstack([Room.from_outlines(HALL).walls, [[2.0, -0.15, 2.0, 0.15]]]), np.zeros((0, 3)))
    ranges, hit = board.cast((0, 0, 0), FINDER)
    seen = np.flatnonzero(hit == 4)
    seen = seen[np.argsort(wrap_angle(FINDER.bearings[seen]))]
    for _ in range(8):
        noisy = ranges + rng.normal(0, 0.005, 720)
        noisy[seen[mixed]] += 0.1
        assert find_poles(Scan(noisy, FINDER), NOISE) == []


def test_exact_readings_give_the_diameter():
    room = Room.from_outlines(HALL, poles=[(1.5, 0.5, 0.1), (-1.0, 2.0, 0.2)])
    found = find_poles(Scan(room.cast((0, 0, 0), FINDER)[0], FINDER), NOISE)
    assert sorted(round(pole.diameter, 2) for pole in found) == [0.2, 0.4]


def test_boards_and_corners_are_no_poles(rng):
    board = Room(
        np.vstack([Room.from_outlines(HALL).walls, [[2.0, -0.2, 2.0, 0.2], [0.3, 2.0, -0.2, 2.1]]]), np.zeros((0, 3))
    )
    for _ in range(10):
        ranges = board.cast((0, 0, 0), FINDER)[0] + rng.normal(0, 0.005, 720)
        assert find_poles(Scan(ranges, FINDER), NOISE) == []


def test_half_hidden_poles_and_those_at_the_border_are_left_out():
    room = Room.from_outlines(HALL, poles=[(2.0, 0.0, 0.15)])
    hidden = Room(np.vstack([room.walls, [[1.0, 0.0, 1.0, 1.0]]]), room.poles)
    assert len(find_poles(Scan(room.cast((0, 0, 0), FINDER)[0], FINDER), NOISE)) == 1
    assert find_poles(Scan(hidden.cast((0, 0, 0), FINDER)[0], FINDER), NOISE) == []
    border = RangeFinder.from_bearings(np.linspace(0.0, 2.0, 200), 20.0)
    assert find_poles(Scan(room.cast((0, 0, 0), border)[0], border), NOISE) == []


def test_a_pole_with_nothing_behind_and_missing_readings_is_found():
    finder = RangeFinder.from_bearings(np.linspace(-0.5, 0.5, 201), 8.0)
    room = Room(np.array([[100.0, 0.0, 100.0, 1.0]]), np.array([[2.0, 0.1, 0.2]]))
    ranges = room.cast((0, 0, 0), finder)[0]
    ranges[110] = np.nan
    [pole] = find_poles(Scan(ranges, finder), NOISE)
    np.testing.assert_allclose(pole.measurement, [np.hypot(2, 0.1), np.arctan2(0.1, 2), 0.4], atol=0.01)
    assert find_poles(Scan(np.full(201, np.nan), finder), NOISE) == []


@pytest.mark.parametrize("nearest", [0.0, 1e-6])
def test_readings_at_the_sensor_itself_are_passed_over(nearest):
    room = Room.from_outlines(HALL, poles=[(2.0, 0.0, 0.15)])
    ranges = room.cast((0, 0, 0), FINDER)[0]
    [before] = find_poles(Scan(ranges, FINDER), NOISE)
    for blinded in (slice(0, 5), slice(100, 140)):
        ranges[blinded] = nearest
    scan = Scan(ranges, FINDER)
    [pole] = find_poles(scan, NOISE)
    np.testing.assert_allclose(pole.measurement, before.measurement, atol=1e-9)
    assert len(find_lines(scan, NOISE)) >= 4
    assert all(minimum.measurement[0] > 1.0 for minimum in find_local_minima(scan, NOISE))


@pytest.mark.parametrize(
    "option",
    [{"min_points": 2}, {"max_diameter": 0.0}, {"clearance": -1.0}, {"max_gap": 0.0}],
    ids=lambda option: next(iter(option)),
)
def test_senseless_limits_are_refused(option):
    with pytest.raises(InvalidInputError, match=next(iter(option))):
        find_poles(Scan(np.full(720, 2.0), FINDER), NOISE, **option)
