"""The likelihood over a map: its maximum is where the scan was taken, its values are the model's."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import between, compose
from beamfield.localization.lattice_noise import widened_field_for_lattice, widened_for_lattice
from beamfield.localization.likelihood_map import likelihood_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder, Scan

PARAMETERS = BeamParameters(z_hit=0.85, z_short=0.05, z_max=0.02, z_rand=0.08, sigma_hit=0.05, lambda_short=0.5)
BEARINGS = np.radians(np.arange(-90.0, 90.0))
TRUTH_IN_GRID = np.array([2.13, 1.48, 0.7])


@pytest.fixture(scope="module")
def grid() -> OccupancyGrid:
    """A room of 6 m x 4 m without symmetry, in a frame that is moved and turned."""
    cells = np.zeros((80, 120), np.float32)
    cells[[0, -1]] = cells[:, [0, -1]] = 1.0
    cells[:30, 80:83] = 1.0
    cells[50:55, 20:40] = 1.0
    cells[60:, 90:] = np.nan
    return OccupancyGrid(cells, 0.05, np.array([3.0, -2.0, 0.4]))


@pytest.fixture(scope="module")
def truth(grid) -> np.ndarray:
    return compose(grid.origin, TRUTH_IN_GRID)


def finder(mount=(0.0, 0.0, 0.0), bearings=BEARINGS) -> RangeFinder:
    return RangeFinder.from_bearings(bearings, 8.0, mount=mount)


def noisy_scan(grid, pose, sensor) -> Scan:
    return BeamModel(grid, PARAMETERS).sample(pose, sensor, np.random.default_rng(5))[0]


def wide_model(grid, **options) -> BeamModel:
    return BeamModel(grid, widened_for_lattice(PARAMETERS, resolution=0.1, headings=72), **options)


def assert_near(best, truth) -> None:
    step = between(truth, best)
    assert np.hypot(*step[:2]) <= 0.15
    assert abs(step[2]) <= np.radians(5.0)


@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (0.2, -0.1, 0.3)], ids=["centred", "mounted"])
def test_the_maximum_of_the_beam_model_is_where_the_scan_was_taken(grid, truth, mount):
    scan = noisy_scan(grid, truth, finder(mount))
    assert_near(likelihood_map(wide_model(grid), scan, grid).best_pose, truth)


def test_the_maximum_of_the_likelihood_field_is_where_the_scan_was_taken(grid, truth):
    scan = noisy_scan(grid, truth, finder())
    parameters = widened_field_for_lattice(
        LikelihoodFieldParameters.from_beam_parameters(PARAMETERS), scan, resolution=0.1, headings=72
    )
    result = likelihood_map(LikelihoodFieldModel(grid, parameters), scan, grid)
    assert_near(result.best_pose, truth)


def test_the_picture_is_darkest_at_the_maximum(grid, truth):
    result = likelihood_map(wide_model(grid), noisy_scan(grid, truth, finder()), grid)
    drawn = [image.get_array() for axes in result.plot(grid).axes for image in axes.images]
    likelihoods = next(values for values in drawn if values.shape[:2] == result.log_likelihood.shape)
    assert np.unravel_index(np.ma.filled(likelihoods, -np.inf).argmax(), likelihoods.shape) == result.best_cell


@pytest.mark.parametrize("mount", [(0.0, 0.0, 0.0), (0.2, -0.1, 0.3)], ids=["centred", "mounted"])
def test_values_are_the_models_at_poses_inside_their_cells(grid, truth, mount):
    scan = noisy_scan(grid, truth, finder(mount))
    model = wide_model(grid, n_beams=40)
    result = likelihood_map(model, scan, grid)
    rows, cols = np.nonzero(result.evaluated)
    poses = result.poses(rows, cols)
    # Many poses are looked up in a table, few are not.
    np.testing.assert_allclose(result.log_likelihood[rows, cols], model.log_likelihood(scan, poses), atol=1e-4)
    in_lattice = between(grid.origin, poses)[:, :2] / result.resolution
    assert np.abs(in_lattice - np.column_stack([cols, rows]) - 0.5).max() <= 0.5 + 1e-9


def test_each_cell_holds_the_largest_value_over_the_headings(grid, truth):
    scan = noisy_scan(grid, truth, finder())
    model = wide_model(grid, n_beams=20)
    result = likelihood_map(model, scan, grid, headings=36)
    rows, cols = (index[::97] for index in np.nonzero(result.evaluated))
    poses = np.repeat(result.poses(rows, cols)[:, None], 36, axis=1)
    poses[..., 2] = 2.0 * np.pi * np.arange(36) / 36
    np.testing.assert_allclose(
        model.log_likelihood(scan, poses).max(axis=1), result.log_likelihood[rows, cols], atol=1e-4
    )


def test_the_rival_is_the_best_place_that_lies_apart(grid, truth):
    result = likelihood_map(wide_model(grid), noisy_scan(grid, truth, finder()), grid, resolution=0.2, headings=36)
    pose, below = result.rival(1.5)
    rows, cols = np.nonzero(result.evaluated)
    places, values = result.poses(rows, cols), result.log_likelihood[rows, cols]
    away = np.hypot(*(places - result.best_pose)[:, :2].T) >= 1.5 - 1e-9
    assert below == values.max() - values[away].max() >= 0.0
    np.testing.assert_array_equal(pose, places[away][np.argmax(values[away])])
    assert result.rival(1000.0) is None
    with pytest.raises(InvalidInputError, match="apart: expected"):
        result.rival(-1.0)


def test_nothing_is_nan_and_only_free_cells_are_evaluated(grid, truth):
    ranges = np.array(noisy_scan(grid, truth, finder()).ranges)
    ranges[::3], ranges[1] = np.nan, np.inf
    impossible = BeamParameters(z_hit=1.0, z_short=0.0, z_max=0.0, z_rand=0.0, sigma_hit=0.05, lambda_short=0.5)
    result = likelihood_map(BeamModel(grid, impossible), Scan(ranges, finder()), grid, headings=12)
    assert not np.isnan(result.log_likelihood).any()
    assert (result.log_likelihood[~result.evaluated] == -np.inf).all()
    assert (result.heading_index[~result.evaluated] == -1).all()
    rows, cols = np.nonzero(result.evaluated)
    # Their centres lie on borders of the map's cells, which belong to the cell above.
    assert grid.look_up(grid.free, grid.to_map(np.column_stack([cols, rows]) * 2.0 + 1.000001)).all()
    # A missing return is impossible under these parameters, wherever the robot is.
    assert result.is_flat
    assert np.isfinite(result.best_pose).all()


def test_a_scan_without_a_measurement_is_as_likely_everywhere(grid):
    for model in (wide_model(grid), LikelihoodFieldModel(grid, LikelihoodFieldParameters(0.8, 0.1, 0.1))):
        result = likelihood_map(model, Scan(np.full(180, np.nan), finder()), grid, headings=4)
        assert result.is_flat
        assert (result.log_likelihood[result.evaluated] == 0.0).all()


def test_free_cells_are_evaluated(grid, truth):
    result = likelihood_map(wide_model(grid), noisy_scan(grid, truth, finder()), grid, headings=8)
    # Centres of the lattice lie on corners of the map's cells, and belong to the cell above.
    np.testing.assert_array_equal(result.evaluated, grid.free[1::2, 1::2])
    assert result.n_poses == 8 * result.evaluated.sum()
    likely = np.quantile(result.log_likelihood[result.evaluated], 0.9)
    assert result.share_above(likely) == pytest.approx(0.1, abs=0.01)


def test_progress_ends_with_the_total(grid, truth):
    calls = []
    scan = noisy_scan(grid, truth, finder())
    likelihood_map(wide_model(grid, n_beams=5), scan, grid, progress=lambda done, total: calls.append((done, total)))
    assert calls[-1][0] == calls[-1][1] > 0


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"resolution": 0.0}, "resolution: expected a positive"),
        ({"resolution": 1e-5}, "more than"),
        ({"headings": 0}, "headings: expected 1 to 3600, got 0"),
        ({"headings": 4.5}, "headings: expected a whole number, got 4.5"),
    ],
    ids=["step", "fine", "headings", "half a heading"],
)
def test_what_makes_no_sense_is_refused(grid, options, message):
    with pytest.raises(InvalidInputError, match=message):
        likelihood_map(wide_model(grid), Scan(np.ones(180), finder()), grid, **options)


def test_the_noise_of_a_lattice_is_added_to_that_of_hits():
    wide = widened_for_lattice(PARAMETERS, resolution=0.3, headings=36)
    assert wide.sigma_hit == pytest.approx(np.sqrt(0.05**2 + 0.3**2 / 6))
    assert wide.sigma_slope == pytest.approx(np.radians(10.0) / np.sqrt(12.0))
    scan = Scan([3.0, 4.0, np.inf], finder(bearings=[0.0, 1.0, 2.0]))
    field = widened_field_for_lattice(LikelihoodFieldParameters(0.8, 0.1, 0.05), scan, resolution=0.3, headings=36)
    assert field.sigma_hit == pytest.approx(np.sqrt(0.05**2 + 0.3**2 / 6 + 12.5 * np.radians(10.0) ** 2 / 12))
    with pytest.raises(InvalidInputError, match="headings"):
        widened_for_lattice(PARAMETERS, resolution=0.3, headings=0)
    with pytest.raises(InvalidInputError, match="resolution"):
        widened_for_lattice(PARAMETERS, resolution=-1.0, headings=8)
