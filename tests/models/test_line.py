"""The model of straight lines beside a slow one that moves points; passes with the JIT off as well."""

from __future__ import annotations

import math

import numpy as np
import pytest
from benchmarks.rooms import l_shaped_room

from beamfield.detections import SPURIOUS, UNKNOWN
from beamfield.errors import InvalidInputError
from beamfield.features.lines import find_lines
from beamfield.features.sweep import RangeNoise
from beamfield.geometry import compose
from beamfield.maps.lines import LineMap
from beamfield.models.line import LineModel, LineParameters
from beamfield.models.line_detections import LineDetections
from beamfield.sensors import RangeFinder, Scan
from tests.reference.line_slow import line_density, seen_from, sum_over_lines, wrapped

LINES = [(2.0, 0.4), (1.0, -2.0), (0.0, 1.2), (3.0, 3.1)]
POSES = np.array([[0.0, 0.0, 0.0], [0.4, -0.3, 2.5], [2.5, 1.5, -3.1], [-2.0, 0.7, 40.0], [1.0, 3.0, 1.0]])
MEASURED = [(1.6, 0.5), (0.05, -2.9), (2.5, 9.0), (0.0, 1.0), (4.0, -0.4)]
COVARIANCES = np.array([[[0.09, s * 0.02], [s * 0.02, 0.04]] for s in (1.0, -1.0, 0.0, 1.5, -1.0)])
MAP = LineMap(LINES, ids=[7, 3, 12, 5])
WIDE = LineParameters(0.3, 0.2, spurious_rate=0.1, max_range=6.0)
EXTRA = LineParameters(0.0, 0.0, spurious_rate=0.1, max_range=6.0)


def model(correspondence="known", parameters=EXTRA, lines=MAP, **options) -> LineModel:
    return LineModel(lines, parameters, correspondence=correspondence, **options)


def detections(ids=None) -> LineDetections:
    return LineDetections(MEASURED, COVARIANCES, ids=ids)


def test_expected_lines_are_those_of_moved_points():
    expected = model().expected(POSES)
    assert expected.shape == (5, 4, 2)
    for i, pose in enumerate(POSES):
        for j, line in enumerate(LINES):
            rho, alpha = seen_from(line, pose)
            assert expected[i, j, 0] == pytest.approx(rho, abs=1e-12)
            if rho > 1e-9:  # else both directions are right
                assert wrapped(expected[i, j, 1] - alpha) == pytest.approx(0.0, abs=1e-9)
    assert (expected[..., 0] >= 0.0).all()
    assert (np.abs(expected[..., 1]) <= np.pi).all()


def test_known_correspondence_is_the_slow_density():
    which = [0, 1, 2, 2, 3]
    z = detections(ids=[MAP.ids[j] for j in which])
    got = model().detection_log_likelihood(z, POSES)
    for i, pose in enumerate(POSES):
        for k, measured in enumerate(MEASURED):
            q = line_density(measured, LINES[which[k]], pose, COVARIANCES[k])
            assert got[i, k] == pytest.approx(math.log(q), rel=1e-9, abs=1e-9)
    np.testing.assert_allclose(model().log_likelihood(z, POSES), got.sum(axis=1))


def test_the_sum_is_over_all_lines_and_none():
    got = model("sum").detection_log_likelihood(detections(), POSES)
    for i, pose in enumerate(POSES):
        for k, measured in enumerate(MEASURED):
            q = sum_over_lines(measured, LINES, pose, COVARIANCES[k], 0.1, 6.0)
            assert got[i, k] == pytest.approx(math.log(q), rel=1e-9, abs=1e-9)


def test_nearest_has_the_least_mahalanobis_distance():
    only_nearest = model("nearest", LineParameters(0.0, 0.0))
    got = only_nearest.detection_log_likelihood(detections(), POSES)
    chosen = only_nearest.correspondences(detections(), POSES)
    for i, pose in enumerate(POSES):
        for k, measured in enumerate(MEASURED):
            each = [line_density(measured, line, pose, COVARIANCES[k]) for line in LINES]
            assert got[i, k] == pytest.approx(math.log(max(each) / len(LINES)), rel=1e-9, abs=1e-9)
            assert chosen[i, k] == MAP.ids[int(np.argmax(each))]


def test_an_assignment_gives_no_line_to_two():
    z = LineDetections([LINES[0], LINES[0]], np.diag([0.01, 0.01]))
    assert model("nearest").correspondences(z, [0.0, 0.0, 0.0]).tolist() == [7, 7]
    best = model("assignment").correspondences(z, [0.0, 0.0, 0.0])
    assert best.tolist() in ([7, SPURIOUS], [SPURIOUS, 7])
    taken = LineDetections([LINES[0], LINES[0]], np.diag([0.01, 0.01]), ids=[7, UNKNOWN])
    assert model("assignment").correspondences(taken, [0.0, 0.0, 0.0]).tolist() == [7, SPURIOUS]
    assert model("assignment", LineParameters(0.1, 0.1), LineMap([[1.0, 0.0]])).log_likelihood(z, POSES)[0] == -np.inf


def test_a_flipped_line_is_the_same_line():
    turned = LineMap([(-rho, alpha + np.pi) for rho, alpha in LINES], ids=MAP.ids)
    flipped = LineDetections([(-rho, alpha - np.pi) for rho, alpha in MEASURED], COVARIANCES * [[1, -1], [-1, 1]])
    for how in ("nearest", "sum"):
        expected = model(how).log_likelihood(detections(), POSES)
        np.testing.assert_allclose(model(how, lines=turned).log_likelihood(detections(), POSES), expected)
        np.testing.assert_allclose(model(how).log_likelihood(flipped, POSES), expected)


def test_the_density_is_continuous_where_the_robot_crosses_a_line():
    """rho falls to 0 and grows again while alpha turns by pi; nothing jumps."""
    wall = LineMap([[2.0, 0.0]])
    poses = np.column_stack([np.linspace(1.99, 2.01, 201), np.zeros(201), np.zeros(201)])
    z = LineDetections([[0.003, 0.02]], [[4e-4, 1e-4], [1e-4, 4e-4]], ids=[1])
    values = model(lines=wall).log_likelihood(z, poses)
    assert np.abs(np.diff(values)).max() < 0.01
    # Before the wall it has the expected direction; behind it, the robot would see it half a turn away.
    z = LineDetections([[0.1, 0.02]], [[4e-4, 1e-4], [1e-4, 4e-4]], ids=[1])
    before, behind = model(lines=wall).log_likelihood(z, [[1.9, 0.0, 0.0], [2.1, 0.0, 0.0]])
    assert before > behind + 40.0


@pytest.mark.parametrize(
    "covariance", [[[0.09, 0.03], [0.03, 0.04]], [[0.09, -0.2], [-0.2, 2.0]]], ids=["narrow", "wide"]
)
def test_it_integrates_to_one_even_next_to_the_line(covariance):
    for pose in ([1.9, 0.0, 0.3], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]):
        rho = (np.arange(250) + 0.5) * 0.02
        alpha = (np.arange(400) + 0.5) * np.pi / 200
        r, a = (axis.ravel() for axis in np.meshgrid(rho, alpha))
        z = LineDetections(np.column_stack([r, a]), covariance, ids=np.full(r.size, 1))
        density = np.exp(model(lines=LineMap([[2.0, 0.0]])).detection_log_likelihood(z, pose))
        assert density.sum() * 0.02 * np.pi / 200 == pytest.approx(1.0, abs=1e-3)


def test_samples_with_correlated_noise_follow_the_density(rng):
    """Next to the line, where folding matters: expectation of a bounded statistic by samples and by integration."""
    wall, covariance, pose = LineMap([[2.0, 0.0]]), [[0.04, 0.03], [0.03, 0.09]], np.array([1.95, 0.0, 0.0])
    m = model(lines=wall)
    samples = m.sample(np.tile(pose, (8_000, 1)), rng, covariances=covariance)
    drawn = np.array([z.lines[0] for z in samples])

    def statistic(rho, alpha):
        return np.sin(alpha) * np.exp(-3.0 * rho) + 0.5 * np.cos(alpha)

    rho, alpha = (np.arange(160) + 0.5) * 0.01, -np.pi + (np.arange(200) + 0.5) * np.pi / 100
    r, a = (axis.ravel() for axis in np.meshgrid(rho, alpha))
    z = LineDetections(np.column_stack([r, a]), covariance, ids=np.full(r.size, 1))
    density = np.exp(m.detection_log_likelihood(z, pose)) * 0.01 * np.pi / 100
    expected, values = float(density @ statistic(r, a)), statistic(*drawn.T)
    assert values.mean() == pytest.approx(expected, abs=4.0 * values.std() / np.sqrt(len(values)))
    assert density.sum() == pytest.approx(1.0, abs=1e-3)


def test_parameters_add_to_what_detections_bring():
    z = detections(ids=[7, 3, 12, 12, 5])
    total = COVARIANCES + np.diag([0.3**2, 0.2**2])
    summed = LineDetections(MEASURED, total, ids=z.ids)
    np.testing.assert_allclose(
        model(parameters=WIDE).log_likelihood(z, POSES), model().log_likelihood(summed, POSES), rtol=1e-12
    )
    bare = LineDetections(MEASURED, ids=z.ids)
    alone = LineDetections(MEASURED, np.diag([0.3**2, 0.2**2]), ids=z.ids)
    np.testing.assert_allclose(model(parameters=WIDE).log_likelihood(bare, POSES), model().log_likelihood(alone, POSES))


def test_a_mount_is_where_the_sensor_is():
    mount = (0.3, -0.2, 0.9)
    z = detections(ids=[7, 3, 12, 12, 5])
    np.testing.assert_allclose(
        model(mount=mount).log_likelihood(z, POSES), model().log_likelihood(z, compose(POSES, mount))
    )


def test_only_segments_beside_the_measured_one_are_candidates():
    """Two walls on one line with a door between them."""
    walls = LineMap.from_segments([[0.0, 2.0, 4.0, 2.0], [6.0, 2.0, 9.0, 2.0]])
    z = LineDetections([[2.0, np.pi / 2]], np.diag([1e-4, 1e-4]), segments=[[-1.0, 2.0, 1.0, 2.0]])
    poses = [[2.0, 0.0, 0.0], [7.0, 0.0, 0.0], [5.0, 0.0, 0.0], [3.6, 0.0, 0.0], [-7.5, 4.0, np.pi]]
    look = model("nearest", lines=walls, min_overlap=0.5)
    assert look.correspondences(z, poses).tolist() == [[1], [2], [SPURIOUS], [1], [SPURIOUS]]
    assert model("nearest", lines=walls).correspondences(z, poses)[2].tolist() == [1]
    assert look.correspondences(LineDetections(z.lines, z.covariances, z.segments[:, [2, 3, 0, 1]]), poses[1])[0] == 2
    assert not look.is_normalized
    with pytest.raises(InvalidInputError, match="end points of every line, got none"):
        look.log_likelihood(LineDetections(z.lines, z.covariances), poses)


def test_the_lines_of_a_scan_find_the_pose(rng):
    room = l_shaped_room()
    finder = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, 360, endpoint=False), 12.0, mount=(0.2, -0.1, 0.4))
    pose = np.array([2.7, 3.1, 0.3])
    exact, _ = room.cast(pose, finder)
    lines = find_lines(Scan(exact + rng.normal(0.0, 0.01, 360), finder), RangeNoise(0.01))
    z = LineDetections.from_lines(lines)
    walls = LineMap.from_segments(room.walls)
    free = LineModel(walls, LineParameters(0.0, 0.0, 0.02, 12.0), correspondence="sum", min_overlap=0.3)
    around = pose + rng.uniform(-1.0, 1.0, (4000, 3)) * [0.5, 0.5, 0.3]
    values = free.log_likelihood(z, np.vstack([pose, around]))
    near = np.abs(around - pose).max(axis=1) < 0.02
    assert values[0] > values[1:][~near].max()
    # Which wall each is, is right at the true pose: the measured and the mapped line agree to their covariance.
    which = free.lines.indices_of(free.correspondences(z, pose))
    error = z.lines - free.expected(pose)[which]
    error[:, 1] = [wrapped(turn) for turn in error[:, 1]]
    squares = np.einsum("ki,kij,kj->k", error, np.linalg.inv(z.covariances), error)
    assert squares.max() < 20.0


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: LineParameters(-0.1, 0.1), "sigma_rho: expected a number from 0 to .*, got -0.1"),
        (lambda: LineParameters(0.1, np.nan), "sigma_alpha: expected a number from 0"),
        (lambda: LineParameters(0.1, 0.1, 1.0, 5.0), "spurious_rate: expected a probability"),
        (lambda: LineParameters(0.1, 0.1, 0.1), "max_range: expected a limit"),
        (lambda: LineParameters(0.1, 0.1, max_range=0.0), "max_range: expected a positive"),
        (lambda: model("best"), "correspondence: expected 'known'"),
        (lambda: model(min_overlap=1.5), "min_overlap: expected a share"),
        (lambda: model(min_overlap=0.5), "min_overlap: expected a map with end points"),
        (lambda: model(mount=np.zeros((1, 3))), r"mount: expected shape \(3,\)"),
        (lambda: model().log_likelihood(detections(), POSES), "needs an id of every line, got none for line 0"),
        (lambda: model().log_likelihood(detections([7, 3, 12, 12, 6]), POSES), "expected ids of the map, got 6"),
        (lambda: model("sum").log_likelihood(LineDetections(MEASURED), POSES), "sigma_rho and sigma_alpha > 0"),
        (
            lambda: model(parameters=LineParameters(0.1, 0.1)).log_likelihood(detections([SPURIOUS] * 5), POSES),
            "max_range: a spurious line needs max_range",
        ),
        (lambda: LineDetections([1.0, 2.0, 3.0]), r"lines: expected shape \(k, 2\)"),
        (lambda: LineDetections([[1.0, np.inf]]), "lines: expected finite numbers, got inf"),
        (lambda: LineDetections([[1.0, 1.0]], np.zeros((2, 2))), "expected symmetric, positive definite matrices"),
        (lambda: LineDetections([[1.0, 1.0]], [[1.0, 1.0], [1.0, 1.0]]), "positive definite"),
        (lambda: LineDetections([[1.0, 1.0]], [[1.0, 0.1], [0.2, 1.0]]), "symmetric"),
        (lambda: LineDetections([[1.0, 1.0]], np.eye(3)), r"covariances: expected shape \(1, 2, 2\)"),
        (lambda: LineDetections([[1.0, 1.0]], segments=[[1.0, 1.0]]), r"segments: expected shape \(1, 4\)"),
        (lambda: LineDetections([[1.0, 1.0]], ids=[-3]), "ids: expected at least -2"),
    ],
    ids=range(21),
)
def test_bad_input_is_refused(build, message):
    with pytest.raises(InvalidInputError, match=message):
        build()


def test_detections_can_be_taken_apart():
    z = LineDetections(MEASURED, COVARIANCES, np.ones((5, 4)), [7, 3, 12, 12, 5])
    part = z.subset([3, 0])
    assert part.ids.tolist() == [12, 7]
    assert part.covariances.tolist() == COVARIANCES[[3, 0]].tolist()
    assert len(z.subset([])) == 0
    assert z.without_ids().ids is None
    assert len(LineDetections.from_lines([])) == 0
    assert model("sum").log_likelihood(LineDetections.from_lines([]), POSES).tolist() == [0.0] * 5
