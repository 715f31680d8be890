"""The three answers of exercise 1, section 6.10."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import wrap_angle
from beamfield.models.ceiling_camera import CeilingCamera
from tests.reference.marker_exercise import image_by_projection

CAMERAS = [
    CeilingCamera(500.0, 2.5),
    CeilingCamera(612.3, 2.81, (0.13, -0.07, np.pi / 2), (321.7, 238.2), (640.0, 480.0)),
    CeilingCamera(80.0, 9.0, (-1.2, 0.4, -2.9), (-5.0, 3.0)),
]


def draw(rng, n=200):
    """Return robot poses and markers near them."""
    robots = rng.uniform([-10.0, -10.0, -np.pi], [10.0, 10.0, np.pi], (n, 3))
    return robots, robots + rng.uniform(-3.0, 3.0, (n, 3))


def assert_same_poses(actual, desired, *, scale=1.0):
    """Compare places to 1e-12 of `scale` (tens of metres, or as many pixels) and angles to 1e-12."""
    np.testing.assert_allclose(actual[..., :2], desired[..., :2], rtol=0.0, atol=1e-12 * scale)
    assert np.abs(wrap_angle(actual[..., 2] - desired[..., 2])).max() < 1e-12


@pytest.mark.parametrize("camera", CAMERAS, ids=["plain", "mounted", "wide"])
class TestRoundTrips:
    def test_the_marker_is_where_its_image_says(self, camera, rng):
        robots, markers = draw(rng)
        assert_same_poses(camera.marker_poses(camera.image_of(markers, robots), robots), markers)

    def test_the_robot_is_where_the_image_of_a_known_marker_says(self, camera, rng):
        robots, markers = draw(rng)
        assert_same_poses(camera.robot_poses(camera.image_of(markers, robots), markers), robots)

    def test_image_coordinates_come_back_through_the_marker_and_through_the_robot(self, camera, rng):
        robots, markers = draw(rng)
        image = rng.uniform([0.0, 0.0, -np.pi], [640.0, 480.0, np.pi], (200, 3))
        tolerance = max(1.0, camera.scale)
        assert_same_poses(camera.image_of(camera.marker_poses(image, robots), robots), image, scale=tolerance)
        assert_same_poses(camera.image_of(markers, camera.robot_poses(image, markers)), image, scale=tolerance)

    def test_the_image_is_that_of_a_pinhole_in_three_dimensions(self, camera, rng):
        robots, markers = draw(rng, 50)
        lens = (camera.mount, camera.focal_length, camera.height, camera.principal_point)
        expected = [image_by_projection(m, r, *lens) for m, r in zip(markers, robots, strict=True)]
        actual = camera.image_of(markers, robots)
        np.testing.assert_allclose(actual[:, :2], np.array(expected)[:, :2], rtol=1e-10, atol=1e-9)
        assert np.abs(wrap_angle(actual[:, 2] - np.array(expected)[:, 2])).max() < 1e-9


def test_numbers_worked_out_by_hand():
    """Camera 0.1 m before the robot's centre, image top to the front; 200 pixels per metre."""
    camera = CeilingCamera(500.0, 2.5, (0.1, 0.0, np.pi / 2), (320.0, 240.0))
    robot = [2.0, 1.0, np.pi / 2]  # looks along +y: the lens is at (2.0, 1.1), +u along -x, +v along -y
    image = camera.image_of([1.5, 1.3, np.pi], robot)
    np.testing.assert_allclose(image, [320.0 + 100.0, 240.0 - 40.0, 0.0], atol=1e-12)


def test_a_marker_ahead_shows_above_the_principal_point_when_the_top_is_to_the_front():
    camera = CeilingCamera(500.0, 2.5, (0.0, 0.0, np.pi / 2), (320.0, 240.0))
    ahead, left = camera.image_of([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [0.0, 0.0, 0.0])
    assert ahead[1] < 240.0
    assert ahead[0] == pytest.approx(320.0)
    # The camera lies on its back, so the robot's left is the image's right.
    assert left[0] > 320.0


def test_a_displacement_is_projected_to_f_over_h_of_it():
    camera = CeilingCamera(400.0, 3.2, (0.2, 0.1, 1.0))
    a, b = camera.image_of([[1.0, 2.0, 0.0], [1.3, 2.4, 0.0]], [0.5, 0.5, 0.7])
    assert np.hypot(*(b - a)[:2]) == pytest.approx(0.5 * 400.0 / 3.2, rel=1e-12)


def test_many_robots_and_markers_broadcast():
    camera = CAMERAS[1]
    robots, markers = np.zeros((5, 1, 3)), np.ones((7, 3))
    assert camera.image_of(markers, robots).shape == (5, 7, 3)
    assert camera.marker_poses(np.zeros((7, 3)), robots).shape == (5, 7, 3)
    assert camera.robot_poses(np.zeros(3), markers).shape == (7, 3)
    assert camera.image_of(np.empty((0, 3)), [0.0, 0.0, 0.0]).shape == (0, 3)


def test_the_image_ends_at_its_size():
    camera = CAMERAS[1]
    image = [[0.0, 0.0, 0.0], [639.9, 479.9, 1.0], [640.0, 3.0, 0.0], [3.0, 480.0, 0.0], [-0.1, 3.0, 0.0]]
    assert camera.sees(image).tolist() == [True, True, False, False, False]
    assert CAMERAS[0].sees([-1e9, 1e9, 0.0])


def test_arguments_are_left_alone():
    image, marker = np.array([420.0, 240.0, 0.3]), np.array([1.0, 2.0, 0.3])
    CAMERAS[1].marker_poses(image, [0.0, 0.0, 0.0])
    CAMERAS[1].robot_poses(image, marker)
    assert image.tolist() == [420.0, 240.0, 0.3]
    assert marker.tolist() == [1.0, 2.0, 0.3]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"focal_length": 0.0}, "focal_length: expected a positive, finite number of pixels, got 0.0"),
        ({"focal_length": np.nan}, "focal_length: expected a positive, finite number of pixels, got nan"),
        ({"height": -2.5}, "height: expected a positive, finite number of metres, got -2.5"),
        ({"height": np.inf}, "height: expected a positive, finite number of metres, got inf"),
        ({"mount": (0.0, np.nan, 0.0)}, "mount: expected finite numbers, got nan"),
        ({"mount": np.zeros((2, 3))}, r"mount: expected shape \(3,\), got \(2, 3\)"),
        ({"principal_point": (np.inf, 0.0)}, "principal_point: expected two finite numbers of pixels, got .inf"),
        ({"principal_point": (1.0, 2.0, 3.0)}, "principal_point: expected two finite numbers"),
        ({"image_size": (640.0, 0.0)}, "image_size: expected positive numbers of pixels, got .640.0, 0.0"),
    ],
)
def test_impossible_cameras_are_refused_by_name_and_value(changes, message):
    with pytest.raises(InvalidInputError, match=message):
        CeilingCamera(**{"focal_length": 500.0, "height": 2.5, **changes})


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda c: c.marker_poses([1.0, np.nan, 0.0], [0.0, 0.0, 0.0]), "image: expected finite numbers, got nan"),
        (lambda c: c.image_of([np.inf, 0.0, 0.0], [0.0, 0.0, 0.0]), "markers: expected finite numbers, got inf"),
        (lambda c: c.image_of([1.0, 0.0, 0.0], [0.0, 0.0]), r"poses: expected shape \(\.\.\., 3\), got \(2,\)"),
        (lambda c: c.robot_poses([1.0, 2.0, np.nan], [0.0, 0.0, 0.0]), "image: expected finite numbers, got nan"),
        (lambda c: c.robot_poses([1.0, 2.0, 0.0], [np.nan, 0.0, 0.0]), "markers: expected finite numbers, got nan"),
        (lambda c: c.sees([np.nan, 2.0, 0.0]), "image: expected finite numbers, got nan"),
    ],
)
def test_numbers_that_are_none_are_refused_by_name_and_value(call, message):
    with pytest.raises(InvalidInputError, match=message):
        call(CAMERAS[0])
