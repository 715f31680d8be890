"""Scans compared with the map along their beams, counted by hand."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.ray_agreement import agreement_at, passing_shares, ray_agreement, scan_agreement
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder, SensorLog

# Four walls, 5 m from the robot in the middle.
FINDER = RangeFinder.from_bearings(np.radians([0.0, 90.0, 180.0, -90.0]), 8.0)
MIDDLE = np.zeros((1, 3))


def room(resolution: float, half: float = 5.0) -> OccupancyGrid:
    n = round(2.0 * half / resolution) + 2
    cells = np.zeros((n, n))
    cells[[0, -1]] = cells[:, [0, -1]] = 1.0
    corner = -half - resolution
    return OccupancyGrid(cells, resolution, (corner, corner, 0.0))


def log_of(ranges: list[float]) -> SensorLog:
    return SensorLog(FINDER, np.zeros(1), np.array([ranges]), MIDDLE, MIDDLE)


# 0.25 m, or three cells, and 2% of 5 m.
@pytest.mark.parametrize(("resolution", "tolerance"), [(0.05, 0.35), (0.1, 0.4), (0.2, 0.7)])
def test_a_reading_agrees_within_a_length_and_a_share_of_it(resolution, tolerance):
    less, more = tolerance - 0.01, tolerance + 0.01
    shares = scan_agreement(log_of([5.0 + less, 5.0 - less, 5.0 + more, 5.0 - more]), room(resolution), MIDDLE)
    assert shares.tolist() == [0.5]
    found = ray_agreement(log_of([5.0 + less, 5.0 + more, np.inf, 5.0 - more]), room(resolution), MIDDLE, np.array([0]))
    assert found == (0.25, 0.5)


def test_beams_count_that_should_hit_something():
    grid = room(0.05)
    assert scan_agreement(log_of([5.0, np.inf, np.nan, np.nan]), grid, MIDDLE).tolist() == [0.5]
    assert np.isnan(scan_agreement(log_of([np.nan] * 4), grid, MIDDLE)).all()
    far = room(0.05, half=9.0)
    assert scan_agreement(log_of([7.9, 6.0, np.inf, 3.0]), far, MIDDLE).tolist() == [0.0]
    assert np.isnan(scan_agreement(log_of([np.inf] * 4), far, MIDDLE)).all()
    assert ray_agreement(log_of([7.9, 6.0, np.inf, 3.0]), far, MIDDLE, np.array([0])) == (0.0, 1.0)


# From 1.1 m off a wall, whose face is at 0.1 m, five of twelve beams reach it: 1, 1.15 and 2 m long.
FAN = RangeFinder.from_bearings(np.radians(np.linspace(-180.0, 150.0, 12)), 5.0)
OBLIQUE = 1.0 / np.cos(np.radians(30.0))
WALL = {0: 1.0, 1: OBLIQUE, 11: OBLIQUE, 2: 2.0, 10: 2.0}


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({}, 1.0),
        ({0: 0.4}, 4 / 5),
        ({0: 5.0}, 4 / 5),
        # Somebody stands where nothing is expected: three quarters of the readings have to be.
        ({6: 2.0}, 1.0),
        ({6: 2.0, 7: 2.0, 5: 2.0}, 5 / 6),
    ],
)
def test_readings_where_nothing_is_count_beyond_a_quarter(changed, expected):
    cells = np.zeros((200, 200))
    cells[:, 0] = 1.0
    at = np.array([[1.1, 10.05, 0.0]])
    log = SensorLog(FAN, np.zeros(1), np.array([[{**WALL, **changed}.get(i, 5.0) for i in range(12)]]), at, at)
    assert scan_agreement(log, OccupancyGrid(cells, 0.1), at)[0] == pytest.approx(expected)


def test_beams_that_pass_through_walls_are_a_share_of_those_that_count():
    z = np.array([5.0, 8.0, 7.0, 3.0])
    expected = np.array([[5.0, 5.0, 8.0, 5.0], [8.0, 8.0, 8.0, 8.0], [5.0, 5.0, 5.0, 5.0]])
    # One of three that should hit something; none that should; two of four.
    assert passing_shares(z, expected, room(0.05), 8.0) == pytest.approx([1 / 3, 0.0, 0.5])


def test_beams_of_a_sparse_sensor_without_return_say_nothing():
    fine = RangeFinder.from_bearings(np.radians(np.linspace(-90.0, 90.0, 181)), 8.0)
    grid = room(0.05)
    z = RayCaster(grid).expected_ranges(MIDDLE, fine)

    def agreement(lost: np.ndarray, finder: RangeFinder = fine) -> tuple[float, float]:
        ranges = np.where(lost, np.inf, z)[:, :: 180 // (finder.n_beams - 1)]
        log = SensorLog(finder, np.zeros(1), ranges, MIDDLE, MIDDLE)
        one = agreement_at(log.scan(0), RayCaster(grid), MIDDLE[0])
        return scan_agreement(log, grid, MIDDLE)[0], one

    at_random = np.random.default_rng(0).random((1, 181)) < 0.6
    assert agreement(at_random) == (1.0, 1.0)
    # A few are lost by any laser, and where a wall is gone all are, side by side.
    assert max(agreement(np.random.default_rng(0).random((1, 181)) < 0.2)) < 0.9
    assert max(agreement(np.arange(181)[None] < 109)) < 0.45
    # Between beams far apart walls end.
    coarse = RangeFinder.from_bearings(np.radians(np.linspace(-90.0, 90.0, 13)), 8.0)
    assert max(agreement(np.arange(181)[None] % 30 > 0, coarse)) < 0.6
