"""A replay's errors, by hand and by simulation, and comparisons that are right as often as they say."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from beamfield.errors import InvalidInputError, TooLittleDataError
from beamfield.localization.replay import (
    PoseBelief,
    Replay,
    ReplayErrors,
    judge_replay,
    normalised_squares,
    reference_start,
)
from beamfield.localization.replay_comparison import ReplayTrials, compare_trials, judge_change
from beamfield.sensors import RangeFinder, SensorLog

COVARIANCE = np.array([[0.04, 0.01, 0.0], [0.01, 0.02, 0.002], [0.0, 0.002, 0.01]])


def replay(poses: np.ndarray, means: np.ndarray | None = None, covariance: np.ndarray = COVARIANCE) -> Replay:
    """Return a run with an update at every scan."""
    n = len(poses)
    means = poses if means is None else means
    return Replay(poses, np.arange(n), means, np.tile(covariance, (n, 1, 1)), np.full(n, 500))


@cache
def no_errors() -> ReplayErrors:
    return judge_replay(replay(np.zeros((1, 3))), np.zeros((1, 3)))


def errors(mean: float, *, lost: bool = False) -> ReplayErrors:
    return replace(no_errors(), mean=mean, lost=lost)


def trials(means: np.ndarray, log: str = "hall", n_lost: int = 0) -> ReplayTrials:
    rows = tuple(errors(float(mean), lost=i < n_lost) for i, mean in enumerate(means))
    return ReplayTrials(log, tuple(range(len(means))), rows)


def test_errors_of_a_run_by_hand():
    truth = np.zeros((4, 3))
    poses = np.array([[3.0, 4.0, np.pi], [0.3, 0.4, -np.pi / 2], [0, 0, 0], [0, 0.1, 0]])
    truth[0, 2] = -np.pi
    found = judge_replay(replay(poses), truth)
    assert found.mean == pytest.approx((5.0 + 0.5 + 0.1) / 4)
    assert found.median == pytest.approx(0.3)
    assert found.p95 == pytest.approx(0.5 + 0.85 * 4.5)  # 0.95 of the three steps between 0, 0.1, 0.5 and 5
    assert found.end == pytest.approx(0.1)
    assert found.lost  # a quarter of the scans
    assert found.yaw_rmse_deg == pytest.approx(45.0)
    assert (found.yaw_mean_deg, found.yaw_median_deg) == pytest.approx((22.5, 0.0))
    assert found.yaw_p95_deg == pytest.approx(0.85 * 90.0)
    assert found.sd_position == pytest.approx(np.sqrt(0.06))
    assert (found.updates, found.particles, found.update_ms) == (4, 500.0, None)
    assert "0.100 at the end, but LOST before, more than 2 m off in over 10% of the scans; heading" in found.summary()
    assert "5.000 at the end: LOST; heading" in judge_replay(replay(poses[::-1]), truth).summary()


@pytest.mark.parametrize(
    ("scans", "off", "lost"), [([19], 1.99, False), ([19], 2.01, True), ([3, 9], 9.0, False), ([3, 9, 5], 2.01, True)]
)
def test_a_run_is_lost_that_ends_far_off_or_is_so_in_more_than_a_tenth_of_the_scans(scans, off, lost):
    poses = np.zeros((20, 3))
    poses[scans, 1] = off
    assert judge_replay(replay(poses), np.zeros((20, 3))).lost is lost


def test_scans_without_reference_or_pose_do_not_count():
    truth = np.array([[9.0, 9.0, 0.0], [np.nan] * 3, [0.0, 0.0, 0.0]])
    poses = np.array([[np.nan] * 3, [5.0, 5.0, 0.0], [0.1, 0.0, 0.0]])
    means = np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]])
    covariances = np.array([0.01 * np.eye(3), 0.04 * np.eye(3)])
    run = Replay(poses, np.array([1, 2]), means, covariances, np.array([10, 20]), np.array([0.002, 0.006]))
    found = judge_replay(run, truth)
    assert found.mean == pytest.approx(0.1)
    assert found.nees_median == pytest.approx(1.0)
    assert (found.updates, found.particles, found.update_ms) == (2, 15.0, 4.0)
    # One of the two updates is judged.
    assert "ellipse in 100% of the updates with a reference (100% with 0.03 m" in found.summary()
    assert "15 particles, standard deviation 0.212 m, 2 updates of 4 ms" in found.summary()


def test_squares_are_those_of_the_inverse(rng):
    off = rng.normal(size=(20, 3))
    roots = rng.normal(size=(20, 3, 3))
    covariances = roots @ np.swapaxes(roots, 1, 2)
    expected = [e @ np.linalg.inv(c) @ e for e, c in zip(off, covariances, strict=True)]
    np.testing.assert_allclose(normalised_squares(off, covariances), expected, rtol=1e-6)


def test_a_right_covariance_has_the_ideal_nees_and_coverage(rng):
    truth = rng.normal(size=(20_000, 3))
    poses = truth + rng.multivariate_normal(np.zeros(3), COVARIANCE, size=len(truth))
    found = judge_replay(replay(poses), truth)
    assert found.nees_median == pytest.approx(2.366, abs=0.06)
    assert found.inside == pytest.approx(0.95, abs=0.006)
    noisy = truth + np.column_stack([rng.normal(0.0, 0.03, (len(truth), 2)), np.zeros(len(truth))])
    assert judge_replay(replay(poses), noisy).inside_noisy == pytest.approx(0.95, abs=0.006)


def test_particles_at_one_point_give_finite_numbers():
    found = judge_replay(replay(np.zeros((1, 3)), covariance=np.zeros((3, 3))), np.full((1, 3), 0.1))
    assert found.nees_median == pytest.approx(3 * 0.1**2 / 1e-12)  # as of a variance of (1 um)^2 or (1 urad)^2
    assert found.inside == 0.0


def test_a_run_without_anything_to_judge_is_refused():
    with pytest.raises(TooLittleDataError, match="0 scans"):
        judge_replay(replay(np.zeros((2, 3))), np.full((2, 3), np.nan))
    with pytest.raises(InvalidInputError, match=r"reference: expected shape \(2, 3\)"):
        judge_replay(replay(np.zeros((2, 3))), np.zeros((3, 3)))


@pytest.mark.parametrize("name", ["sd_position", "sd_heading"])
@pytest.mark.parametrize("value", [-0.5, np.nan, np.inf])
def test_standard_deviations_that_are_none_are_refused(name, value):
    with pytest.raises(InvalidInputError, match=f"{name}: expected a finite number of at least 0"):
        PoseBelief.around([0.0, 0.0, 0.0], **{name: value})


def test_malformed_runs_and_beliefs_are_refused():
    with pytest.raises(InvalidInputError, match="means: expected shape"):
        Replay(np.zeros((2, 3)), np.array([0]), np.zeros((2, 3)), np.zeros((1, 3, 3)), np.array([1]))
    for updates in ([2], [-1], [1, 0], [1, 1]):
        u = len(updates)
        with pytest.raises(InvalidInputError, match="updates: expected increasing"):
            Replay(np.zeros((2, 3)), np.array(updates), np.zeros((u, 3)), np.zeros((u, 3, 3)), np.ones(u, np.int64))
    with pytest.raises(InvalidInputError, match="covariances: expected finite"):
        Replay(np.zeros((2, 3)), np.array([0]), np.zeros((1, 3)), np.full((1, 3, 3), np.nan), np.array([1]))
    for matrix in (-np.eye(3), np.diag([1.0, 1.0, -1e-6]), np.eye(3) + np.eye(3, k=1)):
        with pytest.raises(InvalidInputError, match="covariance: expected a covariance matrix"):
            PoseBelief(np.zeros(3), matrix)
    with pytest.raises(InvalidInputError, match="pose: expected finite"):
        PoseBelief.around([np.nan, 0.0, 0.0])


def test_the_start_is_the_first_scan_with_reference_and_odometry():
    poses = [[np.nan] * 3, [1.0, 2.0, 0.5], [3.0, 2.0, 0.5]]
    odometry = [[0.0] * 3, [np.nan] * 3, [0.0] * 3]
    finder = RangeFinder.from_bearings([0.0], max_range=5.0)
    log = SensorLog(finder, np.arange(3.0), np.ones((3, 1)), poses, odometry)
    scan, start = reference_start(log, sd_position=0.2)
    assert scan == 2
    assert start.mean.tolist() == [3.0, 2.0, 0.5]
    assert np.sqrt(np.diag(start.covariance)) == pytest.approx([0.2, 0.2, np.radians(15.0)])
    with pytest.raises(TooLittleDataError):
        reference_start(log.select([0, 1]))


def test_intervals_of_differences_hold_the_truth_as_often_as_they_say(rng):
    held = 0
    for _ in range(100):
        level = rng.exponential(0.1, 12)  # of a seed, which both filters share
        before, after = trials(level), trials(0.8 * level + rng.normal(0.05, 0.02, 12))
        found = compare_trials([before], [after])
        held += found.low <= -0.02 + 0.05 <= found.high
    assert 0.89 <= held / 100 <= 0.99


@pytest.mark.parametrize(("n_seeds", "n_logs"), [(2, 1), (3, 1), (5, 1), (3, 3)])
def test_intervals_of_few_seeds_hold_the_truth_as_often_too(n_seeds, n_logs, rng):
    held = 0
    for _ in range(200):
        pairs = [(trials(rng.normal(0.2, 0.02, n_seeds), str(i)), trials(rng.normal(0.2, 0.05, n_seeds), str(i)))
                 for i in range(n_logs)]  # fmt: skip
        found = compare_trials(*zip(*pairs, strict=True))
        held += found.low <= 0.0 <= found.high
    assert 0.91 <= held / 200 <= (0.99 if n_logs == 1 else 1.0)


def test_logs_count_alike_and_seeds_are_drawn_within_them():
    before = [trials(np.full(10, 1.0), "a"), trials(np.full(40, 2.0), "b")]
    after = [trials(np.full(10, 0.0), "a"), trials(np.full(40, 2.5), "b")]
    found = compare_trials(before, after)
    assert (found.before, found.after) == (1.5, 1.25)
    assert (found.low, found.high) == pytest.approx((-0.25, -0.25))
    assert found.is_lower
    verdict = judge_change(before, after)
    assert not verdict.is_better  # log b is worse for sure
    assert "not better for sure" in verdict.summary()
    assert "mean position error: 1.500 -> 1.250 m, difference -0.250 m" in verdict.summary()


def test_a_change_that_loses_more_runs_is_not_better():
    before, after = trials(np.linspace(0.2, 0.3, 10)), trials(np.linspace(0.1, 0.15, 10), n_lost=1)
    assert judge_change([before], [trials(np.linspace(0.1, 0.15, 10))]).is_better
    assert not judge_change([before], [after]).is_better


def test_nothing_is_better_than_another_that_is_lost_in_every_run_itself():
    before = trials(np.linspace(4.0, 5.0, 10), n_lost=10)
    for n_lost, is_better in ((9, True), (10, False)):
        assert judge_change([before], [trials(np.linspace(2.0, 3.0, 10), n_lost=n_lost)]).is_better is is_better


def test_logs_of_one_name_are_refused():
    worse, better = (
        (trials(np.full(10, 0.1)), trials(np.full(10, 0.2))),
        (trials(np.full(10, 0.5)), trials(np.ones(10))),
    )
    with pytest.raises(InvalidInputError, match="names of their own"):
        judge_change(worse, better)


def test_few_seeds_decide_nothing():
    found = compare_trials([trials(np.full(5, 1.0))], [trials(np.full(5, 0.1))])
    assert not found.is_sure
    alone = compare_trials([trials(np.ones(1))], [trials(np.zeros(1))])
    assert (alone.low, alone.high) == (-np.inf, np.inf)


def test_comparisons_of_unlike_runs_are_refused():
    with pytest.raises(InvalidInputError, match="same logs"):
        compare_trials([trials(np.ones(3), "a")], [trials(np.ones(3), "b")])
    with pytest.raises(InvalidInputError, match="measure: expected one of"):
        trials(np.ones(3)).column("speed")
    with pytest.raises(InvalidInputError, match="seeds, errors"):
        ReplayTrials("a", (1, 2), (errors(0.1),))
