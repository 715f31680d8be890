"""Surfaces keep the direction of their walls whatever the noise and the density of the beams."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.kernels import scan_field, surfaces


def wall(spacing_deg: float, noise: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Beams (k, 3) and readings of the wall y = 1, seen from the origin up to 60 degrees aside."""
    bearings = np.radians(np.arange(30.0, 150.0, spacing_deg))
    mounts = np.column_stack([np.zeros((len(bearings), 2)), bearings])
    return mounts, 1.0 / np.sin(bearings) + noise * rng.normal(size=len(bearings))


def elements_of(mounts: np.ndarray, ranges: np.ndarray) -> np.ndarray:
    joined, out = np.empty(len(ranges), np.bool_), np.empty((5 * len(ranges), surfaces.COLUMNS))
    surfaces.find_surfaces(mounts, ranges, 0.0, 0.0, joined, np.empty(len(ranges)))
    noise = surfaces.range_noise(mounts[:, 2], ranges, joined)
    surfaces.find_surfaces(mounts, ranges, 0.0, noise, joined, np.empty(len(ranges)))
    points = ranges[:, None] * np.column_stack([np.cos(mounts[:, 2]), np.sin(mounts[:, 2])])
    return out[: surfaces.fit_elements(points, ranges, joined, noise, out)]


@pytest.mark.parametrize("noise", [0.01, 0.03])
def test_the_noise_of_the_ranges_is_found(noise: float, rng: np.random.Generator) -> None:
    mounts, ranges = wall(0.25, noise, rng)
    ranges[240:] -= 0.5  # An edge, which is no noise.
    found = surfaces.range_noise(mounts[:, 2], ranges, np.ones(len(ranges), np.bool_))
    assert found == pytest.approx(noise, rel=0.2)


def test_too_few_end_points_have_no_noise() -> None:
    assert surfaces.range_noise(np.array([0.0, 0.1]), np.ones(2), np.ones(2, np.bool_)) == 0.0
    assert surfaces.range_noise(np.zeros(3), np.ones(3), np.ones(3, np.bool_)) == 0.0


@pytest.mark.parametrize("spacing_deg", [0.25, 1.0])
def test_a_near_wall_stays_a_wall_however_dense_its_noisy_end_points(
    spacing_deg: float, rng: np.random.Generator
) -> None:
    found = elements_of(*wall(spacing_deg, 0.03, rng))
    lines = found[:, surfaces.PULL] == surfaces.LINE
    assert lines.mean() > 0.95
    # Along the wall, its elements say nothing: with the nearest 0.15 m only, 40% of them would.
    along = np.where(lines, found[:, surfaces.NX] ** 2, 1.0)
    assert along.mean() < 0.06
    assert np.abs(found[lines, surfaces.Y] - 1.0).max() < 0.05


def test_no_gap_is_longer_than_there_is_room_for_elements(rng: np.random.Generator) -> None:
    bearings = np.radians(np.arange(0.0, 360.0, 4.0))
    mounts = np.column_stack([np.zeros((len(bearings), 2)), bearings])
    for _ in range(50):
        # In foliage, say, ranges scatter by more than a sixth of a metre.
        ranges = np.abs(10.0 + rng.normal(size=90))
        points = ranges[:, None] * np.column_stack([np.cos(bearings), np.sin(bearings)])
        joined, out = np.empty(90, np.bool_), np.empty((90 * 90, surfaces.COLUMNS))
        surfaces.find_surfaces(mounts, ranges, 0.0, 1.0, joined, np.empty(90))
        gaps = np.hypot(*(np.roll(points, -1, axis=0) - points)[joined].T)
        assert gaps.max() <= surfaces.LONGEST_GAP
        assert surfaces.fit_elements(points, ranges, joined, 1.0, out) <= 4 * 90


def test_a_corner_is_not_rounded_by_wide_fits() -> None:
    bearings = np.radians(np.arange(0.0, 90.0, 0.5))
    ranges = np.minimum(1.0 / np.maximum(np.cos(bearings), 1e-9), 1.0 / np.maximum(np.sin(bearings), 1e-9))
    found = elements_of(np.column_stack([np.zeros((len(bearings), 2)), bearings]), ranges)
    off = np.minimum(np.abs(found[:, surfaces.X] - 1.0), np.abs(found[:, surfaces.Y] - 1.0))
    assert off.max() < 0.01


@pytest.mark.parametrize("spacing_deg", [0.25, 1.0, 10.0])
def test_elements_stand_for_each_end_point_once(spacing_deg: float, rng: np.random.Generator) -> None:
    mounts, ranges = wall(spacing_deg, 0.01, rng)
    assert elements_of(mounts, ranges)[:, surfaces.COUNT].sum() == len(ranges)


def test_elements_know_to_how_many_end_points_their_lines_were_fitted(rng: np.random.Generator) -> None:
    """Their middles scatter across the wall by the ranges' noise over the root of that number."""
    sigma, scatter = 0.01, []
    for _ in range(60):
        elements = elements_of(*wall(1.0, sigma, rng))
        middle = elements[np.argmin(np.abs(elements[:, surfaces.X]))]
        assert middle[surfaces.FITTED] >= 5.0
        scatter.append((middle[surfaces.Y] - 1.0) ** 2 * middle[surfaces.FITTED])
    assert 0.6 < np.sqrt(np.mean(scatter)) / sigma < 1.4


def test_elements_know_how_far_their_end_points_scatter(rng: np.random.Generator) -> None:
    elements = elements_of(*wall(1.0, 0.01, rng))
    middle = elements[np.abs(elements[:, surfaces.X]) < 0.3]
    assert np.sqrt(np.mean(middle[:, surfaces.OFF] ** 2)) == pytest.approx(0.01, rel=0.35)


def test_both_files_mean_the_same_columns() -> None:
    columns = ("X", "Y", "NX", "NY", "BACK", "AHEAD", "PULL", "COUNT", "FITTED", "OFF", "COLUMNS")
    for name in (*columns, "POINT", "NONE", "ELEMENT", "SHORTEST_ELEMENT"):
        assert getattr(scan_field, name) == getattr(surfaces, name)
