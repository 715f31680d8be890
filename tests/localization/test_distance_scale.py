"""Errors that all distances of an odometry share: against an exact filter, and on a robot with worn wheels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import between, chained
from beamfield.localization.distance_scale import DistanceScale
from beamfield.localization.particle_filter import FilterOptions, ParticleFilter
from beamfield.localization.recovery import FreePoses, Recovery
from beamfield.localization.replay import judge_replay, reference_start
from beamfield.localization.scan_localizer import ScanLocalizer
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.gaussian_motion import USUAL_MOTION
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import SensorLog
from tests.localization.test_particle_filter import ALWAYS, Position, Shift

# All alike, and kept for good: what a Kalman filter can have in its state.
ONE_NORMAL = DistanceScale(usual=0.1, worn_share=0.0, redrawn=0.0)


def test_poses_and_scales_are_those_of_a_kalman_filter_with_the_scale_in_its_state():
    rng, n, true_scale, sigma_z = np.random.default_rng(4), 100_000, -0.08, 0.4
    options = FilterOptions(n_particles=n, distance_scale=ONE_NORMAL, **ALWAYS)
    own = ParticleFilter(Position(sigma_z), Shift(0.05), options, rng=1)
    own.start(np.column_stack([rng.normal(0.0, 0.15, (n, 2)), np.zeros(n)]))
    mean, covariance = np.zeros(3), np.diag([0.0225, 0.0225, ONE_NORMAL.usual**2])  # x, y, scale
    odometry, truth = np.zeros(3), np.array([0.1, -0.05])
    for t in range(15):
        if t:
            step = np.array([1.0, 0.5 * (-1) ** t])
            odometry[:2] += step
            truth = truth + (1.0 + true_scale) * step + rng.normal(0.0, 0.05, 2)
            jacobian = np.eye(3)
            jacobian[:2, 2] = step
            mean[:2] += (1.0 + mean[2]) * step
            # The noise of a step is stretched with it, by a tenth of its 0.05 m: next to nothing.
            covariance = jacobian @ covariance @ jacobian.T + np.diag([0.05**2, 0.05**2, 0.0])
        z = truth + rng.normal(0.0, sigma_z, 2)
        gain = covariance[:, :2] @ np.linalg.inv(covariance[:2, :2] + sigma_z**2 * np.eye(2))
        mean, covariance = mean + gain @ (z - mean[:2]), covariance - gain @ covariance[:2]
        own.update(z, odometry)
        scale = own.distance_scale
        assert scale.mean == pytest.approx(mean[2], abs=0.05 * ONE_NORMAL.usual)
        assert scale.deviation == pytest.approx(covariance[2, 2] ** 0.5, rel=0.1)
        np.testing.assert_allclose(own.belief.whole.pose[:2], mean[:2], atol=0.02)
    assert abs(scale.mean - true_scale) < 3.0 * scale.deviation < 0.1


def test_errors_are_drawn_from_two_normal_ones_and_anew_at_the_rate_given():
    rng, n = np.random.default_rng(0), 200_000
    scale = DistanceScale(usual=0.01, worn=0.06, worn_share=0.3, redrawn=0.02)
    drawn = scale.draw(n, rng)
    assert drawn.mean() == pytest.approx(0.0, abs=0.0005)
    assert drawn.var() == pytest.approx(0.7 * 0.01**2 + 0.3 * 0.06**2, rel=0.02)
    before = np.zeros((n, 3))
    after, kept = scale.move(before, np.tile([2.0, -1.0, 0.5], (n, 1)), np.full(n, 0.1), 2.0, rng)
    np.testing.assert_allclose(after, np.tile([2.2, -1.1, 0.5], (n, 1)))
    assert (kept != 0.1).mean() == pytest.approx(0.04, abs=0.002)
    assert kept[kept != 0.1].std() == pytest.approx(drawn.std(), rel=0.05)
    assert scale.times(2.0) == DistanceScale(0.02, 0.12, 0.3, 0.02)


def test_without_one_distances_are_taken_as_they_are():
    own = ParticleFilter(Position(0.4), Shift(0.05), rng=1)
    own.start(np.zeros((100, 3)))
    own.update(np.zeros(2), np.zeros(3))
    own.update(np.zeros(2), np.array([1.0, 0.0, 0.0]))
    assert own.distance_scale is None


def test_errors_of_distance_are_drawn_once_the_place_is_known():
    options = FilterOptions(n_particles=500, distance_scale=DistanceScale(), **ALWAYS)
    own = ParticleFilter(Position(0.1), Shift(0.01), options, rng=1)
    assert own.distance_scale is None
    own.start(np.random.default_rng(0).normal(0.0, [2.0, 2.0, 0.0], (500, 3)))
    assert own.distance_scale is None
    own.update(np.zeros(2), np.zeros(3))
    assert own.distance_scale is not None


def test_poses_that_a_recovery_draws_have_errors_of_their_own():
    room = OccupancyGrid(np.zeros((20, 20)), 0.5)
    recovery = Recovery(alpha_slow=0.01, alpha_fast=0.9)
    options = FilterOptions(n_particles=500, distance_scale=DistanceScale(), recovery=recovery, **ALWAYS)
    own = ParticleFilter(Position(0.2), Shift(0.05), options, source=FreePoses(room), rng=1)
    own.start(np.tile([5.0, 5.0, 0.0], (500, 1)))
    replaced = 0
    for t in range(12):
        # From the sixth measurement on the robot is elsewhere.
        update = own.update(np.array([5.0 + 0.1 * t, 5.0 if t < 6 else 8.0]), [0.1 * t, 0.0, 0.0])
        replaced += update.n_replaced
    assert replaced > 0
    assert np.isfinite(own.distance_scale).all()


@pytest.mark.parametrize("wrong", [{"usual": -0.01}, {"worn": np.nan}, {"worn_share": 1.5}, {"redrawn": -0.1}])
def test_values_out_of_range_are_refused(wrong):
    with pytest.raises(InvalidInputError, match=next(iter(wrong))):
        DistanceScale(**wrong)


def with_worn_wheels(log: SensorLog, error: float) -> SensorLog:
    """Return a log whose odometry measures its distances too long by a share."""
    steps = between(log.odometry[:-1], log.odometry[1:])
    steps[:, :2] *= 1.0 + error
    return replace(log, odometry=chained(log.odometry[0], steps))


@pytest.mark.parametrize("error", [0.09, -0.09])
def test_a_robot_with_worn_wheels_is_followed_and_the_wheels_are_named(office, drive, error):
    worn = with_worn_wheels(drive, error)
    model = LikelihoodFieldModel(office, LikelihoodFieldParameters(0.8, 0.1, 0.1), exponent=0.03)
    localizer = ScanLocalizer(office, model, USUAL_MOTION)
    start = reference_start(worn)[1]
    found = localizer.run(worn, start, np.random.default_rng(0))
    noise_alone = replace(localizer, options=FilterOptions()).run(worn, start, np.random.default_rng(0))
    assert found.distance_scale.mean == pytest.approx(1.0 / (1.0 + error) - 1.0, abs=0.04)
    assert [one.name for one in found.findings] == ["odometry-scale"]
    assert judge_replay(found, worn.poses).mean < 0.7 * judge_replay(noise_alone, worn.poses).mean
    assert not localizer.run(drive, start, np.random.default_rng(0)).findings
