"""Weighted poses: moments, clusters, and where clouds begin."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import wrap_angle
from beamfield.localization.particles import Particles, belief_poses, free_poses
from beamfield.localization.replay import PoseBelief
from beamfield.localization.resampling import BIN_SECTORS, BIN_SIDE
from beamfield.maps.occupancy import OccupancyGrid


def test_moments_are_those_of_numpy_with_headings_on_the_circle(rng):
    poses = rng.normal([40.0, -3.0, np.pi], [0.3, 0.5, 0.4], (500, 3))
    poses[::2, 2] -= 2.0 * np.pi
    weights = rng.random(500)
    weights /= weights.sum()
    whole = Particles(poses, weights).whole
    heading = np.angle((weights * np.exp(1j * poses[:, 2])).sum())
    mean = np.array([*(weights @ poses[:, :2]), heading])
    off = poses - mean
    off[:, 2] = wrap_angle(off[:, 2])
    np.testing.assert_allclose(whole.pose, mean, rtol=1e-10)
    np.testing.assert_allclose(whole.covariance, (weights * off.T) @ off, rtol=1e-9, atol=1e-12)
    assert whole.weight == 1.0
    assert whole.spread == pytest.approx(np.sqrt(weights @ (off[:, :2] ** 2).sum(axis=1)), rel=1e-9)


def clusters_by_search(poses: np.ndarray) -> list[int]:
    """Return a cluster number per pose by walking from bin to bin."""
    cells = np.floor(poses[:, :2] / BIN_SIDE).astype(int)
    sectors = np.floor((poses[:, 2] / (2 * np.pi) % 1.0) * BIN_SECTORS).astype(int)
    keys = [(*cell, sector) for cell, sector in zip(cells.tolist(), sectors.tolist(), strict=True)]
    left, number = set(keys), {}
    while left:
        todo, current = [left.pop()], len(set(number.values()))
        while todo:
            x, y, t = key = todo.pop()
            number[key] = current
            near = {(x + i, y + j, (t + k) % BIN_SECTORS) for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (-1, 0, 1)}
            todo += near & left
            left -= near
    return [number[key] for key in keys]


@pytest.mark.parametrize("turn", [0.3, 7.0])
def test_the_best_cluster_is_the_heaviest_group_of_bins_that_touch(rng, turn):
    for _ in range(5):
        poses = rng.uniform([-4, -4, -turn], [4, 4, turn], (150, 3))
        weights = rng.random(150) ** 3
        weights /= weights.sum()
        group = np.array(clusters_by_search(poses))
        mass = np.bincount(group, weights)
        best = Particles(poses, weights).best_cluster
        assert best.weight == pytest.approx(mass.max())
        inside = group == mass.argmax()
        assert best.pose[:2] == pytest.approx(weights[inside] @ poses[inside, :2] / mass.max())
        off = poses[inside] - best.pose
        off[:, 2] = wrap_angle(off[:, 2])
        of_all = (weights[inside] * off.T) @ off / mass.max()
        np.testing.assert_allclose(best.covariance, of_all, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize("far", [0.0, 6e5, 5e6])
def test_clusters_stay_apart_however_far_the_map_is_from_the_origin(rng, far):
    poses = rng.normal(0.0, 0.2, (500, 3))
    poses[:200, :2] += 30.0
    poses[:, :2] += far
    best = Particles(poses, np.full(500, 0.002)).best_cluster
    assert best.weight == pytest.approx(0.6, abs=0.05)
    assert best.pose[:2] == pytest.approx([far, far], abs=0.1)


def test_a_belief_is_drawn_with_its_mean_and_covariance(rng):
    covariance = np.array([[0.5, 0.2, 0.0], [0.2, 0.3, 0.05], [0.0, 0.05, 0.02]])
    poses = belief_poses(PoseBelief(np.array([1.0, 2.0, 3.0]), covariance), 40_000, rng)
    np.testing.assert_allclose(poses.mean(axis=0), [1, 2, 3], atol=0.015)
    np.testing.assert_allclose(np.cov(poses.T), covariance, atol=0.015)
    sure = PoseBelief(np.array([1.0, 2.0, 3.0]), np.zeros((3, 3)))
    assert belief_poses(sure, 3, rng).tolist() == [[1.0, 2.0, 3.0]] * 3


def test_free_poses_are_uniform_over_free_cells_of_a_turned_map(rng):
    cells = np.ones((4, 6))
    cells[1, 2] = cells[2, 4] = 0.0
    grid = OccupancyGrid(cells, 0.5, np.array([3.0, 1.0, 0.7]))
    poses = free_poses(grid, 4000, rng)
    where = np.floor(grid.to_cells(poses[:, :2])).astype(int)
    first = (where == [2, 1]).all(axis=1)
    assert (first | (where == [4, 2]).all(axis=1)).all()
    assert 0.46 < first.mean() < 0.54
    assert abs(np.exp(1j * poses[:, 2]).mean()) < 0.05


def test_what_is_no_cloud_is_refused(rng):
    with pytest.raises(InvalidInputError, match="no free cell"):
        free_poses(OccupancyGrid(np.ones((3, 3)), 0.1), 5, rng)
    for poses in (np.zeros((0, 3)), np.zeros(3), [[0.0, np.nan, 0.0]]):
        with pytest.raises(InvalidInputError, match="poses"):
            Particles(poses)
    for weights in ([1.0], [0.5, 0.6], [1.5, -0.5]):
        with pytest.raises(InvalidInputError, match="weights"):
            Particles(np.zeros((2, 3)), weights)
