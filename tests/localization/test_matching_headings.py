"""Transforms find the headings, and the correlations, that asking the model for every pose finds."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.geometry import compose, wrap_angle
from beamfield.localization import matching_headings as module
from beamfield.localization.likelihood_map import likelihood_map
from beamfield.localization.matching_headings import matching_headings, simple_ratio
from beamfield.maps.mapping import local_map, scan_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.map_matching import MapMatchingModel
from beamfield.sensors import RangeFinder, Scan
from tests.threads import forced_threads

HEADINGS = 14
ANGLES = wrap_angle(2.0 * np.pi * np.arange(HEADINGS) / HEADINGS)
# What `matching_headings` promises.
DOUBLE_ERROR, SINGLE_LOSS = 1e-8, 1e-3


def a_map(seed: int = 2, shape=(70, 90), values=(0.0, 0.05, 0.9, 1.0)) -> OccupancyGrid:
    """Boxes on free space with unknown parts, in a frame that is moved and turned."""
    rng = np.random.default_rng(seed)
    cells = rng.choice(values[:2], shape)
    for _ in range(25):
        row, col = rng.integers(0, shape[0] - 8), rng.integers(0, shape[1] - 8)
        height, width = rng.integers(1, 8, 2)
        cells[row : row + height, col : col + width] = rng.choice(values[2:])
    cells[:12, :20] = cells[50:, 60:75] = np.nan
    return OccupancyGrid(cells, 0.1, np.array([3.0, -2.0, 0.4]))


def a_local_map(grid: OccupancyGrid, seed: int = 4, resolution: float = 0.1, side: int = 37) -> OccupancyGrid:
    """A piece of the map as a robot inside saw it: a bit blurred, with holes, in cells that do not line up."""
    rng = np.random.default_rng(seed)
    cells = grid.probability[20:45, 25:62][:side, :side].copy()
    cells = np.clip(cells + rng.normal(0.0, 0.03, cells.shape), 0.0, 1.0)
    cells[rng.random(cells.shape) < 0.3] = np.nan
    return OccupancyGrid(cells, resolution, np.array([-0.7, -1.3, 0.3]))


def every_place(grid: OccupancyGrid, resolution: float):
    rows, cols = (int(np.ceil(n * grid.resolution / resolution - 1e-6)) for n in grid.shape)
    row, col = np.indices((rows, cols)).reshape(2, -1)
    return row, col


def ask_for_every_pose(model, z, places, resolution) -> np.ndarray:
    """Return max(rho, 0), (places, headings)."""
    row, col = places
    poses = np.empty((len(row), HEADINGS, 3))
    centres = np.column_stack([col + 0.5, row + 0.5, np.zeros(len(row))]) * resolution
    poses[...] = compose(model.grid.origin, centres)[:, None]
    poses[..., 2] = ANGLES
    return np.maximum(model.correlation(z, poses), 0.0)


def find(model, z, places, resolution, precision, **options):
    return matching_headings(model, z, places, ANGLES, model.grid.origin, resolution, precision=precision, **options)


@pytest.mark.parametrize("ratio", [1.0, 2.0, 0.5, 1.5], ids=["1", "2", "half", "three halves"])
def test_double_precision_gives_the_correlations_of_the_model(ratio):
    grid = a_map()
    model, z, resolution = MapMatchingModel(grid), a_local_map(grid), ratio * grid.resolution
    places = every_place(grid, resolution)
    found = find(model, z, places, resolution, np.float64)
    asked = ask_for_every_pose(model, z, places, resolution)
    assert found.is_exact
    assert (asked.max(axis=1) > 0.0).mean() > 0.5
    assert asked.max() > 0.5
    np.testing.assert_allclose(found.correlation, asked.max(axis=1), atol=DOUBLE_ERROR)
    np.testing.assert_allclose(asked[np.arange(len(asked)), found.heading_index], asked.max(axis=1), atol=DOUBLE_ERROR)
    # Without a positive correlation, and among equals, the first is taken.
    np.testing.assert_array_equal(found.heading_index[asked.max(axis=1) == 0.0], 0)


@pytest.mark.parametrize("seed", range(3))
def test_single_precision_finds_headings_that_are_nearly_the_best(seed):
    grid = a_map(seed)
    model, z = MapMatchingModel(grid), a_local_map(grid, seed)
    places = every_place(grid, 0.1)
    found = find(model, z, places, 0.1, np.float32)
    asked = ask_for_every_pose(model, z, places, 0.1)
    assert not found.is_exact
    loss = asked.max(axis=1) - asked[np.arange(len(asked)), found.heading_index]
    assert loss.max() <= SINGLE_LOSS
    assert (found.heading_index == asked.argmax(axis=1)).mean() > 0.99


@pytest.mark.parametrize("precision", [np.float32, np.float64], ids=["single", "double"])
@pytest.mark.parametrize("values", [(0.0, 0.0, 1.0, 1.0), (0.5, 0.5, 0.5001, 0.5001)], ids=["binary", "faint"])
def test_flat_overlaps_are_left_to_the_model(values, precision):
    """Free space on free space has no variance, and faint maps hardly any: rounding must not decide."""
    grid = a_map(values=values)
    model = MapMatchingModel(grid, min_overlap=0.05)
    z = OccupancyGrid(np.where(np.isnan(grid.probability[20:45, 25:62]), 0.0, grid.probability[20:45, 25:62]), 0.1)
    only_free = OccupancyGrid(np.full((4, 4), values[0]), 0.1, (-0.2, -0.2, 0.0))
    for local in (z, only_free):
        places = every_place(grid, 0.1)
        found = find(model, local, places, 0.1, precision)
        asked = ask_for_every_pose(model, local, places, 0.1)
        best = asked[np.arange(len(asked)), found.heading_index]
        assert (asked.max(axis=1) - best).max() <= SINGLE_LOSS
        np.testing.assert_allclose(found.correlation, best, atol=1e-3 if precision is np.float32 else DOUBLE_ERROR)


def test_places_that_see_nothing_of_the_map_are_worth_nothing():
    grid = a_map()
    cells = np.full((70, 90), np.nan)
    cells[:8, :8] = np.eye(8)
    model = MapMatchingModel(replace(grid, probability=cells))
    z = OccupancyGrid(np.eye(8), 0.1)
    places = every_place(grid, 0.1)
    for precision in (np.float32, np.float64):
        found = find(model, z, places, 0.1, precision)
        asked = ask_for_every_pose(model, z, places, 0.1)
        np.testing.assert_allclose(found.correlation, asked.max(axis=1), atol=1e-5)
        assert (found.correlation[(places[0] > 30) & (places[1] > 30)] == 0.0).all()
    nothing = MapMatchingModel(replace(grid, probability=np.full((70, 90), np.nan)))
    assert (find(nothing, z, places, 0.1, np.float32).correlation == 0.0).all()


def test_tiles_change_nothing(monkeypatch):
    grid = a_map()
    model, z = MapMatchingModel(grid), OccupancyGrid(np.eye(9), 0.1, (-0.4, -0.4, 0.0))
    places = every_place(grid, 0.1)
    whole = find(model, z, places, 0.1, np.float64)
    monkeypatch.setattr(module, "CELLS_PER_TILE", 20)
    tiled = find(model, z, places, 0.1, np.float64)
    np.testing.assert_allclose(tiled.correlation, whole.correlation, atol=1e-11)


def test_the_number_of_threads_changes_no_bit():
    grid = a_map()
    z, places = a_local_map(grid), every_place(grid, 0.1)
    with forced_threads(1):
        one = find(MapMatchingModel(grid), z, places, 0.1, np.float32)
    with forced_threads(3):
        three = find(MapMatchingModel(grid), z, places, 0.1, np.float32)
    np.testing.assert_array_equal(one.correlation, three.correlation)
    np.testing.assert_array_equal(one.heading_index, three.heading_index)


def test_progress_moves_and_ends_with_the_total():
    grid = a_map()
    calls = []
    find(MapMatchingModel(grid), a_local_map(grid), every_place(grid, 0.1), 0.1, np.float32,
         progress=lambda done, total: calls.append((done, total)))  # fmt: skip
    assert calls == sorted(calls)
    assert len(calls) > 1
    assert calls[-1] == (70 * 90 * HEADINGS,) * 2


def test_scans_and_smoothed_maps_are_compared_as_the_model_does():
    grid = a_map()
    finder = RangeFinder.from_bearings(np.radians(np.arange(-90.0, 90.0)), 4.0, mount=(0.2, 0.1, 0.3))
    parameters = BeamParameters(z_hit=1.0, z_short=0.0, z_max=0.0, z_rand=0.0, sigma_hit=0.02, lambda_short=0.5)
    pose = compose(grid.origin, np.array([4.0, 4.5, 0.5]))
    scan = BeamModel(grid, parameters).sample(pose, finder, np.random.default_rng(0))[0]
    model = MapMatchingModel(grid, smoothing=0.1)
    places = every_place(grid, 0.1)
    found = find(model, scan, places, 0.1, np.float64)
    asked = ask_for_every_pose(model, scan, places, 0.1)
    np.testing.assert_allclose(found.correlation, asked.max(axis=1), atol=DOUBLE_ERROR)


def test_the_model_is_asked_for_every_pose_where_transforms_do_not_pay_or_do_not_fit():
    grid = a_map()
    model, z = MapMatchingModel(grid), a_local_map(grid)
    rows, cols = every_place(grid, 0.1)
    assert find(model, z, (rows, cols), 0.1, None) is not None
    assert find(model, z, (rows[:50], cols[:50]), 0.1, None) is None
    assert find(model, z, (rows, cols), 0.1 * np.sqrt(2.0), np.float64) is None
    assert find(model, Scan([np.nan], RangeFinder.from_bearings([0.0], 5.0)), (rows, cols), 0.1, np.float64) is None
    elsewhere = grid.origin + np.array([0.05, 0.0, 0.0])
    assert matching_headings(model, z, (rows, cols), ANGLES, elsewhere, 0.1, precision=np.float64) is None


def test_double_precision_is_taken_for_local_maps_of_many_cells_and_for_small_overlaps():
    grid = a_map()
    places = every_place(grid, 0.1)
    many = OccupancyGrid(np.random.default_rng(0).random((300, 300)), 0.01, (-1.5, -1.5, 0.0))
    assert find(MapMatchingModel(grid), many, places, 0.1, None).is_exact
    few = a_local_map(grid, side=9)
    assert not find(MapMatchingModel(grid), few, places, 0.1, None).is_exact
    assert find(MapMatchingModel(grid, min_overlap=1e-3), few, places, 0.1, None).is_exact


def test_steps_have_simple_ratios_or_none():
    assert simple_ratio(0.1, 0.05) == simple_ratio(0.1, 0.05000000074505806) == 2
    assert simple_ratio(0.1, 0.15) * 3 == 2
    assert simple_ratio(0.1, 0.0371) is None


@pytest.mark.parametrize("cell", [0.1, 0.05000000074505806], ids=["0.1", "single precision 0.05"])
def test_the_map_of_likelihoods_holds_the_models_values(cell):
    grid = replace(a_map(), resolution=cell)
    model, z = MapMatchingModel(grid), a_local_map(grid, resolution=cell, side=12)
    assert not find(model, z, every_place(grid, 2 * cell), 2 * cell, None).is_exact
    result = likelihood_map(model, z, grid, resolution=0.1, headings=HEADINGS)
    assert result.resolution == pytest.approx(0.1, rel=1e-6)
    assert result.resolution / cell == round(0.1 / cell)
    rows, cols = np.nonzero(result.evaluated)
    np.testing.assert_allclose(
        result.log_likelihood[rows, cols], model.log_likelihood(z, result.poses(rows, cols)), rtol=1e-12
    )
    asked = ask_for_every_pose(model, z, (rows, cols), result.resolution).max(axis=1)
    np.testing.assert_allclose(np.exp(result.log_likelihood[rows, cols]), asked, atol=SINGLE_LOSS)


def test_a_local_map_of_many_cells_gets_its_values_from_the_transforms():
    grid = a_map()
    fine = np.repeat(np.repeat(a_local_map(grid).probability, 8, axis=0), 8, axis=1)
    model, z = MapMatchingModel(grid), OccupancyGrid(fine, 0.0125, np.array([-0.7, -1.3, 0.3]))
    places = every_place(grid, 0.1)
    assert find(model, z, places, 0.1, None).is_exact
    result = likelihood_map(model, z, grid, resolution=0.1, headings=HEADINGS, where="all")
    picked = np.arange(0, 6300, 50)
    asked = ask_for_every_pose(model, z, (places[0][picked], places[1][picked]), 0.1).max(axis=1)
    np.testing.assert_allclose(np.exp(result.log_likelihood.reshape(-1)[picked]), asked, atol=DOUBLE_ERROR)
    assert not np.isnan(result.log_likelihood).any()


def test_a_measurement_without_cells_is_as_likely_everywhere():
    grid = a_map()
    empty = OccupancyGrid(np.full((3, 3), np.nan), 0.1)
    result = likelihood_map(MapMatchingModel(grid), empty, grid, headings=4)
    assert result.is_flat
    assert (result.log_likelihood[result.evaluated] == 0.0).all()


@pytest.mark.real
def test_wean_hall_has_the_headings_of_the_model(data):
    from beamfield.io.read_log import read_log
    from beamfield.io.read_map import read_map

    folder = data / "wean_hall"
    grid = read_map(folder / "wean.dat.gz")
    sensor = read_log(folder / "robotdata1.log.gz").only_sensor()
    model = MapMatchingModel(grid)
    local = local_map(sensor, 300, n=10, resolution=0.2, poses=sensor.odometry)
    rng = np.random.default_rng(1)
    for z in (local, scan_map(sensor.scan(600), resolution=0.1)):
        rows, cols = np.nonzero(grid.free)
        picked = rng.choice(len(rows), 300, replace=False)
        asked = ask_for_every_pose(model, z, (rows[picked], cols[picked]), 0.1)
        single = find(model, z, (rows, cols), 0.1, np.float32).heading_index[picked]
        assert (asked.max(axis=1) - asked[np.arange(300), single]).max() <= 1e-4
        double = find(model, z, (rows, cols), 0.1, np.float64).correlation[picked]
        np.testing.assert_allclose(double, asked.max(axis=1), atol=1e-10)
