from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.geometry import compose, invert
from beamfield.kernels import mapping as kernels
from beamfield.maps import mapping
from beamfield.maps.end_points import hit_points
from beamfield.maps.mapping import (
    CONFIDENT,
    InverseSensorModel,
    build_map,
    local_map,
    scan_map,
    share_of_hits_in_obstacles,
)
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.occupancy_mapper import OccupancyMapper
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder, Scan, SensorLog
from tests.reference.map_matching_slow import log_odds_map

AHEAD = RangeFinder.from_bearings([0.0], max_range=8.0)
ODDS = InverseSensorModel(hit=0.8, passed=0.4)


def as_log(ranges, poses, finder) -> SensorLog:
    ranges = np.asarray(ranges, dtype=float)
    t = len(ranges)
    return SensorLog(finder, np.arange(t), ranges, np.asarray(poses, dtype=float), np.full((t, 3), np.nan))


def one_beam(z: float, model=ODDS, finder=AHEAD) -> OccupancyGrid:
    return build_map(as_log([[z]], [(0.25, 0.25, 0.0)], finder), resolution=0.5, inverse_model=model)


def test_cells_before_a_hit_are_passed_the_last_is_hit_and_none_behind_is_touched():
    grid = one_beam(1.6)
    np.testing.assert_allclose(grid.probability, [[0.4, 0.4, 0.4, 0.8]], rtol=1e-6)
    assert grid.origin.tolist() == [0.0, 0.0, 0.0]
    assert grid.resolution == 0.5


def test_no_return_marks_nothing_unless_asked_and_then_no_hit():
    for z in (8.0, np.inf, 9.0):
        assert np.isnan(one_beam(z).probability).all()
        cleared = one_beam(z, model=InverseSensorModel(hit=0.8, passed=0.4, clear_without_return=1.0))
        np.testing.assert_allclose(cleared.probability, [[0.4, 0.4, 0.4]], rtol=1e-6)


def test_no_return_clears_at_most_the_sensors_range():
    model = InverseSensorModel(clear_without_return=100.0)
    assert one_beam(np.inf, model=model).shape == (1, 17)


@pytest.mark.parametrize("z", [np.nan, -np.inf, 0.05])
def test_readings_that_are_no_measurement_mark_nothing(z):
    finder = RangeFinder.from_bearings([0.0], max_range=8.0, min_range=0.1)
    grid = one_beam(z, finder=finder)
    assert grid.shape == (1, 1)
    assert np.isnan(grid.probability).all()


def test_far_hits_clear_up_to_the_limit_only():
    grid = one_beam(5.0, model=InverseSensorModel(hit=0.8, passed=0.4, longest_hit=1.0))
    np.testing.assert_allclose(grid.probability, [[0.4, 0.4, 0.4]], rtol=1e-6)


def test_a_scan_changes_a_cell_once_and_hits_come_before_passes():
    finder = RangeFinder.from_bearings([0.0, 0.0, 0.0], max_range=8.0)
    log = as_log([[1.6, 0.6, 1.6]], [(0.25, 0.25, 0.0)], finder)
    grid = build_map(log, resolution=0.5, inverse_model=ODDS)
    np.testing.assert_allclose(grid.probability, [[0.4, 0.8, 0.4, 0.8]], rtol=1e-6)


def test_scans_add_up_in_log_odds_and_stay_within_bounds():
    def p_after(n):
        return build_map(as_log([[1.6]] * n, [(0.25, 0.25, 0.0)] * n, AHEAD), resolution=0.5, inverse_model=ODDS)

    np.testing.assert_allclose(p_after(2).probability, [[4 / 13] * 3 + [16 / 17]], rtol=1e-6)
    np.testing.assert_allclose(p_after(50).probability, [[0.03] * 3 + [0.97]], rtol=1e-5)


def test_equals_the_slow_reference_on_random_scans(rng):
    bearings = np.linspace(-3.0, 3.0, 23)
    finder = RangeFinder.from_bearings(bearings, max_range=6.0)
    ranges = rng.uniform(0.1, 6.5, (12, 23))
    poses = np.column_stack([rng.uniform(-3, 3, 12), rng.uniform(-3, 3, 12), rng.uniform(-4, 4, 12)])
    grid = build_map(
        as_log(ranges, poses, finder), resolution=0.2, inverse_model=InverseSensorModel(hit=0.8, passed=0.3)
    )
    odds = log_odds_map(ranges, poses, bearings, 6.0, 0.2, 0.8, 0.3, 0.03, 0.97)
    first = np.round(grid.origin[:2] / 0.2).astype(int)
    assert np.count_nonzero(~np.isnan(grid.probability)) == len(odds)
    for (row, col), value in odds.items():
        p = grid.probability[row - first[1], col - first[0]]
        assert p == pytest.approx(1.0 / (1.0 + np.exp(-value)), abs=1e-6)


def test_perfect_readings_mark_the_cells_that_the_ray_caster_hit(rng):
    """Rays along borders and through corners included: poses and headings on the lattice."""
    walls = rng.random((30, 40)) < 0.1
    walls[[0, -1]], walls[:, [0, -1]] = True, True
    world = OccupancyGrid(walls.astype(np.float32), 0.25, (-2.0, 3.0, 0.0))
    free = np.argwhere(~walls[:-1, :-1] & ~walls[1:, 1:] & ~walls[1:, :-1] & ~walls[:-1, 1:])[::7]
    corners = world.to_map(free[:, ::-1] + 1.0)
    poses = [(*corner, heading) for corner in corners for heading in (0.0, np.pi / 2, np.pi, -np.pi / 2, 0.3)]
    poses = np.array([*poses, *((x + 0.1, y + 0.03, 1.0) for x, y in corners)])
    finder = RangeFinder.from_bearings(np.linspace(0, 2 * np.pi, 36, endpoint=False), max_range=20.0)
    caster = RayCaster(world)
    ranges, hits = caster.expected_ranges(poses, finder), caster.expected_hits(poses, finder)
    diagonal_gap = 0
    for pose, z, cells in zip(poses, ranges, hits, strict=True):
        seen = scan_map(Scan(z, finder), resolution=0.25)
        assert seen.shape[0] > 1
        local = build_map(as_log([z], [pose], finder), resolution=0.25)
        offset = np.round(world.to_cells(local.to_map([0.0, 0.0]))).astype(int)
        marked = {(int(r) + offset[1], int(c) + offset[0]) for r, c in np.argwhere(local.occupied)}
        expected = {(int(r), int(c)) for r, c in cells}
        # A ray that two walls block at a corner ends in the cell behind the corner, which may be free.
        diagonal_gap += len(marked ^ expected)
    assert diagonal_gap <= 0.002 * ranges.size


def test_last_cell_is_reached_when_the_ray_enters_it():
    cells = np.empty((4, 2), np.int64)
    x, y = np.array([0.5, 3.5, 0.5, 0.5]), np.full(4, 0.5)
    c, lengths = np.array([1.0, -1.0, 1.0, 1.0]), np.array([2.5, 2.5, 2.4999, 2.5 - 1e-12])
    kernels.last_cells(x, y, c, np.zeros(4), lengths, cells)
    assert cells[:, 0].tolist() == [3, 0, 2, 3]
    assert cells[:, 1].tolist() == [0, 0, 0, 0]


def test_streaming_scans_gives_the_map_of_the_whole_log(rng):
    finder = RangeFinder.from_bearings(np.linspace(-2.0, 2.0, 31), max_range=6.0, mount=(0.2, -0.1, 0.5))
    poses = np.cumsum(rng.normal(0.0, [1.0, 1.0, 0.3], (40, 3)), axis=0)
    ranges = rng.uniform(0.1, 6.5, (40, 31))
    whole = build_map(as_log(ranges, poses, finder), resolution=0.1)
    mapper = OccupancyMapper(0.1)
    for z, pose in zip(ranges, poses, strict=True):
        mapper.add(z[None], finder, pose[None])
    streamed = mapper.to_grid()
    assert mapper.n_scans == 40
    np.testing.assert_array_equal(streamed.probability, whole.probability)
    assert streamed.origin.tolist() == whole.origin.tolist()


def test_mount_and_pose_compose(rng):
    mount, pose = np.array([0.3, -0.2, 0.7]), np.array([2.0, 1.0, -0.4])
    ranges = rng.uniform(0.5, 5.0, 20)
    bearings = np.linspace(-1.0, 1.0, 20)
    mounted = RangeFinder.from_bearings(bearings, max_range=8.0, mount=mount)
    centred = RangeFinder.from_bearings(bearings, max_range=8.0)
    a = build_map(as_log([ranges], [pose], mounted))
    b = build_map(as_log([ranges], [compose(pose, mount)], centred))
    np.testing.assert_array_equal(a.probability, b.probability)


def test_scans_without_pose_are_left_out():
    poses = [(0.25, 0.25, 0.0), (np.nan, 0.0, 0.0)]
    both = build_map(as_log([[1.6], [3.0]], poses, AHEAD), resolution=0.5, inverse_model=ODDS)
    np.testing.assert_array_equal(both.probability, one_beam(1.6).probability)
    with pytest.raises(TooLittleDataError, match="none of the chosen scans has a pose"):
        build_map(as_log([[1.0]], [(np.nan, 0.0, 0.0)], AHEAD))


def test_only_the_chosen_scans_are_used():
    log = as_log([[1.6], [3.0]], [(0.25, 0.25, 0.0)] * 2, AHEAD)
    for scans in ([0], [True, False]):
        grid = build_map(log, resolution=0.5, inverse_model=ODDS, scans=scans)
        np.testing.assert_array_equal(grid.probability, one_beam(1.6).probability)


def test_progress_counts_the_scans():
    calls = []
    log = as_log([[1.0]] * 300, [(0.0, 0.0, 0.0)] * 300, AHEAD)
    build_map(log, progress=lambda done, total: calls.append((done, total)))
    assert calls == [(128, 300), (256, 300), (300, 300)]


def test_absurd_sizes_are_refused_before_memory_is_taken():
    log = as_log([[1.0], [1.0]], [(0.0, 0.0, 0.0), (1e7, 1e7, 0.0)], AHEAD)
    with pytest.raises(InvalidInputError, match=r"1e\+07 m x 1e\+07 m at 0.05 m are .* the limit is 100000000"):
        build_map(log)
    with pytest.raises(InvalidInputError, match="the limit is 10;"):
        build_map(as_log([[1.0]], [(0.0, 0.0, 0.0)], AHEAD), max_cells=10)


def test_a_stream_grows_up_to_its_limit():
    mapper = OccupancyMapper(1.0, max_cells=1000)
    for x in range(0, 100, 10):
        mapper.add([[1.5]], AHEAD, [[float(x), 0.5, 0.0]])
    assert mapper.to_grid().shape == (1, 92)
    with pytest.raises(InvalidInputError, match="the limit is 1000"):
        mapper.add([[1.5]], AHEAD, [[2000.0, 0.5, 0.0]])
    assert mapper.n_scans == 10


def test_local_map_holds_the_last_scans_in_the_robots_frame(rng):
    finder = RangeFinder.from_bearings(np.linspace(-2.0, 2.0, 31), max_range=6.0)
    poses = np.cumsum(rng.normal(0.0, [0.2, 0.2, 0.1], (20, 3)), axis=0) + np.array([50.0, -30.0, 2.0])
    ranges = rng.uniform(1.0, 5.0, (20, 31))
    log = as_log(ranges, poses, finder)
    local = local_map(log, 12, n=4, resolution=0.1)
    own = compose(invert(poses[12]), poses[9:13])
    expected = build_map(as_log(ranges[9:13], own, finder), resolution=0.1, inverse_model=CONFIDENT)
    np.testing.assert_array_equal(local.probability, expected.probability)
    single = local_map(log, 12, n=1, resolution=0.1)
    np.testing.assert_array_equal(single.probability, scan_map(log.scan(12), resolution=0.1).probability)
    assert local_map(log, 1, n=10).probability.size > 0
    moved = local_map(log, 12, n=4, resolution=0.1, poses=compose([7.0, 8.0, 0.9], poses))
    assert np.mean(np.isnan(moved.probability) != np.isnan(local.probability)) < 1e-3


def test_local_map_of_nothing_is_one_unknown_cell():
    log = as_log([[np.nan]] * 3, [(1.0, 2.0, 3.0)] * 3, AHEAD)
    for grid in (local_map(log, 2), scan_map(log.scan(0), resolution=0.05)):
        assert grid.shape == (1, 1)
        assert np.isnan(grid.probability).all()


def test_local_map_refuses_what_is_not_there():
    log = as_log([[1.0]] * 3, [(1.0, 2.0, 3.0)] * 2 + [(np.nan,) * 3], AHEAD)
    with pytest.raises(InvalidInputError, match="index: expected 0 to 2, got 3"):
        local_map(log, 3)
    with pytest.raises(InvalidInputError, match="n: expected at least 1, got 0"):
        local_map(log, 1, n=0)
    with pytest.raises(TooLittleDataError, match="scan 2 has no pose"):
        local_map(log, 2)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"hit": 0.5}, r"hit: expected a probability in \(0.5, 1\), got 0.5"),
        ({"passed": 0.5}, r"passed: expected a probability in \(0, 0.5\), got 0.5"),
        ({"lowest": 0.0}, "bounds: expected 0 < lowest"),
        ({"highest": 0.6}, "got lowest 0.03 and highest 0.6"),
        ({"clear_without_return": -1.0}, "clear_without_return: .* got -1.0"),
        ({"clear_without_return": np.inf}, "clear_without_return: .* got inf"),
        ({"longest_hit": 0.0}, "longest_hit: .* got 0.0"),
        ({"hit": np.nan}, "hit: .* got nan"),
    ],
)
def test_inverse_models_that_make_no_sense_are_refused(options, message):
    with pytest.raises(InvalidInputError, match=message):
        InverseSensorModel(**options)


def test_wrong_shapes_are_refused():
    log = as_log([[1.0]] * 3, [(1.0, 2.0, 3.0)] * 3, AHEAD)
    with pytest.raises(InvalidInputError, match=r"poses: expected shape \(3, 3\), one per scan, got \(2, 3\)"):
        build_map(log, poses=np.zeros((2, 3)))
    with pytest.raises(InvalidInputError, match=r"scans: expected ranges \(t, 1\)"):
        OccupancyMapper(0.1).add([[1.0, 2.0]], AHEAD, [[0.0, 0.0, 0.0]])
    with pytest.raises(InvalidInputError, match=r"resolution: expected a positive number .*, got 0"):
        OccupancyMapper(0.0)


def test_end_points_are_those_of_hits():
    finder = RangeFinder.from_bearings([0.0, np.pi / 2, 0.1, 0.2], max_range=8.0, mount=(1.0, 0.0, 0.0))
    points = hit_points([[2.0, 3.0, np.inf, np.nan], [1.0] * 4], finder, [[0.0, 0.0, np.pi / 2], [np.nan] * 3])
    np.testing.assert_allclose(points, [[0.0, 3.0], [-3.0, 1.0]], atol=1e-12)


def test_sharpness_falls_when_poses_are_wrong(rng):
    walls = np.zeros((80, 120))
    walls[[0, -1]], walls[:, [0, -1]], walls[40, :70] = 100, 100, 100
    world = OccupancyGrid.from_ros(walls, 0.1)
    finder = RangeFinder.from_bearings(np.linspace(-2.0, 2.0, 90), max_range=15.0)
    poses = np.column_stack([rng.uniform(1, 11, 60), rng.uniform(1, 3.5, 60), rng.uniform(-3, 3, 60)])
    ranges = RayCaster(world).expected_ranges(poses, finder) + rng.normal(0.02, 0.02, (60, 90))
    shares = []
    for error in (0.0, 0.2):
        log = as_log(ranges, poses + rng.normal(0.0, [error, error, 0.2 * error], poses.shape), finder)
        shares.append(share_of_hits_in_obstacles(build_map(log, resolution=0.1), log))
    assert shares[0] > 0.97
    assert shares[1] < 0.7
    assert share_of_hits_in_obstacles(world, as_log(np.full((60, 90), np.inf), poses, finder)) == 0.0


def test_a_hit_counts_as_sharp_in_the_cell_of_an_obstacle_and_in_the_next():
    world = OccupancyGrid([[1.0, 0.0, 0.0, 0.0]], 0.5)
    logs = [as_log([[0.3]], [(x, 0.25, 0.0)], AHEAD) for x in (0.0, 0.5, 1.0)]  # ends in the first, second, third cell
    assert [share_of_hits_in_obstacles(world, log) for log in logs] == [1.0, 1.0, 0.0]


def test_chunks_do_not_matter(monkeypatch, rng):
    finder = RangeFinder.from_bearings(np.linspace(-2.0, 2.0, 31), max_range=6.0)
    poses = rng.normal(0.0, 2.0, (30, 3))
    log = as_log(rng.uniform(0.5, 5.0, (30, 31)), poses, finder)
    whole = build_map(log)
    monkeypatch.setattr(mapping, "SCANS_PER_CHUNK", 7)
    np.testing.assert_array_equal(build_map(log).probability, whole.probability)
