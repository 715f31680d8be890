"""Hits and passes per cell, against counting by hand and against the map by log-odds."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.maps.hit_counts import count_hits
from beamfield.maps.mapping import build_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog

ALL = np.ones(2, bool)


def log_of(ranges, poses, finder) -> SensorLog:
    return SensorLog(finder, np.arange(len(ranges)), ranges, poses, np.full((len(ranges), 3), np.nan))


def test_a_scan_counts_once_per_cell_and_a_hit_before_a_pass():
    # Three beams along one row of cells of 0.5 m: to the fourth cell, to the third and, twice, to the fourth again.
    finder = RangeFinder.from_bearings([0.0, 0.0, 0.0], 8.0)
    counts = count_hits(log_of([[1.6, 1.2, 1.6], [1.6, 9.0, np.nan]], [[0.25, 0.25, 0.0]] * 2, finder), ALL, 0.5)
    row, col = (np.array([0, 0]) - counts.first)[::-1]
    assert counts.hits[row, col : col + 5].tolist() == [0, 0, 1, 2, 0]
    assert counts.passes[row, col : col + 5].tolist() == [2, 2, 1, 0, 0]
    assert counts.hits.sum() == 3


def test_moments_are_those_of_the_end_points_by_direction():
    finder = RangeFinder.from_bearings([0.0, np.pi], 8.0)
    # Two walls' readings in one cell, seen from the left and from the right.
    log = log_of([[0.9, np.nan], [np.nan, 0.7]], [[0.0, 0.1, 0.1], [1.8, 0.1, 0.1]], finder)
    counts = count_hits(log, ALL, 1.0)
    ends = np.array([[0.9 * np.cos(0.1), 0.1 + 0.9 * np.sin(0.1)], [1.8 - 0.7 * np.cos(0.1), 0.1 - 0.7 * np.sin(0.1)]])
    for (x, y), cell, sector in zip(ends, ((0, 0), (0, 1)), (0, 4), strict=True):
        row, col = np.array(cell) - counts.first[::-1]
        (index,) = np.flatnonzero(counts.cells == row * counts.hits.shape[1] + col)
        dx, dy = x - cell[1] - 0.5, y - cell[0] - 0.5
        expected = [1.0, dx, dy, dx * dx, dx * dy, dy * dy]
        np.testing.assert_allclose(counts.moments[index, sector], expected, atol=1e-12)
        assert counts.moments[index].sum() == pytest.approx(sum(expected))


def test_the_map_of_counts_is_that_of_log_odds_where_no_bound_is_reached():
    grid = OccupancyGrid(np.pad(np.zeros((40, 60), np.float32), 1, constant_values=1.0), 0.1)
    finder = RangeFinder.from_bearings(np.linspace(-3.0, 3.0, 40), 8.0)
    poses = np.column_stack([np.linspace(1.0, 5.0, 5), np.full(5, 2.0), np.linspace(0.0, 1.0, 5)])
    model = BeamModel(grid, BeamParameters(0.8, 0.1, 0.05, 0.05, 0.05, 0.5))
    ranges = [scan.ranges for scan in model.sample(poses, finder, np.random.default_rng(1))]
    log = log_of(ranges, poses, finder)
    drawn, summed = build_map(log, resolution=0.1), count_hits(log, np.ones(5, bool), 0.1).to_grid()
    inside = (drawn.probability > 0.031) & (drawn.probability < 0.969)
    assert inside.sum() > 1000
    np.testing.assert_array_equal(drawn.origin, summed.origin)
    np.testing.assert_allclose(summed.probability[inside], drawn.probability[inside], atol=1e-6)
    np.testing.assert_array_equal(np.isnan(summed.probability), np.isnan(drawn.probability))


def test_a_cell_that_was_passed_once_is_free():
    finder = RangeFinder.from_bearings([0.0], 8.0)
    grid = count_hits(log_of([[1.6]], [[0.25, 0.25, 0.0]], finder), ALL[:1], 0.5).to_grid()
    assert grid.free.tolist() == [[True, True, True, False]]
    assert grid.occupied.tolist() == [[False, False, False, True]]


def test_nothing_to_draw_and_too_much_are_refused():
    finder = RangeFinder.from_bearings([0.0], 8.0)
    log = log_of([[1.0], [1.0]], [[0.0, 0.0, 0.0], [1e6, 1e6, 0.0]], finder)
    with pytest.raises(TooLittleDataError, match="none of the chosen scans has a pose"):
        count_hits(log, ~ALL, 0.5)
    with pytest.raises(InvalidInputError, match="the limit is"):
        count_hits(log, ALL, 0.05)
    with pytest.raises(InvalidInputError, match="resolution"):
        count_hits(log, ALL, 0.0)
