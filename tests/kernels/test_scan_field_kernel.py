"""The buckets find the nearest element, and the climb's gradient is that of its score."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.kernels import scan_field as kernels
from beamfield.kernels.pull_scatter import SUMS, sum_patches
from beamfield.kernels.scan_alignment import ascend, linearise, settle
from beamfield.maps.end_points import hit_points
from beamfield.maps.scan_field import ScanField
from beamfield.sensors import RangeFinder, Scan

BEARINGS = np.radians(np.arange(-120.0, 120.5))


@pytest.fixture(scope="module")
def scan() -> Scan:
    ranges = np.minimum(
        3.0 / np.maximum(np.abs(np.cos(BEARINGS)), 1e-3), 2.0 / np.maximum(np.abs(np.sin(BEARINGS)), 1e-3)
    )
    ranges[30:40] = 1.0
    return Scan(ranges, RangeFinder.from_bearings(BEARINGS, 20.0))


def test_the_longest_element_is_found_from_beyond_its_end(scan: Scan) -> None:
    # Its middle lies at the end of the first bucket, and the point far in the third, along the element.
    element = np.zeros((1, kernels.COLUMNS))
    element[0, : kernels.PULL] = 0.39, 0.2, 0.0, -1.0, 0.1, kernels.LONGEST_HALF
    start, items = np.zeros(4, np.int64), np.zeros(1, np.int64)
    kernels.fill_buckets(element, 0.0, 0.0, 0.4, 3, start, items)
    view = ScanField.from_scan(scan).view._replace(
        elements=element, bucket_start=start, bucket_items=items, left=0.0, bottom=0.0, bucket=0.4, rows=1, cols=3
    )
    index, square = kernels.nearest_element(0.39 + kernels.LONGEST_HALF + 0.239, 0.2, 0.24, view)
    assert index == 0
    assert square == pytest.approx(0.239**2)


def test_no_element_reaches_further_from_its_middle_than_is_searched(rng: np.random.Generator) -> None:
    longest = 0.0
    for _ in range(20):
        bearings = np.sort(rng.uniform(-3.0, 3.0, 250))
        ranges = 2.0 / np.maximum(np.abs(np.cos(bearings)), 0.25) + rng.normal(0.0, 0.02, 250)
        view = ScanField.from_scan(Scan(ranges, RangeFinder.from_bearings(bearings, 20.0))).view
        longest = max(longest, view.elements[:, [kernels.BACK, kernels.AHEAD]].max())
    assert 0.125 < longest <= kernels.LONGEST_HALF


def test_the_nearest_element_is_that_of_a_search_through_all(scan: Scan, rng: np.random.Generator) -> None:
    view = ScanField.from_scan(scan).view
    elements, reach = view.elements, 0.7
    for x, y in rng.uniform(-4.0, 4.0, (500, 2)):
        dx, dy = x - elements[:, kernels.X], y - elements[:, kernels.Y]
        across = dx * elements[:, kernels.NX] + dy * elements[:, kernels.NY]
        along = dy * elements[:, kernels.NX] - dx * elements[:, kernels.NY]
        beyond = np.maximum(np.maximum(along - elements[:, kernels.AHEAD], -along - elements[:, kernels.BACK]), 0.0)
        square = across**2 + beyond**2
        index, found = kernels.nearest_element(x, y, reach, view)
        if square.min() < reach**2:
            assert found == pytest.approx(square.min(), abs=1e-12)
            assert square[index] == pytest.approx(found, abs=1e-12)
        else:
            assert (index, found) == (-1, np.inf)


def test_the_gradient_is_the_slope_of_the_score_away_from_ends_of_surfaces(scan: Scan) -> None:
    # There, and behind the walls, where the other part of the density is constant, the gradient is exact.
    field = ScanField.from_scan(scan, sigma_hit=0.1)
    points = hit_points(scan.ranges, scan.finder)[60:180:4]
    points = points[(np.abs(points[:, 0]) < 2.4) | (np.abs(points[:, 1]) < 1.4)]
    points = points + 0.08 * points / np.linalg.norm(points, axis=1, keepdims=True)
    pose, gradient, information = np.array([0.02, -0.01, 0.002]), np.zeros(3), np.zeros((3, 3))

    def score(at: np.ndarray) -> float:
        return linearise(points, at, 1, 0.1, 0.8, field.view, np.zeros(3), np.zeros((3, 3)))[0]

    linearise(points, pose, 1, 0.1, 0.8, field.view, gradient, information)
    step = 1e-6
    slopes = [(score(pose + d) - score(pose - d)) / (2 * step) for d in step * np.eye(3)]
    np.testing.assert_allclose(gradient / 0.1**2, slopes, rtol=1e-4, atol=1e-3)
    np.testing.assert_allclose(information, information.T)
    assert np.linalg.eigvalsh(information).min() > 0.0


def test_the_information_is_the_sum_over_points_of_their_levers(rng: np.random.Generator) -> None:
    """A wall with the normal n, at 35 degrees, holds n . (dx, dy) + (r x n) dtheta of each point r, by its weight."""
    bearings, normal = np.radians(np.arange(5.0, 66.0)), np.array([np.cos(np.radians(35.0)), np.sin(np.radians(35.0))])
    wall = 3.0 / (np.cos(bearings) * normal[0] + np.sin(bearings) * normal[1])
    field = ScanField.from_scan(Scan(wall, RangeFinder.from_bearings(bearings, 20.0)), sigma_hit=0.1)
    along = rng.uniform(-0.8, 0.8, (6, 1))
    points = 3.02 * normal + along * np.array([-normal[1], normal[0]])
    information, pose = np.zeros((3, 3)), np.zeros(3)
    _, weight, _, _ = linearise(points, pose, 1, 0.1, 0.8, field.view, np.zeros(3), information)
    assert weight > 1.0
    np.testing.assert_allclose(information[:2, :2], weight * np.outer(normal, normal), rtol=1e-6, atol=1e-9)
    # All points are as far from the wall and count the same.
    turns = points[:, 0] * normal[1] - points[:, 1] * normal[0]
    np.testing.assert_allclose(information[2, 2], weight * (turns**2).mean(), rtol=1e-6)
    np.testing.assert_allclose(information[:2, 2], weight * turns.mean() * normal, rtol=1e-6, atol=1e-9)


def test_a_climb_never_lowers_the_score(scan: Scan, rng: np.random.Generator) -> None:
    view, points = ScanField.from_scan(scan).view, hit_points(scan.ranges, scan.finder)
    for start in rng.normal(size=(5, 3)) * (0.3, 0.3, 0.2):
        for sigma in (0.4, 0.05):
            before = linearise(points, start, 1, sigma, 4 * sigma, view, np.zeros(3), np.zeros((3, 3)))[0]
            after, _ = ascend(points, start, 1, sigma, 3.0, 0.02, 1e-4, 10, view)
            assert after >= before - 1e-9


def test_free_share_rises_smoothly_in_front_of_a_wall(scan: Scan) -> None:
    view = ScanField.from_scan(scan).view
    share = [kernels.free_share(3.0 - d, 0.1, 0.2, view) for d in (-0.1, 0.0, 0.05, 0.1, 0.15, 0.2, 0.5)]
    assert np.all(np.diff(share) > -1e-5)
    assert share[:2] == pytest.approx([0.0, 0.0], abs=1e-5)
    assert share[3] == pytest.approx(0.5, abs=2e-3)
    assert share[-1] == 1.0


def test_pulls_are_summed_by_patches_of_surface(scan: Scan, rng: np.random.Generator) -> None:
    noisy = Scan(scan.ranges + 0.02 * rng.normal(size=len(BEARINGS)), scan.finder)
    view = ScanField.from_scan(noisy).view
    points = hit_points(scan.ranges, scan.finder)
    pose, sigma, reach, patch = np.array([0.02, -0.01, 0.005]), 0.03, 0.12, 0.5
    pulls, noise, sums = np.empty((3, 3)), np.empty((3, 3)), np.empty((len(view.elements), SUMS))
    sum_patches(points, pose, sigma, reach, patch, view, sums, pulls, noise)

    # One list of (residual, its square without the element's noise, pull of one metre, weight) per element.
    found: list[list[tuple[float, float, np.ndarray, float]]] = [[] for _ in view.elements]
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    for arm in points @ np.array([(cos, sin), (-sin, cos)]):
        at = pose[:2] + arm
        i, square = kernels.nearest_element(*at, reach, view)
        if i < 0 or view.elements[i, kernels.PULL] == kernels.NONE:
            continue
        free = kernels.free_share(*at, 2.0 * sigma, view)
        hit = 0.9 * np.exp(-0.5 * square / sigma**2) / np.sqrt(2.0 * np.pi) / sigma
        weight = hit / (hit + free * 0.1 / 20.0 + (1.0 - free) / 20.0)
        normal = view.elements[i, kernels.NX : kernels.NY + 1]
        normals = [normal, np.array([-normal[1], normal[0]])][: 1 + (view.elements[i, kernels.PULL] == kernels.POINT)]
        for n in normals:
            residual = float((at - view.elements[i, :2]) @ n)
            # Its square holds the noise of the element too, that of an end point over the number fitted.
            square = residual**2 / (1.0 + 1.0 / view.elements[i, kernels.FITTED])
            found[i].append((residual, square, weight * np.array([*n, n @ (-arm[1], arm[0])]), weight))
    expected_pulls, expected_noise, patches = np.zeros((3, 3)), np.zeros((3, 3)), 0
    for members in _patches(view.elements, patch):
        inside = [one for i in members for one in found[i]]
        if not inside:
            continue
        patches += 1
        together = sum(residual * pull for residual, _, pull, _ in inside)
        expected_pulls += np.outer(together, together)
        for _, square, pull, _ in inside:
            expected_noise += square * np.outer(pull, pull)
        of_lines = [i for i in members if view.elements[i, kernels.OFF] >= 0.0]
        if of_lines:
            off, count = view.elements[of_lines][:, [kernels.OFF, kernels.COUNT]].T
            square = np.average(off**2, weights=count)
        else:
            square = sum(w * square for _, square, _, w in inside) / sum(w for _, _, _, w in inside)
        offset = sum(pull for _, _, pull, _ in inside)
        expected_noise += square / max(view.elements[members, kernels.COUNT].sum(), 1.0) * np.outer(offset, offset)
    assert patches > 10
    np.testing.assert_allclose(pulls, expected_pulls, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(noise, expected_noise, rtol=1e-9, atol=1e-12)


def _patches(elements: np.ndarray, patch: float) -> list[list[int]]:
    """Return the elements of each patch: as they follow one another, so long or with so many end points."""
    patches: list[list[int]] = []
    for i in np.flatnonzero(elements[:, kernels.PULL] != kernels.NONE):
        if patches:
            apart = np.hypot(*(elements[[patches[-1][0], patches[-1][-1]], :2] - elements[i, :2]).T)
            if apart[1] <= patch and (apart[0] <= patch or elements[patches[-1], kernels.COUNT].sum() < 4):
                patches[-1].append(int(i))
                continue
        patches.append([int(i)])
    return patches


def test_settling_ends_where_pulls_balance(scan: Scan, rng: np.random.Generator) -> None:
    noisy = Scan(scan.ranges + 0.02 * rng.normal(size=len(BEARINGS)), scan.finder)
    view, points = ScanField.from_scan(noisy).view, hit_points(scan.ranges, scan.finder)
    pose, gradient, information = np.array([0.01, -0.01, 0.003]), np.empty(3), np.empty((3, 3))
    settle(points, pose, 0.03, 2.5, 0.02, 1e-6, 20, view)
    linearise(points, pose, 1, 0.03, 0.12, view, gradient, information)
    assert np.abs(np.linalg.solve(information, gradient) * (1.0, 1.0, 2.5)).max() < 1e-5


def test_settling_leaves_a_pose_far_from_an_optimum_alone(scan: Scan) -> None:
    view, points = ScanField.from_scan(scan).view, hit_points(scan.ranges, scan.finder)
    pose = np.array([0.08, 0.08, 0.0])
    settle(points, pose, 0.03, 2.5, 0.02, 1e-6, 20, view)
    np.testing.assert_array_equal(pose, [0.08, 0.08, 0.0])
