"""What each program takes where its file says nothing, written down a second time.

Compared with sources and documents of nav2, ROS 1's amcl, Beluga and F1TENTH's particle filter; of MRPT only the
numbers of its two models.
"""

from dataclasses import asdict

import pytest

from beamfield.stacks.files.filter_file import read_filter_settings
from beamfield.stacks.files.parameter_file import read_stack_file
from beamfield.stacks.registry import STACKS

NAV2 = {
    "laser_model_type": "likelihood_field", "z_hit": 0.5, "z_short": 0.05, "z_max": 0.05, "z_rand": 0.5,
    "sigma_hit": 0.2, "lambda_short": 0.1, "laser_likelihood_max_dist": 2.0, "laser_max_range": 100.0,
    "laser_min_range": -1.0, "max_beams": 60, "do_beamskip": False, "beam_skip_distance": 0.5,
    "beam_skip_threshold": 0.3, "beam_skip_error_threshold": 0.9,
    "robot_model_type": "nav2_amcl::DifferentialMotionModel", **{f"alpha{i}": 0.2 for i in range(1, 6)},
    "min_particles": 500, "max_particles": 2000, "pf_err": 0.05, "pf_z": 0.99, "resample_interval": 1,
    "update_min_d": 0.25, "update_min_a": 0.2, "recovery_alpha_slow": 0.0, "recovery_alpha_fast": 0.0,
}  # fmt: skip
ROS_1 = {
    "laser_model_type": "likelihood_field", "laser_z_hit": 0.95, "laser_z_short": 0.1, "laser_z_max": 0.05,
    "laser_z_rand": 0.05, "laser_sigma_hit": 0.2, "laser_lambda_short": 0.1, "laser_likelihood_max_dist": 2.0,
    "laser_max_range": -1.0, "laser_min_range": -1.0, "laser_max_beams": 30, "do_beamskip": False,
    "beam_skip_distance": 0.5, "beam_skip_threshold": 0.3, "beam_skip_error_threshold": 0.9,
    "odom_model_type": "diff", **{f"odom_alpha{i}": 0.2 for i in range(1, 6)},
    "min_particles": 100, "max_particles": 5000, "kld_err": 0.01, "kld_z": 0.99, "resample_interval": 2,
    "update_min_d": 0.2, "update_min_a": pytest.approx(0.5235987756), "recovery_alpha_slow": 0.001,
    "recovery_alpha_fast": 0.1, "selective_resampling": False,
}  # fmt: skip
BELUGA = {name: value for name, value in NAV2.items() if "skip" not in name} | {
    "laser_min_range": 0.0, "model_unknown_space": False, "only_obstacle_boundaries": True,
    "robot_model_type": "differential_drive", "spatial_resolution_x": 0.5, "spatial_resolution_y": 0.5,
    "spatial_resolution_theta": pytest.approx(0.1745329252), "selective_resampling": False,
}  # fmt: skip
MRPT = {
    "likelihoodMethod": 4, "LF_stdHit": 0.35, "LF_zHit": 0.95, "LF_zRandom": 0.05, "LF_maxRange": 81.0,
    "LF_decimation": 5, "LF_maxCorrsDistance": 0.3, "LF_useSquareDist": False, "LF_alternateAverageMethod": False,
    "enableLikelihoodCache": True,
}  # fmt: skip
MRPT_RAYS = {
    "likelihoodMethod": 1, "rayTracing_stdHit": 1.0, "rayTracing_decimation": 10, "rayTracing_useDistanceFilter": True,
}  # fmt: skip
F1TENTH = {
    "z_short": 0.01, "z_max": 0.07, "z_rand": 0.12, "z_hit": 0.75, "sigma_hit": 8.0, "squash_factor": 2.2,
    "max_range": 10.0, "angle_step": 18, "theta_discretization": 112, "range_method": "cddt",
    "motion_dispersion_x": 0.05, "motion_dispersion_y": 0.025, "motion_dispersion_theta": 0.25, "max_particles": 4000,
}  # fmt: skip


@pytest.mark.parametrize(("name", "model", "defaults"), [
    ("nav2", "likelihood_field", NAV2), ("ros1", "likelihood_field", ROS_1), ("beluga", "likelihood_field", BELUGA),
    ("f1tenth", "table", F1TENTH),
])  # fmt: skip
def test_a_program_has_its_own_defaults(name, model, defaults):
    stack = STACKS[name]
    found = asdict(stack.start(model)) | asdict(stack.filter.motion()) | asdict(stack.filter.parameters())
    assert found == defaults


@pytest.mark.parametrize(("model", "defaults"), [("LF_Thrun", MRPT), ("rayTracing", MRPT_RAYS)])
def test_mrpts_models_have_the_defaults_of_its_classes(model, defaults):
    assert asdict(STACKS["mrpt"].start(model)) == defaults


def test_belugas_node_for_ros_1_has_the_weights_of_amcl(tmp_path):
    path = tmp_path / "amcl.yaml"
    path.write_text("odom_alpha1: 0.2\nselective_resampling: false\n")
    found = asdict(read_filter_settings(read_stack_file(path, stack="beluga")).sensor)
    names = ("z_hit", "z_short", "z_max", "z_rand", "sigma_hit", "lambda_short", "max_beams")
    assert {name: found[name] for name in names} == {name: ROS_1[f"laser_{name}"] for name in names}
