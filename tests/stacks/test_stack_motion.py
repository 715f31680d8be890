"""Stacks' motion models: draws as in a literal transcription, densities as their own draws show them."""

from __future__ import annotations

import math

import numpy as np
import pytest

from beamfield.errors import InvalidInputError
from beamfield.geometry import wrap_angle
from beamfield.stacks.beluga.motion import BelugaMotion
from beamfield.stacks.f1tenth.motion import F1tenthMotion
from beamfield.stacks.mrpt.motion import NAMES, MrptMotion
from beamfield.stacks.nav2.motion import OMNI, Nav2Motion
from beamfield.stacks.ros1.motion import Ros1Motion
from tests.reference import motion_slow as slow

ALPHAS = (0.11, 0.07, 0.05, 0.03, 0.13)
STEPS = {
    "ahead": [[1.0, 2.0, 0.5], [1.2, 2.1, 0.6]],
    "back": [[1.0, 2.0, 0.5], [0.8, 1.9, 0.4]],
    "in place": [[1.0, 2.0, 0.5], [1.005, 2.001, 0.9]],
    "turned round": [[1.0, 2.0, 3.1], [0.7, 1.8, -3.0]],
    "sideways": [[0.0, 0.0, -2.0], [0.2, -0.2, -2.1]],
}
POSES = np.array([[0.0, 0.0, 0.0], [3.0, -1.0, 2.9], [-2.0, 5.0, -1.2]])


def identity(value):
    return value


MODELS = {
    "nav2 differential": (
        Nav2Motion("nav2_amcl::DifferentialMotionModel", *ALPHAS),
        lambda pose, u, n: slow.amcl_differential(pose, u, ALPHAS[:4], n),
    ),
    "nav2 omni": (
        Nav2Motion(OMNI, *ALPHAS),
        lambda pose, u, n: slow.amcl_omni(pose, u, slow.nav2_omni_factors(*ALPHAS), n),
    ),
    "nav2 differential before Humble": (
        Nav2Motion("differential", *ALPHAS),
        lambda pose, u, n: slow.amcl_differential(pose, u, ALPHAS[:4], n),
    ),
    "nav2 omni before Humble": (
        Nav2Motion("omnidirectional", *ALPHAS),
        lambda pose, u, n: slow.amcl_omni(pose, u, slow.nav2_omni_factors(*ALPHAS), n),
    ),
    "ROS 1 diff": (
        Ros1Motion("diff", *ALPHAS),
        lambda pose, u, n: slow.amcl_differential(pose, u, ALPHAS[:4], n, identity),
    ),
    "ROS 1 diff-corrected": (
        Ros1Motion("diff-corrected", *ALPHAS),
        lambda pose, u, n: slow.amcl_differential(pose, u, ALPHAS[:4], n),
    ),
    "ROS 1 omni": (
        Ros1Motion("omni", *ALPHAS),
        lambda pose, u, n: slow.amcl_omni(pose, u, slow.ros1_omni_factors(*ALPHAS), n, identity),
    ),
    "ROS 1 omni-corrected": (
        Ros1Motion("omni-corrected", *ALPHAS),
        lambda pose, u, n: slow.amcl_omni(pose, u, slow.nav2_omni_factors(*ALPHAS), n),
    ),
    "Beluga differential": (
        BelugaMotion("differential_drive", *ALPHAS),
        lambda pose, u, n: slow.beluga_differential(pose, u, ALPHAS[:4], n),
    ),
    "Beluga omnidirectional": (
        BelugaMotion("omnidirectional_drive", *ALPHAS),
        lambda pose, u, n: slow.beluga_omnidirectional(pose, u, ALPHAS, n),
    ),
    "Beluga stationary": (
        BelugaMotion("stationary"),
        lambda pose, _, n: slow.se2(pose, [0.02 * value for value in n]),
    ),
    "MRPT Thrun": (
        MrptMotion("mmThrun", **dict(zip(NAMES["mmThrun"], (*ALPHAS[:4], 0.01, math.degrees(0.02)), strict=True))),
        lambda pose, u, n: slow.mrpt_thrun(pose, u, ALPHAS[:4], 0.01, 0.02, n),
    ),
    "F1TENTH": (F1tenthMotion(0.05, 0.02, 0.1), lambda pose, u, n: slow.f1tenth(pose, u, (0.05, 0.02, 0.1), n)),
}


@pytest.mark.parametrize("odometry", STEPS.values(), ids=STEPS.keys())
@pytest.mark.parametrize(("model", "literal"), MODELS.values(), ids=MODELS.keys())
def test_draws_are_those_of_a_literal_transcription(model, literal, odometry):
    n_normals = 6 if isinstance(model, MrptMotion) else 3
    normals = np.random.default_rng(5).standard_normal((len(POSES), n_normals))
    drawn = model.sample(POSES, odometry, np.random.default_rng(5))
    if n_normals == 6:  # ours adds the noise of x and y in the map's axes, which has the same distribution
        cos, sin = np.cos(POSES[:, 2]), np.sin(POSES[:, 2])
        normals[:, 3], normals[:, 4] = (
            cos * normals[:, 3] + sin * normals[:, 4], -sin * normals[:, 3] + cos * normals[:, 4],
        )  # fmt: skip
    for pose, row, result in zip(POSES, normals, drawn, strict=True):
        expected = literal(pose, odometry, row)
        np.testing.assert_allclose(result[:2], expected[:2], atol=1e-12)
        assert abs(wrap_angle(result[2] - expected[2])) < 1e-12


@pytest.mark.parametrize("heading", [0.0, 2.9, -3.0])
@pytest.mark.parametrize("name", ["nav2 differential", "Beluga differential", "MRPT Thrun"])
def test_a_turn_on_the_spot_is_as_noisy_whatever_the_heading(name, heading):
    model, literal = MODELS[name]
    odometry = [[1.0, 2.0, heading], [1.0, 2.0, heading + 1.2]]
    normals = np.random.default_rng(5).standard_normal((1, 6))
    n_used = 6 if isinstance(model, MrptMotion) else 3
    drawn = model.sample(np.zeros((1, 3)), odometry, np.random.default_rng(5))[0]
    np.testing.assert_allclose(drawn, literal(np.zeros(3), odometry, normals[0, :n_used]), atol=1e-12)


@pytest.mark.parametrize("odometry", STEPS.values(), ids=STEPS.keys())
def test_mrpt_gaussian_has_the_mean_and_covariance_of_its_source(odometry):
    model = MrptMotion(a1=0.1, a2=0.05, a3=math.degrees(0.07), a4=0.2)
    before, after = np.array(odometry)
    cos, sin = np.cos(before[2]), np.sin(before[2])
    x, y = np.array([[cos, sin], [-sin, cos]]) @ (after - before)[:2]
    phi = wrap_angle(after[2] - before[2]).item()
    position = (0.01 + 0.1 * np.hypot(x, y) + 0.05 * abs(phi)) ** 2
    heading = (np.deg2rad(0.2) + 0.07 * np.hypot(x, y) + 0.2 * abs(phi)) ** 2
    c, s = np.cos(phi / 2), np.sin(phi / 2)
    jacobian = np.array([[c, -s, -s * x - c * y], [s, c, c * x - s * y], [0.0, 0.0, 1.0]])
    covariance = jacobian @ np.diag([position, position, heading]) @ jacobian.T
    step = model.step(np.array(odometry))
    np.testing.assert_allclose(step.mean, [x, y, phi], atol=1e-12)
    np.testing.assert_allclose(step.covariance(), covariance, rtol=1e-10)
    drawn = model.sample(np.zeros((20_000, 3)), odometry, np.random.default_rng(0))
    np.testing.assert_allclose(np.cov(drawn.T), covariance, atol=0.05 * covariance.max())


@pytest.mark.parametrize(
    "make",
    [
        lambda: Nav2Motion("differential_drive"),
        lambda: Nav2Motion(alpha1=-0.1),
        lambda: Ros1Motion(odom_alpha5=float("nan")),
        lambda: BelugaMotion("ackermann"),
        lambda: MrptMotion(minStdXY=-1.0),
        lambda: MrptMotion(alfa1_rot_rot=float("inf")),
        lambda: MrptMotion("mmOther"),
        lambda: F1tenthMotion(motion_dispersion_x=-0.1),
    ],
)
def test_parameters_that_no_program_can_use_are_refused(make):
    with pytest.raises(InvalidInputError):
        make()
