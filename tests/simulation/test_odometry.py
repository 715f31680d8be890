from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import between, wrap_angle
from beamfield.simulation.odometry import OdometryNoise, noisy_odometry

PERFECT = OdometryNoise(distance=0.0, drift=0.0, turn=0.0, distance_scale=0.0, turn_scale=0.0)


def straight(length: float, n_steps: int) -> np.ndarray:
    along = np.linspace(0.0, length, n_steps + 1)
    return np.column_stack([2.0 + along, np.full_like(along, 1.0), np.zeros_like(along)])


def spin(angle: float, n_steps: int) -> np.ndarray:
    heading = np.linspace(0.0, angle, n_steps + 1)
    return np.column_stack([np.zeros_like(heading), np.zeros_like(heading), wrap_angle(heading)])


def test_without_noise_odometry_is_the_true_drive_seen_from_its_start(rng: np.random.Generator) -> None:
    truth = np.cumsum(rng.normal(0.0, 0.3, (60, 3)), axis=0)
    odometry = noisy_odometry(truth, rng, PERFECT)
    np.testing.assert_allclose(odometry[:, :2], between(truth[0], truth)[:, :2], atol=1e-9)
    np.testing.assert_allclose(wrap_angle(odometry[:, 2] - between(truth[0], truth)[:, 2]), 0.0, atol=1e-9)


@pytest.mark.parametrize("n_steps", [10, 200])
def test_the_spread_after_a_drive_is_as_stated_at_any_rate(n_steps: int, rng: np.random.Generator) -> None:
    noise = OdometryNoise(distance=0.02, drift=0.01, turn=0.03, distance_scale=0.0, turn_scale=0.0)
    ends = np.array([noisy_odometry(straight(9.0, n_steps), rng, noise)[-1] for _ in range(300)])
    # sqrt(9 m) times the noise of one metre; 300 draws know a deviation to 4 percent (one sigma).
    assert ends[:, 0].std() == pytest.approx(0.06, rel=0.16)
    assert ends[:, 2].std() == pytest.approx(0.03, rel=0.16)
    # Heading errors along the way add up to a lateral error of drift * sqrt(L^3 / 3).
    assert ends[:, 1].std() == pytest.approx(0.01 * np.sqrt(9.0**3 / 3.0), rel=0.2)
    turned = np.array([noisy_odometry(spin(4.0, n_steps), rng, noise)[-1] for _ in range(300)])
    assert wrap_angle(turned[:, 2] - 4.0).std() == pytest.approx(0.06, rel=0.16)


def test_scale_errors_are_systematic(rng: np.random.Generator) -> None:
    noise = OdometryNoise(distance=0.0, drift=0.0, turn=0.0, distance_scale=0.02, turn_scale=-0.05)
    assert noisy_odometry(straight(10.0, 50), rng, noise)[-1] == pytest.approx([10.2, 0.0, 0.0])
    assert noisy_odometry(spin(2.0, 50), rng, noise)[-1] == pytest.approx([0.0, 0.0, 1.9])


def test_a_robot_that_stands_adds_no_error(rng: np.random.Generator) -> None:
    standing = np.repeat([[1.0, 2.0, 0.5]], 50, axis=0)
    np.testing.assert_array_equal(noisy_odometry(standing, rng), np.zeros((50, 3)))


def test_the_default_drifts_some_percent_of_the_way(rng: np.random.Generator) -> None:
    ends = np.array([noisy_odometry(straight(50.0, 500), rng)[-1] for _ in range(50)])
    error = np.hypot(ends[:, 0] - 50.0, ends[:, 1])
    assert 0.5 < np.median(error) < 4.0


@pytest.mark.parametrize("n", [0, 1])
def test_a_drive_of_no_step_is_the_origin(n: int, rng: np.random.Generator) -> None:
    np.testing.assert_array_equal(noisy_odometry(np.ones((n, 3)), rng), np.zeros((n, 3)))


@pytest.mark.parametrize("bad", [{"distance": -0.1}, {"drift": np.inf}, {"turn_scale": -1.5}])
def test_impossible_noise_is_refused(bad: dict[str, float]) -> None:
    with pytest.raises(InvalidInputError, match=next(iter(bad))):
        OdometryNoise(**bad)


def test_poses_of_another_shape_are_refused(rng: np.random.Generator) -> None:
    with pytest.raises(InvalidInputError, match=r"expected shape \(t, 3\)"):
        noisy_odometry([0.0, 0.0, 0.0], rng)
