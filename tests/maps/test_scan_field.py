"""The field of one scan says hit, free or unseen as its beams do, whatever their order and mounts."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import compose, invert, transform_points
from beamfield.kernels import surfaces as kernels
from beamfield.maps.end_points import hit_points
from beamfield.maps.scan_field import Category, ScanField
from beamfield.sensors import RangeFinder, Scan
from tests.threads import forced_threads

MAX_RANGE = 20.0
BEARINGS = np.radians(np.arange(-90.0, 90.5))


def room(bearings: np.ndarray) -> np.ndarray:
    """Ranges in a room of 6 m x 4 m, seen from its centre."""
    with np.errstate(divide="ignore"):
        return np.minimum(3.0 / np.abs(np.cos(bearings)), 2.0 / np.abs(np.sin(bearings)))


@pytest.fixture(scope="module")
def scan() -> Scan:
    return Scan(room(BEARINGS), RangeFinder.from_bearings(BEARINGS, MAX_RANGE))


def test_space_is_free_before_a_wall_hit_at_it_and_unseen_behind_it(scan: Scan) -> None:
    found = ScanField.from_scan(scan).category(
        [[2.0, 0.5], [3.0, 0.5], [3.3, 0.5], [1.0, -2.05], [1.0, -2.3], [-1.0, 0.0]]
    )
    assert [Category(c).name for c in found] == ["FREE", "HIT", "UNSEEN", "HIT", "UNSEEN", "UNSEEN"]


def test_values_are_those_of_the_formulas(scan: Scan) -> None:
    field = ScanField.from_scan(scan, sigma_hit=0.1, z_hit=0.8, z_rand=0.2)
    # Behind the wall x = 3 the unseen part is added in full, far before it the random part.
    behind, free, far_behind = field.log_density([[3.15, 0.3], [1.0, 0.0], [5.0, 0.0]])
    normal = np.exp(-0.5 * 1.5**2) / (0.1 * np.sqrt(2 * np.pi))
    assert behind == pytest.approx(np.log(0.8 * normal + 1 / MAX_RANGE), abs=1e-6)
    assert free == pytest.approx(np.log(0.2 / MAX_RANGE))
    assert far_behind == pytest.approx(np.log(1 / MAX_RANGE))


def test_distances_are_exact_between_sparse_end_points() -> None:
    # Beams 3 degrees apart hit the wall x = 8 every 0.4 m.
    bearings = np.radians(np.arange(-30.0, 31.0, 3.0))
    field = ScanField.from_scan(
        Scan(8.0 / np.cos(bearings), RangeFinder.from_bearings(bearings, MAX_RANGE)), sigma_hit=0.1
    )
    y = np.linspace(-3.0, 3.0, 400)
    for offset in (-0.37, 0.0, 0.21):
        points = np.column_stack([np.full_like(y, 8.0 + offset), y])
        np.testing.assert_allclose(field.distance(points), abs(offset), atol=1e-9)


@pytest.mark.parametrize("n_dense", [30, 31])
def test_a_wall_goes_on_across_a_gap_after_dense_end_points(n_dense: int) -> None:
    # Whether the last end point before the gap has a line of its own depends on their number.
    y = np.concatenate([0.05 - 0.03 * np.arange(n_dense)[::-1], np.arange(0.4, 1.5, 0.03)])
    finder = RangeFinder.from_bearings(np.arctan2(y, 2.0), MAX_RANGE)
    field = ScanField.from_scan(Scan(np.hypot(2.0, y), finder), sigma_hit=0.03)
    on_the_wall = np.column_stack([np.full(50, 2.0), np.linspace(0.05, 0.4, 50)])
    np.testing.assert_allclose(field.distance(on_the_wall), 0.0, atol=1e-9)


def test_an_edge_before_a_far_wall_casts_a_shadow_without_a_wall() -> None:
    bearings = np.radians(np.arange(-20.0, 20.5))
    ranges = np.where(np.abs(bearings) < np.radians(5.0), 2.0, 6.0) / np.cos(bearings)
    field = ScanField.from_scan(Scan(ranges, RangeFinder.from_bearings(bearings, MAX_RANGE)))
    # Halfway between the edge of the box and where the next beam hits the wall: no surface joins them.
    edge, beyond = np.radians(4.0), np.radians(5.0)
    middle = 0.5 * (np.array([2.0, 2.0 * np.tan(edge)]) + np.array([6.0, 6.0 * np.tan(beyond)]))
    assert field.category(middle) != Category.HIT
    assert field.category([4.0, 0.0]) == Category.UNSEEN
    assert field.category([4.0, 4.0 * np.tan(np.radians(10.0))]) == Category.FREE


def test_lone_readings_do_not_part_a_wall_and_pull_nothing(scan: Scan) -> None:
    ranges = scan.ranges.copy()
    ranges[[100, 101, 120, 140]] = [1.1, np.inf, 0.7, 1.2]
    field = ScanField.from_scan(Scan(ranges, scan.finder))
    elements = field.view.elements
    for lone in (100, 120, 140):
        there = ranges[lone] * np.array([np.cos(BEARINGS[lone]), np.sin(BEARINGS[lone])])
        nearest = np.argmin(np.hypot(*(elements[:, :2] - there).T))
        assert elements[nearest, kernels.PULL] == kernels.NONE
    for missing in (100, 101, 120, 140):
        there = scan.ranges[missing] * np.array([np.cos(BEARINGS[missing]), np.sin(BEARINGS[missing])])
        assert field.distance(there) < 1e-6


def test_the_order_of_the_beams_changes_nothing(scan: Scan, rng: np.random.Generator) -> None:
    points = rng.uniform([-1.0, -3.0], [4.0, 3.0], (500, 2))
    shuffled = scan.subset(rng.permutation(scan.finder.n_beams))
    np.testing.assert_array_equal(
        ScanField.from_scan(shuffled).log_density(points), ScanField.from_scan(scan).log_density(points)
    )


def test_a_mount_moves_the_field_with_the_sensor(scan: Scan, rng: np.random.Generator) -> None:
    mount = np.array([0.3, -0.1, 2.0])
    moved = Scan(scan.ranges, RangeFinder.from_bearings(BEARINGS, MAX_RANGE, mount=mount))
    points = rng.uniform([-1.0, -3.0], [4.0, 3.0], (500, 2))
    np.testing.assert_allclose(
        ScanField.from_scan(moved).log_density(transform_points(mount, points)),
        ScanField.from_scan(scan).log_density(points),
        atol=1e-6,
    )


def test_a_pose_moves_the_field_with_the_robot(scan: Scan, rng: np.random.Generator) -> None:
    pose = np.array([10.0, -4.0, -1.0])
    points = rng.uniform([-1.0, -3.0], [4.0, 3.0], (500, 2))
    np.testing.assert_allclose(
        ScanField.from_scan(scan, pose=pose).log_density(transform_points(pose, points)),
        ScanField.from_scan(scan).log_density(points),
        atol=1e-6,
    )


def test_two_sensors_in_one_scan_see_what_each_sees(scan: Scan) -> None:
    back = RangeFinder.from_bearings(BEARINGS, MAX_RANGE, mount=(-0.2, 0.0, np.pi))
    both = RangeFinder(np.concatenate([scan.finder.mounts, back.mounts]), MAX_RANGE)
    field = ScanField.from_scan(Scan(np.concatenate([scan.ranges, np.full(len(BEARINGS), 1.5)]), both))
    assert field.category([[2.0, 0.5], [-1.0, 0.0], [-1.7, 0.0], [-2.0, 0.0]]).tolist() == [1, 1, 2, 0]


def test_what_any_of_several_scans_saw_through_is_free(scan: Scan) -> None:
    poses = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, np.pi]])
    field = ScanField.from_scans([scan, scan], poses)
    assert field.category([[2.0, 0.5], [-2.0, 0.5], [-3.0, 0.5], [3.3, 0.0]]).tolist() == [1, 1, 2, 0]


def test_a_beam_without_return_saw_nothing_or_free_space() -> None:
    finder = RangeFinder.from_bearings(BEARINGS, MAX_RANGE)
    scan = Scan(np.full(len(BEARINGS), np.inf), finder)
    assert ScanField.from_scan(scan).category([5.0, 0.0]) == Category.UNSEEN
    assert ScanField.from_scan(scan, no_return="free").category([5.0, 0.0]) == Category.FREE


def test_cones_see_as_wide_as_they_open() -> None:
    finder = RangeFinder.from_bearings([0.0], 5.0, opening_angle=np.radians(30.0))
    field = ScanField.from_scan(Scan([3.0], finder))
    beside = [[2.0 * np.cos(a), 2.0 * np.sin(a)] for a in np.radians([14.0, 16.0])]
    assert field.category(beside).tolist() == [Category.FREE, Category.UNSEEN]


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 0.01])
def test_a_scan_without_end_points_gives_a_field_that_says_nothing(value: float) -> None:
    finder = RangeFinder.from_bearings(BEARINGS, MAX_RANGE, min_range=0.1)
    empty = Scan(np.full(len(BEARINGS), value), finder)
    field = ScanField.from_scan(empty)
    assert field.n_elements == 0
    assert np.isnan(field.bounds).all()
    np.testing.assert_allclose(field.log_density([[1.0, 0.0], [0.0, 0.0]]), -np.log(MAX_RANGE))
    assert field.log_likelihood(empty, [0.0, 0.0, 0.0]) == 0.0


def test_likelihoods_are_sums_over_end_points_and_threads_change_no_bit(scan: Scan, rng: np.random.Generator) -> None:
    field = ScanField.from_scan(scan)
    poses = rng.normal(size=(20, 3)) * 0.2
    expected = [field.log_density(transform_points(pose, hit_points(scan.ranges, scan.finder))).sum() for pose in poses]
    np.testing.assert_allclose(field.log_likelihood(scan, poses), expected, rtol=1e-12)
    alone = field.log_likelihood(scan, poses)
    with forced_threads(3):
        np.testing.assert_array_equal(field.log_likelihood(scan, poses), alone)


def test_the_true_pose_scores_best(scan: Scan, rng: np.random.Generator) -> None:
    field = ScanField.from_scan(scan)
    poses = rng.normal(size=(200, 3)) * (0.3, 0.3, 0.2)
    assert field.log_likelihood(scan, [0.0, 0.0, 0.0]) > field.log_likelihood(scan, poses).max()


def test_fields_pickle(scan: Scan) -> None:
    field = ScanField.from_scan(scan)
    assert pickle.loads(pickle.dumps(field)).log_density([3.0, 0.1]) == field.log_density([3.0, 0.1])


def test_end_points_follow_the_mounts(scan: Scan) -> None:
    mount = np.array([0.3, -0.1, 2.0])
    moved = Scan(scan.ranges, RangeFinder.from_bearings(BEARINGS, MAX_RANGE, mount=mount))
    np.testing.assert_allclose(
        transform_points(invert(mount), hit_points(moved.ranges, moved.finder)),
        hit_points(scan.ranges, scan.finder),
        atol=1e-12,
    )
    np.testing.assert_allclose(compose(mount, invert(mount)), 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"sigma_hit": 0.0}, "sigma_hit"),
        ({"sigma_hit": np.nan}, "sigma_hit"),
        ({"z_hit": 0.9, "z_rand": 0.2}, "z_hit"),
        ({"z_hit": 1.0, "z_rand": 0.0}, "z_hit"),
        ({"no_return": "far"}, "no_return"),
        ({"pose": [0.0, 0.0, np.nan]}, "poses"),
    ],
)
def test_senseless_options_are_refused_by_name(scan: Scan, options: dict[str, object], name: str) -> None:
    with pytest.raises(InvalidInputError, match=name):
        ScanField.from_scan(scan, **options)  # type: ignore[arg-type]


def test_other_bad_input_is_refused(scan: Scan) -> None:
    field = ScanField.from_scan(scan)
    with pytest.raises(InvalidInputError, match="points"):
        field.log_density([0.0, np.nan])
    with pytest.raises(InvalidInputError, match="points"):
        field.distance([[0.0, 1.0, 2.0]])
    with pytest.raises(InvalidInputError, match="one per scan"):
        ScanField.from_scans([], np.zeros((0, 3)))
    with pytest.raises(InvalidInputError, match="one per scan"):
        ScanField.from_scans([scan], np.zeros((2, 3)))
