"""Means, spreads and standard errors of groups of residuals, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.landmark_noise.residuals import ResidualGroup, groups_by_distance, groups_by_landmark
from beamfield.landmark_noise.sighting_table import SightingTable

# Two landmarks, seen in five blocks of four sightings each, one after the other.
LANDMARKS = np.repeat([0, 1], 20)
BLOCKS = np.tile(np.repeat(np.arange(5), 4), 2)
IDS = np.array([7, 3])


def table(landmarks: np.ndarray, blocks: np.ndarray, distances: np.ndarray) -> SightingTable:
    n = len(landmarks)
    zeros = np.zeros(n)
    return SightingTable(distances, zeros, distances, zeros, landmarks, np.arange(n, dtype=float), blocks)


def test_a_landmarks_mean_spread_and_standard_error_are_those_of_its_blocks() -> None:
    # A block has one value; that of the second landmark is 10 times the first's.
    ranges = 0.1 * BLOCKS * np.where(LANDMARKS == 1, 10.0, 1.0)
    bearings = np.where(LANDMARKS == 0, np.nan, 0.02)
    first, second = groups_by_landmark(table(LANDMARKS, BLOCKS, np.full(40, 2.0)), IDS, ranges, bearings, np.ones(40))
    # The five means 0, 0.1, 0.2, 0.3 and 0.4 have the sample variance 0.025.
    assert (first.name, first.n) == ("7", 20.0)
    assert (first.range_mean, first.range_std) == pytest.approx((0.2, np.sqrt(0.02)))
    assert first.range_mean_se == pytest.approx(np.sqrt(0.025 / 5.0))
    assert np.isnan([first.bearing_mean, first.bearing_std, first.bearing_mean_se]).all()
    assert (second.name, second.range_mean, second.range_std) == ("3", pytest.approx(2.0), pytest.approx(np.sqrt(2.0)))
    assert (second.bearing_mean, second.bearing_std) == pytest.approx((0.02, 0.0))


def test_a_sighting_counts_as_far_as_it_is_of_its_landmark() -> None:
    landmarks, blocks = np.zeros(40, np.int64), np.repeat(np.arange(5), 8)
    weights = np.tile([1.0, 0.5, 0.0, 0.0], 10)
    ranges = np.tile([0.3, -0.3, 99.0, np.nan], 10)
    (group,) = groups_by_landmark(table(landmarks, blocks, np.full(40, 2.0)), IDS[:1], ranges, ranges, weights)
    assert group.n == 15.0
    # Two thirds at 0.3 and a third at -0.3.
    assert (group.range_mean, group.range_std) == pytest.approx((0.1, np.sqrt(0.08)))


def test_three_blocks_give_no_standard_error_and_nine_sightings_no_group() -> None:
    blocks = np.repeat([0, 1, 2], [4, 4, 3])
    seen = table(np.repeat([0, 1], [2, 9]), blocks, np.full(11, 2.0))
    assert groups_by_landmark(seen, IDS, np.zeros(11), np.zeros(11), np.ones(11)) == ()
    seen = table(np.zeros(11, np.int64), blocks, np.full(11, 2.0))
    (group,) = groups_by_landmark(seen, IDS, np.ones(11), np.ones(11), np.ones(11))
    assert group.range_mean == 1.0
    assert np.isnan(group.range_mean_se)
    four = table(np.zeros(12, np.int64), np.repeat(np.arange(4), 3), np.full(12, 2.0))
    (group,) = groups_by_landmark(four, IDS, np.repeat([0.0, 1.0], 6), np.ones(12), np.ones(12))
    assert group.range_mean_se == pytest.approx(np.sqrt(1.0 / 3.0 / 4.0))


def test_quarters_by_distance_hold_each_sighting_of_a_landmark_once() -> None:
    """Landmark 0 from 1 to 4 m, landmark 1 from 5 to 8 m, a tenth sighting of none."""
    distances = np.concatenate([np.repeat(np.arange(1.0, 9.0), 5), np.full(4, 3.0)])
    landmarks = np.concatenate([LANDMARKS, np.full(4, -1)])
    ranges = np.where(landmarks < 0, 99.0, 0.01 * distances)
    seen = table(landmarks, np.concatenate([BLOCKS, np.zeros(4, np.int64)]), distances)
    groups: tuple[ResidualGroup, ...] = groups_by_distance(seen, ranges, np.zeros(44), np.ones(44))
    assert [group.n for group in groups] == [10.0] * 4
    assert [group.range_mean for group in groups] == pytest.approx([0.015, 0.035, 0.055, 0.075])
    assert [group.name.split(" to ")[0] for group in groups] == ["1", "2.75", "4.5", "6.25"]
    assert groups_by_distance(seen, ranges, np.zeros(44), np.full(44, 0.9)) == ()
    assert groups_by_distance(table(landmarks, seen.blocks, np.ones(44)), ranges, ranges, np.ones(44)) == ()
