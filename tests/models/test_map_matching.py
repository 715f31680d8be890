from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import compose
from beamfield.kernels import correlation as kernels
from beamfield.maps.mapping import InverseSensorModel, local_map, scan_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.occupancy_mapper import OccupancyMapper
from beamfield.maps.raycast import RayCaster
from beamfield.maps.smoothing import smooth_map
from beamfield.models.cell_difference import CellDifferenceModel
from beamfield.models.histogram_matching import HistogramMatchingModel
from beamfield.models.map_matching import MapMatchingModel
from beamfield.sensors import RangeFinder, Scan, SensorLog
from tests.localization.test_global_search import draw_room
from tests.reference.map_matching_slow import correlation, pairs_by_local_cells, pairs_by_map_cells

FINDER = RangeFinder.from_bearings(np.linspace(-2.2, 2.2, 121), max_range=8.0, mount=(0.1, 0.0, 0.0))


@pytest.fixture
def room() -> OccupancyGrid:
    return draw_room((-1.0, 2.0, 0.4))


def random_map(rng, shape, resolution, origin) -> OccupancyGrid:
    values = rng.random(shape)
    values[rng.random(shape) < 0.3] = np.nan
    return OccupancyGrid(values, resolution, origin)


@pytest.mark.parametrize("local_resolution", [0.07, 0.25])
def test_correlation_equals_the_slow_reference(rng, local_resolution):
    grid = random_map(rng, (40, 50), 0.1, (1.0, -2.0, 0.7))
    local = random_map(rng, (17, 23), local_resolution, (-0.6, -0.9, -0.2))
    poses = compose([1.0, -2.0, 0.7], rng.uniform([0, 0, -4], [5, 4, 4], (15, 3)))
    found = MapMatchingModel(grid, min_overlap=1e-3).match(local, poses)
    n_local = np.count_nonzero(~np.isnan(local.probability))
    for pose, rho, overlap, determined in zip(poses, *found, strict=True):
        pairs = pairs_by_local_cells(grid, local, pose)
        assert overlap == len(pairs) / n_local
        assert determined == (len(pairs) / n_local >= 1e-3)
        if determined:
            assert rho == pytest.approx(correlation(pairs), abs=1e-7)


def test_walking_the_maps_cells_instead_gives_nearly_the_same(room, rng):
    """The chapter's sum runs over the cells of the global map."""
    truth = compose([-1.0, 2.0, 0.4], [3.0, 4.5, 0.9])
    local = scan_map(Scan(RayCaster(room).expected_ranges(truth, FINDER), FINDER), resolution=0.1)
    model = MapMatchingModel(room)
    for pose in truth + rng.normal(0.0, [0.2, 0.2, 0.2], (2, 3)):
        expected = correlation(pairs_by_map_cells(room, local, pose))
        assert float(model.correlation(local, pose)) == pytest.approx(expected, abs=0.05)


def test_equal_maps_correlate_fully_and_opposite_maps_not_at_all():
    values = np.array([[0.0, 1.0, 0.0], [0.25, 0.5, 1.0]])
    grid = OccupancyGrid(values, 1.0)
    model = MapMatchingModel(grid)
    assert float(model.correlation(grid, [0.0, 0.0, 0.0])) == pytest.approx(1.0, abs=1e-12)
    assert float(model.correlation(OccupancyGrid(1.0 - values, 1.0), [0.0, 0.0, 0.0])) == pytest.approx(-1.0, abs=0.15)
    assert model.log_likelihood(OccupancyGrid(1.0 - values, 1.0), [0.0, 0.0, 0.0]) == -np.inf


def test_the_mean_runs_over_both_maps():
    """By hand: m = 0, 1 and l = 0.5, 1: mean 5/8, so rho = (-5/8 (-1/8) + 3/8 3/8) / sqrt((25 + 9)/64 (1 + 9)/64)."""
    model = MapMatchingModel(OccupancyGrid([[0.0, 1.0]], 1.0))
    rho = float(model.correlation(OccupancyGrid([[0.5, 1.0]], 1.0), [0.0, 0.0, 0.0]))
    assert rho == pytest.approx((5 + 9) / np.sqrt(34 * 10), abs=1e-9)


def test_the_true_pose_wins_against_its_surroundings(room):
    truth = compose([-1.0, 2.0, 0.4], [3.0, 4.5, 0.9])
    scan = Scan(RayCaster(room).expected_ranges(truth, FINDER), FINDER)
    steps = np.array(np.meshgrid(*[np.linspace(-1, 1, 9)] * 2, np.linspace(-0.6, 0.6, 9))).reshape(3, -1).T
    for model in (MapMatchingModel(room), MapMatchingModel(room, smoothing=0.15)):
        assert np.abs(steps[model.correlation(scan, truth + steps).argmax()]).max() < 1e-9
    assert MapMatchingModel(room).correlation(scan, truth) > 0.6


def test_local_maps_of_several_scans_are_measurements_too(room, rng):
    poses = compose([-1.0, 2.0, 0.4], np.linspace([2.0, 1.2, 0.1], [4.0, 1.0, 0.5], 10))
    ranges = RayCaster(room).expected_ranges(poses, FINDER) + 0.02
    log = SensorLog(FINDER, np.arange(10.0), ranges, poses, np.full((10, 3), np.nan))
    local = local_map(log, 9, resolution=0.1)
    near = poses[9] + rng.normal(0.0, [1.0, 1.0, 0.5], (300, 3))
    found = MapMatchingModel(room).correlation(local, np.vstack([poses[9], near]))
    assert found.argmax() == 0 or np.abs(near[found.argmax() - 1] - poses[9]).max() < 0.08
    assert found[0] > 0.7


def test_smoothing_makes_the_score_vary_slowly(room):
    truth = compose([-1.0, 2.0, 0.4], [3.0, 4.5, 0.9])
    scan = Scan(RayCaster(room).expected_ranges(truth, FINDER), FINDER)
    path = truth + np.linspace(0.0, 0.4, 41)[:, None] * [1.0, 0.0, 0.0]
    jumps = [
        np.abs(np.diff(MapMatchingModel(room, smoothing=s).correlation(scan, path))).max() for s in (None, 0.1, 0.2)
    ]
    assert jumps[2] < jumps[1] < 0.7 * jumps[0]


def test_smoothing_is_that_of_the_map(room):
    pose, scan = compose([-1.0, 2.0, 0.4], [3.0, 4.5, 0.9]), Scan(np.full(121, 2.0), FINDER)
    assert MapMatchingModel(room, smoothing=0.2).correlation(scan, pose) == MapMatchingModel(
        smooth_map(room, 0.2)
    ).correlation(scan, pose)


def test_off_the_map_nothing_is_determined(room):
    scan = Scan(np.full(121, 2.0), FINDER)
    model = MapMatchingModel(room)
    found = model.match(scan, [[100.0, 100.0, 0.0], [1e9, -1e9, 1.0], [-1e300, 1e300, 0.0]])
    assert found.correlation.tolist() == [0.0] * 3
    assert found.overlap.tolist() == [0.0] * 3
    assert not found.determined.any()
    assert (model.log_likelihood(scan, [[100.0, 100.0, 0.0]]) == -np.inf).all()


def test_too_little_overlap_is_not_determined():
    grid = OccupancyGrid([[0.0, 1.0, 0.0, 1.0]], 1.0)
    poses = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0]]
    found = MapMatchingModel(grid, min_overlap=0.5).match(grid, poses)
    assert found.overlap.tolist() == [1.0, 0.75, 0.5, 0.25]
    assert found.determined.tolist() == [True, True, True, False]
    np.testing.assert_allclose(found.correlation, [1.0, -1.0, 1.0, 0.0], atol=1e-12)


def test_maps_without_contrast_are_not_determined():
    found = MapMatchingModel(OccupancyGrid(np.zeros((9, 9)), 1.0)).match(OccupancyGrid([[0.0]], 1.0), [3.0, 3.0, 0.0])
    assert (found.correlation, found.overlap, found.determined) == (0.0, 1.0, False)
    # Two different constants are opposites.
    found = MapMatchingModel(OccupancyGrid(np.zeros((9, 9)), 1.0)).match(OccupancyGrid([[1.0]], 1.0), [3.0, 3.0, 0.0])
    assert (found.correlation, found.determined) == (pytest.approx(-1.0), True)


def test_a_map_of_unknown_cells_determines_nothing():
    model = MapMatchingModel(OccupancyGrid(np.full((5, 5), np.nan), 1.0))
    assert not model.match(OccupancyGrid([[0.0, 1.0]], 1.0), [2.0, 2.0, 0.0]).determined


def test_a_scan_without_measurement_says_nothing(room):
    model = MapMatchingModel(room)
    for ranges in (np.full(121, np.nan), np.full(121, np.inf)):
        scan = Scan(ranges, FINDER)
        assert model.log_likelihood(scan, [[0.0, 5.0, 0.0], [99.0, 0.0, 0.0]]).tolist() == [0.0, 0.0]
        assert not model.match(scan, [0.0, 5.0, 0.0]).determined


def test_timid_local_maps_score_low_because_the_mean_is_common(room):
    truth = compose([-1.0, 2.0, 0.4], [3.0, 4.5, 0.9])
    scan = Scan(RayCaster(room).expected_ranges(truth, FINDER), FINDER)
    model = MapMatchingModel(room)
    timid = OccupancyMapper(room.resolution, inverse_model=InverseSensorModel())
    timid.add(scan.ranges[None], scan.finder, np.zeros((1, 3)))
    assert model.correlation(timid.to_grid(), truth) < 0.2 < model.correlation(scan, truth)


def test_fast_sums_equal_plain_sums(rng):
    """The kernel may reorder its sums; no NaN reaches it, because undefined cells carry a number."""
    table = rng.uniform(-0.5, 0.5, (32, 42)).astype(np.float32)
    table[rng.random(table.shape) < 0.3] = kernels.UNDEFINED
    table[[0, -1]], table[:, [0, -1]] = kernels.UNDEFINED, kernels.UNDEFINED
    xs, ys = rng.uniform(-20, 20, (2, 1001))
    values = rng.uniform(-0.5, 0.5, 1001).astype(np.float32)
    angle = rng.uniform(-3, 3, 50)
    poses = np.column_stack([rng.uniform(-20, 60, 50), rng.uniform(-20, 50, 50), np.cos(angle), np.sin(angle)])
    sums = np.empty((50, 6))
    kernels.fill_sums(poses, xs, ys, values, table.reshape(-1), 30, 40, sums)
    for (x, y, c, s), row in zip(poses, sums, strict=True):
        col = np.clip(np.floor(x + c * xs - s * ys), -1, 40).astype(int)
        line = np.clip(np.floor(y + s * xs + c * ys), -1, 30).astype(int)
        m = table[line + 1, col + 1].astype(float)
        known = m < 1
        m, v = m[known], values[known].astype(float)
        expected = [known.sum(), v.sum(), m.sum(), (m * v).sum(), (v * v).sum(), (m * m).sum()]
        np.testing.assert_allclose(row, expected, atol=1e-10)


@pytest.mark.parametrize("min_overlap", [0.0, -0.1, 1.1, np.nan])
@pytest.mark.parametrize("model", [MapMatchingModel, CellDifferenceModel, HistogramMatchingModel])
def test_overlaps_that_are_no_share_are_refused(room, model, min_overlap):
    with pytest.raises(InvalidInputError, match=r"min_overlap: expected a share in \(0, 1\], got"):
        model(room, min_overlap=min_overlap)


def test_kernels_that_make_no_sense_are_refused(room):
    with pytest.raises(InvalidInputError, match=r"smoothing: expected a standard deviation .* got -1"):
        MapMatchingModel(room, smoothing=-1.0)
