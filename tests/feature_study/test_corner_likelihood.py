"""The likelihood of corners over poses is the mixture that its docstring states, and a density."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.feature_study.corner_likelihood import CornerLikelihood
from benchmarks.feature_study.field_of_view import FieldOfView, corners_in_sight
from benchmarks.feature_study.noise import TYPICAL_CORNERS, CornerNoise, LineNoise
from benchmarks.rooms import drawn_room
from scipy.stats import gamma, norm

from beamfield.errors import InvalidInputError
from beamfield.features.corners import Corner
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.line import LineParameters
from beamfield.sensors import RangeFinder

NICHES = [(0, 0), (6, 0), (6, 4), (4, 4), (4, 5), (3, 5), (3, 4), (0, 4)]
HALF_TURN = FieldOfView(0.0, np.pi / 2)
NOISE = CornerNoise(0.1, 0.02, 0.2, 0.2, 3.0, 0.8, 3.0, 0.8, 0.4, 0.4, 4.0, 0.3)


def corner(measurement, variances=(0.0004, 0.0001, 0.0025)):
    return Corner(np.array(measurement, dtype=float), np.diag(variances), np.arange(3))


@pytest.fixture(scope="module")
def room():
    grid, _, corners = drawn_room(NICHES)
    return grid, corners


def slow_density(seen, pose, corners, in_sight, noise, half, cell):
    """Transcribe the docstring, one corner of the map after the other."""
    distance, bearing, opening = seen.measurement
    side, step = cell
    sigma = [
        np.sqrt(seen.covariance[0, 0] + noise.sigma_place**2 + side**2 / 12),
        np.sqrt(
            seen.covariance[1, 1]
            + (noise.sigma_place**2 + side**2 / 12) / distance**2
            + noise.sigma_heading**2
            + step**2 / 12
        ),
        np.sqrt(seen.covariance[2, 2] + noise.sigma_opening**2),
    ]
    clutter = gamma.pdf(distance, noise.clutter_shape, scale=noise.clutter_scale) / (2 * half)
    clutter *= (1 - noise.convex_share) * norm.pdf(opening, np.pi / 2, noise.clutter_opening) + (
        noise.convex_share * norm.pdf(opening, 1.5 * np.pi, noise.clutter_opening)
    )
    above, below = noise.clutter * clutter, noise.clutter
    for j, (x, y) in enumerate(corners.positions):
        r = np.hypot(x - pose[0], y - pose[1])
        phi = np.angle(np.exp(1j * (np.arctan2(y - pose[1], x - pose[0]) - pose[2])))
        seen_well = np.exp(-(r**2) / (2 * noise.reach**2)) * in_sight[j]
        errors = [r - distance, np.angle(np.exp(1j * (phi - bearing))), corners.signatures[j] - opening]
        density = sum(
            share * np.prod([norm.pdf(e, scale=wide * s) for e, s in zip(errors, sigma, strict=True)])
            for share, wide in ((1 - noise.tail_share, 1.0), (noise.tail_share, noise.tail_factor))
        )
        above += (seen_well + noise.hidden / len(corners)) * density
        below += seen_well * (abs(phi) <= half) + noise.hidden / len(corners)
    return above / below


def test_it_is_the_mixture_corner_by_corner(room):
    grid, corners = room
    rng = np.random.default_rng(2)
    positions, headings = rng.uniform([0.5, 0.5], [5.5, 3.5], (5, 2)), rng.uniform(-np.pi, np.pi, 4)
    seen = [corner([2.0, 0.3, 1.6]), corner([3.1, -1.0, 4.6]), corner([1.2, 1.4, 1.5])]
    cell = (0.2, 0.1)
    likelihood = CornerLikelihood.on(grid, corners, positions, HALF_TURN, cell)
    values = likelihood.log_likelihood(seen, headings, replace(NOISE, exponent=0.5))
    for i, position in enumerate(positions):
        for h, heading in enumerate(headings):
            slow = [
                slow_density(one, [*position, heading], corners, likelihood.in_sight[i], NOISE, np.pi / 2, cell)
                for one in seen
            ]
            np.testing.assert_allclose(values[i, h], 0.5 * np.log(slow).sum(), atol=1e-4)


def test_it_is_a_density_over_range_bearing_and_opening():
    corners = LandmarkMap([[2.0, 0.5], [3.0, -0.8]], signatures=[np.pi / 2, 1.5 * np.pi])
    # Wide, so that a coarse sum is exact; the extraction adds next to nothing.
    noise = replace(NOISE, sigma_place=0.2, sigma_heading=0.2, sigma_opening=0.5, tail_factor=1.2, clutter_opening=0.6)
    noise = replace(noise, clutter_scale=0.4)
    likelihood = CornerLikelihood(corners, np.ones((1, 2), dtype=bool), np.zeros((1, 2)), HALF_TURN)
    bearings = (np.arange(12) + 0.5) * np.pi / 12 - np.pi / 2
    total = sum(
        np.exp(likelihood.log_likelihood([corner([r, phi, opening], (1e-4, 1e-4, 1e-4))], np.zeros(1), noise)[0, 0])
        for r in np.arange(0.175, 6.0, 0.35)
        for phi in bearings
        for opening in np.arange(-1.0, 8.0, 0.6)
    )
    assert total * 0.35 * (np.pi / 12) * 0.6 == pytest.approx(1.0, abs=0.02)


def test_walls_hide_corners(room):
    grid, corners = room
    nearest = int(np.hypot(*(corners.positions - [3.0, 5.0]).T).argmin())  # the far end of the niche
    seen = corners_in_sight(grid, corners, np.array([[3.5, 2.0], [0.5, 3.5]]))
    assert seen[:, nearest].tolist() == [True, False]


@pytest.mark.parametrize(
    ("bearings", "centre", "half"),
    [
        (np.radians(np.arange(-90.0, 90.5)), 0.0, np.pi / 2),
        (np.radians(np.arange(90.0, 270.5)), np.pi, np.pi / 2),
        (np.radians(np.arange(0.0, 360.0)), 0.0, np.pi),
    ],
)
def test_the_view_is_where_the_beams_are(bearings, centre, half):
    view = FieldOfView.of(RangeFinder.from_bearings(bearings, 10.0))
    assert abs(np.angle(np.exp(1j * (view.centre - centre)))) < 1e-9
    assert view.half == pytest.approx(half, abs=0.01)
    assert view.holds(np.array([centre])).all()


def test_without_corners_every_pose_is_as_likely(room):
    grid, corners = room
    likelihood = CornerLikelihood.on(grid, corners, np.array([[1.0, 1.0]]), HALF_TURN)
    assert likelihood.log_likelihood([], np.zeros(3), TYPICAL_CORNERS).tolist() == [[0.0, 0.0, 0.0]]


def test_bad_input_is_refused(room):
    grid, corners = room
    with pytest.raises(InvalidInputError, match="opening angles as signatures, got kind 'none'"):
        CornerLikelihood.on(grid, LandmarkMap([[1.0, 1.0]]), np.array([[1.0, 1.0]]), HALF_TURN)
    with pytest.raises(InvalidInputError, match=r"in_sight: expected shape \(1, 8\), got \(2, 8\)"):
        CornerLikelihood(corners, np.ones((2, 8), dtype=bool), np.ones((1, 2)), HALF_TURN)
    with pytest.raises(InvalidInputError, match="sigma_place: expected a positive, finite number, got 0"):
        replace(NOISE, sigma_place=0.0)
    with pytest.raises(InvalidInputError, match="tail_share: expected a share below 1"):
        replace(NOISE, tail_share=1.0)
    with pytest.raises(InvalidInputError, match="tail_factor: expected at least 1"):
        replace(NOISE, tail_factor=0.5)
    with pytest.raises(InvalidInputError, match=r"exponent: expected a number in \(0, 1\], got 1.5"):
        replace(NOISE, exponent=1.5)
    with pytest.raises(InvalidInputError, match=r"exponent: expected a number in \(0, 1\], got 0"):
        LineNoise(LineParameters(0.1, 0.1), 0.0)
