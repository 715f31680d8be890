"""Both passes of the distance transform against their definitions; passes with the JIT off as well."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beamfield.kernels import distance
from tests.kernels.entry import entry

fill_near_squares, try_columns = entry(distance._fill_near_squares), entry(distance._try_columns)
find_envelope, largest_of = entry(distance._find_envelope), entry(distance._largest_of)
write_metres = entry(distance._write_metres)
FAR = distance.NO_OBSTACLE


def nearest_squares(heights):
    """The least (u - i)^2 + h_i^2 for every column u of a row, by trying all columns i in Python's integers."""
    heights = [int(h) for h in heights]
    return [min((u - i) ** 2 + h * h for i, h in enumerate(heights)) for u in range(len(heights))]


def squares_by_trying(heights, reach):
    near = np.full(len(heights) + 2 * distance.NEAR, distance.CAP**2, np.uint16)
    fill_near_squares(heights, near[distance.NEAR : -distance.NEAR])
    out = np.empty(len(heights))
    try_columns(near, reach, np.empty(len(heights) + 3, np.uint16), out)
    return out


def squares_by_envelope(heights, reach, first=0, last=None):
    out = np.full(len(heights), -1.0)
    find_envelope(heights, reach, first, len(heights) if last is None else last, np.empty((3, len(heights))), out)
    return out


def test_heights_are_the_cells_to_the_nearest_obstacle_of_the_column(rng):
    obstacles = rng.random((7, 2 * distance.STRIP + 5)) < 0.2
    out = np.full(obstacles.shape, -1, np.int32)
    first, last = 3, obstacles.shape[1] - 1
    distance.fill_heights(obstacles, first, last, out)
    assert (out[:, :first] == -1).all()
    assert (out[:, last:] == -1).all()
    for c in range(first, last):
        rows = np.flatnonzero(obstacles[:, c])
        if rows.size:
            assert out[:, c].tolist() == [np.abs(rows - r).min() for r in range(7)]
        else:
            assert (out[:, c] >= FAR).all()


@pytest.mark.parametrize("tallest", [1, 3, 20, 179])
@pytest.mark.parametrize("n", [1, 2, 7, 40, 190])
def test_both_ways_find_the_nearest_column(rng, n, tallest):
    heights = rng.integers(0, tallest + 1, n).astype(np.int32)
    heights[rng.random(n) < 0.3] = FAR
    heights[rng.integers(n)] = tallest
    expected = nearest_squares(heights)
    reach = math.isqrt(max(expected)) + 1
    assert squares_by_envelope(heights, reach).tolist() == expected
    if reach <= distance.NEAR:
        assert squares_by_trying(heights, reach).tolist() == expected


@pytest.mark.parametrize("side", [-1, 1])
def test_columns_are_tried_up_to_the_last_in_reach(side):
    """An obstacle NEAR columns away on either side, others just out of reach above and below."""
    heights = np.full(distance.NEAR + 1, distance.NEAR + 1, np.int32)
    heights[::side][0] = 0
    expected = np.arange(distance.NEAR + 1)[::side] ** 2
    assert squares_by_trying(heights, distance.NEAR).tolist() == expected.tolist()


def test_distances_beyond_the_reach_stay_beyond_it():
    heights = np.full(500, FAR, np.int32)
    heights[250] = 170
    assert min(squares_by_trying(heights, 160)) >= 160**2
    assert (squares_by_envelope(heights, 160) == 160**2).all()
    heights[250] = 100
    away = np.abs(np.arange(500) - 250)
    expected = away**2 + 100**2
    for out in (squares_by_trying(heights, 160), squares_by_envelope(heights, 160)):
        within = expected <= 160**2
        assert (out[within] == expected[within]).all()
        assert (out[~within] >= 160**2).all()


@pytest.mark.parametrize(("obstacle", "first", "last"), [(6, 50, 51), (94, 50, 51)])
def test_the_envelope_takes_the_last_columns_in_reach_into_account(obstacle, first, last):
    heights = np.full(200, FAR, np.int32)
    heights[obstacle] = 0
    out = squares_by_envelope(heights, 44, first, last)
    assert out[first:last].tolist() == [(u - obstacle) ** 2 for u in range(first, last)]


@pytest.mark.parametrize(("first", "last"), [(0, 60), (60, 130), (100, 101), (140, 200)])
def test_a_part_of_a_row_takes_columns_beside_it_into_account(rng, first, last):
    heights = rng.integers(0, 60, 200).astype(np.int32)
    heights[80:150] = FAR
    expected = np.array(nearest_squares(heights), dtype=np.float64)
    out = squares_by_envelope(heights, math.isqrt(int(expected.max())) + 1, first, last)
    assert (out[first:last] == expected[first:last]).all()
    assert (np.delete(out, slice(first, last)) == -1.0).all()


def test_the_longest_sides_are_exact():
    """Two obstacles as far up as can be: the squares of the distances differ in their last digits only."""
    side = distance.MAX_SIDE_CELLS
    heights = np.full(9, FAR, np.int32)
    heights[0] = heights[8] = side - 1
    expected = nearest_squares(heights)
    assert squares_by_envelope(heights, 2 * side + 1).tolist() == expected
    assert max(expected) > 2**51


def test_the_largest_square_is_found(rng):
    for n in (1, 7, 256):
        squares = np.floor(rng.uniform(0.0, 2.0**53, n))
        assert largest_of(squares) == squares.max()


def test_metres_are_rounded_once_and_cut_off():
    out = np.empty(4, np.float32)
    write_metres(np.array([0.0, 2.0, 2.0**40 + 1.0, 2.0**53]), 0.05, 1e6, out)
    assert out.tolist() == [0.0, np.float32(math.sqrt(2.0) * 0.05), np.float32(math.sqrt(2.0**40 + 1) * 0.05), 1e6]


@pytest.mark.parametrize("reach", [4, 40])
def test_rows_go_from_heights_to_metres_in_place(rng, reach):
    obstacles = rng.random((9, 20)) < 0.05
    obstacles[4, 3] = True
    out = np.empty(obstacles.shape, np.float32)
    distance.fill_heights(obstacles, 0, 20, out.view(np.int32))
    distance.fill_metres(reach, 0.5, 0.5 * (reach - 1), out)
    cells = np.argwhere(obstacles)
    for (r, c), metres in np.ndenumerate(out):
        square = min((r - y) ** 2 + (c - x) ** 2 for y, x in cells.tolist())
        assert metres == np.float32(min(math.sqrt(square), reach - 1) * 0.5)
