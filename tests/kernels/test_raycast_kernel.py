"""The parts of the ray casting kernel, on few rays: they run with the JIT switched off, too."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.kernels import raycast as kernels
from beamfield.kernels.exact_rays import Terrain, one_beam, trace_fan
from beamfield.kernels.free_rectangles import free_rectangles
from tests.kernels.entry import entry

allocate, start = entry(kernels._allocate), entry(kernels._start)


def tables_of(occupied):
    rectangles = np.empty((4, occupied.shape[0] + 2, occupied.shape[1] + 2), np.uint16)
    free_rectangles(occupied, rectangles)
    # As casters have them, so that kernels are not compiled for tests alone.
    rectangles.flags.writeable = False
    return rectangles


def terrain_of(occupied):
    rows, cols = occupied.shape
    return Terrain(tables_of(occupied).reshape(-1), rows, cols, 1.0, 30.0, 30.0)


def test_rectangles_are_free_and_start_at_their_cell(rng):
    occupied = rng.random((9, 12)) < 0.15
    rectangles = tables_of(occupied)
    for quadrant in range(4):
        seen = occupied[:: -1 if quadrant & 2 else 1, :: -1 if quadrant & 1 else 1]
        table = rectangles[quadrant, 1:-1, 1:-1]
        np.testing.assert_array_equal(table == 0, seen)
        for row, col in np.argwhere(table > 0):
            width, height = table[row, col] & 255, table[row, col] >> 8
            assert width >= 1
            assert height >= 1
            assert row + height <= 9
            assert col + width <= 12
            assert not seen[row : row + height, col : col + width].any()


def test_the_frame_of_the_table_stops_rays(rng):
    rectangles = tables_of(rng.random((5, 6)) < 0.3)
    for edge in (rectangles[:, 0], rectangles[:, -1], rectangles[:, :, 0], rectangles[:, :, -1]):
        assert not edge.any()


def test_a_free_map_is_one_rectangle():
    table = tables_of(np.zeros((4, 6), bool))[0, 1:-1, 1:-1]
    assert (table[0, 0] & 255, table[0, 0] >> 8) == (6, 4)
    assert (table[3, 5] & 255, table[3, 5] >> 8) == (1, 1)


def test_rectangles_are_at_most_255_cells_long():
    table = tables_of(np.zeros((1, 300), bool))[0, 1, 1:-1]
    assert (table & 255)[:3].tolist() == [255, 255, 255]
    assert (table >> 8).tolist() == [1] * 300


def test_rays_in_lockstep_equal_rays_one_by_one(rng):
    terrain = terrain_of(rng.random((20, 30)) < 0.05)
    # 300 rays: more than a block. Half of them meet corners and borders.
    origins = np.column_stack([rng.uniform(-4, [34, 24], (300, 2)), rng.uniform(-4, 4, 300)])
    origins[::2] = np.round(origins[::2] * 2) / 2
    origins[::2, 2] *= np.pi / 4
    ranges, one_by_one, cells = np.empty(300), np.empty(300), np.empty((300, 2), np.int32)
    kernels.cast_fan(origins, (0.0, 0.0, 0.0), one_beam(), True, terrain, ranges)
    trace_fan(origins, (0.0, 0.0, 0.0), one_beam(), terrain, one_by_one, cells, False)
    np.testing.assert_array_equal(ranges, one_by_one)
    np.testing.assert_array_equal(cells[:, 0] >= 0, ranges < 30.0)


@pytest.mark.parametrize("same_mount", [True, False])
def test_a_fan_equals_its_beams_one_by_one(rng, same_mount):
    terrain = terrain_of(rng.random((20, 30)) < 0.05)
    poses = np.column_stack([rng.uniform(1, [29, 19], (5, 2)), rng.uniform(-4, 4, 5)])
    bearings = rng.uniform(-2, 2, 61)
    fan = np.zeros((4, 69))
    fan[:2, :61] = 0.25 if same_mount else rng.uniform(-1, 1, (2, 61))
    fan[2, :61], fan[3, :61] = np.cos(bearings), np.sin(bearings)
    ranges, one_by_one, cells = np.empty(305), np.empty(305), np.empty((305, 2), np.int32)
    kernels.cast_fan(poses, (0.5, 0.5, 0.3), fan, same_mount, terrain, ranges)
    trace_fan(poses, (0.5, 0.5, 0.3), fan, terrain, one_by_one, cells, False)
    np.testing.assert_array_equal(ranges, one_by_one)


def test_rays_float32_cannot_decide_are_traced():
    """A ray into a corner is in doubt; the answer is that of the trace, not that of the lanes."""
    occupied = np.zeros((8, 8), bool)
    occupied[3, 4] = occupied[4, 3] = True
    terrain = terrain_of(occupied)
    origins = np.array([[0.5, 0.5, np.pi / 4]])
    ranges = np.empty(1)
    kernels.cast_fan(origins, (0.0, 0.0, 0.0), one_beam(), True, terrain, ranges)
    assert ranges[0] == pytest.approx(3.5 * np.sqrt(2), rel=1e-15)


def test_in_a_map_too_wide_for_float32_every_ray_is_in_doubt():
    terrain = Terrain(np.zeros(0, np.uint16), 1, 2**24, 1.0, 30.0, 30.0)
    lanes = allocate().block
    lanes.ray[kernels.COS : kernels.COS + kernels.BLOCK] = 1.0
    lanes.ray[kernels.CELL_X : kernels.CELL_X + kernels.BLOCK] = 2.0**24 - 1
    start(lanes, terrain, kernels.BLOCK)
    assert not lanes.base.any()
    assert (lanes.state[kernels.LIMIT :] == -1.0).all()
    # One column less, and the last one has its right index.
    lanes.ray[kernels.CELL_X : kernels.CELL_X + kernels.BLOCK] = 2.0**24 - 2
    start(lanes, terrain._replace(cols=2**24 - 1), kernels.BLOCK)
    np.testing.assert_array_equal(lanes.base, (2**24 + 1) + 2**24 - 1)


def test_a_direction_just_short_of_parallel_is_in_doubt_and_one_just_beyond_is_not():
    """Between float64's bound and float32's the two would disagree on which edges a ray can cross."""
    terrain = terrain_of(np.zeros((8, 8), bool))
    lanes = allocate().block
    lanes.ray[kernels.SIN : kernels.SIN + kernels.BLOCK] = 1.0
    lanes.ray[kernels.COS : kernels.COS + 4] = [0.998e-12, 0.9995e-12, 1e-12, -1.1e-12]
    start(lanes, terrain, kernels.BLOCK)
    np.testing.assert_array_equal(lanes.state[kernels.LIMIT : kernels.LIMIT + 4] > 0, [True, False, False, False])
