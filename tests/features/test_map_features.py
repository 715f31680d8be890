"""Walls and corners found in grid maps are those that were drawn."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.rooms import drawn_room

from beamfield.errors import InvalidInputError
from beamfield.features.map_features import map_features, merged_corners, merged_segments
from beamfield.geometry import compose, transform_points
from beamfield.maps.occupancy import OccupancyGrid

NICHES = [(0, 0), (6, 0), (6, 4), (4, 4), (4, 5), (3, 5), (3, 4), (0, 4)]
MOVE = np.array([12.0, -5.0, 0.7])


@pytest.fixture(scope="module")
def found():
    grid, walls, corners = drawn_room(NICHES)
    moved = OccupancyGrid(grid.probability, grid.resolution, compose(MOVE, grid.origin))
    return map_features(moved, spacing=1.2), walls, corners


def test_every_wall_is_found_once_with_its_ends(found):
    features, walls, _ = found
    truth = transform_points(MOVE, walls.segments.reshape(-1, 2, 2))
    assert len(features.lines) == len(truth)
    ends = features.lines.segments.reshape(-1, 2, 2)
    for one, two in truth:
        error = np.minimum(np.hypot(*(ends - [one, two]).T).max(axis=0), np.hypot(*(ends - [two, one]).T).max(axis=0))
        assert error.min() < 0.15  # an end is the last beam that met the wall


def test_every_corner_is_found_once_with_its_opening(found):
    features, _, corners = found
    truth = transform_points(MOVE, corners.positions)
    away = np.hypot(*(features.corners.positions[:, None] - truth).T)
    assert len(features.corners) == len(truth)
    assert away.min(axis=1).max() < 0.02
    nearest = away.argmin(axis=1)
    np.testing.assert_allclose(features.corners.signatures[nearest], corners.signatures, atol=0.05)


def test_a_wall_seen_in_pieces_is_one_and_two_beside_a_door_are_two():
    pieces = np.array([[0.0, 0.0, 3.0, 0.0], [5.9, 0.01, 2.8, 0.0], [7.5, 0.0, 9.0, 0.0], [0.0, 1.0, 3.0, 1.0]])
    pieces = np.vstack([pieces, pieces[2:], [[20.0, 0.0, 21.0, 0.0]]])  # the last is seen once
    walls = merged_segments(pieces, 0.05)
    assert len(walls) == 3
    lengths = np.sort(np.hypot(*(walls[:, 2:] - walls[:, :2]).T))
    np.testing.assert_allclose(lengths, [1.5, 3.0, 5.9], atol=0.01)
    assert merged_segments(np.empty((0, 4)), 0.05).shape == (0, 4)


def test_of_corners_that_are_one_the_surest_sighting_is_kept():
    sightings = np.array([[1.0, 1.0, 1.5, 0.1], [1.1, 1.0, 1.6, 0.01], [5.0, 5.0, 1.7, 0.02]])
    assert merged_corners(sightings).tolist() == [[1.1, 1.0, 1.6], [5.0, 5.0, 1.7]]


def test_a_map_without_features_has_none():
    empty = map_features(OccupancyGrid.from_ros(np.zeros((40, 40)), 0.1))
    assert empty.lines is None
    assert empty.corners is None


def test_bad_input_is_refused():
    grid = OccupancyGrid.from_ros(np.full((4, 4), 100), 0.5)
    with pytest.raises(InvalidInputError, match="no free place"):
        map_features(grid)
    with pytest.raises(InvalidInputError, match="spacing, max_range: expected positive metres, got -1"):
        map_features(grid, spacing=-1.0)
