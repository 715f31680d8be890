"""Lens distortion is taken out as OpenCV does it, and a real camera becomes the exercise's pinhole."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import wrap_angle
from beamfield.models.camera_intrinsics import CameraIntrinsics
from beamfield.models.marker import image_of_corners

K = np.array([[1010.0, 0.0, 637.0], [0.0, 990.0, 470.0], [0.0, 0.0, 1.0]])
LENS = np.array([0.157, -0.286, -5.6e-5, 1.6e-3, 0.02])
CAMERA = CameraIntrinsics(K, LENS, (1280.0, 960.0))


def project(points):
    """The pixels of points (n, 3) in the camera's frame, by the formula that OpenCV documents for its lenses."""
    k1, k2, p1, p2, k3 = LENS
    pixels = []
    for x, y in points[:, :2] / points[:, 2:]:
        r2 = x**2 + y**2
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        x_lens = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
        y_lens = y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
        pixels.append([K[0, 0] * x_lens + K[0, 2], K[1, 1] * y_lens + K[1, 2]])
    return np.array(pixels)


def test_the_reference_is_opencvs_projection():
    """Numbers of cv2.projectPoints, OpenCV 5.0."""
    points = np.array([[0.0, 0.0, 1.0], [-0.6, -0.4, 1.0], [0.55, -0.45, 1.0], [1.2, 0.9, 2.0]])
    expected = [
        [637.0, 470.0],
        [28.663328640000145, 71.89511744000004],
        [1199.27881838875, 19.69000468624995],
        [1245.878186584375, 916.9164595929687],
    ]
    np.testing.assert_allclose(project(points), expected, rtol=1e-14)


def test_ideal_pixels_are_those_without_distortion(rng):
    pixels = rng.uniform(0.0, [1280.0, 960.0], (300, 2))
    ideal = CAMERA.ideal_pixels(pixels)
    again = project(np.column_stack([(ideal - K[:2, 2]) / K[0, 0], np.ones(300)]))
    np.testing.assert_allclose(again, pixels, atol=2e-4)
    assert CAMERA.ideal_pixels(pixels.reshape(3, 100, 2)).shape == (3, 100, 2)
    assert CAMERA.ideal_pixels(np.empty((0, 2))).shape == (0, 2)


def test_a_square_on_the_ceiling_is_where_the_ceiling_camera_says(rng):
    """From corners in three dimensions, projected with distortion, back to the marker's pose."""
    height, marker = 2.4, np.array([0.6, -0.4, 0.7])
    camera = CAMERA.ceiling_camera(height, (0.1, 0.2, 0.3))
    robots = np.column_stack([rng.uniform(-0.2, 0.4, (20, 2)), rng.uniform(-3, 3, 20)])
    square = 0.07 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    for robot in robots:
        lens = camera.map_from_camera(robot)
        turn = marker[2] - lens[2]
        c, s = np.cos(lens[2]), np.sin(lens[2])
        middle = np.array([[c, s], [-s, c]]) @ (marker[:2] - lens[:2])
        flat = middle + square @ np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])
        points = np.column_stack([flat, np.full(4, height)])
        image = image_of_corners(CAMERA.ideal_pixels(project(points)))
        found = camera.robot_poses(image, marker)
        np.testing.assert_allclose(found[:2], robot[:2], atol=1e-5)
        assert abs(wrap_angle(found[2] - robot[2])) < 1e-5


def test_the_centre_of_a_tilted_marker_is_where_its_diagonals_cross():
    """The mean of the corners is not the image of the centre when the camera tilts."""
    corners = np.array([[-1.0, -1.0, 5.0], [1.0, -1.0, 5.5], [1.0, 1.0, 6.0], [-1.0, 1.0, 5.5]])
    image = image_of_corners(corners[:, :2] / corners[:, 2:])
    np.testing.assert_allclose(image[:2], [0.0, 0.0], atol=1e-15)
    assert np.abs(np.mean(corners[:, :2] / corners[:, 2:], axis=0)).max() > 1e-3


@pytest.mark.parametrize("turn", [0.0, 1.0, np.pi, -2.0])
def test_the_angle_of_a_marker_is_that_of_its_upper_edge(turn):
    square = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    image = image_of_corners(100.0 + 10.0 * square @ rotation.T)
    np.testing.assert_allclose(image, [100.0, 100.0, turn], atol=1e-12)


BAD_CORNERS = {
    "nan": ([[0.0, 0.0], [1.0, np.nan], [1.0, 1.0], [0.0, 1.0]], "corners: expected finite numbers"),
    "three": ([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], r"corners: expected finite numbers of shape .*got shape \(3, 2\)"),
    "crossed": ([[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]], "corners: expected a convex four-sided marker, got"),
    "one point": (np.zeros((4, 2)), "corners: expected a convex four-sided marker, got"),
}


@pytest.mark.parametrize("case", BAD_CORNERS)
def test_corners_that_are_none_of_a_marker_are_refused(case):
    corners, message = BAD_CORNERS[case]
    with pytest.raises(InvalidInputError, match=message):
        image_of_corners(corners)


BAD_CAMERAS = {
    "focal length": ((np.diag([500.0, 0.0, 1.0]), (), (640, 480)), "matrix: expected positive focal lengths"),
    "skew": (([[5.0, 1.0, 3.0], [0.0, 5.0, 3.0], [0.0, 0.0, 1.0]], (), (640, 480)), "matrix: expected .*fx, 0, cx"),
    "shape": ((np.eye(2), (), (640, 480)), "matrix: expected 3 x 3 finite numbers"),
    "distortion": ((K, [0.1] * 6, (640, 480)), "distortion: expected at most 5 finite numbers"),
    "size": ((K, (), (640, -1)), r"image_size: expected two positive numbers of pixels, got \[640.0, -1.0\]"),
}


@pytest.mark.parametrize("case", BAD_CAMERAS)
def test_impossible_cameras_are_refused_by_name_and_value(case):
    arguments, message = BAD_CAMERAS[case]
    with pytest.raises(InvalidInputError, match=message):
        CameraIntrinsics(*arguments)


def test_pixels_without_an_undistorted_place_are_refused():
    strong = CameraIntrinsics(K, [-0.5], (1280.0, 960.0))
    with pytest.raises(InvalidInputError, match=r"pixels: the distortion has no inverse at \[\[5000.0, 470.0\]"):
        strong.ideal_pixels([[640.0, 470.0], [5000.0, 470.0]])
    with pytest.raises(InvalidInputError, match="pixels: expected finite numbers"):
        CAMERA.ideal_pixels([np.nan, 3.0])
    with pytest.raises(InvalidInputError, match="pixels: expected finite numbers"):
        CAMERA.ideal_pixels([1.0, 2.0, 3.0])
