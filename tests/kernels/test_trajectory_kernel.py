"""Following a pose through a log, against an extended Kalman filter written with whole matrices."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.geometry import compose, invert, wrap_angle
from beamfield.kernels import trajectory as kernels
from beamfield.kernels.trajectory import HitNoise, StepNoise, Walls

HITS, INDEPENDENT = HitNoise(0.1, 0.02, 0.0, 0.0), 6.0
STEPS = StepNoise(0.05**2, 0.03**2, 0.03**2, 0.1**2, 0.02**2, 1e-6)
KNOWN = np.diag(np.square([0.15, 0.15, 0.04, 0.1, 0.1, 0.05, 0.05]))
# Distances are longer and turns shorter than the odometry says; the robot turns without noticing, and drives aside.
WRONG = np.array([0.15, -0.1, 0.06, 0.1])


def moved(pose, systematic, step, direction):
    distance, turn, per_metre, aside = systematic
    towards = compose([0.0, 0.0, aside], [*(1.0 + distance) * step[:2], 0.0])[:2]
    corrected = np.array([*towards, (1.0 + turn) * step[2] + per_metre * step[0]])
    return compose(pose, corrected if direction > 0 else invert(corrected))


def room():
    """Signed distances to the walls of a room of 6 m x 4 m, in cells of 0.05 m."""
    y, x = np.mgrid[-10:90, -10:130] * 0.05 + 0.025
    inside = np.minimum(np.minimum(x, 6.0 - x), np.minimum(y, 4.0 - y))
    return Walls(inside.astype(np.float32), -0.5, -0.5, 0.0, 0.05, 0.3)


def scan_from(pose, n=40):
    bearings = np.linspace(-np.pi, np.pi, n, endpoint=False)
    cos, sin = np.cos(pose[2] + bearings), np.sin(pose[2] + bearings)
    with np.errstate(divide="ignore"):
        to_x = np.where(cos > 0, 6.0 - pose[0], -pose[0]) / cos
        to_y = np.where(sin > 0, 4.0 - pose[1], -pose[1]) / sin
    ranges = np.minimum(np.abs(to_x), np.abs(to_y))
    return np.column_stack([ranges * np.cos(bearings), ranges * np.sin(bearings), np.cos(bearings), np.sin(bearings)])


def numeric(function, at, n_out, h=1e-6):
    columns = []
    for j in range(len(at)):
        step = np.zeros(len(at))
        step[j] = h
        difference = function(at + step) - function(at - step)
        difference[2] = wrap_angle(difference[2])
        columns.append(difference / (2.0 * h))
    return np.column_stack(columns).reshape(n_out, len(at))


def followed(points, first, steps, walls, start, direction, pose):
    """Return poses, costs, and the last state's covariance, in information form with numeric derivatives."""
    n = len(first) - 1
    state, covariance = np.concatenate([pose, np.zeros(4)]), KNOWN.copy()
    poses, costs = np.full((n, 3), np.nan), np.full(n, np.nan)
    gradient, information = np.empty(6), np.empty((3, 3))
    i = start
    while True:
        ends, predicted, known = points[first[i] : first[i + 1]], state.copy(), np.linalg.inv(covariance)
        share = INDEPENDENT / max(1, len(ends))
        for _ in range(int(kernels.TRACK_STEPS)):
            kernels.sum_scan(ends, state[:3].copy(), walls, HITS, gradient, information)
            total, pull = known.copy(), known @ (state - predicted)
            total[:3, :3] += share * information
            pull[:3] += share * gradient[:3]
            state = state - np.linalg.solve(total, pull)
        cost = kernels.sum_scan(ends, state[:3].copy(), walls, HITS, gradient, information)
        off = (state - predicted)[:3]
        poses[i], costs[i] = state[:3], share * cost + 0.5 * off @ np.linalg.inv(covariance[:3, :3]) @ off
        known[:3, :3] += share * information
        covariance = np.linalg.inv(known)
        following = i + direction
        if not 0 <= following < n:
            return poses, costs, covariance
        step = steps[min(i, following)]

        def onwards(value, step=step):
            return np.concatenate([moved(value[:3], value[3:], step, direction), value[3:]])

        jacobian = numeric(onwards, state, 7)
        heading = state[2]
        corrected = moved(np.zeros(3), state[3:], step, direction)
        state = onwards(state)
        variances = np.empty(3)
        kernels.step_variances(*corrected, STEPS, variances)
        c, s = np.cos(heading), np.sin(heading)
        turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        covariance = jacobian @ covariance @ jacobian.T
        covariance[:3, :3] += turn @ np.diag(variances) @ turn.T
        i = following


def drive(n=30):
    random = np.random.default_rng(4)
    steps = np.column_stack([random.uniform(0.05, 0.15, n - 1), 0.01 * random.normal(size=n - 1),
                             random.uniform(-0.1, 0.2, n - 1)])  # fmt: skip
    poses = [np.array([1.5, 1.2, 0.3])]
    for step in steps:
        poses.append(moved(poses[-1], WRONG, step, 1))
    return steps, np.array(poses)


@pytest.mark.parametrize(("start", "direction"), [(0, 1), (29, -1), (12, 1), (12, -1)])
@pytest.mark.parametrize("sees", [True, False], ids=["with scans", "blind"])
def test_a_pose_is_followed_as_by_a_filter_that_learns_systematic_errors(start, direction, sees):
    steps, truth = drive()
    scans = [scan_from(pose) if sees else np.empty((0, 4)) for pose in truth]
    points, first = np.concatenate(scans), np.concatenate([[0], np.cumsum([len(one) for one in scans])])
    begun = truth[start] + [0.05, -0.04, 0.02]
    expected, expected_costs, expected_covariance = followed(points, first, steps, room(), start, direction, begun)
    poses, costs, covariance = np.full((len(truth), 3), np.nan), np.full(len(truth), np.nan), KNOWN.copy()
    poses[start] = begun
    kernels.track(points, first, steps, room(), HITS, HITS, STEPS, INDEPENDENT, start, direction, poses, covariance,
                  costs)  # fmt: skip
    np.testing.assert_allclose(poses, expected, atol=2e-4)
    np.testing.assert_allclose(costs, expected_costs, atol=0.02)
    np.testing.assert_allclose(covariance, expected_covariance, atol=1e-7, rtol=0.01)
    assert (covariance[3, 3] < 0.5 * KNOWN[3, 3]) == sees
