from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from beamfield.errors import InvalidInputError
from beamfield.features.minima import find_local_minima
from beamfield.features.sweep import RangeNoise
from beamfield.geometry import wrap_angle
from beamfield.sensors import RangeFinder, Scan

BEARINGS = np.linspace(-1.0, 1.0, 401)


def test_covariance_of_a_minimum_is_that_of_its_errors(rng):
    mount = (0.4, -0.3, 2.5)
    finder = RangeFinder.from_bearings(BEARINGS, 10.0, mount=mount)
    position = np.array(mount[:2]) + 2.0 * np.array([np.cos(0.3 + mount[2]), np.sin(0.3 + mount[2])])
    # The parabola in a window of 5 degrees leaves a bias far below the noise.
    truth = np.array([np.hypot(*position), np.arctan2(position[1], position[0]), 2.0])
    squares = []
    for _ in range(400):
        ranges = 2.0 / np.cos(BEARINGS - 0.3) + rng.normal(0, 0.001, 401)
        found = find_local_minima(Scan(ranges, finder), RangeNoise(0.001), half_width=np.deg2rad(5.0))
        [nearest] = [f for f in found if abs(wrap_angle(f.measurement[1] - truth[1])) < 0.1][:1]
        error = nearest.measurement - truth
        error[1] = wrap_angle(error[1])
        squares.append(error @ np.linalg.solve(nearest.covariance, error))
    # The window is put around the least reading, by the same data: the bounds are not those of chance alone.
    assert 2.4 < np.mean(squares) < 3.4
    assert np.mean(np.array(squares) < chi2.ppf(0.95, 3)) > 0.92


def test_a_minimum_lies_between_the_beams_and_not_beyond_the_edge_of_the_view(rng):
    bearings = np.deg2rad(np.arange(0.0, 90.25, 0.5))
    finder = RangeFinder.from_bearings(bearings, 10.0)
    # A wall that is nearest 18 degrees outside of the view: noise makes some of the first readings the least.
    ranges = 1.5 / np.cos(bearings[:61] + np.deg2rad(18.0))
    scans = [Scan(np.append(ranges + rng.normal(0, 0.02, 61), np.full(120, np.nan)), finder) for _ in range(400)]
    found = [minimum for scan in scans for minimum in find_local_minima(scan, RangeNoise(0.02))]
    assert all(bearings[0] <= minimum.measurement[1] <= bearings[60] for minimum in found)


def test_no_minimum_is_lost_where_a_full_turn_begins(rng):
    """End points so dense that noise alone decides which two are the farthest apart."""
    bearings = np.linspace(-np.pi, np.pi, 720, endpoint=False)
    finder = RangeFinder.from_bearings(bearings, 10.0)
    for _ in range(40):
        heading = bearings + rng.uniform(0, 2 * np.pi)
        room = np.minimum(
            2.0 / np.maximum(np.abs(np.cos(heading)), 1e-9), 2.2 / np.maximum(np.abs(np.sin(heading)), 1e-9)
        )
        found = find_local_minima(Scan(room + rng.normal(0, 0.02, 720), finder), RangeNoise(0.02))
        walls = np.array([minimum.measurement[1] for minimum in found]) + heading[0] - bearings[0]
        assert set(np.round(walls / (np.pi / 2)).astype(int) % 4) == {0, 1, 2, 3}


def test_noise_on_a_circle_has_no_minima(rng):
    finder = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 720, endpoint=False), 10.0)
    found = [find_local_minima(Scan(3 + rng.normal(0, 0.02, 720), finder), RangeNoise(0.02)) for _ in range(20)]
    assert sum(map(len, found)) <= 2


def test_minimum_of_an_edge_is_found_with_a_wider_covariance():
    finder = RangeFinder.from_bearings(BEARINGS, 10.0)
    # Two walls that meet in (2, 0) and lead away at 45 degrees.
    ranges = 2.0 * np.sin(np.pi / 4) / np.sin(np.pi / 4 - np.minimum(np.abs(BEARINGS), 0.6))
    ranges[np.abs(BEARINGS) > 0.6] = np.nan
    [edge] = find_local_minima(Scan(ranges, finder), RangeNoise(0.005))
    np.testing.assert_allclose(edge.measurement[:2], [2.0, 0.0], atol=0.06)
    smooth = find_local_minima(Scan(2.0 / np.cos(BEARINGS), finder), RangeNoise(0.005))
    assert edge.covariance[0, 0] > 4 * smooth[0].covariance[0, 0]


def test_gaps_and_missing_readings_are_passed_over():
    finder = RangeFinder.from_bearings(BEARINGS, 10.0)
    ranges = 2.0 / np.cos(BEARINGS - 0.2)
    ranges[[235, 240]] = np.nan, np.inf
    [found] = find_local_minima(Scan(ranges, finder), RangeNoise(0.005))
    # The wall is no parabola: its curvature comes out 2.5% too large in a window of 15 degrees.
    np.testing.assert_allclose(found.measurement, [2.0, 0.2, 2.0], atol=0.06)
    assert not np.isin([235, 240], found.beams).any()
    assert find_local_minima(Scan(np.full(401, np.nan), finder), RangeNoise()) == []


def test_a_ring_of_separate_origins_is_left_out():
    angles = np.linspace(-0.5, 0.5, 21)
    ring = RangeFinder(np.column_stack([0.2 * np.cos(angles), 0.2 * np.sin(angles), angles]), 5.0)
    assert find_local_minima(Scan(2 / np.cos(angles), ring), RangeNoise()) == []


@pytest.mark.parametrize("half_width", [0.0, 1.0, np.nan], ids=str)
def test_senseless_windows_are_refused(half_width):
    finder = RangeFinder.from_bearings(BEARINGS, 10.0)
    with pytest.raises(InvalidInputError, match="half_width"):
        find_local_minima(Scan(np.full(401, 2.0), finder), RangeNoise(), half_width=half_width)
