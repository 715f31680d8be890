"""F1TENTH's particle filter against a plain transcription, and what a log says of its dispersions."""

from __future__ import annotations

import bisect
import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from beamfield.calibration.odometry.learning import calibrate_odometry
from beamfield.calibration.odometry.result import OdometryOptions
from beamfield.errors import InvalidInputError
from beamfield.geometry import compose
from beamfield.localization.particles import normal_poses
from beamfield.localization.replay import PoseBelief
from beamfield.sensors import RangeFinder, SensorLog
from beamfield.stacks.f1tenth.filter import F1tenthFilterParameters
from beamfield.stacks.f1tenth.motion import F1tenthMotion, dispersions
from beamfield.stacks.f1tenth.parameters import F1tenthParameters
from beamfield.stacks.f1tenth.table import F1tenthTable
from beamfield.stacks.registry import build_filter
from tests.reference import motion_slow
from tests.stacks.small_room import small_room
from tests.stacks.test_filters import START, drive

SENSOR = F1tenthParameters(max_range=2.0, angle_step=2)
WIDTHS = (0.03, 0.01, 0.05)


def f1tenth_filter(sensor: F1tenthParameters = SENSOR, n: int = 300):
    parameters = F1tenthFilterParameters(n)
    return build_filter("f1tenth", F1tenthTable(small_room(), sensor), F1tenthMotion(*WIDTHS), parameters)


def slow_run(model: F1tenthTable, log: SensorLog, n: int, rng: np.random.Generator) -> list[list[float]]:
    """MCL and expected_pose, one particle at a time: draw, move, weigh, normalise, average; all numbers as they are."""
    particles, weights, answers = normal_poses(START, n, rng).tolist(), [1.0 / n] * n, []
    for t in range(len(log)):
        sums = list(itertools.accumulate(weights))
        chosen = [bisect.bisect_right(sums, u * sums[-1]) for u in rng.random(n).tolist()]
        step = log.odometry[[max(t - 1, 0), t]].tolist()
        normals = rng.standard_normal((n, 3)).tolist()
        particles = [
            motion_slow.f1tenth(particles[i], step, WIDTHS, row) for i, row in zip(chosen, normals, strict=True)
        ]
        likelihoods = [math.exp(model.log_likelihood(log.scan(t), [pose])[0]) for pose in particles]
        weights = [one / sum(likelihoods) for one in likelihoods]
        answers.append([sum(w * pose[i] for w, pose in zip(weights, particles, strict=True)) for i in range(3)])
    return answers


def test_it_answers_as_a_plain_transcription_does():
    log, filtered = drive(4), f1tenth_filter(n=25)
    replay = filtered.run(log, START, np.random.default_rng(3))
    expected = slow_run(filtered.model, log, 25, np.random.default_rng(3))
    np.testing.assert_allclose(replay.poses, expected, atol=1e-9)
    assert replay.updates.tolist() == [0, 1, 2, 3]
    assert replay.particles.tolist() == [25] * 4


def test_headings_are_averaged_as_numbers():
    start = PoseBelief.around([1.0, 1.0, math.pi - 0.01], sd_position=0.05, sd_heading=0.05)
    near_pi = f1tenth_filter().run(drive(2), start, np.random.default_rng(1))
    assert abs(near_pi.poses[0, 2] - math.pi) < 0.2  # they run on past pi
    # From anywhere they are spread over the whole circle, and their mean says nothing.
    clouds = []
    anywhere = f1tenth_filter().run(
        drive(1), None, np.random.default_rng(1), watch=lambda _, poses, __: clouds.append(poses)
    )
    assert np.isfinite(anywhere.poses).all()
    # From 0 to 2 pi in the map's axes, and the noise of a step.
    yaw = small_room().origin[2]
    assert (clouds[0][:, 2].min() - yaw, clouds[0][:, 2].max() - yaw) == pytest.approx((0.0, 2.0 * math.pi), abs=0.2)


@pytest.mark.parametrize("case", ["all weights zero", "nothing measured"])
def test_where_a_scan_says_nothing_particles_become_equal(case):
    log, sensor = drive(3), SENSOR
    if case == "all weights zero":
        sensor = replace(SENSOR, z_short=0.0, z_max=0.0, z_rand=0.0, z_hit=1.0, sigma_hit=0.01)
    else:
        log = SensorLog(log.finder, log.stamps, np.full_like(log.ranges, np.nan), log.poses, log.odometry)
    filtered = f1tenth_filter(sensor)
    replay = filtered.run(log, START, np.random.default_rng(2))
    # As many everywhere as were drawn there.
    assert replay.covariances[-1, 0, 0] == pytest.approx(START.covariance[0, 0] + 3 * WIDTHS[0] ** 2, rel=0.3)


def test_dispersions_are_recovered_from_a_log():
    rng, widths = np.random.default_rng(3), (0.04, 0.04, 0.03)
    model, odometry, poses = F1tenthMotion(*widths), [np.zeros(3)], [np.zeros(3)]
    for turn in rng.normal(0.0, 0.2, 300):
        odometry.append(compose(odometry[-1], [0.1, 0.0, turn]))
        poses.append(model.sample(poses[-1][None], odometry[-2:], rng)[0])
    log = SensorLog(RangeFinder.from_bearings([0.0], 8.0), np.arange(301.0), np.ones((301, 1)), poses, odometry)
    options = OdometryOptions(0.0, 0.0, reference_error=1e-3)
    found = dispersions(calibrate_odometry(log, options))
    assert found["motion_dispersion_x"] == found["motion_dispersion_y"] == pytest.approx(0.04, rel=0.2)
    assert found["motion_dispersion_theta"] == pytest.approx(0.03, rel=0.2)


def test_a_number_of_particles_that_is_none_is_refused():
    for n in (0, 2.5, 10**9):
        with pytest.raises(InvalidInputError, match="max_particles"):
            F1tenthFilterParameters(n)
