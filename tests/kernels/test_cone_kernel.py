"""The parts of the cone kernel, on few cones: they run with the JIT switched off, too."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.kernels import cone as kernels
from tests.kernels.entry import entry

NOT_ASKED = np.empty((0, 0, 2)), np.empty((0, 0, 2), np.int32)
HERE = (0.0, 0.0, 0.0)


def packed(stops):
    words = (stops.shape[1] + 31) // 32
    bits = np.empty((stops.shape[0], words), np.uint32)
    bands = np.empty((-(-stops.shape[0] // kernels.BAND), words), np.uint32)
    kernels.pack_rows(stops, bits, bands)
    # As casters have them, so that kernels are not compiled for tests alone.
    bits.flags.writeable = bands.flags.writeable = False
    return bits, bands


def one_cone(half):
    zero, c, s = np.zeros(1), np.array([np.cos(half)]), np.array([np.sin(half)])
    return kernels.Cones(zero, zero, c, -s, c, s)


@pytest.mark.parametrize("cols", [1, 31, 32, 33, 70])
def test_bits_are_the_cells(rng, cols):
    stops = rng.random((21, cols)) < 0.1
    bits, bands = packed(stops)
    column = np.arange(cols)
    np.testing.assert_array_equal((bits[:, column // 32] >> (column % 32).astype(np.uint32)) & 1, stops)
    together = np.array([stops[i : i + kernels.BAND].any(axis=0) for i in range(0, 21, kernels.BAND)])
    np.testing.assert_array_equal((bands[:, column // 32] >> (column % 32).astype(np.uint32)) & 1, together)


def test_the_first_and_last_set_columns_are_found(rng):
    first_set, last_set = entry(kernels._first_set), entry(kernels._last_set)
    for density in (0.0, 0.02, 0.5, 1.0):
        stops = rng.random((1, 100)) < density
        bits, _ = packed(stops)
        for _ in range(80):
            first, last = rng.integers(0, 100, 2)
            inside = np.flatnonzero(stops[0, first : last + 1]) + first
            wanted = (inside[0], inside[-1]) if len(inside) else (-1, -1)
            found = first_set(bits, 0, first, last), last_set(bits, 0, first, last)
            assert found == wanted


def test_ranges_are_shortened_to_cells_in_the_cone_alone():
    stops = np.zeros((5, 40), bool)
    stops[3, 33] = True
    poses = np.array([[0.5, 2.0, 0.0], [0.5, 2.0, 1.0], [0.5, 2.0, -0.3]])
    ranges = np.full((3, 1), 50.0)
    kernels.shorten_to_cells(poses, HERE, 1.0, one_cone(0.1), kernels.Bitmap(*packed(stops), 40), ranges, *NOT_ASKED)
    assert ranges[:, 0].tolist() == [np.hypot(32.5, 1.0), 50.0, 50.0]
    shorter = np.full((3, 1), 7.0)
    kernels.shorten_to_cells(poses, HERE, 1.0, one_cone(0.1), kernels.Bitmap(*packed(stops), 40), shorter, *NOT_ASKED)
    assert shorter[:, 0].tolist() == [7.0, 7.0, 7.0]


def test_points_and_cells_are_those_of_the_nearest():
    stops = np.zeros((5, 40), bool)
    stops[0, 8] = stops[4, 33] = True
    poses = np.array([[20.5, 2.0, np.pi], [20.5, 2.0, 0.0]])
    ranges, points, cells = np.full((2, 1), 50.0), np.full((2, 1, 2), -9.0), np.full((2, 1, 2), -1, np.int32)
    bitmap = kernels.Bitmap(*packed(stops), 40)
    kernels.shorten_to_cells(poses, HERE, 1.0, one_cone(0.5), bitmap, ranges, points, cells)
    assert ranges[:, 0] == pytest.approx([np.hypot(11.5, 1.0), np.hypot(12.5, 2.0)], rel=1e-15)
    np.testing.assert_allclose(points[:, 0], [[9.0, 1.0], [33.0, 4.0]], atol=1e-12)
    assert cells[:, 0].tolist() == [[0, 8], [4, 33]]
