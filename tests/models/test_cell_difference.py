from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import compose
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.cell_difference import CellDifferenceModel
from tests.reference.map_matching_slow import pairs_by_local_cells


def random_map(rng, shape, origin) -> OccupancyGrid:
    values = rng.random(shape)
    values[rng.random(shape) < 0.3] = np.nan
    return OccupancyGrid(values, 0.1, origin)


def test_equals_the_slow_reference(rng):
    grid, local = random_map(rng, (40, 50), (1.0, -2.0, 0.7)), random_map(rng, (17, 23), (-0.6, -0.9, -0.2))
    poses = compose([1.0, -2.0, 0.7], rng.uniform([-1, -1, -4], [6, 5, 4], (20, 3)))
    values = CellDifferenceModel(grid, 3.0, min_overlap=0.3).log_likelihood(local, poses)
    total = np.count_nonzero(~np.isnan(local.probability))
    assert np.isinf(values).any()
    for pose, value in zip(poses, values, strict=True):
        pairs = np.array(pairs_by_local_cells(grid, local, pose)).reshape(-1, 2)
        if len(pairs) < 0.3 * total:
            assert value == -np.inf
        else:
            difference = ((pairs[:, 0] - pairs[:, 1]) ** 2).mean() * total
            assert value == pytest.approx(-difference / 18.0, rel=1e-6)


def test_equal_maps_differ_by_nothing_and_each_wrong_cell_costs(rng):
    values = rng.integers(0, 2, (5, 6)).astype(float)
    grid = OccupancyGrid(values, 1.0)
    wrong = values.copy()
    wrong[2, 3] = 1.0 - wrong[2, 3]
    model = CellDifferenceModel(grid, 0.5)
    assert model.log_likelihood(grid, [0.0, 0.0, 0.0]) == 0.0
    assert model.log_likelihood(OccupancyGrid(wrong, 1.0), [0.0, 0.0, 0.0]) == pytest.approx(-2.0)


def test_cells_off_the_map_count_as_the_mean_of_the_others():
    grid = OccupancyGrid([[0.0, 1.0, 0.0, 1.0]], 1.0)
    local = OccupancyGrid([[0.0, 1.0, 0.0, 0.0]], 1.0)
    at_home, half_off = CellDifferenceModel(grid).log_likelihood(local, [[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])
    assert at_home == pytest.approx(-0.5)  # one of four cells is wrong
    assert half_off == pytest.approx(0.0)  # both common cells are right
    shifted = CellDifferenceModel(grid).log_likelihood(local, [1.0, 0.0, 0.0])
    assert shifted == pytest.approx(-0.5 * 4.0)  # all three common cells are wrong, and count for four


@pytest.mark.parametrize("sigma", [0.0, -1.0, np.nan, np.inf])
def test_sigmas_that_make_no_sense_are_refused(sigma):
    with pytest.raises(InvalidInputError, match="sigma: expected a positive, finite number, got"):
        CellDifferenceModel(OccupancyGrid([[0.0]], 1.0), sigma)
