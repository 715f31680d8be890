"""The nearest landmark in a cone, by hand and beside points sampled on discs."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import compose
from beamfield.maps.landmark_cone import LandmarkCones
from beamfield.maps.landmarks import LandmarkMap
from beamfield.sensors import RangeFinder


def sonar(*bearings_deg, opening_deg=30.0, max_range=10.0):
    return RangeFinder.from_bearings(np.radians(bearings_deg), max_range, opening_angle=np.radians(opening_deg))


def test_the_nearest_landmark_in_the_cone_counts():
    cones = LandmarkCones(LandmarkMap([[4.0, 1.0], [3.0, -0.5], [2.0, 2.0], [-1.0, 0.0]]))
    ranges = cones.expected_ranges([0.0, 0.0, 0.0], sonar(0, 14, 50, 180, -90))
    assert ranges == pytest.approx([np.hypot(3, 0.5), np.hypot(4, 1), np.hypot(2, 2), 1.0, 10.0])


def test_landmarks_beyond_max_range_are_not_seen():
    cones = LandmarkCones(LandmarkMap([[4.0, 0.0]]))
    assert cones.expected_ranges([0.0, 0.0, 0.0], sonar(0, max_range=3.9)) == 3.9
    assert cones.expected_ranges([0.0, 0.0, 0.0], sonar(0, max_range=4.1)) == 4.0


def test_a_point_on_the_axis_behind_a_beam_is_not_seen():
    cones = LandmarkCones(LandmarkMap([[-2.0, 0.0]]))
    assert cones.expected_ranges([0.0, 0.0, 0.0], sonar(0, opening_deg=0.0)) == 10.0
    assert cones.expected_ranges([-4.0, 0.0, 0.0], sonar(0, opening_deg=0.0)) == 2.0


def test_a_round_landmark_is_seen_at_its_surface_as_soon_as_a_part_is_in_the_cone():
    cones = LandmarkCones(LandmarkMap([[2.0, 0.0]]), radius=0.5)
    assert cones.expected_ranges([0.0, 0.0, 0.0], sonar(0)) == 1.5
    # Edges of a beam that passes the centre at 0.3 m: 2 cos a - sqrt(0.5^2 - 0.3^2), with sin a = 0.15.
    turned = RangeFinder([[0.0, 0.0, np.arcsin(0.15)]], 10.0)
    assert cones.expected_ranges([0.0, 0.0, 0.0], turned) == pytest.approx(2 * np.sqrt(1 - 0.15**2) - 0.4)
    # The disc ends at asin(0.25) = 14.5 degrees.
    assert cones.expected_ranges([0.0, 0.0, 0.0], sonar(29, -29)).max() < 2.0
    assert cones.expected_ranges([0.0, 0.0, 0.0], sonar(30, -30)).tolist() == [10.0, 10.0]
    assert cones.expected_ranges([1.6, 0.1, 3.0], sonar(0, 90)).tolist() == [0.0, 0.0]


def test_round_landmarks_agree_with_sampled_discs(rng):
    angle = np.linspace(0, 2 * np.pi, 4001)
    for _ in range(60):
        centre, radius = rng.uniform(-3, 3, 2), rng.uniform(0.1, 1.0)
        width = rng.uniform(1, 170)
        found = LandmarkCones(LandmarkMap([centre]), [radius]).expected_ranges([0, 0, 0.4], sonar(0, opening_deg=width))
        rim = centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])
        bearing = np.angle(np.exp(1j * (np.arctan2(rim[:, 1], rim[:, 0]) - 0.4)))
        inside = np.abs(bearing) <= np.radians(width) / 2
        wanted = np.hypot(*rim[inside].T).min() if inside.any() else 10.0
        if np.hypot(*centre) <= radius:
            wanted = 0.0
        # A rim nearly along an edge moves fast along it: half a step of the rim, times that speed.
        assert found[0] == pytest.approx(wanted, abs=0.05)
        assert found[0] <= wanted + 1e-9


def test_moving_map_and_poses_together_changes_nothing(rng):
    points = rng.uniform(-3, 3, (20, 2))
    poses = np.column_stack([rng.uniform(-3, 3, (50, 2)), rng.uniform(-4, 4, 50)])
    finder = RangeFinder([[0.1, 0.0, 0.2], [0.0, -0.2, 2.0]], 5.0, opening_angle=0.6)
    move = np.array([30.0, -12.0, 1.1])
    moved = compose(move, np.column_stack([points, np.zeros(20)]))[:, :2]
    here = LandmarkCones(LandmarkMap(points), 0.05).expected_ranges(poses, finder)
    there = LandmarkCones(LandmarkMap(moved), 0.05).expected_ranges(compose(move, poses), finder)
    np.testing.assert_allclose(there, here, atol=1e-9)
    assert 0.2 < (here < 5.0).mean() < 0.95


@pytest.mark.parametrize(
    ("radius", "message"),
    [
        (-0.1, "radius: expected finite metres >= 0, got -0.1"),
        ([0.1, np.nan], "radius: expected finite metres >= 0, got nan"),
        ([0.1], r"radius: expected one number or 2, got shape \(1,\)"),
    ],
)
def test_bad_radii_are_an_error(radius, message):
    with pytest.raises(InvalidInputError, match=message):
        LandmarkCones(LandmarkMap([[0.0, 1.0], [1.0, 0.0]]), radius)
