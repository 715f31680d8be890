"""Motion models: densities integrate to 1 and are those of the draws, steps of no noise, and bad input."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy import stats

from beamfield.errors import InvalidInputError
from beamfield.geometry import compose, wrap_angle
from beamfield.models.differential_motion import DifferentialMotion
from beamfield.models.gaussian_motion import GaussianMotion, StationaryMotion
from beamfield.models.omni_motion import OmniMotion
from beamfield.models.velocity_motion import VelocityMotion
from beamfield.stacks.f1tenth.motion import F1tenthMotion
from beamfield.stacks.mrpt.motion import NAMES, MrptMotion
from tests.reference import motion_slow as slow

AHEAD = [[2.0, 1.0, 0.3], [2.5, 1.2, 0.5]]
BACK = [[2.0, 1.0, 0.3], [1.5, 0.8, 0.5]]
IN_PLACE = [[0.0, 0.0, 3.0], [0.005, 0.0, -2.5]]


def mrpt_thrun(*values: float) -> MrptMotion:
    return MrptMotion("mmThrun", **dict(zip(NAMES["mmThrun"], values, strict=True)))


STILL = [[1.0, 1.0, 1.0], [1.0, 1.0, 1.0]]
MODELS = {
    "differential": DifferentialMotion(0.2, 0.1, 0.05, 0.05),
    "differential, variance as deviation": DifferentialMotion(1.0, 1.0, 0.7, 0.5, variance_as_deviation=True),
    "omni": OmniMotion(0.5, 0.2, 0.1, 0.1, 0.15),
    "gaussian": GaussianMotion(0.1, 0.08, 0.05, 0.3, 0.2, 0.01, 0.05),
    "stationary": StationaryMotion(0.1, 0.2),
    "velocity": VelocityMotion(0.1, 0.1, 0.2, 0.3, 0.1, 0.1, duration=0.7),
    "MRPT Gaussian": MrptMotion("mmGaussian", 0.2, 0.1, math.degrees(0.3), 0.2, 0.02, math.degrees(0.05)),
    "MRPT Thrun": mrpt_thrun(0.2, 0.3, 0.2, 0.1, 0.15, math.degrees(0.1)),
    "F1TENTH": F1tenthMotion(0.2, 0.2, 0.4),
}
START = np.array([-1.0, 2.0, 2.5])


def test_the_density_of_mrpts_model_is_that_of_its_added_noise_where_the_robot_all_but_stands():
    model, odometry = mrpt_thrun(0.2, 0.3, 0.2, 0.1, 0.15, math.degrees(0.1)), [[0.0, 0.0, 0.0], [1e-9, 0.0, 0.0]]
    after = np.array([[0.1, -0.2, 0.15]])
    added = [stats.norm.logpdf(value, scale=sigma) for value, sigma in zip(after[0], (0.15, 0.15, 0.1), strict=True)]
    assert model.log_density(after, np.zeros((1, 3)), odometry)[0] == pytest.approx(sum(added), abs=1e-6)


@pytest.mark.parametrize("odometry", [AHEAD, BACK], ids=["ahead", "back"])
@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS.keys())
def test_the_density_integrates_to_one_and_is_that_of_the_draws(model, odometry):
    drawn = model.sample(np.tile(START, (20_000, 1)), odometry, np.random.default_rng(1))
    low, high = np.quantile(drawn, [0.0, 1.0], axis=0)
    low, high = low - 0.15 * (high - low), high + 0.15 * (high - low)
    if high[2] - low[2] > 2 * np.pi:
        drawn[:, 2] = wrap_angle(drawn[:, 2])
        low[2], high[2] = -np.pi, np.pi
    bins, fine = 8, 5 if getattr(model, "modelSelection", "") != "mmThrun" else 4
    edges = [np.linspace(a, b, bins + 1) for a, b in zip(low, high, strict=True)]
    centres = [np.linspace(e[0], e[-1], bins * fine, endpoint=False) + (e[1] - e[0]) / fine / 2 for e in edges]
    grid = np.stack(np.meshgrid(*centres, indexing="ij"), axis=-1)
    volume = np.prod([axis[1] - axis[0] for axis in centres])
    mass = np.exp(model.log_density(grid, START, odometry)) * volume
    mass = mass.reshape(bins, fine, bins, fine, bins, fine).sum(axis=(1, 3, 5))
    assert mass.sum() == pytest.approx(1.0, abs=0.015)  # the grid is coarse for the narrowest
    counts, _ = np.histogramdd(drawn, edges)
    full = len(drawn) * mass > 12.0
    expected = np.append(len(drawn) * mass[full], len(drawn) * (1.0 - mass[full].sum()))
    seen = np.append(counts[full], len(drawn) - counts[full].sum())
    assert full.sum() > 30
    # The grid is coarse where the density is steep, and so is the test; a wrong determinant gives thousands.
    chi2 = np.sum((seen - expected) ** 2 / expected)
    assert chi2 < stats.chi2.ppf(0.9999, full.sum()) + 0.002 * len(drawn)


@pytest.mark.parametrize("odometry", [AHEAD, BACK], ids=["ahead", "back"])
def test_a_wide_density_integrates_to_one_in_polar_coordinates_too(odometry):
    # Rotations of more than a radian and translations through the pole: both ways to an end point, and wraps, count.
    model = DifferentialMotion(1.0, 3.0, 0.6, 0.3)
    r = (np.arange(150) + 0.5) * 0.02
    angle = -np.pi + (np.arange(60) + 0.5) * 2 * np.pi / 60
    grid = np.stack(np.meshgrid(r, angle, angle, indexing="ij"), axis=-1)
    after = np.stack([grid[..., 0] * np.cos(grid[..., 1]), grid[..., 0] * np.sin(grid[..., 1]), grid[..., 2]], axis=-1)
    density = np.exp(model.log_density(after, np.zeros(3), odometry))
    assert np.sum(density * grid[..., 0]) * 0.02 * (2 * np.pi / 60) ** 2 == pytest.approx(1.0, abs=1e-4)


@pytest.mark.parametrize(
    "model",
    [
        DifferentialMotion(0.004, 0.004, 0.006, 0.002),
        OmniMotion(0.01, 0.01, 0.02, 0.01, 0.03),
        GaussianMotion(),
        VelocityMotion(0.01, 0.01, 0.01, 0.01, 0.01, 0.01, duration=0.7),
        MrptMotion(),
        mrpt_thrun(0.05, 0.05, 0.05, 0.05, 0.05, math.degrees(0.05)),
    ],
)
def test_the_covariance_of_a_step_is_that_of_its_draws(model):
    drawn = model.sample(np.zeros((40_000, 3)), AHEAD, np.random.default_rng(6))
    seen = np.cov(drawn.T)
    scale = np.sqrt(np.outer(np.diag(seen), np.diag(seen)))
    np.testing.assert_allclose(model.step(np.array(AHEAD)).covariance() / scale, seen / scale, atol=0.03)


def test_turning_in_place_is_certain_but_for_translation_and_heading():
    model = DifferentialMotion(0.1, 0.0, 0.0, 0.1)
    odometry = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]
    ahead = [[0.1, 0.0, 0.9], [-0.1, 0.0, 0.9], [0.1, 0.001, 0.9]]
    normal = stats.norm(scale=np.sqrt(0.1))
    expected = normal.logpdf(0.1) + normal.logpdf(0.1)
    np.testing.assert_allclose(model.log_density(ahead, np.zeros(3), odometry), [expected, expected, -np.inf])


@pytest.mark.parametrize("model", [DifferentialMotion(), OmniMotion(), GaussianMotion(), VelocityMotion()])
def test_a_robot_that_stands_stays_surely(model):
    drawn = model.sample(START[None], STILL, np.random.default_rng(0))
    np.testing.assert_array_equal(drawn, START[None])
    after = START + np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 2 * np.pi], [1e-3, 0.0, 0.0], [0.0, 0.0, 1e-3]])
    assert model.log_density(after, START, STILL).tolist() == [0.0, 0.0, -np.inf, -np.inf]


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS.keys())
@pytest.mark.parametrize("odometry", [AHEAD, IN_PLACE, STILL], ids=["ahead", "in place", "still"])
def test_log_densities_are_never_nan_and_broadcast(model, odometry):
    rng = np.random.default_rng(3)
    before, after = rng.normal(size=(4, 1, 3)), rng.normal(size=(1, 5, 3))
    values = model.log_density(after, before, odometry)
    assert values.shape == (4, 5)
    assert not np.isnan(values).any()
    alone = float(model.log_density(after[0, 3], before[2, 0], odometry))
    assert values[2, 3] == pytest.approx(alone, rel=1e-12)
    assert not np.isnan(model.log_density(before, before, odometry)).any()
    assert model.sample(np.empty((0, 3)), odometry, rng).shape == (0, 3)


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS.keys())
def test_moving_map_and_poses_together_changes_nothing(model):
    shift = np.array([3.0, -2.0, 1.3])
    after = model.sample(np.tile(START, (5, 1)), AHEAD, np.random.default_rng(2))
    moved = model.log_density(compose(shift, after), compose(shift, START), AHEAD)
    np.testing.assert_allclose(moved, model.log_density(after, START, AHEAD), rtol=1e-9, atol=1e-9)


def test_the_gaussian_model_does_not_depend_on_how_often_odometry_is_read():
    model = GaussianMotion(forward=0.1, sideways=0.05, shift=0.0, drift=0.04, turn=0.0)
    whole = model.step(np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0]])).covariance()
    covariance = np.zeros((3, 3))
    for _ in range(10):
        step = model.step(np.array([[0.0, 0.0, 0.0], [0.2, 0.0, 0.0]]))
        jacobian = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.2], [0.0, 0.0, 1.0]])
        covariance = jacobian @ covariance @ jacobian.T + step.covariance()
    np.testing.assert_allclose(covariance, whole, atol=1e-12)


def test_velocity_draws_are_those_of_table_5_3():
    alphas = (0.1, 0.1, 0.2, 0.3, 0.1, 0.1)
    v, w, duration = 1.2, 0.4, 0.7
    radius, turn = v / w, w * duration
    odometry = compose([5.0, 1.0, -0.4], [[0, 0, 0], [radius * np.sin(turn), radius * (1 - np.cos(turn)), turn]])
    poses = np.array([[0.0, 0.0, 0.0], [3.0, -1.0, 2.9]])
    drawn = VelocityMotion(*alphas, duration=duration).sample(poses, odometry, np.random.default_rng(4))
    normals = np.random.default_rng(4).standard_normal((2, 3))
    for pose, row, result in zip(poses, normals, drawn, strict=True):
        np.testing.assert_allclose(result, slow.velocity(pose, v, w, alphas, duration, row), atol=1e-12)


def test_velocity_goes_on_straight_without_a_turn():
    drawn = VelocityMotion(0, 0, 0, 0, 0, 0).sample(
        [[1.0, 1.0, 0.0]], [[0, 0, 0], [-0.3, 0, 0]], np.random.default_rng()
    )
    np.testing.assert_allclose(drawn, [[0.7, 1.0, 0.0]], atol=1e-15)


@pytest.mark.parametrize(
    ("poses", "odometry", "name"),
    [
        (np.zeros(3), AHEAD, "poses"),
        (np.zeros((2, 2)), AHEAD, "poses"),
        ([[0.0, np.nan, 0.0]], AHEAD, "poses"),
        (np.zeros((2, 3)), np.zeros((3, 3)), "odometry"),
        (np.zeros((2, 3)), [[0.0, 0.0, np.inf], [0.0, 0.0, 0.0]], "odometry"),
    ],
)
def test_bad_arguments_are_named(poses, odometry, name):
    with pytest.raises(InvalidInputError, match=name):
        DifferentialMotion().sample(poses, odometry, np.random.default_rng(0))


def test_densities_of_shapes_that_do_not_fit_are_refused():
    with pytest.raises(InvalidInputError, match="after: expected a shape that broadcasts"):
        OmniMotion().log_density(np.zeros((2, 3)), np.zeros((3, 3)), AHEAD)


@pytest.mark.parametrize(
    "make",
    [
        lambda: DifferentialMotion(alpha4=-1.0),
        lambda: OmniMotion(alpha5=float("nan")),
        lambda: GaussianMotion(drift=float("inf")),
        lambda: VelocityMotion(duration=0.0),
        lambda: StationaryMotion(position=-0.1),
        lambda: DifferentialMotion(alpha1="much"),
    ],
)
def test_parameters_that_make_no_distribution_are_refused(make):
    with pytest.raises(InvalidInputError):
        make()
