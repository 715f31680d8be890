"""Where rays end in a map drawn from scans, in worlds whose walls are known."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.geometry import compose
from beamfield.maps.drawn_walls import CLUTTER, LINE, NOTHING, UNSEEN, UNSURE, ranges_to_walls
from beamfield.maps.hit_counts import HitCounts, count_hits
from beamfield.sensors import RangeFinder, SensorLog

NOISE = 0.03
# A wall at x = 4.02, inside a cell of 0.05 m; it ends at y = 3.
WALL_X, WALL_END = 4.02, 3.0
FAN = RangeFinder.from_bearings(np.linspace(-0.9, 0.9, 61), 8.0)


def to_wall(poses: np.ndarray, finder: RangeFinder) -> np.ndarray:
    """Return exact ranges to the wall; inf where a ray passes its end."""
    theta = poses[:, None, 2] + finder.bearings
    z = (WALL_X - poses[:, None, 0]) / np.cos(theta)
    return np.where(poses[:, None, 1] + z * np.sin(theta) < WALL_END, z, np.inf)


def drawn(rng: np.random.Generator, n: int = 60, odd_share: float = 0.0, turn: float = 0.0) -> HitCounts:
    """Draw the wall, turned about the origin, from n scans.

    A share of the readings is of unexpected objects, uniform up to the wall.
    """
    poses = np.column_stack([rng.uniform(0.5, 2.5, n), rng.uniform(0.5, 2.0, n), rng.uniform(-0.2, 0.2, n)])
    z = to_wall(poses, FAN) + rng.normal(0.0, NOISE, (n, FAN.n_beams))
    odd = rng.random(z.shape) < odd_share
    z[odd] *= rng.random(odd.sum())
    poses = compose([0.0, 0.0, turn], poses)
    return count_hits(SensorLog(FAN, np.arange(n), z, poses, np.full((n, 3), np.nan)), np.ones(n, bool), 0.05)


def ahead(*poses: tuple[float, float, float]) -> tuple[np.ndarray, RangeFinder]:
    return np.array(poses), RangeFinder.from_bearings([0.0], 8.0)


@pytest.mark.parametrize("turn", [0.0, 0.6, 2.2])
def test_a_wall_is_found_inside_its_cell(rng, turn):
    poses, finder = ahead(*((x, y, t) for x in (1.0, 2.0) for y in (1.0, 1.5) for t in (-0.3, 0.0, 0.3)))
    expected, met = ranges_to_walls(drawn(rng, turn=turn), compose([0.0, 0.0, turn], poses), finder)
    assert (met == LINE).all()
    # A cell's edge would be 0.02 m or 0.03 m off.
    np.testing.assert_allclose(expected, to_wall(poses, finder), atol=0.012)
    assert abs((expected - to_wall(poses, finder)).mean()) < 0.005


def test_readings_of_unexpected_objects_stop_no_ray(rng):
    poses, finder = ahead(*((0.6, y, 0.0) for y in np.linspace(0.8, 1.8, 40)))
    expected, met = ranges_to_walls(drawn(rng, 200, odd_share=0.2), poses, finder)
    relied = (met == LINE) | (met == CLUTTER)
    assert relied.mean() > 0.7
    assert np.abs(expected - to_wall(poses, finder))[relied].max() < 0.1


def test_a_ray_beside_the_end_of_a_wall_enters_unseen_space(rng):
    expected, met = ranges_to_walls(drawn(rng), *ahead((2.0, 2.9, 0.3), (2.0, 2.0, 1.4)))
    assert (met == UNSEEN).all()
    assert (expected == 8.0).all()


def test_a_wall_seen_twice_is_not_sure_and_one_seen_often_is(rng):
    poses, finder = ahead((1.5, 1.2, 0.0))
    assert ranges_to_walls(drawn(rng, 1), poses, finder).met[0, 0] != LINE
    assert ranges_to_walls(drawn(rng, 60), poses, finder).met[0, 0] == LINE


def test_a_door_that_is_open_half_of_the_time_is_not_sure(rng):
    """Half of the scans end in it, half go on to the wall behind: no expected range would be right."""
    n = 80
    poses = np.column_stack([rng.uniform(0.5, 1.0, n), rng.uniform(0.5, 2.0, n), np.zeros(n)])
    z = to_wall(poses, FAN) + rng.normal(0.0, NOISE, (n, FAN.n_beams))
    z[::2] = ((2.5 - poses[:, None, 0]) / np.cos(FAN.bearings))[::2] + rng.normal(0.0, NOISE, (n // 2, FAN.n_beams))
    z[:, np.abs(FAN.bearings) > 0.6] = np.nan
    counts = count_hits(SensorLog(FAN, np.arange(n), z, poses, np.full((n, 3), np.nan)), np.ones(n, bool), 0.05)
    assert ranges_to_walls(counts, *ahead((0.7, 1.2, 0.0))).met[0, 0] == UNSURE


def test_both_sides_of_a_thin_wall_are_found(rng):
    """A board 0.1 m thick, seen from both sides."""
    n, sides = 60, []
    for x, heading, face in ((1.0, 0.0, 2.0), (3.1, np.pi, 2.1)):
        poses = np.column_stack([np.full(n, x), rng.uniform(1.0, 3.0, n), np.full(n, heading)])
        z = np.abs(face - x) / np.cos(FAN.bearings) + rng.normal(0.0, 0.01, (n, FAN.n_beams))
        sides.append((poses, z))
    poses, z = (np.concatenate([side[i] for side in sides]) for i in (0, 1))
    counts = count_hits(
        SensorLog(FAN, np.arange(2 * n), z, poses, np.full((2 * n, 3), np.nan)), np.ones(2 * n, bool), 0.05
    )
    expected, met = ranges_to_walls(counts, *ahead((1.0, 2.0, 0.0), (3.1, 2.0, np.pi)))
    assert met[:, 0].tolist() == [LINE, LINE]
    assert expected[:, 0] == pytest.approx([1.0, 1.0], abs=0.005)


def test_within_max_range_there_may_be_nothing(rng):
    poses, _ = ahead((0.6, 1.2, 0.0))
    short = RangeFinder.from_bearings([0.0], 1.0)
    expected, met = ranges_to_walls(drawn(rng), poses, short)
    assert met[0, 0] == NOTHING
    assert expected[0, 0] == 1.0


def test_a_thin_post_is_where_its_readings_are(rng):
    """Seen from all around, so that no line fits its end points."""
    n, radius = 200, 0.04
    heading = rng.uniform(-np.pi, np.pi, n)
    poses = np.column_stack([-2.0 * np.cos(heading), -2.0 * np.sin(heading), heading])
    finder = RangeFinder.from_bearings(np.radians(np.arange(-20.0, 21.0)), 8.0)
    beside = 2.0 * np.sin(finder.bearings)
    with np.errstate(invalid="ignore"):
        z = 2.0 * np.cos(finder.bearings) - np.sqrt(radius**2 - beside**2)
    z = np.where(np.isnan(z), np.inf, z) + rng.normal(0.0, 0.005, (n, finder.n_beams))
    counts = count_hits(SensorLog(finder, np.arange(n), z, poses, np.full((n, 3), np.nan)), np.ones(n, bool), 0.05)
    around = np.arange(-3.0, 3.0, 0.5)
    start = np.column_stack([-1.5 * np.cos(around), -1.5 * np.sin(around), around])
    expected, met = ranges_to_walls(counts, start, RangeFinder.from_bearings([0.0], 8.0))
    assert (met == CLUTTER).sum() > 3
    # The mean of what was read from all sides is the post's axis.
    np.testing.assert_allclose(expected[met == CLUTTER], 1.5, atol=0.02)
