from __future__ import annotations

import pickle

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import compose, wrap_angle
from beamfield.kernels import global_search as kernels
from beamfield.localization import search_window
from beamfield.localization.global_search import GlobalSearch, SearchWindow
from beamfield.maps.end_points import hit_points
from beamfield.maps.mapping import scan_map
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.raycast import RayCaster
from beamfield.sensors import RangeFinder, Scan
from tests.reference.map_matching_slow import every_pose
from tests.threads import forced_threads

FINDER = RangeFinder.from_bearings(np.linspace(-2.2, 2.2, 61), max_range=8.0, mount=(0.1, 0.0, 0.0))
EMPTY = Scan(np.full(61, np.nan), FINDER)


def draw_room(origin=(-1.0, 2.0, 0.0)) -> OccupancyGrid:
    values = np.zeros((60, 90))
    values[[0, -1]], values[:, [0, -1]], values[25, :40], values[25:45, 60] = 100, 100, 100, 100
    values[5:9, 70:74] = 100
    values[50:58, 2:20] = -1
    return OccupancyGrid.from_ros(values, 0.1, origin)


def scan_at(grid: OccupancyGrid, pose, rng=None) -> Scan:
    ranges = RayCaster(grid).expected_ranges(pose, FINDER)
    return Scan(ranges if rng is None else ranges + rng.normal(0.0, 0.03, ranges.shape), FINDER)


@pytest.mark.parametrize("trial", range(10))
def test_equals_trying_every_pose(trial):
    """Windows in the middle and half off the map; random scans too, which fit nowhere and make the search hard.

    Of the last four, only three readings are hits: many poses score alike.
    """
    rng = np.random.default_rng(trial)
    grid = draw_room()
    truth = np.array([rng.uniform(0.5, 7.0), rng.uniform(2.5, 4.0), rng.uniform(-3, 3)])
    scan = scan_at(grid, truth, rng) if trial < 3 else Scan(rng.uniform(0.5, 8.5, 61), FINDER)
    if trial >= 6:
        scan = Scan(np.where(np.arange(61) % 20 == 10, scan.ranges, np.nan), FINDER)
    center = truth + rng.uniform(-1, 1, 3) - [0.0, 3.0 * (trial % 2), 0.0]
    search = GlobalSearch(grid, sigma=0.15, angle_step=np.radians(6.0))
    found = search.search(scan, SearchWindow(center, 5.0, 3.6), apart=(0.5, 0.6))

    xs = center[0] + np.arange(-25, 26) * 0.1
    ys = center[1] + np.arange(-18, 19) * 0.1
    headings = center[2] + np.arange(60) * np.radians(6.0)
    points = hit_points(scan.ranges, FINDER)
    sums = every_pose(search._field.astype(int), grid, points, xs, ys, headings)
    assert found.n_candidates == sums.size
    assert found.n_scored < 0.5 * sums.size or trial >= 6

    k, j, i = np.unravel_index(sums.argmax(), sums.shape)  # the first of the greatest
    assert found.best.score == pytest.approx(sums.max() / (255 * len(points)), abs=1e-12)
    np.testing.assert_allclose(found.best.pose, [xs[i], ys[j], wrap_angle(headings[k])], atol=1e-9)

    near = (xs[None, :] - xs[i]) ** 2 + (ys[:, None] - ys[j]) ** 2 <= 0.5**2 + 1e-9
    sums[np.abs(wrap_angle(headings - headings[k])) <= 0.6] = np.where(
        near, -1, sums[np.abs(wrap_angle(headings - headings[k])) <= 0.6]
    )
    k, j, i = np.unravel_index(sums.argmax(), sums.shape)
    assert found.runner_up.score == pytest.approx(sums.max() / (255 * len(points)), abs=1e-12)
    np.testing.assert_allclose(found.runner_up.pose, [xs[i], ys[j], wrap_angle(headings[k])], atol=1e-9)
    assert [line.split()[0] for line in found.summary().splitlines()] == ["best", "runner-up"]


def test_the_levels_of_the_pyramid_change_no_result(monkeypatch, rng):
    grid = draw_room()
    scan = scan_at(grid, [2.0, 3.3, 0.7], rng)
    results = []
    for levels in (1, 2, 4, 6, 8):
        monkeypatch.setattr(search_window, "LEVELS", levels)
        found = GlobalSearch(grid, angle_step=0.1).search(scan, SearchWindow([3.0, 4.0, 0.0], 3.0, 3.0))
        results.append((found.best.pose.tolist(), found.best.score, found.runner_up.pose.tolist()))
    assert all(result == results[0] for result in results)


def test_any_number_of_threads_gives_the_same_result(rng):
    grid = draw_room()
    for scan in (scan_at(grid, [2.0, 3.3, 0.7], rng), Scan(rng.uniform(0.5, 8.5, 61), FINDER)):
        results = []
        for threads in (1, 2, 5):
            with forced_threads(threads):
                found = GlobalSearch(grid).search(scan, SearchWindow([3.0, 4.0, 0.0], 6.0, 6.0))
            results.append((found.best.pose.tolist(), found.best.score, found.runner_up.pose.tolist()))
        assert results[0] == results[1] == results[2]


def test_finds_the_robot_anywhere_in_a_turned_map(rng):
    grid = draw_room((30.0, -20.0, 0.5))
    search = GlobalSearch(grid)
    for _ in range(5):
        truth = compose([30.0, -20.0, 0.5], [rng.uniform(0.5, 5.5), rng.uniform(0.5, 2.2), rng.uniform(-3, 3)])
        found = search.search(scan_at(grid, truth, rng), SearchWindow.whole_map(grid))
        assert np.hypot(*(found.best.pose - truth)[:2]) < 0.1
        assert abs(wrap_angle(found.best.pose[2] - truth[2])) < 0.03
        assert found.best.score > 0.75
        assert found.found


def test_the_score_is_that_of_the_pose(rng):
    grid = draw_room((30.0, -20.0, 0.5))
    truth = compose([30.0, -20.0, 0.5], [2.03, 1.74, 1.1])
    scan = scan_at(grid, truth, rng)
    search = GlobalSearch(grid)
    found = search.search(scan, SearchWindow(truth + np.array([0.013, 0.027, 0.1]), 2.0, 2.0, 0.6))
    poses = [found.best.pose, found.runner_up.pose]
    np.testing.assert_allclose(search.score(scan, poses), [found.best.score, found.runner_up.score], atol=1e-9)


def test_a_symmetric_room_has_two_answers():
    values = np.zeros((40, 80))
    values[[0, -1]], values[:, [0, -1]] = 100, 100
    grid = OccupancyGrid.from_ros(values, 0.1)
    finder = RangeFinder.from_bearings(np.linspace(-3.1, 3.1, 90), max_range=12.0)
    truth = np.array([2.05, 1.45, 0.5])
    scan = Scan(RayCaster(grid).expected_ranges(truth, finder), finder)
    found = GlobalSearch(grid, angle_step=np.radians(0.5)).search(scan, SearchWindow([4.0, 2.0, 0.0], 8.0, 4.0))
    mirrored = np.array([8.0 - 2.05, 4.0 - 1.45, 0.5 - np.pi])
    answers = sorted([found.best.pose, found.runner_up.pose], key=lambda pose: pose[0])
    for answer, expected in zip(answers, (truth, mirrored), strict=True):
        assert np.hypot(*(answer - expected)[:2]) < 0.12
        assert abs(wrap_angle(answer[2] - expected[2])) < 0.03
    assert found.runner_up.score > 0.97 * found.best.score


def test_local_maps_are_searched_by_their_occupied_cells(rng):
    grid = draw_room()
    truth = np.array([2.0, 3.3, 0.7])
    local = scan_map(scan_at(grid, truth, rng), resolution=0.1)
    found = GlobalSearch(grid).search(local, SearchWindow([3.0, 4.0, 0.0], 6.0, 6.0))
    assert found.n_points == np.count_nonzero(local.occupied)
    assert np.hypot(*(found.best.pose - truth)[:2]) < 0.15


def test_windows_off_the_map_find_nothing_and_say_so():
    search = GlobalSearch(draw_room())
    scan = scan_at(draw_room(), [2.0, 3.3, 0.7])
    for center in ([200.0, 0.0, 0.3], [-1e9, 1e9, 0.3], [1e200, 0.0, 0.3]):
        found = search.search(scan, SearchWindow(center, 3.0, 3.0))
        assert not found.found
        assert found.best.pose.tolist() == center
        assert found.best.score == 0.0
        assert found.runner_up is None


def test_scans_without_hits_and_maps_without_obstacles_find_nothing():
    room = draw_room()
    window = SearchWindow([2.0, 4.0, 0.0], 2.0, 2.0)
    for scan in (EMPTY, Scan(np.full(61, np.inf), FINDER)):
        found = GlobalSearch(room).search(scan, window)
        assert (found.found, found.n_points, found.best.score, found.runner_up) == (False, 0, 0.0, None)
        assert GlobalSearch(room).score(scan, [[0.0, 0.0, 0.0]]).tolist() == [0.0]
    empty = GlobalSearch(OccupancyGrid(np.zeros((50, 50)), 0.1))
    found = empty.search(scan_at(room, [2.0, 3.3, 0.7]), window)
    assert (found.found, found.best.score) == (False, 0.0)


def test_a_window_of_one_pose_is_scored(rng):
    grid, truth = draw_room(), np.array([2.0, 3.3, 0.7])
    found = GlobalSearch(grid).search(scan_at(grid, truth, rng), SearchWindow(truth, 0.0, 0.0, 0.0))
    assert found.n_candidates == 1
    np.testing.assert_allclose(found.best.pose, truth, atol=1e-9)
    assert found.runner_up is None


def test_windows_have_the_candidates_that_they_promise():
    grid = OccupancyGrid(np.zeros((50, 50)), 0.05)
    found = GlobalSearch(grid).search(scan_at(draw_room(), [2.0, 3.3, 0.7]), SearchWindow([0.0, 0.0, 0.0]))
    assert found.n_candidates == 401 * 401 * 360


def test_flat_fields_do_not_make_the_search_long():
    """All poses score 1: the first one wins, without looking at the others one by one."""
    grid = OccupancyGrid(np.ones((200, 200)), 0.1)
    scan = Scan(np.full(61, 0.5), FINDER)
    found = GlobalSearch(grid).search(scan, SearchWindow([10.0, 10.0, 0.0], 10.0, 10.0))
    assert found.best.score == 1.0
    np.testing.assert_allclose(found.best.pose, [5.0, 5.0, 0.0], atol=1e-9)
    assert found.n_scored < 0.02 * found.n_candidates


def test_pyramid_holds_the_greatest_value_of_each_block(rng):
    field = rng.integers(0, 256, (9, 13)).astype(np.uint8)
    pyramid = np.full((4, 9 + 16, 13 + 16), 77, np.uint8)
    kernels.fill_pyramid(field, pyramid)
    padded = np.zeros((48, 48), np.uint8)
    padded[8:17, 8:21] = field
    for level in range(4):
        side = 2**level
        for row in range(25):
            for col in range(29):
                assert pyramid[level, row, col] == padded[row : row + side, col : col + side].max()


def test_survives_pickling(rng):
    grid = draw_room()
    scan, window = scan_at(grid, [2.0, 3.3, 0.7], rng), SearchWindow([3.0, 4.0, 0.0], 3.0, 3.0)
    search = GlobalSearch(grid)
    twin = pickle.loads(pickle.dumps(search))
    assert twin.search(scan, window).best.pose.tolist() == search.search(scan, window).best.pose.tolist()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sigma": 0.0}, "sigma: expected a positive number .*, got 0.0"),
        ({"sigma": np.nan}, "sigma: expected a positive number .*, got nan"),
        ({"sigma": 40.0}, "sigma: expected at most the map's longer side, 1 m, got 40.0"),
        ({"angle_step": -1.0}, "angle_step: expected a positive number .*, got -1.0"),
    ],
)
def test_parameters_that_make_no_sense_are_refused(options, message):
    with pytest.raises(InvalidInputError, match=message):
        GlobalSearch(OccupancyGrid([[0.0]], 1.0), **options)


def test_windows_that_make_no_sense_are_refused():
    with pytest.raises(InvalidInputError, match="width: expected a finite number >= 0, got -1"):
        SearchWindow([0.0, 0.0, 0.0], -1.0)
    with pytest.raises(InvalidInputError, match=r"turn: .* got nan"):
        SearchWindow([0.0, 0.0, 0.0], turn=np.nan)
    with pytest.raises(InvalidInputError, match=r"center: expected shape \(3,\), got \(1, 3\)"):
        SearchWindow([[0.0, 0.0, 0.0]])
    with pytest.raises(InvalidInputError, match="center: expected finite numbers"):
        SearchWindow([0.0, np.nan, 0.0])
    search = GlobalSearch(draw_room())
    scan = scan_at(draw_room(), [2.0, 3.3, 0.7])
    with pytest.raises(InvalidInputError, match="apart: expected metres and radians >= 0"):
        search.search(scan, SearchWindow([0.0, 0.0, 0.0], 1.0, 1.0), apart=(1.0, -1.0))
    with pytest.raises(InvalidInputError, match=r"window: 360 headings of .* search a smaller window"):
        search.search(scan, SearchWindow([0.0, 0.0, 0.0], 1e4, 1e4))
