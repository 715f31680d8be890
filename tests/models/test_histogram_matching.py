from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from beamfield.geometry import compose, transform_points
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.histogram_matching import HistogramMatchingModel
from beamfield.sensors import RangeFinder, Scan


def random_map(rng, shape, origin) -> OccupancyGrid:
    values = rng.choice([0.0, 0.2, 0.5, 0.9, 1.0, np.nan], shape)
    return OccupancyGrid(values, 0.1, origin)


def common_share(grid: OccupancyGrid, local: OccupancyGrid, pose) -> tuple[int, float]:
    """Return number of common cells and the share that the histograms have in common, with counters."""
    columns, lines = (Counter(), Counter()), (Counter(), Counter())
    n = 0
    for row, col in np.argwhere(~np.isnan(local.probability) & (local.probability != 0.5)):
        point = transform_points(pose, local.to_map([col + 0.5, row + 0.5]))
        c, r = np.floor(grid.to_cells(point) + 1e-9).astype(int)
        if not (0 <= r < grid.shape[0] and 0 <= c < grid.shape[1]):
            continue
        m = grid.probability[r, c]
        if np.isnan(m) or m == 0.5:
            continue
        n += 1
        for histogram, value in ((0, local.probability[row, col]), (1, m)):
            columns[histogram][(c, value > 0.5)] += 1
            lines[histogram][(r, value > 0.5)] += 1
    shared = [sum((a & b).values()) for a, b in (columns, lines)]
    return n, sum(shared) / 2 / max(n, 1)


def test_equals_counting_cell_by_cell(rng):
    grid, local = random_map(rng, (40, 50), (1.0, -2.0, 0.7)), random_map(rng, (17, 23), (-0.6, -0.9, -0.2))
    poses = compose([1.0, -2.0, 0.7], rng.uniform([-1, -1, -4], [6, 5, 4], (20, 3)))
    values = HistogramMatchingModel(grid, min_overlap=0.3).log_likelihood(local, poses)
    total = np.count_nonzero(~np.isnan(local.probability) & (local.probability != 0.5))
    assert np.isinf(values).any()
    for pose, value in zip(poses, values, strict=True):
        n, share = common_share(grid, local, pose)
        assert np.exp(value) == pytest.approx(share if n >= 0.3 * total else 0.0, abs=1e-12)


def test_cells_may_move_along_a_wall_but_not_across():
    """A single obstacle in the same column: the column histogram agrees, the row histogram does not."""
    values = np.zeros((4, 5))
    values[1, 2] = 1.0
    moved = np.zeros((4, 5))
    moved[3, 2] = 1.0
    model = HistogramMatchingModel(OccupancyGrid(values, 1.0))
    share = np.exp(model.log_likelihood(OccupancyGrid(moved, 1.0), [0.0, 0.0, 0.0]))
    assert share == pytest.approx((20 + 18) / 40)
    assert model.log_likelihood(OccupancyGrid(values, 1.0), [0.0, 0.0, 0.0]) == 0.0


def test_off_the_map_is_impossible_however_far():
    model = HistogramMatchingModel(OccupancyGrid(np.zeros((4, 5)), 1.0))
    poses = [[50.0, 0.0, 0.0], [-1e9, 1e9, 1.0], [1e300, 0.0, 0.0]]
    assert (model.log_likelihood(OccupancyGrid(np.zeros((3, 3)), 1.0), poses) == -np.inf).all()


def test_a_measurement_without_decided_cells_says_nothing():
    model = HistogramMatchingModel(OccupancyGrid(np.zeros((4, 5)), 1.0))
    scan = Scan([np.nan], RangeFinder.from_bearings([0.0], 5.0))
    for z in (scan, OccupancyGrid([[0.5, np.nan]], 1.0)):
        assert model.log_likelihood(z, [[2.0, 2.0, 0.0], [99.0, 0.0, 0.0]]).tolist() == [0.0, 0.0]
