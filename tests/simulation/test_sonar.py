"""Sonars among walls that mirror sound: ways by geometry, causes, rates and logs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.io.logs.carmen import read_carmen, write_carmen
from beamfield.maps.cone import ConeCaster
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.sonar import (
    SPEED_OF_SOUND,
    EchoCause,
    SonarPhysics,
    SonarReadings,
    simulate_sonar,
    sonar_ring,
)
from beamfield.simulation.sonar_log import simulate_sonar_log
from beamfield.simulation.surfaces import Surfaces, surfaces_of_grid
from beamfield.simulation.trajectory import drive_through
from tests.reference.sound_rays import returning_ways
from tests.threads import forced_threads

# Mirrors only, every echo heard, no noise.
EXACT = SonarPhysics(
    roughness=0.0, corner_echo=1.0, edge_echo=1.0, second_echo=1.0, dropout=0.0, sigma=0.0, sigma_slope=0.0,
    cross_talk=0.0, phantoms=0.0,
)  # fmt: skip
WALL = Surfaces.from_outlines([[[-50.0, 2.0], [50.0, 2.0]][::-1]], closed=False)
OFFICE = draw_floor_plan(seed=1)


def one_sensor(theta: float, opening_deg: float = 30.0, **limits: float) -> RangeFinder:
    return RangeFinder.from_bearings([theta], 5.0, opening_angle=np.radians(opening_deg), **limits)


def reading(
    walls: Surfaces,
    theta: float,
    physics: SonarPhysics = EXACT,
    place: tuple[float, float] = (0.0, 0.0),
    **sensor: float,
) -> tuple[float, EchoCause]:
    """Return the reading of one sensor and its cause."""
    found = simulate_sonar(walls, [[*place, 0.0]], one_sensor(theta, **sensor), physics)
    return float(found.ranges[0, 0]), EchoCause(found.causes[0, 0])


@pytest.mark.parametrize("off_axis_deg", [0.0, 5.0, -14.9, 14.9])
def test_a_wall_whose_perpendicular_lies_in_the_cone_gives_its_exact_distance(off_axis_deg):
    z, cause = reading(WALL, np.pi / 2 + np.radians(off_axis_deg))
    assert z == pytest.approx(2.0, abs=1e-12)
    assert cause == EchoCause.DIRECT


@pytest.mark.parametrize("off_axis_deg", [15.1, -15.1, 40.0, -60.0])
def test_a_smooth_wall_beyond_half_the_opening_angle_gives_no_echo(off_axis_deg):
    z, cause = reading(WALL, np.pi / 2 + np.radians(off_axis_deg))
    assert z == np.inf
    assert cause == EchoCause.LOST


def test_the_opening_angle_decides_which_walls_are_heard():
    assert reading(WALL, np.pi / 2 + 0.4, opening_deg=40.0)[1] == EchoCause.LOST
    assert reading(WALL, np.pi / 2 + 0.4, opening_deg=50.0) == (pytest.approx(2.0), EchoCause.DIRECT)
    assert reading(WALL, np.pi / 2, opening_deg=0.0) == (pytest.approx(2.0), EchoCause.DIRECT)


def test_where_nothing_is_in_the_cone_the_cause_says_so():
    assert reading(WALL, -np.pi / 2) == (np.inf, EchoCause.NOTHING)


def test_a_rough_wall_is_heard_from_its_nearest_point_in_the_cone():
    off_axis = np.radians(40.0)
    z, cause = reading(WALL, np.pi / 2 + off_axis, replace(EXACT, roughness=1.0))
    assert cause == EchoCause.DIFFUSE
    assert z == pytest.approx(2.0 / np.cos(off_axis - np.radians(15.0)))


def test_a_pulse_that_is_mirrored_to_a_second_wall_comes_back_too_late():
    # A mirror at 45 degrees sends the pulse up to a wall 1.5 m above where it is hit.
    walls = Surfaces.from_outlines([[[1.0, -1.0], [3.0, 1.0]], [[4.0, 1.5], [0.0, 1.5]]], closed=False)
    z, cause = reading(walls, 0.0, replace(EXACT, edge_echo=0.0), opening_deg=10.0)
    assert cause == EchoCause.SECOND
    assert z == pytest.approx(2.0 + 1.5)
    assert reading(walls, 0.0, replace(EXACT, edge_echo=0.0, second_echo=0.0), opening_deg=10.0)[1] == EchoCause.LOST


def test_an_inner_corner_returns_what_its_walls_do_not():
    room = Surfaces.from_outlines([[[-4, -4], [3, -4], [3, 2], [-4, 2]]])
    toward = np.arctan2(2.0, 3.0)
    z, cause = reading(room, toward, opening_deg=20.0)
    assert (z, cause) == (pytest.approx(np.hypot(3.0, 2.0)), EchoCause.CORNER)
    assert reading(room, toward, replace(EXACT, corner_echo=0.0), opening_deg=20.0)[1] == EchoCause.LOST


def test_an_edge_is_heard_from_both_sides_but_not_from_behind():
    box = Surfaces.from_outlines([[[2, 1], [2, 3], [4, 3], [4, 1]]])
    toward = np.arctan2(1.0, 2.0)
    z, cause = reading(box, toward, opening_deg=4.0)
    assert (z, cause) == (pytest.approx(np.hypot(1.0, 2.0)), EchoCause.EDGE)
    assert reading(box, toward, replace(EXACT, edge_echo=0.0), opening_deg=4.0)[1] == EchoCause.LOST
    # The farthest edge is hidden by the box itself.
    far = reading(box, np.arctan2(3.0, 4.0), opening_deg=1.0)
    assert far[1] != EchoCause.EDGE


def test_a_round_pillar_is_heard_from_everywhere_at_its_distance():
    turn = np.linspace(0.0, -2.0 * np.pi, 12, endpoint=False)
    pillar = Surfaces.from_outlines([np.column_stack([np.cos(turn), np.sin(turn)]) * 0.3])
    for direction in np.linspace(0.0, 2.0 * np.pi, 29):
        place = (2.0 * np.cos(direction), 2.0 * np.sin(direction))
        z, cause = reading(pillar, direction + np.pi, place=place, opening_deg=10.0)
        assert cause == EchoCause.DIRECT
        assert z == pytest.approx(1.7, abs=0.3 * (1.0 - np.cos(np.pi / 12)) + 1e-9)


def test_a_wall_hides_what_is_behind_it():
    # The plate is slanted, so that it sends nothing back itself; behind it the wall would be heard.
    plate = [[0.6, 1.4], [-0.6, 1.0]]
    walls = Surfaces.from_outlines([plate, [[50.0, 2.0], [-50.0, 2.0]]], closed=False)
    assert reading(walls, np.pi / 2, replace(EXACT, edge_echo=0.0), opening_deg=10.0)[1] != EchoCause.DIRECT
    assert reading(WALL, np.pi / 2, opening_deg=10.0)[1] == EchoCause.DIRECT


@pytest.mark.parametrize("seed", range(6))
def test_ways_over_mirrors_are_those_that_rays_find(seed):
    rng = np.random.default_rng(seed)
    # A crooked room, no corner square, with a slanted plate in it.
    room = np.array([[-4.0, -2.6], [4.2, -3.1], [3.4, 2.2], [-0.5, 3.2], [-4.4, 1.9]])
    plate = np.array([[1.5, 0.2], [0.4, 0.9], [0.5, 1.1]])
    surfaces = Surfaces.from_outlines([room, plate])
    walls = np.column_stack([surfaces.starts, surfaces.ends])
    sensor = np.array([*rng.uniform([-3.0, -2.0], [0.2, 1.5]), rng.uniform(-np.pi, np.pi)])
    mirrors_only = replace(EXACT, corner_echo=0.0, edge_echo=0.0)
    half = np.radians(25.0)
    finder = RangeFinder.from_bearings([0.0], 8.0, opening_angle=2.0 * half)
    z = simulate_sonar(surfaces, [sensor], finder, mirrors_only)
    ways = {chain: length for chain, length in returning_ways(walls, sensor, half).items()
            if len(chain) < 3 or chain[0] == chain[2]}  # fmt: skip
    shortest = min((length for length in ways.values() if length < 16.0), default=np.inf)
    # Rays pass the sensor within 2 mm; a way over the round of the plate's edges is heard by its own rule.
    assert z.ranges[0, 0] == pytest.approx(0.5 * shortest, abs=3e-3)


def test_the_nearest_point_in_the_cone_is_that_of_the_cone_caster():
    poses = drive_through(OFFICE, np.arange(0.0, 60.0, 2.0)).poses
    for opening_deg in (0.0, 12.0, 30.0, 75.0):
        ring = sonar_ring(16, opening_angle=np.radians(opening_deg))
        found = simulate_sonar(surfaces_of_grid(OFFICE, smoothing=0.0), poses, ring)
        np.testing.assert_allclose(found.nearest, ConeCaster(OFFICE).expected_ranges(poses, ring), atol=1e-7)


def test_rough_walls_without_noise_give_the_ranges_that_a_cone_expects():
    poses = drive_through(OFFICE, np.arange(0.0, 30.0, 2.0)).poses
    ring = sonar_ring(8)
    found = simulate_sonar(OFFICE, poses, ring, SonarPhysics.diffuse(sigma=0.0))
    np.testing.assert_allclose(np.minimum(found.ranges, ring.max_range), found.nearest)
    silent = found.nearest >= ring.max_range
    assert (found.causes[silent] == EchoCause.NOTHING).all()


def facing_pair() -> RangeFinder:
    """Two sensors 2 m apart, both turned towards the place on the wall between them: too far for their own echoes."""
    mounts = [[-1.0, 0.0, np.pi / 2 - np.radians(30.0)], [1.0, 0.0, np.pi / 2 + np.radians(30.0)]]
    return RangeFinder(np.array(mounts), 5.0, opening_angle=np.radians(30.0))


def test_cross_talk_is_half_the_way_from_the_other_sensor_when_both_fire_at_once():
    silent = simulate_sonar(WALL, [[0.0, 0.0, 0.0]], facing_pair(), EXACT)
    assert (silent.causes == EchoCause.LOST).all()
    at_once = replace(EXACT, cross_talk=1.0, firing_groups=1, firing_interval=0.1)
    found = simulate_sonar(WALL, [[0.0, 0.0, 0.0]], facing_pair(), at_once)
    # Over the wall half-way: 1 m to the side, 2 m up.
    np.testing.assert_allclose(found.ranges, np.hypot(1.0, 2.0))
    assert (found.causes == EchoCause.CROSS_TALK).all()


def test_cross_talk_needs_the_other_sensor():
    alone = facing_pair().subset([0])
    found = simulate_sonar(WALL, [[0.0, 0.0, 0.0]], alone, replace(EXACT, cross_talk=1.0, firing_groups=1))
    assert found.causes[0, 0] == EchoCause.LOST


def test_a_pulse_sent_earlier_is_taken_for_a_short_range_and_one_sent_later_for_a_long_one():
    interval = 0.004
    physics = replace(EXACT, cross_talk=1.0, firing_groups=20, firing_interval=interval)
    z = simulate_sonar(WALL, [[0.0, 0.0, 0.0]], facing_pair(), physics).ranges[0]
    late = 0.5 * SPEED_OF_SOUND * interval
    # Sensor 0 fires first: it hears sensor 1 that much later, and is heard that much earlier.
    np.testing.assert_allclose(z, np.hypot(1.0, 2.0) + np.array([late, -late]))


def test_slow_firing_ends_cross_talk():
    poses = drive_through(OFFICE, np.arange(0.0, 20.0, 0.5)).poses
    ring = sonar_ring(16)
    fast = simulate_sonar(OFFICE, poses, ring, SonarPhysics(cross_talk=1.0, firing_interval=0.004, firing_groups=8))
    slow = simulate_sonar(OFFICE, poses, ring, SonarPhysics(cross_talk=1.0, firing_interval=0.06, firing_groups=None))
    assert (fast.causes == EchoCause.CROSS_TALK).mean() > 0.2
    assert (slow.causes == EchoCause.CROSS_TALK).sum() == 0


@pytest.fixture(scope="module")
def many() -> SonarReadings:
    """20,000 readings of one sensor before a wall."""
    physics = replace(EXACT, dropout=0.1, sigma=0.03, sigma_slope=0.02, objects=0.2, object_rate=0.5, phantoms=0.05)
    ring = RangeFinder(np.tile([0.0, 0.0, np.pi / 2], (10, 1)), 5.0, opening_angle=np.radians(30.0))
    return simulate_sonar(WALL, np.zeros((2000, 3)), ring, physics, np.random.default_rng(5))


def test_causes_come_at_the_rates_of_the_physics(many):
    n = many.causes.size
    nearer = 1.0 - np.exp(-0.5 * 2.0)
    beyond = np.exp(-0.5 * 2.0) - np.exp(-0.5 * 5.0)
    expected = {
        EchoCause.PHANTOM: 0.05,
        EchoCause.OBJECT: 0.95 * 0.2 * (nearer + 0.1 * beyond),
        EchoCause.LOST: 0.95 * 0.1 * (0.8 + 0.2 * np.exp(-0.5 * 5.0)),
    }
    for cause, share in expected.items():
        found = (many.causes == cause).mean()
        assert abs(found - share) < 4.0 * np.sqrt(share * (1.0 - share) / n), cause


def test_echoes_have_the_noise_and_phantoms_are_uniform(many):
    direct = many.ranges[many.causes == EchoCause.DIRECT]
    assert direct.mean() == pytest.approx(2.0, abs=4.0 * 0.05 / np.sqrt(len(direct)))
    assert direct.std() == pytest.approx(np.hypot(0.03, 0.02 * 2.0), rel=0.03)
    phantoms = many.ranges[many.causes == EchoCause.PHANTOM]
    assert phantoms.mean() == pytest.approx(2.5, abs=4.0 * 5.0 / np.sqrt(12.0 * len(phantoms)))
    np.testing.assert_array_equal(np.isposinf(many.ranges), many.causes == EchoCause.LOST)
    np.testing.assert_allclose(many.nearest, 2.0)


def test_ranges_below_the_shortest_are_too_close():
    near = Surfaces.from_outlines([[[5.0, 0.2], [-5.0, 0.2]]], closed=False)
    assert reading(near, np.pi / 2, min_range=0.3)[0] == -np.inf


def test_the_same_seed_gives_the_same_readings_on_any_number_of_threads():
    poses = drive_through(OFFICE, np.arange(0.0, 20.0, 0.5)).poses
    runs = []
    for seed, threads in ((3, 1), (3, 2), (4, 1)):
        with forced_threads(threads):
            runs.append(simulate_sonar(OFFICE, poses, sonar_ring(8), None, np.random.default_rng(seed)))
    np.testing.assert_array_equal(runs[0].ranges, runs[1].ranges)
    np.testing.assert_array_equal(runs[0].causes, runs[1].causes)
    assert (runs[0].ranges != runs[2].ranges).any()


@pytest.mark.parametrize("n", [8, 16, 24])
def test_a_ring_looks_outwards_from_the_rim_and_survives_a_log(tmp_path, n):
    ring = sonar_ring(n, radius=0.21, opening_angle=0.4, first_bearing=0.1)
    np.testing.assert_allclose(np.hypot(*ring.mounts[:, :2].T), 0.21)
    np.testing.assert_allclose(
        np.exp(1j * np.arctan2(ring.mounts[:, 1], ring.mounts[:, 0])), np.exp(1j * ring.bearings)
    )
    log, readings = simulate_sonar_log(OFFICE, ring, duration=5.0, seed=2)
    write_carmen(tmp_path / "ring.log", log)
    read = read_carmen(tmp_path / "ring.log").only_sensor()
    np.testing.assert_allclose(read.finder.mounts, ring.mounts, atol=1e-9)
    assert read.finder.opening_angle == ring.opening_angle
    assert read.finder.max_range == ring.max_range
    measured = np.isfinite(readings.ranges)
    np.testing.assert_array_equal(np.isposinf(read.ranges), np.isposinf(readings.ranges))
    np.testing.assert_allclose(read.ranges[measured], readings.ranges[measured], atol=1e-6)
    np.testing.assert_allclose(read.poses, log.only_sensor().poses, atol=1e-8)


def test_a_log_is_the_same_for_the_same_seed_and_another_for_another():
    one, again, other = (simulate_sonar_log(OFFICE, sonar_ring(8), duration=4.0, seed=seed)[0] for seed in (1, 1, 2))
    for name in ("ranges", "poses", "odometry", "stamps"):
        np.testing.assert_array_equal(getattr(one.only_sensor(), name), getattr(again.only_sensor(), name))
    assert (one.only_sensor().poses != other.only_sensor().poses).any()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"roughness": 1.2}, r"roughness: expected a share in \[0, 1\], got 1.2"),
        ({"cross_talk": float("nan")}, "cross_talk: expected a share"),
        ({"sigma": -0.1}, "sigma: expected a positive finite number, got -0.1"),
        ({"object_rate": 0.0}, "object_rate: expected a positive"),
        ({"firing_interval": float("inf")}, "firing_interval: expected a positive finite"),
        ({"firing_groups": 0}, "firing_groups: expected a whole number >= 1 or None, got 0"),
        ({"firing_groups": 1.5}, "firing_groups: expected a whole number"),
    ],
)
def test_impossible_physics_is_refused(change, message):
    with pytest.raises(InvalidInputError, match=message):
        SonarPhysics(**change)


def test_impossible_rings_and_poses_are_refused():
    with pytest.raises(InvalidInputError, match="n_sensors: expected at least 1, got 0"):
        sonar_ring(0)
    with pytest.raises(InvalidInputError, match="radius: expected a finite number of metres >= 0, got -1"):
        sonar_ring(8, radius=-1.0)
    with pytest.raises(InvalidInputError, match=r"opening_angle: expected \[0, pi\)"):
        sonar_ring(8, opening_angle=4.0)
    with pytest.raises(InvalidInputError, match=r"poses: expected shape \(t, 3\), got \(3,\)"):
        simulate_sonar(WALL, [0.0, 0.0, 0.0], sonar_ring(8))
    with pytest.raises(InvalidInputError, match="no occupied cell"):
        simulate_sonar(OccupancyGrid(np.zeros((3, 3)), 1.0), [[0.0, 0.0, 0.0]], sonar_ring(8))
