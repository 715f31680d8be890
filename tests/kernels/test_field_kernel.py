"""The likelihood field's formulas against SciPy; passes with the JIT off as well (NUMBA_DISABLE_JIT=1)."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from beamfield.kernels import field
from tests.kernels.entry import entry

exact_distance = entry(field._exact_distance)
VIEW = field.FieldView(0.6, 0.2, 0.01, math.log(0.01), math.inf)
NO_RAND = VIEW._replace(rand=0.0, log_rand=-math.inf)
FRAME = field.FrameView(1.3, -0.7, math.cos(0.4), math.sin(0.4), 0.4, 20.0, 3.0)


def test_a_distance_in_single_precision_tells_its_whole_square():
    """Even if its last digit is off."""
    squares = np.arange(1020**2, 1023**2)
    for direction in (0.0, 1e9):
        shifted = np.nextafter(np.sqrt(squares).astype(np.float32), np.float32(direction))
        assert [exact_distance(float(d)) for d in shifted] == np.sqrt(squares).tolist()


def test_a_distance_that_is_not_between_cells_stays():
    assert exact_distance(1.5) == 1.5
    assert exact_distance(float(np.float32(math.sqrt(58.0)))) == math.sqrt(58.0)
    assert exact_distance(math.inf) == math.inf
    assert exact_distance(2000.25) == 2000.25


@pytest.mark.parametrize("distance", [0.0, 0.01, 0.2, 1.0, 3.0, 50.0, math.inf])
def test_a_beam_has_the_value_of_line_8(distance):
    expected = math.log(0.6 * stats.norm.pdf(distance, scale=0.2) + 0.01)
    assert field.log_value(distance, VIEW) == pytest.approx(expected, abs=1e-14)


def test_without_rand_values_stay_finite_until_the_density_underflows():
    for distance in (0.0, 1.0, 7.0):
        expected = math.log(0.6) + stats.norm.logpdf(distance, scale=0.2)
        assert field.log_value(distance, NO_RAND) == pytest.approx(expected, rel=1e-14)
    assert field.log_value(7.8, NO_RAND) == -math.inf
    assert field.log_value(math.inf, NO_RAND) == -math.inf


def test_beyond_the_reach_only_rand_is_left():
    assert field.log_value(1.5, VIEW._replace(reach=1.5)) == math.log(0.01)


def test_without_hits_nothing_depends_on_the_distance():
    view = VIEW._replace(z_hit=0.0)
    assert field.log_value(0.0, view) == field.log_value(9.0, view) == math.log(0.01)


def test_codes_come_back_within_half_a_step():
    low, step = -5.0, 1e-8
    for value in (-5.0, -4.123456789, 0.3):
        assert low + step * field.encode(value, low, step) == pytest.approx(value, abs=0.5001 * step)
    assert field.encode(-math.inf, low, step) == field.IMPOSSIBLE


@pytest.fixture
def poses(rng):
    return np.column_stack([rng.uniform(-5, 8, (600, 2)), rng.uniform(-9, 9, 600)])


def test_positions_in_the_table_are_those_of_double_precision(poses):
    x, y, c, s = (np.empty(len(poses), np.float32) for _ in range(4))
    field.place(poses, FRAME, x, y, c, s)
    expected = np.array([field.to_table(pose, FRAME) for pose in poses])
    np.testing.assert_allclose(np.column_stack([x, y, c, s]), expected, rtol=2e-7, atol=1e-7)


def test_large_headings_keep_their_digits():
    poses = np.array([[0.0, 0.0, 1e9], [0.0, 0.0, 0.1]])
    x, y, c, s = (np.empty(2, np.float32) for _ in range(4))
    field.place(poses, FRAME, x, y, c, s)
    assert c[0] == pytest.approx(math.cos(1e9 - 0.4), abs=1e-6)
    assert s[1] == pytest.approx(math.sin(0.1 - 0.4), abs=1e-7)


@pytest.mark.parametrize("k", [1, 3, 4, 11])
@pytest.mark.parametrize("n", [1, 2, 511, 600])
def test_sums_are_those_of_the_single_beams(poses, rng, n, k):
    codes = rng.integers(0, field.LARGEST_CODE, (90, 120)).astype(np.int32)
    codes[0] = field.LARGEST_CODE  # four of these are the largest sum there is
    # Cut from a longer array, as models have it: the kernel is compiled for nothing else.
    ends = rng.uniform(-60, 60, (2, k + 1)).astype(np.float32)[:, :k]
    total, each = np.empty(n), np.empty((n, k))
    field.fill_scan_sums(poses[:n], FRAME, ends, codes, -3.0, 1e-8, total)
    field.fill_beam_values(poses[:n], FRAME, ends.copy(), codes, -3.0, 1e-8, each)
    np.testing.assert_allclose(total, each.sum(axis=1), rtol=1e-12)


def test_the_cell_is_that_of_double_precision_but_for_end_points_on_a_border(poses, rng):
    """Single precision places an end point within 1e-4 cells here; the compiler may also fuse and reorder."""
    codes = np.arange(90 * 120, dtype=np.int32).reshape(90, 120)
    ends = rng.uniform(-60, 60, (2, 20)).astype(np.float32)
    each = np.empty((len(poses), 20))
    field.fill_beam_values(poses, FRAME, ends, codes, 0.0, 1.0, each)
    table = np.array([field.to_table(pose, FRAME) for pose in poses])
    x, y, c, s = (table[:, [i]] for i in range(4))
    u, v = x + c * ends[0] - s * ends[1], y + s * ends[0] + c * ends[1]
    expected = np.floor(v).clip(0, 89) * 120 + np.floor(u).clip(0, 119)
    on_border = (np.abs(u - np.round(u)) < 1e-4) | (np.abs(v - np.round(v)) < 1e-4)
    assert (each == expected)[~on_border].all()
    assert on_border.mean() < 1e-3


def test_poses_beyond_all_numbers_read_the_frame():
    codes = np.zeros((5, 5), np.int32)
    codes[[0, -1]] = codes[:, [0, -1]] = 7
    poses = np.array([[1e300, -1e300, 0.3], [-1e308, 1e308, 2.0], [1e20, 0.0, 0.0]])
    out = np.empty(3)
    with np.errstate(over="ignore", invalid="ignore"):  # warns only with the JIT off
        field.fill_scan_sums(poses, FRAME, np.array([[1.0, 0.0], [2.0, 0.0]], np.float32)[:, :1], codes, 0.0, 1.0, out)
    assert (out == 7.0).all()


def test_impossible_cells_give_minus_infinity(poses):
    codes = np.full((90, 120), 5, np.int32)
    codes[40:50] = field.IMPOSSIBLE
    ends = np.array([[0.0, 3.0], [0.0, 4.0]], np.float32)
    each = np.empty((len(poses), 2))
    field.fill_beam_values(poses, FRAME, ends, codes, 0.0, 1.0, each)
    table = np.array([field.to_table(pose, FRAME) for pose in poses])
    impossible = (np.floor(table[:, 1]) >= 40) & (np.floor(table[:, 1]) < 50)
    assert 0 < impossible.sum() < len(poses)
    np.testing.assert_array_equal(each[:, 0], np.where(impossible, -math.inf, 5.0))
