"""Readings of what moves, told by the scans alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.geometry import interpolate_poses, transform_points, wrap_angle
from beamfield.kernels.jit import integer
from beamfield.kernels.seen_through import mark_seen_through
from beamfield.localization import moving_objects
from beamfield.localization.drive import Drive, prepare
from beamfield.localization.moving_objects import without_crowd, without_crowd_so_far
from beamfield.localization.trajectory import fit_trajectory
from beamfield.maps.end_points import end_points
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import RangeFinder, SensorLog


def with_people(log: SensorLog, n: int) -> tuple[SensorLog, np.ndarray]:
    """Return a log in which n people walk beside the robot, each from one place near it to the next, and what hides."""
    rng = np.random.default_rng(5)
    since = log.stamps - log.stamps[0]
    times = np.arange(0.0, since[-1] + 3.0, 2.0)
    ranges = log.ranges.copy()
    bearings = log.finder.mounts[:, 2]
    for _ in range(n):
        places = np.column_stack(
            [rng.uniform(0.9, 3.0, len(times)), np.zeros(len(times)), rng.uniform(-1.6, 1.6, len(times))]
        )
        distance, _, bearing = interpolate_poses(times, places, since).T
        meets = np.abs(wrap_angle(bearings - bearing[:, None])) < 0.25 / distance[:, None]
        at = np.broadcast_to(distance[:, None], ranges.shape)
        ranges = np.where(meets & (at < ranges), at, ranges)
    return replace(log, ranges=ranges), ranges < log.ranges


@pytest.fixture(scope="module")
def crowded(drive: SensorLog) -> tuple[SensorLog, np.ndarray]:
    return with_people(drive, 7)


def test_the_kernel_marks_what_a_plain_loop_marks(rng: np.random.Generator):
    n, k, reach, most_way, most_turn, near, share, width = 12, 40, 5, 0.9, 0.5, 0.2, 0.05, 0.5
    bearings = np.sort(rng.uniform(-3.0, 3.0, k))
    ranges = rng.choice([1.0, 2.0, 4.0, 8.0, np.nan], (n, k), p=[0.2, 0.2, 0.4, 0.1, 0.1])
    lasers = np.column_stack([rng.normal(0.0, 0.3, (n, 2)), rng.uniform(-7.0, 7.0, n)])
    way, turn = np.sort(rng.uniform(0.0, 2.0, n)), rng.uniform(0.0, 1.0, n)
    scans, others = np.arange(1, n), np.arange(n)
    bounds = np.column_stack([scans - reach, scans + reach + 1]).clip(0, n)
    marks = np.zeros((n, k), bool)
    mark_seen_through(ranges, 8.0, bearings, np.arange(k), lasers, way, turn, scans, others, bounds, most_way,
                      most_turn, integer(1), near, share, width, marks)  # fmt: skip
    expected = np.zeros((n, k), bool)
    for i, b in np.argwhere(ranges < 8.0):
        if i == 0:
            continue  # not judged
        end = transform_points(lasers[i], ranges[i, b] * np.array([np.cos(bearings[b]), np.sin(bearings[b])]))
        votes = []
        for j in range(n):
            if j == i or abs(j - i) > reach or abs(way[j] - way[i]) > most_way or abs(turn[j] - turn[i]) > most_turn:
                continue
            distance = np.hypot(*(end - lasers[j, :2]))
            seen_at = wrap_angle(np.arctan2(*(end - lasers[j, :2])[::-1]) - lasers[j, 2])
            right = int((bearings < seen_at).sum())
            if not 0 < right < k or (bearings[right] - bearings[right - 1]) * distance > width:
                continue
            both = ranges[j, right - 1 : right + 1]
            if (both < 8.0).all():
                apart = near + share * distance
                votes.append(1 if both.min() > distance + apart else -1 if both.max() >= distance - apart else 0)
        expected[i, b] = votes.count(1) > max(votes.count(-1), 1)
    assert 0.02 < expected.mean() < 0.5
    np.testing.assert_array_equal(marks, expected)


def test_people_are_told_from_walls(drive: SensorLog):
    log, hidden = with_people(drive, 3)
    prepared = prepare(log, log.odometry)
    left, _ = without_crowd(log, prepared)
    marked = (np.isnan(left.ranges) & ~np.isnan(log.ranges))[prepared.scans]
    hidden, returned = hidden[prepared.scans], (log.ranges < log.finder.max_range)[prepared.scans]
    assert hidden.mean() > 0.12
    assert marked[hidden].mean() > 0.6
    # Of the drive's own readings a tenth is short or random, too.
    assert marked[returned & ~hidden].mean() < 0.15
    # Scans between are as they were.
    others = np.setdiff1d(np.arange(len(log)), prepared.scans)
    np.testing.assert_array_equal(left.ranges[others], log.ranges[others])


def test_a_crowd_does_not_hide_the_trajectory_and_is_named(
    drive: SensorLog, office: OccupancyGrid, crowded: tuple[SensorLog, np.ndarray]
):
    fit = fit_trajectory(crowded[0], office)
    assert np.hypot(*(fit.poses - drive.poses)[:, :2].T).max() < 0.1
    assert fit.trusted.all()
    [said] = [one for one in fit.findings if one.name == "moving-objects"]
    assert said.severity == "info"
    assert 0.2 < said.values["share"] < crowded[1].mean() + 0.1
    assert not [one for one in fit.findings if one.severity != "info"]


def test_without_a_crowd_nothing_is_left_out_of_a_fit(drive: SensorLog):
    prepared = prepare(drive, drive.odometry)
    log, said = without_crowd(drive, prepared)
    assert log is drive
    assert said == ()


def test_a_filter_does_without_a_crowd_by_the_scans_before(drive: SensorLog, monkeypatch: pytest.MonkeyPatch):
    # Who walks as fast as the robot hides where it will be.
    monkeypatch.setattr(moving_objects, "MANY", 0.05)
    log, hidden = with_people(drive, 3)
    left, said = without_crowd_so_far(log)
    marked = np.isnan(left.ranges) & ~np.isnan(log.ranges)
    assert marked[hidden].mean() > 0.25
    assert marked[~hidden].mean() < 0.1
    assert [one.name for one in said] == ["moving-objects"]
    # What comes later is not known: the same readings are left out of a log that ends earlier.
    before, _ = without_crowd_so_far(log[: len(log) // 2])
    np.testing.assert_array_equal(before.ranges, left.ranges[: len(log) // 2])


def test_without_a_crowd_a_filter_uses_all(drive: SensorLog):
    log, said = without_crowd_so_far(drive)
    assert log is drive
    assert said == ()


def test_cones_and_rings_of_several_origins_are_understood(monkeypatch: pytest.MonkeyPatch):
    """A wall 3 m ahead and something that crosses in one scan, seen by two lasers back to back and by cones."""
    monkeypatch.setattr(moving_objects, "MANY", 0.001)
    bearings = np.radians(np.arange(-60.0, 60.5, 2.0))
    ahead = np.column_stack([np.full(61, 0.2), np.zeros(61), bearings])
    behind = np.column_stack([np.full(61, -0.2), np.zeros(61), bearings + np.pi])
    finder = RangeFinder(np.concatenate([ahead, behind]), max_range=10.0)
    ranges = np.tile(3.0 / np.cos(bearings), (11, 2))
    ranges[5, 25:35] = 1.0
    poses = np.column_stack([np.zeros((11, 2)), np.zeros(11)])
    log = SensorLog(finder, np.arange(11.0), ranges, poses, poses)
    for cone, n in ((0.0, 10), (0.3, 0)):
        seen = replace(log, finder=replace(finder, opening_angle=cone))
        points = end_points(seen.ranges, seen.finder)
        prepared = Drive(log.stamps, np.zeros((10, 3)), np.zeros(10, bool), np.arange(11), points[0], np.arange(2),
                         np.zeros(11, bool))  # fmt: skip
        left = np.isnan(without_crowd(seen, prepared)[0].ranges)
        assert np.argwhere(left).tolist() == [[5, beam] for beam in range(25, 25 + n)]
