from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from beamfield.errors import InvalidInputError
from beamfield.geometry import (
    as_poses,
    between,
    compose,
    interpolate_poses,
    invert,
    transform_points,
    wrap_angle,
    yaw_from_quaternion,
)

coordinate = st.floats(-1e3, 1e3)
pose = st.tuples(coordinate, coordinate, st.floats(-10.0, 10.0)).map(np.array)


def matrix(p: np.ndarray) -> np.ndarray:
    """The independent reference: homogeneous matrices."""
    c, s = np.cos(p[2]), np.sin(p[2])
    return np.array([[c, -s, p[0]], [s, c, p[1]], [0.0, 0.0, 1.0]])


@given(pose, pose)
def test_composition_is_the_product_of_matrices(a, b):
    np.testing.assert_allclose(matrix(compose(a, b)), matrix(a) @ matrix(b), atol=1e-9)


@given(pose)
def test_a_pose_and_its_inverse_cancel(a):
    np.testing.assert_allclose(compose(a, invert(a)), 0.0, atol=1e-9)
    np.testing.assert_allclose(compose(invert(a), a), 0.0, atol=1e-9)


@given(pose, pose, pose)
def test_composition_is_associative(a, b, c):
    left, right = compose(compose(a, b), c), compose(a, compose(b, c))
    np.testing.assert_allclose(matrix(left), matrix(right), atol=1e-8)


@given(pose, pose)
def test_between_leads_from_one_pose_to_the_other(a, b):
    np.testing.assert_allclose(matrix(compose(a, between(a, b))), matrix(b), atol=1e-8)


@given(pose, coordinate, coordinate)
def test_points_move_as_matrices_say(a, x, y):
    np.testing.assert_allclose(transform_points(a, [x, y]), (matrix(a) @ [x, y, 1.0])[:2], atol=1e-9)


@given(st.floats(-1e4, 1e4))
def test_wrapped_angles_lie_in_the_half_open_interval_and_point_the_same_way(angle):
    wrapped = float(wrap_angle(angle))
    assert -np.pi < wrapped <= np.pi
    assert np.cos(wrapped) == pytest.approx(np.cos(angle), abs=1e-9)
    assert np.sin(wrapped) == pytest.approx(np.sin(angle), abs=1e-9)


@pytest.mark.parametrize("angle", [np.pi, -np.pi, 3 * np.pi, -3 * np.pi])
def test_half_turns_wrap_to_plus_pi(angle):
    assert float(wrap_angle(angle)) == pytest.approx(np.pi)


def test_interpolation_takes_the_short_way_round():
    track = [[0.0, 0.0, 3.0], [1.0, 2.0, -3.0]]
    halfway = interpolate_poses([0.0, 1.0], track, [0.5])[0]
    np.testing.assert_allclose(halfway[:2], [0.5, 1.0])
    assert abs(halfway[2]) == pytest.approx(np.pi)


def test_interpolation_does_not_extrapolate_or_bridge_gaps():
    stamps, track = [0.0, 1.0, 5.0], np.zeros((3, 3))
    result = interpolate_poses(stamps, track, [-0.1, 0.5, 3.0, 5.0, 5.1], max_gap=2.0)
    np.testing.assert_array_equal(np.isfinite(result).all(axis=1), [False, True, False, True, False])


def test_interpolation_of_one_pose_knows_only_its_stamp():
    result = interpolate_poses([1.0], [[1.0, 2.0, 3.0]], [0.5, 1.0])
    assert np.isnan(result[0]).all()
    np.testing.assert_allclose(result[1], [1.0, 2.0, 3.0])


def test_interpolation_of_nothing_is_nan():
    assert np.isnan(interpolate_poses([], np.zeros((0, 3)), [1.0])).all()


@given(st.floats(-3.1, 3.1))
def test_yaw_of_a_turn_about_z_is_its_angle(angle):
    assert float(yaw_from_quaternion(0.0, 0.0, np.sin(angle / 2), np.cos(angle / 2))) == pytest.approx(angle)


def test_bad_poses_are_named():
    with pytest.raises(InvalidInputError, match=r"expected shape \(\.\.\., 3\), got \(2,\)"):
        as_poses([1.0, 2.0])
    with pytest.raises(InvalidInputError, match=r"start: expected finite numbers, got nan at index \(1, 2\)"):
        as_poses([[0.0, 0.0, 0.0], [0.0, 0.0, np.nan]], "start")


@pytest.mark.parametrize("n", [3, 5000], ids=["few", "many"])
def test_poses_are_finite_numbers_however_many_and_large(n):
    huge = np.full((n, 3), 1e308)
    assert as_poses(huge) is huge
    for value in (np.nan, np.inf, -np.inf):
        bad = np.ones((n, 3))
        bad[1, 2] = value
        with pytest.raises(InvalidInputError, match=rf"got {value} at index \(1, 2\)"):
            as_poses(bad)
    bad[0, 0] = np.inf  # beside -inf: their sum is NaN
    with pytest.raises(InvalidInputError, match=r"got inf at index \(0, 0\)"):
        as_poses(bad)
