from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.smoothing import smooth_map


def test_each_cell_becomes_the_weighted_mean_of_the_defined_ones(rng):
    values = rng.random((14, 17))
    values[rng.random(values.shape) < 0.3] = np.nan
    grid = OccupancyGrid(values, 0.1, (1.0, 2.0, 0.3))
    smooth = smooth_map(grid, 0.15)
    rows, cols = np.indices(values.shape)
    for row, col in np.argwhere(~np.isnan(values))[::11]:
        # The kernel is a product over the axes, cut off at 4 sigma = 6 cells along each.
        near = (abs(rows - row) <= 6) & (abs(cols - col) <= 6) & ~np.isnan(values)
        weight = np.exp(-((rows - row) ** 2 + (cols - col) ** 2) / (2 * 1.5**2)) * near
        expected = (weight * np.nan_to_num(values)).sum() / weight.sum()
        assert smooth.probability[row, col] == pytest.approx(expected, abs=1e-6)
    assert smooth.origin.tolist() == grid.origin.tolist()


def test_undefined_cells_stay_undefined_and_say_nothing():
    values = np.full((20, 20), np.nan)
    values[:, :10] = 0.25
    smooth = smooth_map(OccupancyGrid(values, 0.1), 0.2)
    assert (np.isnan(smooth.probability) == np.isnan(values)).all()
    np.testing.assert_allclose(smooth.probability[:, :10], 0.25, rtol=1e-6)


@pytest.mark.parametrize("sigma", [0.0, -0.1, np.nan, np.inf, 0.02, 5.0])
def test_kernels_that_make_no_sense_are_refused_by_name_and_value(sigma):
    with pytest.raises(InvalidInputError, match=rf"smoothing: .* 0.025 m, and .* 0.5 m; got {sigma:g}"):
        smooth_map(OccupancyGrid(np.zeros((10, 20)), 0.1), sigma)
