"""The marker model's formulas against SciPy and complex numbers; passes with the JIT off as well."""

from __future__ import annotations

import cmath
import math

import numpy as np
import pytest
from scipy import stats

from beamfield.kernels import marker
from tests.reference.marker_exercise import wrapped_normal_density


def view(sigma_angle: float = 0.1) -> marker.CameraView:
    n_turns = math.ceil(0.5 + math.sqrt(0.25 + marker.NEGLIGIBLE * sigma_angle**2 / (2.0 * math.pi**2)))
    peaks = -math.log(2.0 * math.pi * 9.0), -0.5 * math.log(2.0 * math.pi * sigma_angle**2)
    return marker.CameraView(0.2, -0.1, 0.7, 230.0, 3.0, sigma_angle, *peaks, n_turns)


def test_the_camera_of_a_robot_is_its_pose_composed_with_the_mount():
    x, y, theta = marker.camera_pose(1.0, 2.0, 0.5, view())
    place = 1.0 + 2.0j + cmath.exp(0.5j) * (0.2 - 0.1j)
    assert (x, y, theta) == pytest.approx((place.real, place.imag, 1.2), abs=1e-15)


@pytest.mark.parametrize("sigma", [1e-3, 0.1, 1.0, math.pi])
@pytest.mark.parametrize("turn", [0.0, 0.05, -0.05, 2.0, math.pi, -math.pi, 3.2, -9.0, 40.0])
def test_the_density_of_an_angle_is_the_sum_over_all_turns(sigma, turn):
    value = marker.wrapped_normal_log_density(turn, view(sigma))
    near = math.remainder(turn, 2.0 * math.pi)
    if abs(near) / sigma < 30.0:
        assert value == pytest.approx(math.log(wrapped_normal_density(near, sigma)), rel=1e-9, abs=1e-9)
    else:
        # The sum underflows, its logarithm does not: one turn is all there is, or two at half a turn.
        two = math.log(2.0) if abs(abs(near) - math.pi) < 1e-9 else 0.0
        assert value == pytest.approx(stats.norm.logpdf(near, scale=sigma) + two, rel=1e-9)


def test_a_detection_has_normal_places_and_a_wrapped_angle():
    camera, pose = view(), (1.0, 2.0, 0.5)
    x, y, theta = marker.camera_pose(*pose, camera)
    markers = np.array([[1.4, 2.3, 3.0]])
    place = 230.0 * ((1.4 - x) + 1j * (2.3 - y)) * cmath.exp(-1j * theta)
    image = np.array([[place.real + 2.0, place.imag - 4.0, 3.0 - theta + 0.05]])
    expected = (
        stats.norm.logpdf(2.0, scale=3.0) + stats.norm.logpdf(-4.0, scale=3.0) + stats.norm.logpdf(0.05, 0.0, 0.1)
    )
    value = marker.detection_log_density(x, y, theta, math.cos(theta), math.sin(theta), image, markers, 0, camera)
    assert value == pytest.approx(expected, abs=1e-9)
    image[0, 2] = math.nan
    value = marker.detection_log_density(x, y, theta, math.cos(theta), math.sin(theta), image, markers, 0, camera)
    assert value == pytest.approx(expected - stats.norm.logpdf(0.05, 0.0, 0.1), abs=1e-9)


def test_the_sum_over_detections_is_that_of_the_table_of_detections(rng):
    camera = view()
    poses, markers = rng.normal(size=(7, 3)), rng.normal(size=(4, 3))
    image = np.column_stack([rng.normal(0.0, 100.0, (4, 2)), rng.uniform(-3.0, 3.0, 4)])
    image[2, 2] = math.nan
    total, each = np.full(7, np.nan), np.full((7, 4), np.nan)
    marker.fill_scan_log_density(poses, image, markers, camera, total)
    marker.fill_detection_log_density(poses, image, markers, camera, each)
    assert np.isfinite(each).all()
    np.testing.assert_allclose(each.sum(axis=1), total, rtol=1e-13)


def test_no_detections_add_nothing():
    total = np.full(3, np.nan)
    marker.fill_scan_log_density(np.zeros((3, 3)), np.empty((0, 3)), np.empty((0, 3)), view(), total)
    assert total.tolist() == [0.0, 0.0, 0.0]
