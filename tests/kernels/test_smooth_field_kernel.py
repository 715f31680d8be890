"""The likelihood field by interpolated distance against SciPy; passes with the JIT off as well."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from beamfield.kernels import field, smooth_field
from beamfield.kernels.smooth_field import OFF_ROWS, PAIRS, SmoothView, Table

FRAME = field.FrameView(1.3, -0.7, math.cos(0.4), math.sin(0.4), 0.4, 20.0, 3.5)
OFF = -5.0


def view_of(z_hit, sigma_hit, rand, reach=math.inf, log_off=OFF):
    peak = z_hit / (sigma_hit * math.sqrt(2.0 * math.pi))
    return SmoothView(
        log_peak=math.log(peak) if peak > 0.0 else -math.inf,
        log_rand=math.log(rand) if rand > 0.0 else -math.inf,
        log_off=log_off,
        ratio=peak / rand if rand > 0.0 else math.inf,
        quotient=rand / peak if peak > 0.0 else math.inf,
        steep=-1.0 / sigma_hit**2,
        bits=-0.5 / sigma_hit**2 / math.log(2.0),
        reach=reach,
    )


VIEW = view_of(0.6, 0.2, 0.01, log_off=-4.0)


def table_of(distance, marked=None):
    """Frame distances (rows, cols), and perhaps a mask, as the kernels read them. What lies off the field is junk."""
    framed = np.pad(np.asarray(distance, np.float32), 1, mode="edge")
    framed = np.vstack([framed, np.full((OFF_ROWS, framed.shape[1]), 77.0, np.float32)])
    uniform = np.empty(0, np.bool_)
    if marked is not None:
        uniform = np.pad(marked, ((1, 1 + OFF_ROWS), (1, 1)), constant_values=True).ravel()
    return Table(*framed.shape, framed.ravel(), uniform)


def positions_of(poses, ends):
    """Return (col, row) of end points in cells from the corner of the field: (n, k) each."""
    moved = np.array([field.to_table(pose, FRAME._replace(offset=3.0)) for pose in poses])
    x, y, c, s = (moved[:, [i]] for i in range(4))
    return x + c * ends[0] - s * ends[1], y + s * ends[0] + c * ends[1]


def on_field(u, v, shape):
    return (u >= 0.0) & (u < shape[1]) & (v >= 0.0) & (v < shape[0])


def scipys_distances(distance, poses, ends):
    """Return the interpolated distances (n, k) by SciPy, constant across the edge; NaN off the field."""
    u, v = positions_of(poses, ends)
    values = map_coordinates(distance.astype(np.float64), [v - 0.5, u - 0.5], order=1, mode="nearest")
    return np.where(on_field(u, v, distance.shape), values, np.nan)


def distances(table, poses, ends):
    out = np.empty((len(poses), ends.shape[1]))
    smooth_field.fill_distances(poses, FRAME, ends, table, math.nan, out)
    return out


def sums(table, poses, ends, n_factors=None):
    out = np.empty(len(poses))
    n_factors = smooth_field.n_factors(VIEW) if n_factors is None else n_factors
    smooth_field.fill_sums(poses, FRAME, ends, table, VIEW, n_factors, out)
    return out


def gradient(table, poses, ends):
    out = np.empty((len(poses), 3))
    smooth_field.fill_gradient(poses, FRAME, ends, table, VIEW, out)
    return out


@pytest.fixture
def distance(rng):
    return rng.uniform(0.0, 1.5, (60, 90)).astype(np.float32)


@pytest.fixture
def poses(rng):
    return np.column_stack([rng.uniform(0.5, 5.0, 40), rng.uniform(-1.0, 3.0, 40), rng.uniform(-9, 9, 40)])


@pytest.fixture
def ends(rng):
    return rng.uniform(-30, 30, (2, 37))


@pytest.mark.parametrize("parameters", [(0.6, 0.2, 0.01), (1.0, 0.05, 0.0), (0.6, 0.2, 1e-310), (0.0, 0.2, 0.01)])
def test_a_beam_has_the_value_of_the_other_look_up(parameters):
    z_hit, sigma_hit, rand = parameters
    reach = 0.0 if z_hit == 0.0 else math.inf
    nearest = field.FieldView(z_hit, sigma_hit, rand, math.log(rand) if rand > 0.0 else -math.inf, reach)
    view = view_of(*parameters, reach)
    for d in (0.0, 0.03, 0.2, 0.9, 1.9, 2.1, 7.5, 50.0, math.inf):
        assert smooth_field.log_beam(d, view) == pytest.approx(field.log_value(d, nearest), rel=1e-12, abs=1e-12)


def test_a_gain_is_a_value_over_rand():
    view = VIEW._replace(reach=1.2)
    for d in (0.0, 0.1, 0.5, 1.19, 1.2, 3.0, math.inf):
        expected = smooth_field.log_beam(d, view) - view.log_rand
        assert math.log(smooth_field.gain(np.float64(d), view)) == pytest.approx(expected, abs=1e-13)
    assert smooth_field.gain(np.float64(math.nan), view) == 1.0


@pytest.mark.parametrize("view", [VIEW, view_of(1.0, 0.2, 0.0)])
@pytest.mark.parametrize("d", [0.03, 0.2, 0.7, 1.4])
def test_the_slope_is_the_derivative_of_the_value(view, d):
    step = 1e-5
    difference = (smooth_field.log_beam(d + step, view) - smooth_field.log_beam(d - step, view)) / (2 * step)
    assert smooth_field.log_slope(np.float64(d), view) == pytest.approx(difference, rel=1e-5, abs=1e-8)


def test_beyond_the_reach_and_without_hits_there_is_no_slope():
    assert smooth_field.log_slope(np.float64(1.5), VIEW._replace(reach=1.5)) == 0.0
    assert smooth_field.log_slope(np.float64(0.1), view_of(0.0, 0.2, 0.01)) == 0.0


def test_distances_are_those_of_scipy(distance, poses, ends):
    expected = scipys_distances(distance, poses, ends)
    np.testing.assert_allclose(distances(table_of(distance), poses, ends), expected, rtol=0, atol=1e-12)
    assert 0.05 < np.isnan(expected).mean() < 0.9


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (4, 1)])
def test_fields_of_one_row_or_column_are_constant_across_it(rng, poses, shape):
    distance = rng.uniform(0.0, 1.0, shape).astype(np.float32)
    ends = rng.uniform(-2.0, 2.0, (2, 50))
    poses = np.array([[1.3, -0.7, 0.4], [1.2, -0.8, 2.0]])  # at the frame's origin, 3 cells from the corner
    ends = ends - 2.0
    expected = scipys_distances(distance, poses, ends)
    np.testing.assert_allclose(distances(table_of(distance), poses, ends), expected, rtol=0, atol=1e-12)
    assert 0.0 < np.isnan(expected).mean() < 1.0


def test_edges_belong_to_the_field_below_and_left_only():
    """Along one row of three cells, from its first edge to its last."""
    table, pose = table_of([[1.0, 2.0, 4.0]]), np.array([[0.0, 0.0, 0.0]])
    frame = field.FrameView(0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.5)
    ends = np.array([[0.0, 0.25, 0.5, 1.0, 2.5, 2.75, np.nextafter(3.0, 0.0), 3.0, -1e-9], [0.5] * 9])
    out = np.empty((1, 9))
    smooth_field.fill_distances(pose, frame, ends, table, math.nan, out)
    assert out[0].tolist()[:7] == [1.0, 1.0, 1.0, 1.5, 4.0, 4.0, 4.0]
    assert np.isnan(out[0, 7:]).all()


def test_beside_an_infinite_distance_it_is_infinite_and_has_no_slope(poses, ends):
    distance = np.full((60, 90), 0.1, np.float32)
    distance[20:40, ::2] = math.inf
    table = table_of(distance)
    with np.errstate(invalid="ignore"):  # warns only with the JIT off
        got, slopes = distances(table, poses, ends), gradient(table, poses, ends)
        summed = sums(table, poses, ends)
    u, v = positions_of(poses, ends)
    row, on = np.floor(v - 0.5), on_field(u, v, distance.shape)
    # The last column, repeated past its centres, is one of the finite ones.
    beside = on & (row >= 19) & (row < 40) & (u < 89.5)
    assert np.isinf(got[beside]).all()
    np.testing.assert_allclose(got[on & ~beside], 0.1, rtol=1e-6)
    assert beside.sum() > 100
    assert (slopes == 0.0).all()
    assert np.isfinite(summed).all()


def test_marked_cells_count_as_off_the_field(rng, distance, poses, ends):
    marked = rng.random(distance.shape) < 0.3
    u, v = positions_of(poses, ends)
    on = on_field(u, v, distance.shape)
    inside = np.floor(v.clip(0, 59)).astype(int), np.floor(u.clip(0, 89)).astype(int)
    left_out = ~on | marked[inside]
    got = distances(table_of(distance, marked), poses, ends)
    assert (np.isnan(got) == left_out).all()
    assert (got[~left_out] == distances(table_of(distance), poses, ends)[~left_out]).all()
    assert (on & left_out).sum() > 100
    # The sum is that of the beams; the gradient that of those beams alone that count.
    values = got.copy()
    smooth_field.fill_values(VIEW, values)
    assert (values[left_out] == VIEW.log_off).all()
    np.testing.assert_allclose(sums(table_of(distance, marked), poses, ends), values.sum(axis=1), rtol=0, atol=1e-11)
    slopes = gradient(table_of(distance, marked), poses, ends)
    for i in range(len(poses)):
        alone = gradient(table_of(distance), poses[[i]], np.ascontiguousarray(ends[:, ~left_out[i]]))
        np.testing.assert_allclose(slopes[[i]], alone, rtol=1e-9, atol=1e-9)


def test_poses_beyond_all_numbers_are_off_the_field(distance, ends):
    poses = np.array([[1e300, -1e300, 0.3], [-1e308, 1e308, 2.0], [1e20, 0.0, 1e9]])
    with np.errstate(over="ignore", invalid="ignore"):  # warns only with the JIT off
        assert np.isnan(distances(table_of(distance), poses, ends)).all()
        np.testing.assert_allclose(sums(table_of(distance), poses, ends), 37 * VIEW.log_off, rtol=1e-12)
        assert (gradient(table_of(distance), poses, ends) == 0.0).all()


@pytest.mark.parametrize("n_factors", [1, 3, 4, 150])
@pytest.mark.parametrize("k", [0, 1, 3, 56, PAIRS + 9])
def test_sums_are_those_of_the_single_beams(rng, distance, poses, k, n_factors):
    ends = rng.uniform(-30, 30, (2, k))
    values = distances(table_of(distance), poses, ends)
    smooth_field.fill_values(VIEW, values)
    got = sums(table_of(distance), poses, ends, n_factors=n_factors)
    np.testing.assert_allclose(got, values.sum(axis=1), rtol=1e-13, atol=1e-11)


def test_a_pose_has_the_same_bits_in_any_company(distance, poses, ends):
    table = table_of(distance)
    together = sums(table, poses, ends), gradient(table, poses, ends), distances(table, poses, ends)
    for few in (1, 7):
        for start in range(0, len(poses), few):
            part = slice(start, start + few)
            assert (sums(table, poses[part], ends) == together[0][part]).all()
            assert (gradient(table, poses[part], ends) == together[1][part]).all()
            assert ((d := distances(table, poses[part], ends)) == together[2][part])[~np.isnan(d)].all()


@pytest.mark.parametrize("view", [VIEW, view_of(0.99, 1e-3, 1e-9), view_of(0.5, 0.1, 0.1, log_off=400.0)])
def test_products_of_gains_stay_below_the_largest_number(view):
    largest = max(smooth_field.gain(np.float64(0.0), view), math.exp(view.log_off - view.log_rand))
    n = smooth_field.n_factors(view)
    assert n >= 1
    assert n * math.log(largest) < 700.0


def test_nothing_is_multiplied_where_one_gain_may_be_too_large():
    assert smooth_field.n_factors(view_of(1.0, 0.1, 0.0, log_off=-math.inf)) == 0
    assert smooth_field.n_factors(view_of(1.0, 0.1, 1e-290)) == 0
    assert smooth_field.n_factors(view_of(0.0, 0.1, 1e-290, log_off=0.0)) == 0


def test_the_fast_sums_are_those_of_plain_loops(rng):
    for k in (0, 1, 5, 64, 101):
        a, b, ends = rng.normal(size=k), rng.normal(size=k), rng.normal(size=(2, k))
        expected = a.sum(), b.sum(), (ends[0] * b - ends[1] * a).sum(), (ends[0] * a + ends[1] * b).sum()
        assert smooth_field.sum_slopes(a, b, ends) == pytest.approx(expected, abs=1e-12)
