from __future__ import annotations

import numpy as np
import pytest
from benchmarks.rooms import Room, l_shaped_room
from scipy.stats import chi2

from beamfield.errors import InvalidInputError
from beamfield.features.lines import find_lines
from beamfield.features.straight_line import fit_line
from beamfield.features.sweep import RangeNoise, sweeps
from beamfield.geometry import compose, wrap_angle
from beamfield.sensors import RangeFinder, Scan

FULL_TURN = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 720, endpoint=False), 12.0, mount=(0.2, -0.1, 0.4))
POSE = np.array([2.7, 3.1, 0.3])
NOISE = RangeNoise(0.01)


def mean_within(statistic, degrees, n):
    """Whether a mean of n chi-square values is one that 99.98% of such means are."""
    low, high = chi2.ppf([1e-4, 1 - 1e-4], n * degrees) / n
    return low < statistic < high


def wall_in_view(room: Room, pose, wall: int) -> np.ndarray:
    """Return (rho, alpha) of a wall as the robot sees it."""
    start, end = room.walls[wall, :2], room.walls[wall, 2:]
    along = (end - start) / np.hypot(*(end - start))
    normal = np.array([along[1], -along[0]])
    rho = normal @ (start - pose[:2])
    return np.array([abs(rho), wrap_angle(np.arctan2(*(normal * np.sign(rho))[::-1]) - pose[2])])


@pytest.mark.parametrize("sigma_bearing", [0.0, 0.003], ids=["exact bearings", "noisy bearings"])
def test_covariance_of_a_line_is_that_of_its_errors(rng, sigma_bearing):
    offset = (0.3, -0.2, 2.0)
    noise = RangeNoise(0.02, sigma_bearing)
    angles = np.sort(rng.uniform(-0.4, 1.4, 60))
    finder = RangeFinder.from_bearings(angles, 20.0, mount=offset)
    [clean] = sweeps(Scan(np.full(60, 1.0), finder))
    order = clean.beams
    facing = np.cos(finder.bearings - 0.7 - offset[2])
    normal = np.array([np.cos(0.7 + offset[2]), np.sin(0.7 + offset[2])])
    rho = 2.5 + normal @ np.array(offset[:2])
    ranges = 2.5 / facing
    hits = finder.mounts[:, :2] + ranges[:, None] * np.column_stack([np.cos(finder.bearings), np.sin(finder.bearings)])
    truth = np.array([rho, wrap_angle(0.7 + offset[2]), np.hypot(*(hits[order[-1]] - hits[order[0]]))])
    squares, n = [], 1000
    for _ in range(n):
        # A beam whose direction is off by e measures the range of that other direction.
        off = rng.normal(0.0, sigma_bearing, 60) if sigma_bearing else np.zeros(60)
        z = 2.5 / np.cos(finder.bearings + off - 0.7 - offset[2]) + rng.normal(0.0, 0.02, 60)
        [sweep] = sweeps(Scan(z, finder))
        line = fit_line(sweep, np.arange(60), noise)
        error = line.measurement - truth
        if sigma_bearing:
            # The length then is between other places of the wall: the line alone has a truth.
            error = error[:2]
        squares.append(error @ np.linalg.solve(line.covariance[: len(error), : len(error)], error))
    assert mean_within(np.mean(squares), 2 if sigma_bearing else 3, n)
    assert np.mean(np.array(squares) < chi2.ppf(0.95, 2 if sigma_bearing else 3)) == pytest.approx(0.95, abs=0.02)


def test_noise_that_grows_with_the_range_is_weighted_and_stated(rng):
    """A wall from 1 m to 9 m, as a scanner that triangulates sees it."""
    noise = RangeNoise(0.005, sigma_slope=0.005)
    finder = RangeFinder.from_bearings(np.linspace(0.0, 1.45, 150), 20.0)
    exact = 1.0 / np.cos(finder.bearings)
    squares, n = [], 500
    for _ in range(n):
        z = exact + rng.normal(0.0, np.hypot(0.005, 0.005 * exact))
        [sweep] = sweeps(Scan(z, finder))
        line = fit_line(sweep, np.arange(150), noise)
        error = line.measurement[:2] - [1.0, 0.0]
        squares.append(error @ np.linalg.solve(line.covariance[:2, :2], error))
    # The noise of a reading is that at the measured range, not at the true one: a per cent of difference.
    assert 0.93 * chi2.ppf(1e-4, 2 * n) / n < np.mean(squares) < 1.07 * chi2.ppf(1 - 1e-4, 2 * n) / n


def test_lines_of_an_exact_scan_are_the_walls():
    room = l_shaped_room()
    ranges, hit = room.cast(POSE, FULL_TURN)
    lines = find_lines(Scan(ranges, FULL_TURN), NOISE)
    for wall in range(6):
        if np.sum(hit == wall) < 30:
            continue
        rho, alpha = wall_in_view(room, POSE, wall)
        seen = [line for line in lines if abs(line.rho - rho) < 1e-3 and abs(wrap_angle(line.alpha - alpha)) < 1e-3]
        assert seen, f"wall {wall} at {rho}, {alpha}"
        assert np.isin(seen[0].beams, np.flatnonzero(hit == wall)).mean() > 0.95


def test_moving_robot_and_room_together_changes_nothing():
    room = l_shaped_room()
    ranges, _ = room.cast(POSE, FULL_TURN)
    turned = RangeFinder(compose([0.5, 0.2, 1.0], FULL_TURN.mounts), 12.0)
    before = find_lines(Scan(ranges, FULL_TURN), NOISE)
    after = find_lines(Scan(ranges, turned), NOISE)
    shift = np.array([0.5, 0.2])
    assert len(before) == len(after)
    known = {tuple(np.sort(line.beams)): line for line in after}
    for line in before:
        moved = known[tuple(np.sort(line.beams))]
        signed = line.rho + shift @ [np.cos(line.alpha + 1.0), np.sin(line.alpha + 1.0)]
        assert moved.rho == pytest.approx(abs(signed), abs=1e-6)
        assert moved.length == pytest.approx(line.length, abs=1e-6)


def test_order_of_the_beams_does_not_matter(rng):
    ranges, _ = l_shaped_room().cast(POSE, FULL_TURN)
    shuffled = rng.permutation(720)
    one = find_lines(Scan(ranges, FULL_TURN), NOISE)
    two = find_lines(Scan(ranges[shuffled], FULL_TURN.subset(shuffled)), NOISE)
    np.testing.assert_allclose([a.measurement for a in one], [b.measurement for b in two], atol=1e-12)


def test_missing_wrong_and_max_readings_do_not_break_a_wall(rng):
    finder = RangeFinder.from_bearings(np.linspace(-0.8, 0.8, 200), 10.0)
    ranges = 2.0 / np.cos(finder.bearings) + rng.normal(0, 0.01, 200)
    ranges[[20, 21, 60]] = np.nan
    ranges[[100, 140]] = np.inf
    ranges[[50, 120]] = 1.0, 6.0
    ranges[170] = -np.inf
    [line] = find_lines(Scan(ranges, finder), NOISE)
    assert abs(line.rho - 2.0) < 4 * np.sqrt(line.covariance[0, 0])
    assert len(line.beams) >= 190
    assert not np.isin([50, 120, 100, 20], line.beams).any()


def test_wall_across_the_start_of_a_full_turn_is_one_line():
    finder = RangeFinder.from_bearings(np.linspace(0, 2 * np.pi, 360, endpoint=False), 10.0)
    room = Room.from_outlines([(-2, -2), (2, -2), (2, 2), (-2, 2)])
    for heading in (0.0, 0.7, 3.0):
        lines = find_lines(Scan(room.cast((0.1, 0.2, heading), finder)[0], finder), NOISE)
        assert len(lines) == 4
        assert min(line.length for line in lines) > 3.8


def test_wall_behind_a_pole_is_one_line_and_a_wide_doorway_parts_it():
    finder = RangeFinder.from_bearings(np.linspace(-0.8, 0.8, 321), 10.0)
    ranges = 3.0 / np.cos(finder.bearings)
    behind = ranges.copy()
    behind[150:160] = 1.0
    assert len([line for line in find_lines(Scan(behind, finder), NOISE) if abs(line.rho - 3) < 0.01]) == 1
    doorway = ranges.copy()
    doorway[130:200] = np.inf
    assert len(find_lines(Scan(doorway, finder), NOISE)) == 2


def test_rings_of_single_beams_and_empty_scans_have_no_lines():
    bearings = np.linspace(0, 2 * np.pi, 16, endpoint=False)
    ring = RangeFinder(np.column_stack([0.2 * np.cos(bearings), 0.2 * np.sin(bearings), bearings]), 5.0)
    assert find_lines(Scan(np.full(16, np.nan), ring), NOISE) == []
    assert find_lines(Scan(np.full(16, np.inf), ring), NOISE) == []
    assert find_lines(Scan(np.full(1, 2.0), ring.subset([0])), NOISE) == []


def test_beams_of_different_origins_see_one_wall():
    offsets = np.linspace(-0.5, 0.5, 20)
    finder = RangeFinder(np.column_stack([np.zeros(20), offsets, 0.3 * offsets]), 10.0)
    [line] = find_lines(Scan(2.0 / np.cos(0.3 * offsets), finder), NOISE)
    np.testing.assert_allclose(line.measurement[:2], [2.0, 0.0], atol=1e-9)


@pytest.mark.parametrize(
    ("options", "message"),
    [({"min_points": 2}, "min_points"), ({"min_length": -1.0}, "min_length"), ({"max_gap": 0.0}, "max_gap")],
    ids=lambda value: value if isinstance(value, str) else "",
)
def test_senseless_limits_are_refused(options, message):
    with pytest.raises(InvalidInputError, match=message):
        find_lines(Scan(np.full(720, 2.0), FULL_TURN), NOISE, **options)


@pytest.mark.parametrize(
    "wrong", [(0.0, 0.0), (np.nan, 0.0), (0.1, -1.0), (0.1, np.inf), (0.1, 0.0, -0.1), (0.1, 0.0, np.nan)], ids=str
)
def test_senseless_noise_is_refused(wrong):
    with pytest.raises(InvalidInputError, match="sigma"):
        RangeNoise(*wrong)


def test_a_line_needs_two_different_points():
    finder = RangeFinder(np.zeros((5, 3)), 10.0)
    [sweep] = sweeps(Scan(np.full(5, 2.0), finder))
    with pytest.raises(InvalidInputError, match="at least 2"):
        fit_line(sweep, [1], NOISE)
    with pytest.raises(InvalidInputError, match="different points"):
        fit_line(sweep, [0, 1, 2], NOISE)
