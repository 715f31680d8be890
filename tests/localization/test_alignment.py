"""Alignment finds the pose, says how sure it is and which directions the geometry leaves open."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.alignment_worlds import Conditions, corridor_pairs, room_pairs

from beamfield.errors import InvalidInputError
from beamfield.geometry import between, compose, invert, wrap_angle
from beamfield.localization.alignment import AlignmentResult, align
from beamfield.maps.scan_field import ScanField
from beamfield.sensors import RangeFinder, Scan

MAX_RANGE = 30.0
HALF_CIRCLE = np.radians(np.arange(-90.0, 90.5))
FULL_CIRCLE = np.radians(np.arange(0.0, 360.0))

# Walls as (x0, y0, x1, y1): a room of 8 m x 6 m with a recess, a box and a pillar.
ROOM = np.array([
    (-3, -2, 5, -2), (5, -2, 5, 4), (5, 4, 1, 4), (1, 4, 1, 5), (1, 5, -3, 5), (-3, 5, -3, -2),
    (2, -1, 3, -1), (3, -1, 3, -0.2), (3, -0.2, 2, -0.2), (2, -0.2, 2, -1),
    (-1.5, 3, -1.2, 3), (-1.2, 3, -1.2, 3.3), (-1.2, 3.3, -1.5, 3.3), (-1.5, 3.3, -1.5, 3),
], dtype=float)  # fmt: skip
CORRIDOR = np.array([(-100, -1, 100, -1), (-100, 1.2, 100, 1.2)], dtype=float)


def see(walls: np.ndarray, pose: np.ndarray, finder: RangeFinder, noise: np.ndarray | float = 0.0) -> Scan:
    """Return the scan that meets the first of the walls along each beam, exactly."""
    mounts = compose(pose, finder.mounts)
    cos, sin = np.cos(mounts[:, 2])[:, None], np.sin(mounts[:, 2])[:, None]
    ax, ay = walls[:, 0] - mounts[:, :1], walls[:, 1] - mounts[:, 1:2]
    dx, dy = walls[:, 2] - walls[:, 0], walls[:, 3] - walls[:, 1]
    with np.errstate(divide="ignore", invalid="ignore"):
        cross = cos * dy - sin * dx
        distance = (ax * dy - ay * dx) / cross
        along = (ax * sin - ay * cos) / cross
    hit = (distance > 0) & (along >= 0) & (along <= 1)
    ranges = np.where(hit, distance, np.inf).min(axis=1)
    return Scan(np.where(ranges < finder.max_range, ranges + noise, np.inf), finder)


def finder(bearings: np.ndarray, mount: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> RangeFinder:
    return RangeFinder.from_bearings(bearings, MAX_RANGE, mount=mount)


def errors(result: AlignmentResult, truth: np.ndarray) -> tuple[float, float]:
    error = between(truth, result.pose)
    return float(np.hypot(error[0], error[1])), float(abs(error[2]))


def mahalanobis_squares(truth: list[np.ndarray], results: list[AlignmentResult]) -> np.ndarray:
    error = np.array([result.pose for result in results]) - np.array(truth)
    error[:, 2] = wrap_angle(error[:, 2])
    covariances = np.array([result.covariance for result in results])
    return np.einsum("ni,ni->n", error, np.linalg.solve(covariances, error[..., None])[..., 0])


FIRST = np.array([0.0, 0.5, 0.3])
MOTION = np.array([0.5, 0.15, 0.2])


@pytest.mark.parametrize(
    "sensor",
    [
        finder(HALF_CIRCLE),
        finder(FULL_CIRCLE),
        finder(FULL_CIRCLE, (0.25, -0.1, 1.0)),
        finder(np.radians(np.arange(-135.0, 135.0, 0.25))),
    ],
    ids=["half circle", "full circle", "off centre", "fine"],
)
def test_the_motion_between_two_scans_comes_back(sensor: RangeFinder) -> None:
    onto, scan = see(ROOM, FIRST, sensor), see(ROOM, compose(FIRST, MOTION), sensor)
    for start in (MOTION, MOTION + np.array((0.2, -0.2, np.radians(12.0))), np.zeros(3)):
        result = align(scan, onto, start)
        translation, rotation = errors(result, MOTION)
        assert translation < 0.01
        assert rotation < np.radians(0.2)
        assert result.problem == ""
        assert result.converged


# Mean squared errors in units of the covariance (NEES) of 120 alignments would be 3, give or take 0.22, and of 60
# 0.32, were the covariances exact. Those with 1.5 cm and 5 mrad for what cannot be told had 0.1.
SPARSE, DENSE = (finder(np.radians(np.arange(0.0, 360.0, step))) for step in (2.0, 0.25))


@pytest.mark.parametrize(
    ("n", "conditions"),
    [
        (120, Conditions()),
        (60, Conditions(sigma=0.005)),
        (240, Conditions(sigma=0.05)),
        (60, Conditions(onto=SPARSE, scan=DENSE)),
        (60, Conditions(onto=DENSE, scan=SPARSE)),
    ],
    ids=["usual", "5 mm", "50 mm", "dense onto sparse", "sparse onto dense"],
)
def test_covariances_tell_the_errors_in_rooms(n: int, conditions: Conditions) -> None:
    pairs = room_pairs(n, 11, conditions)
    results = [align(pair.scan, pair.onto, pair.start) for pair in pairs]
    nees = mahalanobis_squares([pair.truth for pair in pairs], results)
    certain = np.array([result.problem == "" for result in results])
    assert certain.mean() > 0.95
    assert 2.0 < nees[certain].mean() < 4.0
    assert np.mean(nees[certain] < 7.815) > 0.88


@pytest.mark.parametrize(("onto_noise", "scan_noise"), [(0.03, 0.002), (0.002, 0.03)])
def test_covariances_tell_the_errors_of_scans_from_unlike_sensors(
    onto_noise: float, scan_noise: float, rng: np.random.Generator
) -> None:
    """The scan's residuals do not tell how noisy the field is: as if they did, these means were 6 and 1.7."""
    sensor, truths, results = finder(FULL_CIRCLE), [], []
    for turn in rng.uniform(-np.pi, np.pi, 100):
        first = np.array([0.0, 1.0, turn])
        onto = see(ROOM, first, sensor, onto_noise * rng.normal(size=360))
        scan = see(ROOM, compose(first, MOTION), sensor, scan_noise * rng.normal(size=360))
        truths.append(MOTION)
        results.append(align(scan, onto, MOTION))
    # End points lie off the surfaces by their own noise, and by some of that of the field, which smooths it.
    assert 0.01 < np.mean([one.spread for one in results]) < 0.03
    assert 2.1 < mahalanobis_squares(truths, results).mean() < 4.0


def test_deviations_grow_with_the_noise_and_shrink_with_the_beams() -> None:
    def deviation(step: float, sigma: float) -> float:
        """Return the median over ten pairs."""
        rng = np.random.default_rng(5)
        sensor = finder(np.radians(np.arange(0.0, 360.0, step)))
        variances = []
        for _ in range(10):
            scan, onto = (see(ROOM, pose, sensor, sigma * rng.normal(size=len(sensor.bearings)))
                          for pose in (compose(FIRST, MOTION), FIRST))  # fmt: skip
            variances.append(np.trace(align(scan, onto, MOTION).covariance[:2, :2]))
        return float(np.sqrt(np.median(variances)))

    usual = deviation(1.0, 0.02)
    assert 2.0 < usual / deviation(1.0, 0.005) < 5.0
    assert 1.6 < usual / deviation(0.25, 0.02) < 2.6


def test_errors_that_neighbouring_beams_share_widen_the_covariance(rng: np.random.Generator) -> None:
    """Runs of eight beams err alike: as much in each beam, but less averages away."""
    sensor = finder(FULL_CIRCLE)

    def deviation(run: int) -> float:
        variances = []
        for _ in range(15):
            scans = [see(ROOM, pose, sensor, np.repeat(0.01 * rng.normal(size=360 // run), run))
                     for pose in (compose(FIRST, MOTION), FIRST)]  # fmt: skip
            variances.append(np.trace(align(*scans, MOTION).covariance[:2, :2]))
        return float(np.sqrt(np.median(variances)))

    assert deviation(8) > 1.5 * deviation(1)


def test_exact_readings_leave_a_millimetre_or_less() -> None:
    sensor = finder(np.radians(np.arange(0.0, 360.0, 0.25)))
    result = align(see(ROOM, compose(FIRST, MOTION), sensor), see(ROOM, FIRST, sensor), MOTION)
    assert (np.sqrt(np.diag(result.covariance)) < 1e-3).all()
    assert np.linalg.eigvalsh(result.covariance).min() > 0.0


def test_outliers_and_occlusion_do_not_pull(rng: np.random.Generator) -> None:
    sensor = finder(FULL_CIRCLE)
    onto, scan = see(ROOM, FIRST, sensor), see(ROOM, compose(FIRST, MOTION), sensor)
    ranges = scan.ranges.copy()
    people = rng.choice(360, 70, replace=False)
    ranges[people] *= rng.uniform(0.3, 0.9, 70)
    translation, rotation = errors(align(Scan(ranges, sensor), onto, MOTION + np.array((0.15, 0.1, -0.1))), MOTION)
    assert translation < 0.01
    assert rotation < np.radians(0.2)


@pytest.mark.parametrize("heading", [0.0, 0.6, -2.0])
def test_a_corridor_leaves_its_axis_undetermined_and_untouched(heading: float, rng: np.random.Generator) -> None:
    sensor = finder(FULL_CIRCLE)
    first = np.array([0.0, 0.0, heading])
    onto = see(CORRIDOR, first, sensor, 0.01 * rng.normal(size=360))
    scan = see(CORRIDOR, compose(first, MOTION), sensor, 0.01 * rng.normal(size=360))
    start = MOTION + np.array((0.1, 0.1, 0.05))
    result = align(scan, onto, start)
    assert result.problem == "undetermined"
    assert "deg (standard, the 100 m along undetermined directions in them)" in result.summary()
    assert result.summary().endswith("problem   undetermined")
    assert result.undetermined.shape == (1, 3)
    axis = np.array([np.cos(-heading), np.sin(-heading)])
    direction = result.undetermined[0]
    assert abs(direction[:2] @ axis) == pytest.approx(1.0, abs=0.01)
    assert abs(direction[2]) < 0.02
    # What the walls determine is found; along the corridor the start is kept.
    across = np.array([-axis[1], axis[0]])
    assert abs((result.pose - MOTION)[:2] @ across) < 0.01
    assert abs(result.pose[2] - MOTION[2]) < np.radians(0.3)
    assert (result.pose - start)[:2] @ axis == pytest.approx(0.0, abs=0.02)
    assert axis @ result.covariance[:2, :2] @ axis > 90.0**2
    normal = np.array([-direction[1], direction[0]]) / np.hypot(*direction[:2])
    assert normal @ result.covariance[:2, :2] @ normal < 0.05**2


def test_ellipses_hold_the_truth_in_corridors_with_random_and_short_readings() -> None:
    pairs = corridor_pairs(120, seed=7)
    results = [align(pair.scan, pair.onto, pair.start) for pair in pairs]
    truth = [pair.truth for pair in pairs]
    assert np.mean(mahalanobis_squares(truth, results) < 7.815) >= 0.9
    error = np.array([result.pose for result in results]) - truth
    covariances = np.array([result.covariance for result in results])
    distance = np.hypot(error[:, 0], error[:, 1])
    # Nor is that bought with doubt: nearly half of the alignments are sure of 5 cm.
    worst = np.sqrt(np.linalg.eigvalsh(covariances[:, :2, :2])[:, -1])
    assert np.mean((distance > 0.1) & (distance > 3.0 * worst)) <= 0.03
    assert np.median(distance) < 0.02
    assert np.mean(worst < 0.05) > 0.4


def test_places_that_fit_about_as_well_are_said_to_be_ambiguous(rng: np.random.Generator) -> None:
    # Pillars 5 cm deep every 0.4 m: a slide by 0.4 m fits again, and the start lies halfway.
    teeth = np.vstack([[(x, 1.2, x, 1.15), (x, 1.15, x + 0.13, 1.15), (x + 0.13, 1.15, x + 0.13, 1.2)]
                       for x in np.arange(-20.0, 20.0, 0.4)])  # fmt: skip
    walls = np.vstack([CORRIDOR, teeth])
    sensor = finder(HALF_CIRCLE)
    flagged, held, n = 0, 0, 40
    for _ in range(n):
        onto, scan = (see(walls, pose, sensor, 0.01 * rng.normal(size=181)) for pose in (np.zeros(3), MOTION))
        result = align(scan, onto, MOTION + np.array((0.2, 0.0, 0.0)))
        if result.problem == "ambiguous":
            flagged += 1
            assert result.covariance[0, 0] > 0.1**2 > result.covariance[1, 1]
        error = result.pose - MOTION
        held += error @ np.linalg.solve(result.covariance, error) < 7.815
    assert flagged >= n // 4
    assert held >= 0.9 * n


def test_a_round_room_leaves_the_heading_undetermined() -> None:
    sensor = finder(FULL_CIRCLE)
    result = align(Scan(np.full(360, 3.0), sensor), Scan(np.full(360, 3.0), sensor), [0.05, 0.0, 0.2])
    assert result.undetermined.shape == (1, 3)
    assert abs(result.undetermined[0, 2]) * result.lever == pytest.approx(1.0, abs=0.05)
    assert np.hypot(*result.pose[:2]) < 0.01
    assert result.pose[2] == pytest.approx(0.2, abs=0.02)


def test_an_end_wall_determines_the_corridor() -> None:
    sensor = finder(FULL_CIRCLE)
    walls = np.vstack([CORRIDOR, [(6.0, -1.0, 6.0, 1.2)]])
    onto, scan = see(walls, np.zeros(3), sensor), see(walls, MOTION, sensor)
    result = align(scan, onto, MOTION + np.array((0.15, 0.05, 0.05)))
    assert result.undetermined.shape == (0, 3)
    assert errors(result, MOTION)[0] < 0.01


def test_the_order_of_the_beams_changes_nothing(rng: np.random.Generator) -> None:
    sensor = finder(HALF_CIRCLE)
    onto, scan = see(ROOM, FIRST, sensor), see(ROOM, compose(FIRST, MOTION), sensor)
    order = rng.permutation(181)
    found = align(scan, onto.subset(order), np.zeros(3))
    np.testing.assert_array_equal(found.pose, align(scan, onto, np.zeros(3)).pose)
    np.testing.assert_allclose(align(scan.subset(order), onto, np.zeros(3)).pose, found.pose, atol=1e-3)


def test_moving_the_field_moves_pose_and_covariance() -> None:
    sensor = finder(HALF_CIRCLE)
    onto, scan = see(ROOM, FIRST, sensor), see(ROOM, compose(FIRST, MOTION), sensor)
    here = align(scan, onto, np.zeros(3))
    there = align(scan, onto, FIRST, onto_poses=FIRST)
    np.testing.assert_allclose(there.pose, compose(FIRST, here.pose), atol=1e-3)
    turn = np.array([[np.cos(0.3), -np.sin(0.3), 0], [np.sin(0.3), np.cos(0.3), 0], [0, 0, 1]])
    np.testing.assert_allclose(there.covariance, turn @ here.covariance @ turn.T, rtol=0.02, atol=1e-6)


def test_several_scans_see_more_than_one() -> None:
    sensor = finder(HALF_CIRCLE)
    poses = np.array([[0.0, 0.5, 0.3], [0.0, 0.5, 0.3 + np.pi]])
    scans = [see(ROOM, pose, sensor) for pose in poses]
    truth = np.array([0.2, 0.7, 1.9])
    scan = see(ROOM, truth, sensor)
    both = align(scan, scans, truth + np.array((0.1, -0.1, 0.1)), onto_poses=poses)
    one = align(scan, scans[0], truth + np.array((0.1, -0.1, 0.1)), onto_poses=poses[0])
    assert errors(both, truth)[0] < 0.01
    assert both.overlap > 0.9 > one.overlap
    assert np.trace(both.covariance) < np.trace(one.covariance)


def test_a_search_finds_what_a_single_start_misses() -> None:
    sensor = finder(FULL_CIRCLE)
    onto, scan = see(ROOM, FIRST, sensor), see(ROOM, compose(FIRST, MOTION), sensor)
    start = MOTION + np.array((0.9, -0.8, 1.2))
    assert errors(align(scan, onto, start, search=(0.0, 0.0)), MOTION)[0] > 0.1
    assert errors(align(scan, onto, start, search=(1.0, 1.5)), MOTION)[0] < 0.01


def test_headings_across_the_seam_are_wrapped() -> None:
    sensor = finder(FULL_CIRCLE)
    motion = np.array([0.1, 0.0, np.pi - 0.01])
    onto, scan = see(ROOM, FIRST, sensor), see(ROOM, compose(FIRST, motion), sensor)
    result = align(scan, onto, motion + np.array((0.0, 0.0, 0.1)))
    assert -np.pi < result.pose[2] <= np.pi
    assert errors(result, motion)[1] < np.radians(0.2)


@pytest.mark.parametrize(
    ("ranges", "onto_ranges", "problem"),
    [
        (np.nan, 2.0, "no end points"),
        (np.inf, 2.0, "no end points"),
        (2.0, np.inf, "no overlap"),
        (2.0, np.nan, "no overlap"),
    ],
)
def test_nothing_to_align_gives_the_start_and_a_flag(ranges: float, onto_ranges: float, problem: str) -> None:
    sensor = finder(HALF_CIRCLE)
    start = np.array([0.1, 0.2, 4.0])
    result = align(Scan(np.full(181, ranges), sensor), Scan(np.full(181, onto_ranges), sensor), start)
    check_failure(result, problem)
    np.testing.assert_allclose(result.pose, [0.1, 0.2, 4.0 - 2 * np.pi])


def test_scans_far_apart_have_no_overlap() -> None:
    sensor = finder(FULL_CIRCLE)
    result = align(see(ROOM, FIRST, sensor), see(ROOM, FIRST, sensor), [1e4, -50.0, 0.0])
    check_failure(result, "no overlap")
    assert result.overlap == 0.0


def test_a_single_beam_is_no_alignment() -> None:
    one = Scan([2.0], finder(np.zeros(1)))
    check_failure(align(one, one, np.zeros(3)), "no overlap")


def check_failure(result: AlignmentResult, problem: str) -> None:
    assert result.problem == problem
    assert not result.converged
    assert len(result.undetermined) == 3
    assert np.isfinite(result.score)
    assert np.linalg.eigvalsh(result.covariance).min() > 1.0


def test_looking_the_other_way_is_not_called_certain() -> None:
    sensor = finder(HALF_CIRCLE)
    turned = np.array([0.0, 0.0, np.pi])
    result = align(see(ROOM, compose(FIRST, turned), sensor), see(ROOM, FIRST, sensor), turned)
    assert result.overlap < 0.5
    assert result.problem in ("undetermined", "no overlap", "outside the search")


def test_another_place_that_looks_alike_is_outside_the_search() -> None:
    sensor = finder(HALF_CIRCLE)
    pair = room_pairs(95, 501, Conditions(onto=sensor, scan=sensor, turn=0.6))[94]
    result = align(pair.scan, pair.onto, pair.start)
    assert errors(result, pair.truth)[1] > np.radians(80.0)
    assert result.problem == "outside the search"
    # Whoever searches that far may find it.
    assert align(pair.scan, pair.onto, pair.start, search=(0.0, np.radians(90.0))).problem != "outside the search"


@pytest.mark.parametrize(
    ("options", "name"),
    [
        ({"initial": [0.0, 0.0]}, "initial"),
        ({"initial": [0.0, 0.0, np.inf]}, "initial"),
        ({"initial": np.zeros((2, 3))}, "initial"),
        ({"search": (-1.0, 0.0)}, "search"),
        ({"search": (np.nan, 0.0)}, "search"),
        ({"search": (1e5, 0.0)}, "search"),
    ],
)
def test_senseless_options_are_refused_by_name(options: dict[str, object], name: str) -> None:
    scan = see(ROOM, FIRST, finder(HALF_CIRCLE))
    with pytest.raises(InvalidInputError, match=name):
        align(scan, scan, **({"initial": np.zeros(3)} | options))  # type: ignore[arg-type]


def test_poses_of_what_to_align_onto_are_needed_or_refused() -> None:
    scan = see(ROOM, FIRST, finder(HALF_CIRCLE))
    with pytest.raises(InvalidInputError, match="onto_poses"):
        align(scan, [scan, scan], np.zeros(3))
    with pytest.raises(InvalidInputError, match="onto_poses"):
        align(scan, ScanField.from_scan(scan), np.zeros(3), onto_poses=np.zeros(3))


def test_inputs_stay_as_they_are() -> None:
    scan = see(ROOM, FIRST, finder(HALF_CIRCLE))
    start = np.array([0.1, 0.0, 0.0])
    align(scan, scan, start)
    np.testing.assert_array_equal(start, [0.1, 0.0, 0.0])
    np.testing.assert_allclose(compose(invert(start), start), 0.0, atol=1e-12)
