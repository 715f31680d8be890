"""What is drawn from known noise of features comes back; shared errors lower the exponent."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.feature_study.corner_likelihood import CornerLikelihood
from benchmarks.feature_study.field_of_view import FieldOfView, corners_in_sight
from benchmarks.feature_study.learning import (
    CornerSightings,
    learn_corner_noise,
    learn_exponent,
    learn_line_noise,
)
from benchmarks.feature_study.noise import TYPICAL_LINES, CornerNoise
from benchmarks.feature_study.posteriors import (
    corner_likelihood,
    learn_feature_noise,
    posterior_of_corners,
    posterior_of_lines,
)
from benchmarks.rooms import drawn_room

from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.features.corners import Corner
from beamfield.features.map_features import MapFeatures
from beamfield.geometry import wrap_angle
from beamfield.localization.pose_posterior import PoseLattice
from beamfield.maps.landmarks import LandmarkMap
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.line import LineParameters
from beamfield.models.line_detections import LineDetections
from beamfield.sensors import RangeFinder, SensorLog

NICHES = [(0, 0), (6, 0), (6, 4), (4, 4), (4, 5), (3, 5), (3, 4), (0, 4)]
ALL_AROUND = FieldOfView(0.0, np.pi)
NOISE = CornerNoise(0.05, 0.02, 0.1, 0.15, 4.0, 2.0, 4.0, 0.5, 0.5, 0.3, 3.0, 1e-3)
EXTRACTION = np.array([0.02, 0.01, 0.05])


@pytest.fixture(scope="module")
def room():
    grid, walls, corners = drawn_room(NICHES)
    return grid, walls, corners


def draw_corner(pose, corners, in_sight, rng, noise=NOISE):
    """Draw one corner as the docstring of CornerNoise says (nothing hidden is seen)."""
    away = corners.positions - pose[:2]
    distance = np.hypot(*away.T)
    weight = np.append(in_sight * np.exp(-0.5 * (distance / noise.reach) ** 2), noise.clutter)
    j = rng.choice(len(weight), p=weight / weight.sum())
    if j == len(corners):
        opening = np.pi * (1.5 if rng.random() < noise.convex_share else 0.5) + noise.clutter_opening * rng.normal()
        value = [rng.gamma(noise.clutter_shape, noise.clutter_scale), rng.uniform(-np.pi, np.pi), opening]
    else:
        wide = noise.tail_factor if rng.random() < noise.tail_share else 1.0
        r, phi = distance[j], np.arctan2(away[j, 1], away[j, 0]) - pose[2]
        sigma = np.hypot(EXTRACTION, [noise.sigma_place, np.hypot(noise.sigma_place / r, noise.sigma_heading), 0.1])
        value = np.array([r, phi, corners.signatures[j]]) + wide * sigma * rng.normal(size=3)
        value[1] = wrap_angle(value[1])
    value[0] = max(value[0], 0.05)
    return Corner(np.array(value), np.diag(EXTRACTION**2), np.arange(3))


def random_poses(n, rng):
    return np.column_stack([rng.uniform(0.5, 5.5, n), rng.uniform(0.5, 3.5, n), rng.uniform(-np.pi, np.pi, n)])


@pytest.fixture(scope="module")
def sightings(room):
    grid, _, corners = room
    rng = np.random.default_rng(4)
    poses = random_poses(250, rng)
    sight = corners_in_sight(grid, corners, poses[:, :2])
    scans = [[draw_corner(pose, corners, seen, rng) for _ in range(3)] for pose, seen in zip(poses, sight, strict=True)]
    return CornerSightings.of(scans, poses, grid, corners, ALL_AROUND), scans, poses


def test_a_sighting_is_worth_what_the_likelihood_of_poses_says(room, sightings):
    grid, _, corners = room
    table, scans, poses = sightings
    values = table.log_likelihood(NOISE)
    for t in range(5):
        at = CornerLikelihood.on(grid, corners, poses[t : t + 1, :2], ALL_AROUND)
        for k in range(3):
            one = at.log_likelihood([scans[t][k]], poses[t : t + 1, 2], NOISE)[0, 0]
            assert values[3 * t + k] == pytest.approx(one, abs=1e-4)


def test_known_noise_comes_back(sightings):
    table = sightings[0]
    learned = learn_corner_noise(table)
    for name, tolerance in {
        "sigma_place": 0.2, "sigma_opening": 0.2, "clutter": 0.25, "clutter_shape": 0.2, "clutter_scale": 0.2,
        "convex_share": 0.15, "clutter_opening": 0.1, "reach": 0.35, "tail_factor": 0.35,
    }.items():  # fmt: skip
        assert getattr(learned, name) == pytest.approx(getattr(NOISE, name), rel=tolerance), name
    assert learned.tail_share == pytest.approx(NOISE.tail_share, abs=0.08)
    assert table.log_likelihood(learned).sum() > table.log_likelihood(NOISE).sum() - 3.0


def test_logs_are_stacked_sighting_by_sighting(sightings):
    table = sightings[0]
    both = CornerSightings.stacked([table, table])
    np.testing.assert_array_equal(both.log_likelihood(NOISE), np.tile(table.log_likelihood(NOISE), 2))


def test_posteriors_hold_poses_as_often_as_they_say(room):
    grid, _, corners = room
    lattice = PoseLattice.over_map(grid, resolution=0.25, headings=40)
    finder = RangeFinder.from_bearings(np.radians(np.arange(0.0, 360.0, 2.0)), 10.0)
    likelihood = corner_likelihood(grid, MapFeatures(None, corners), lattice, finder)
    rng = np.random.default_rng(8)
    centres, above = lattice.centres(), []
    for pose in random_poses(60, rng):
        sight = corners_in_sight(grid, corners, pose[None, :2])[0]
        seen = [draw_corner(pose, corners, sight, rng) for _ in range(3)]
        posterior = posterior_of_corners(seen, likelihood, lattice, NOISE)
        cell = np.hypot(*(centres - pose[:2]).T).argmin()
        heading = np.abs(wrap_angle(lattice.headings - pose[2])).argmin()
        value = posterior.log_mass[cell, heading]
        above.append(np.exp(posterior.log_mass[posterior.log_mass > value]).sum())
    # Three standard errors of 60 draws.
    assert np.mean(np.array(above) < 0.95) > 0.95 - 3.0 * np.sqrt(0.95 * 0.05 / 60)
    assert abs(np.mean(np.array(above) < 0.5) - 0.5) < 3.0 * np.sqrt(0.25 / 60)


def test_an_exponent_undoes_evidence_that_is_counted_twice():
    rng = np.random.default_rng(1)
    place, others = rng.uniform(0.0, 40.0, 150), np.linspace(0.0, 40.0, 81)
    seen = place + rng.normal(size=150)
    honest = -0.5 * (seen - place) ** 2, -0.5 * (seen[:, None] - others) ** 2
    assert learn_exponent(honest[0].tolist(), list(honest[1])) > 0.85
    assert learn_exponent((4.0 * honest[0]).tolist(), list(4.0 * honest[1])) == pytest.approx(0.25, abs=0.04)


def test_noise_of_walls_comes_back(room):
    _, walls, _ = room
    rng = np.random.default_rng(3)
    poses, scans = random_poses(60, rng), []
    for pose in poses:
        chosen = rng.integers(len(walls), size=4)
        rho, alpha = walls.lines[chosen].T
        d = rho - pose[0] * np.cos(alpha) - pose[1] * np.sin(alpha) + 0.05 * rng.normal(size=4)
        phi = np.where(d < 0.0, alpha + np.pi, alpha) - pose[2] + 0.02 * rng.normal(size=4)
        lines = np.column_stack([np.abs(d), wrap_angle(phi)])
        clutter = rng.random(4) < 0.3
        lines[clutter] = np.column_stack([rng.uniform(0.0, 8.0, 4), rng.uniform(-np.pi, np.pi, 4)])[clutter]
        scans.append(LineDetections(lines, np.tile(np.diag([1e-6, 1e-6]), (4, 1, 1))))
    learned = learn_line_noise(scans, poses, walls, LineParameters(0.02, 0.01, 0.2, 80.0), None)
    assert learned.sigma_rho == pytest.approx(0.05, rel=0.25)
    assert learned.sigma_alpha == pytest.approx(0.02, rel=0.25)
    assert learned.spurious_rate == pytest.approx(0.3, abs=0.12)
    assert learned.max_range < 8.0


def test_without_features_the_posterior_is_the_prior(room):
    grid, walls, _ = room
    lattice = PoseLattice.over_map(grid, resolution=1.0, headings=4)
    finder = RangeFinder.from_bearings(np.radians(np.arange(0.0, 360.0, 2.0)), 10.0)
    assert corner_likelihood(grid, MapFeatures(walls, None), lattice, finder) is None
    for posterior in (
        posterior_of_corners([], None, lattice, NOISE),
        posterior_of_lines([], walls, lattice, TYPICAL_LINES),
    ):
        assert posterior.information == pytest.approx(0.0, abs=1e-9)


def test_too_little_is_refused(room):
    grid, walls, corners = room
    none = CornerSightings.of([[]], np.array([[1.0, 1.0, 0.0]]), grid, corners, ALL_AROUND)
    with pytest.raises(TooLittleDataError, match="noise of corners: 0 corners seen; at least 10"):
        learn_corner_noise(none)
    with pytest.raises(TooLittleDataError, match="noise of walls: 0 walls seen; at least 10"):
        learn_line_noise([], np.empty((0, 3)), walls, LineParameters(0.1, 0.1, 0.1, 5.0), 0.5)
    finder = RangeFinder.from_bearings(np.radians(np.arange(0.0, 360.0, 2.0)), 10.0)
    lattice = PoseLattice.over_map(grid, resolution=1.0, headings=4)
    features, parameters = (
        MapFeatures(walls, LandmarkMap([[1.0, 1.0]], signatures=[1.5])),
        BeamParameters(0.9, 0.0, 0.05, 0.05, 0.05, 1.0),
    )
    poses = np.array([[1.0, 1.0, 0.0], [np.nan] * 3])
    log = SensorLog(finder, np.arange(2.0), np.full((2, 180), 10.0), poses, poses)
    with pytest.raises(InvalidInputError, match="scan 1 has no reference pose"):
        learn_feature_noise(log, [0, 1], grid, parameters, features, lattice)
    with pytest.raises(TooLittleDataError, match="noise of walls: no scan shows any"):
        learn_feature_noise(log, [0], grid, parameters, features, lattice)
