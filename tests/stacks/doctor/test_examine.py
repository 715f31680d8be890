"""The doctor: every finding with a file that triggers it, and one that does not."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest

from beamfield.errors import FormatError
from beamfield.geometry import compose, wrap_angle
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.sensors import NoReturnPolicy, RangeFinder, SensorLog
from beamfield.stacks.doctor.examine import CHECKS, examine
from beamfield.stacks.doctor.subject import MapFile
from beamfield.stacks.files.calibration_record import record_text, with_record
from beamfield.stacks.files.parameter_file import read_stack_file
from beamfield.stacks.nav2.motion import Nav2Motion
from beamfield.stacks.nav2.parameters import Nav2Parameters
from tests.calibration.test_odometry import amcl_log
from tests.pillar_hall import drive, hall

N_BEAMS = 120
MAX_RANGE = 10.0


def amcl(tmp_path, stack="nav2", **values):
    """Return a parameter file; ROS 1's flat, the others' for ROS 2."""
    if "text" in values:
        path = tmp_path / values.get("name", "params.yaml")
        path.write_text(values["text"])
        return read_stack_file(path, stack=stack)
    path = tmp_path / "params.yaml"
    indent, head = ("  ", "amcl:\n") if stack == "ros1" else ("    ", "amcl:\n  ros__parameters:\n")
    path.write_text(head + "".join(f"{indent}{name}: {value}\n" for name, value in values.items()) + f"{indent}x: 1\n")
    return read_stack_file(path, stack=stack, unknown_model="default")


def mrpt(tmp_path, method=4, **values):
    """Return an ini file of MRPT."""
    path = tmp_path / "params.ini"
    lines = [f"{name} = {value}\n" for name, value in values.items()]
    path.write_text(f"[map_likelihoodOpts]\nlikelihoodMethod = {method}\n" + "".join(lines))
    return read_stack_file(path)


def f1tenth(tmp_path, **values):
    """Return a flat YAML file of F1TENTH."""
    path = tmp_path / "params.yaml"
    lines = [f"{name}: {value}\n" for name, value in {"squash_factor": 2.2, **values}.items()]
    path.write_text("".join(lines))
    return read_stack_file(path)


def room(resolution=0.05, unknown=False):
    """Return 8 x 6 m with walls all round; on request with an unmapped part that nothing separates."""
    rows, cols = round(6.0 / resolution), round(8.0 / resolution)
    cells = np.zeros((rows, cols))
    cells[[0, -1]] = 100
    cells[:, [0, -1]] = 100
    if unknown:
        cells[1:-1, cols // 2 : -1] = -1
    return OccupancyGrid.from_ros(cells, resolution=resolution)


def turned_room():
    return replace(room(), origin=np.array([0.0, 0.0, 0.1]))


def painted_black():
    """Return the room amid six metres of black."""
    return replace(room(), probability=np.pad(room().probability, 120, constant_values=1.0))


MIDDLE = np.tile([4.0, 3.0, 0.0], (10, 1))


def walls():
    """Return (k,) readings in the middle of the room, by hand."""
    bearings = np.linspace(-np.pi, np.pi, N_BEAMS, endpoint=False)
    with np.errstate(divide="ignore"):
        return np.minimum(3.95 / np.abs(np.cos(bearings)), 2.95 / np.abs(np.sin(bearings)))


def wrong_in(n):
    """Return (10, k) readings there, of which those of some scans are of another place."""
    readings = np.tile(walls(), (10, 1))
    readings[:n] = 1.0
    return readings


def scans(fill=3.0, *, n_beams=N_BEAMS, poses=None):
    """Return ten scans of a full circle with one value for all beams, or values given."""
    finder = RangeFinder.from_bearings(np.linspace(-np.pi, np.pi, n_beams, endpoint=False), MAX_RANGE, min_range=0.1)
    ranges = np.broadcast_to(np.asarray(fill, dtype=np.float64), (10, n_beams)).copy()
    nowhere = np.full((10, 3), np.nan)
    return SensorLog(finder, np.arange(10.0), ranges, nowhere if poses is None else poses, nowhere)


def reporting_the_limit(fill):
    """Return scans whose driver reports the longest range where nothing comes back."""
    return replace(scans(fill), no_return=NoReturnPolicy((MAX_RANGE,), origin="given"))


FRAMES = "r1/odom", "r1/base_link", "r1/laser"


def on(topic):
    """Return scans of a topic."""
    log = scans()
    return replace(log, finder=replace(log.finder, name=topic))


def at(start):
    """Return scans with stamps from a time on."""
    log = scans()
    return replace(log, stamps=start + log.stamps)


def some(value, share):
    """Return (k,) readings of which the first share has one value."""
    ranges = np.full(N_BEAMS, 3.0)
    ranges[: round(share * N_BEAMS)] = value
    return ranges


NODE = """<launch>
  <arg name="z"/>
  <node pkg="amcl" type="amcl" name="amcl">
    <param name="laser_z_hit" value="0.95"/>
    <param name="laser_z_rand" value="$(arg z)"/>
    <rosparam file="$(find robot)/amcl.yaml"/>
  </node>
</launch>
"""
WITHOUT = NODE.replace("$(arg z)", "0.05").replace(
    """    <rosparam file="$(find robot)/amcl.yaml"/>
""",
    "",
)
ROBOT = {"stack": "ros1", "name": "amcl.launch"}
AGAIN = WITHOUT.replace("  </node>", '    <param name="laser_z_hit" value="0.9"/>\n  </node>')


RECORDED = with_record(
    "amcl:\n  ros__parameters:\n    sigma_hit: 0.6\n",
    record_text("nav2", "likelihood_field", Nav2Parameters(sigma_hit=0.6), Nav2Motion(), "1.0", "well"), "yaml",
)  # fmt: skip


def alphas(value):
    """Return parameters of a motion model with this noise, at every step of `noisy_drive`."""
    return {**{f"alpha{i}": value for i in range(1, 5)}, "update_min_d": 0.01, "update_min_a": 0.01}


def diff_alphas(value):
    """Return the same for ROS 1's "diff", whose noise grows with the square of the step: steps here are of 0.05 m."""
    noise = {f"odom_{name}" if "alpha" in name else name: each for name, each in alphas(value).items()}
    return {"stack": "ros1", "laser_z_hit": 0.9, **noise}


@cache
def noisy_drive():
    """Return 400 steps whose odometry errs with all alphas 0.03."""
    return amcl_log((0.03,) * 4, 1, n=400)


@cache
def sideways_drive():
    """Return the same drive of a robot whose x axis points to the right of where it goes."""
    log = noisy_drive()
    right = [0.0, 0.0, -np.pi / 2]
    return replace(log, poses=compose(log.poses, right), odometry=compose(log.odometry, right))


@cache
def drive_in_a_circle():
    """Return a drive to the left about a point 0.5 m away; the robot looks where it goes."""
    turn = 0.1 * np.arange(200.0)
    log, poses = noisy_drive(), np.column_stack([0.5 * np.sin(turn), 0.5 * (1.0 - np.cos(turn)), wrap_angle(turn)])
    return replace(log[:200], poses=poses, odometry=poses)


@cache
def turn_on_the_spot():
    """Return turns on the spot, the odometry moving by a millimetre a scan back and forth."""
    log, turn = noisy_drive()[:200], 0.1 * np.arange(200.0)
    jitter = np.random.default_rng(0).normal(0.0, 0.001, (2, 200))
    poses = np.column_stack([*jitter, wrap_angle(turn)])
    return replace(log, poses=poses, odometry=poses)


def made(others):
    """Return map and log, made now: at import, each worker would compile what makes them before its first test."""
    return {name: make() if callable(make) else make for name, make in others.items()}


# name, keywords for the file, map and log that trigger it, and what to change so that they do not.
FINDINGS = {
    "not-finite": ({"z_rand": ".inf"}, {}, {"z_rand": 0.5}, {}),
    "wrong-type": ({"z_rand": 1}, {}, {"z_rand": 1.0}, {}),
    "wrong-type of text": ({"z_rand": "much"}, {}, {"z_rand": 0.5}, {}),
    "wrong-type of count": ({"max_beams": 59.5}, {}, {"max_beams": 59}, {}),
    "out-of-range": ({"sigma_hit": -0.1}, {}, {"sigma_hit": 0.1}, {}),
    "out-of-range of Beluga": (
        {"stack": "beluga", "laser_min_range": -1.0}, {}, {"stack": "beluga", "laser_min_range": 0.0}, {},
    ),
    "filled-in-at-start": ({"text": NODE, **ROBOT}, {}, {"text": WITHOUT, **ROBOT}, {}),
    "filled-in-at-start of YAML": ({"z_rand": "$(var z_rand)"}, {}, {"z_rand": 0.5}, {}),
    "motion-noise-wide": (alphas(0.9), {"log": noisy_drive}, alphas(0.03), {"log": noisy_drive}),
    "motion-noise-wide where the least safe noise is wider": (
        diff_alphas(2.0), {"log": drive_in_a_circle}, diff_alphas(0.5), {"log": drive_in_a_circle}
    ),
    "motion-noise-narrow": (alphas(0.001), {"log": noisy_drive}, alphas(0.03), {"log": noisy_drive}),
    "no-motion-noise": (alphas(0.0), {}, alphas(0.001), {}),
    "moves-sideways": (alphas(0.03), {"log": sideways_drive}, alphas(0.03), {"log": noisy_drive}),
    "moves-sideways along an arc": (alphas(0.03), {"log": sideways_drive}, alphas(0.03), {"log": drive_in_a_circle}),
    "moves-sideways on the spot": (alphas(0.03), {"log": sideways_drive}, alphas(0.03), {"log": turn_on_the_spot}),
    "moves-sideways with the right model": (
        alphas(0.03), {"log": sideways_drive},
        {**alphas(0.03), "robot_model_type": '"nav2_amcl::OmniMotionModel"'}, {"log": sideways_drive},
    ),
    "updates-far-apart": ({"update_min_d": 1.5}, {}, {"update_min_d": 0.9}, {}),
    "updates-far-apart in angle": ({"update_min_a": 1.1}, {}, {"update_min_a": 1.0}, {}),
    "particles-reversed": ({"min_particles": 500, "max_particles": 100}, {},
                           {"min_particles": 100, "max_particles": 500}, {}),
    "few-particles": ({"min_particles": 100, "max_particles": 199}, {},
                      {"min_particles": 100, "max_particles": 200}, {}),
    "few-particles of a sum": (
        {"min_particles": 50, "max_particles": 100}, {},
        {"min_particles": 50, "max_particles": 100, "laser_model_type": "likelihood_field_prob"}, {},
    ),
    "recovery-in-product": (
        {"laser_model_type": "likelihood_field_prob", "recovery_alpha_slow": 0.001, "recovery_alpha_fast": 0.1}, {},
        {"laser_model_type": "likelihood_field", "recovery_alpha_slow": 0.001, "recovery_alpha_fast": 0.1}, {},
    ),
    "recovery-in-product of ROS 1's default": (
        {"stack": "ros1", "laser_model_type": "likelihood_field_prob"}, {},
        {"stack": "ros1", "laser_model_type": "likelihood_field_prob", "recovery_alpha_fast": 0.0}, {},
    ),
    "recovery-reversed": ({"recovery_alpha_slow": 0.1, "recovery_alpha_fast": 0.01}, {},
                          {"recovery_alpha_slow": 0.001, "recovery_alpha_fast": 0.1}, {}),
    "recovery-reversed where both are alike": ({"recovery_alpha_slow": 0.1, "recovery_alpha_fast": 0.1}, {},
                                               {"recovery_alpha_slow": 0.0, "recovery_alpha_fast": 0.0}, {}),
    "frame-not-in-log": ({"base_frame_id": "base_footprint"}, {"frames": FRAMES}, {"base_frame_id": "base_link"},
                         {"frames": FRAMES}),
    "frame-not-in-log of odometry": ({"odom_frame_id": "odom_combined"}, {"frames": FRAMES},
                                     {"odom_frame_id": "<robot_namespace>/odom"}, {"frames": FRAMES}),
    "frame-not-in-log of none": ({"base_frame_id": "base"}, {"frames": FRAMES}, {"base_frame_id": "base"}, {}),
    "other-scan-topic": ({"scan_topic": "scan_filtered"}, {"log": on("/robot1/scan")}, {"scan_topic": "scan"},
                         {"log": on("/robot1/scan")}),
    "other-scan-topic of a text log": ({"scan_topic": "front"}, {"log": on("/scan")}, {"scan_topic": "front"},
                                       {"log": on("FLASER")}),
    "no-broadcast": ({"tf_broadcast": "false"}, {}, {"tf_broadcast": "true"}, {}),
    "simulated-time": ({"use_sim_time": "True"}, {"log": at(1.7e9)}, {"use_sim_time": "True"}, {"log": at(100.0)}),
    "simulated-time off": ({"use_sim_time": "True"}, {"log": at(1.7e9)}, {"use_sim_time": "False"}, {"log": at(1.7e9)}),
    "unknown-name": ({"robot_model_type": '"nav_amcl::DifferentialMotionModel"'}, {},
                     {"robot_model_type": '"nav2_amcl::OmniMotionModel"'}, {}),
    "given-again": ({"text": AGAIN, **ROBOT}, {}, {"text": AGAIN.replace('"0.9"', '"0.95"'), **ROBOT}, {}),
    "given-again in YAML": ({"text": "z_hit: 0.4\nz_hit: 0.5\n"}, {}, {"text": "z_hit: 0.5\nz_hit: 0.5\n"}, {}),
    "old-motion-name": ({"robot_model_type": '"differential"'}, {},
                        {"robot_model_type": '"nav2_amcl::DifferentialMotionModel"'}, {}),
    "loaded-elsewhere": ({"text": NODE, **ROBOT}, {}, {"text": WITHOUT, **ROBOT}, {}),
    "no-ros-parameters-key": ({"text": "amcl:\n  z_hit: 0.5\n"}, {}, {"z_hit": 0.5}, {}),
    "wrong-type of a list": ({"z_hit": "[0.5]"}, {}, {"z_hit": 0.5}, {}),
    "wrong-type of a switch": ({"do_beamskip": "maybe"}, {}, {"do_beamskip": "yes"}, {}),
    "wrong-type of a switch in ROS 1": ({"stack": "ros1", "do_beamskip": 1}, {},
                                        {"stack": "ros1", "do_beamskip": "true"}, {}),
    "wrong-type in YAML 1.1": ({"stack": "ros1", "laser_z_hit": "1e-1"}, {},
                               {"stack": "ros1", "laser_z_hit": "1.0e-1"}, {}),
    "wrong-type in a launch file": ({"text": WITHOUT.replace("0.95", "95e-2"), **ROBOT}, {},
                                    {"text": WITHOUT.replace("0.95", "9.5e-1"), **ROBOT}, {}),
    "wrong-type in YAML 1.1 only in ROS 1": ({"stack": "ros1", "laser_z_hit": "5e-1"}, {}, {"z_hit": "5e-1"}, {}),
    "wrong-type of grouped digits": ({"max_particles": "2_000"}, {}, {"max_particles": "2000"}, {}),
    "wrong-type of grouped digits only in ROS 2": ({"max_beams": "6_0"}, {},
                                                   {"stack": "ros1", "laser_max_beams": "6_0"}, {}),
    "wrong-type of octal digits": ({"max_beams": "0o74"}, {}, {"max_beams": "0x3c"}, {}),
    "out-of-range of size": ({"sigma_hit": "1.0e-300"}, {}, {"sigma_hit": "1.0e-2"}, {}),
    "out-of-range of beams": ({"max_beams": 1}, {}, {"max_beams": 2}, {}),
    "out-of-range of digits": ({"max_beams": "9" * 400}, {}, {"max_beams": 9999999}, {}),
    "foreign-name": ({"laser_z_hit": 0.5}, {}, {"z_hit": 0.5}, {}),
    "foreign-name in ROS 1": ({"stack": "ros1", "z_hit": 0.5}, {}, {"stack": "ros1", "laser_z_hit": 0.5}, {}),
    "foreign-name of Beluga": ({"model_unknown_space": "true"}, {},
                               {"stack": "beluga", "model_unknown_space": "true"}, {}),
    "foreign-name of motion": ({"odom_alpha1": 0.05}, {}, {"alpha1": 0.05}, {}),
    "foreign-name of motion in ROS 1": ({"stack": "ros1", "laser_z_hit": 0.9, "alpha1": 0.05}, {},
                                        {"stack": "ros1", "laser_z_hit": 0.9, "odom_alpha1": 0.05}, {}),
    "foreign-name of particles": ({"kld_err": 0.01}, {}, {"pf_err": 0.01}, {}),
    "out-of-range of motion": ({"alpha1": -0.2}, {}, {"alpha1": 0.2}, {}),
    "wrong-type of particles": ({"max_particles": "many"}, {}, {"max_particles": 500}, {}),
    "misspelt-name": ({"simga_hit": 0.5}, {}, {"odom_frame_id": "odom"}, {}),
    "misspelt-name of few letters": ({"z_rnad": 0.5}, {}, {"z_rand": 0.5}, {}),
    "misspelt-name in other letters": ({"Z_Rand": 0.5}, {}, {"z_rand": 0.5}, {}),
    "weights-sum": ({"z_hit": 0.5, "z_rand": 0.6}, {}, {"z_hit": 0.5, "z_rand": 0.5}, {}),
    "weights-sum of the beam model": ({"laser_model_type": "beam"}, {},
                                      {"laser_model_type": "beam", "z_hit": 0.4}, {}),
    "unused-parameters": ({"z_short": 0.1}, {}, {"z_short": 0.05, "z_hit": 0.4, "laser_model_type": "beam"}, {}),
    "unused-parameters of beam skipping": (
        {"do_beamskip": "true"}, {}, {"do_beamskip": "true", "laser_model_type": "likelihood_field_prob"}, {}
    ),
    "unused-parameters of beam skipping that is on": ({"do_beamskip": "true"}, {}, {"do_beamskip": "false"}, {}),
    "no-random-readings": ({"z_rand": 0.0, "z_hit": 1.0, "laser_model_type": "likelihood_field_prob"}, {},
                           {"z_rand": 0.0, "z_hit": 1.0}, {}),
    "value-above-one": ({"z_hit": 1.2}, {}, {"z_hit": 1.0, "z_rand": 0.2}, {}),
    "value-above-one of the beam model": ({"laser_model_type": "beam", "z_hit": 0.95, "z_max": 0.1}, {},
                                          {"laser_model_type": "beam", "z_hit": 0.95, "z_max": 0.05}, {}),
    "all-weights-zero": ({"z_rand": 0.0, "z_hit": 0.0, "laser_model_type": "likelihood_field_prob"}, {},
                         {"z_rand": 0.0, "z_hit": 0.1, "laser_model_type": "likelihood_field_prob"}, {}),
    "sigma-below-resolution": ({"sigma_hit": 0.02}, {"grid": room(0.05)}, {"sigma_hit": 0.02}, {"grid": room(0.04)}),
    "sigma-huge": ({"sigma_hit": 1.0}, {}, {"sigma_hit": 0.4}, {}),
    "distance-limit": ({"sigma_hit": 0.4, "laser_likelihood_max_dist": 0.9}, {},
                       {"sigma_hit": 0.4, "laser_likelihood_max_dist": 1.0}, {}),
    "map-disagrees": ({}, {"grid": room(), "log": scans(1.0, poses=MIDDLE)},
                      {}, {"grid": room(), "log": scans(walls(), poses=MIDDLE)}),
    "map-disagrees-in-part": ({}, {"grid": room(), "log": scans(wrong_in(3), poses=MIDDLE)},
                              {}, {"grid": room(), "log": scans(wrong_in(2), poses=MIDDLE)}),
    "map-out-of-date": ({}, {"grid": hall, "log": partial(drive, hall(), 30)},
                        {}, {"grid": hall, "log": partial(drive, hall(), 22)}),
    "nearly-flat": ({}, {}, {"laser_model_type": "likelihood_field_prob"}, {}),
    "absurdly-sharp": ({"laser_model_type": "likelihood_field_prob", "sigma_hit": 0.05, "z_hit": 0.99, "z_rand": 0.01},
                       {}, {"laser_model_type": "likelihood_field_prob", "max_beams": 10, "z_rand": 5.0}, {}),
    "max-beams-above-scan": ({"laser_model_type": "beam", "max_beams": 121}, {"log": scans()},
                             {"laser_model_type": "beam", "max_beams": 120}, {"log": scans()}),
    "max-beams-above-scan in ROS 1": ({"stack": "ros1", "laser_model_type": "beam", "laser_max_beams": 121},
                                      {"log": scans()}, {"stack": "ros1", "laser_max_beams": 121}, {"log": scans()}),
    "max-beams-above-scan of the beam model only": ({"laser_model_type": "beam", "max_beams": 121}, {"log": scans()},
                                                    {"max_beams": 121}, {"log": scans()}),
    "max-beams-above-scan not in Beluga": (
        {"laser_model_type": "beam", "max_beams": 121}, {"log": scans()},
        {"stack": "beluga", "laser_model_type": "beam", "max_beams": 121}, {"log": scans()}
    ),
    "nan-readings": ({"stack": "ros1", "laser_model_type": "beam"}, {"log": scans(some(np.nan, 0.1))},
                     {"stack": "ros1", "laser_model_type": "beam"}, {"log": scans(some(np.inf, 0.1))}),
    "nan-readings in ROS 1 only": ({"stack": "ros1", "laser_model_type": "beam"}, {"log": scans(some(np.nan, 0.1))},
                                   {"laser_model_type": "beam"}, {"log": scans(some(np.nan, 0.1))}),
    "nan-readings of the beam model only": (
        {"stack": "ros1", "laser_model_type": "beam"}, {"log": scans(some(np.nan, 0.1))},
        {"stack": "ros1", "laser_model_type": "likelihood_field"}, {"log": scans(some(np.nan, 0.1))}
    ),
    "unknown-model": ({"laser_model_type": "likelihood_feild"}, {}, {"laser_model_type": "likelihood_field"}, {}),
    "unknown-model in ROS 1": ({"stack": "ros1", "laser_model_type": "likelihood"}, {},
                               {"stack": "ros1", "laser_model_type": "beam"}, {}),
    "unknown-model in Beluga": ({"stack": "beluga", "laser_model_type": "laser"}, {}, {"stack": "beluga"}, {}),
    "range-limit-short": ({"laser_max_range": 1.0}, {}, {"laser_max_range": 1.0}, {"log": scans(0.5)}),
    "range-limit-short by its number": ({"laser_max_range": 2.9}, {}, {"laser_max_range": 3.0}, {}),
    "range-limit-short unless switched off": ({"laser_max_range": 2.9}, {}, {"laser_max_range": -1.0}, {}),
    "distance-queue-uninitialised": ({}, {}, {"stack": "ros1", "laser_z_hit": 0.5}, {}),
    "distance-queue-uninitialised in fields only": ({"laser_model_type": "likelihood_field_prob"}, {},
                                                    {"laser_model_type": "beam"}, {}),
    "max-beams-rounded": ({"max_beams": 70}, {"log": scans()}, {"max_beams": 100}, {"log": scans(n_beams=1001)}),
    "few-usable-beams": ({"max_beams": 60}, {"log": scans(some(np.inf, 0.9))},
                         {"max_beams": 60}, {"log": scans(some(np.inf, 0.4))}),
    "few-usable-beams by NaN in Beluga": ({"stack": "beluga", "max_beams": 30}, {"log": scans(some(np.nan, 0.7))},
                                          {"stack": "beluga", "max_beams": 90}, {"log": scans(some(np.nan, 0.7))}),
    "few-usable-beams in a product": ({"laser_model_type": "likelihood_field_prob", "max_beams": 5}, {"log": scans()},
                                      {"laser_model_type": "likelihood_field_prob", "max_beams": 9}, {"log": scans()}),
    "few-usable-beams in a sum": ({"max_beams": 9}, {"log": scans()}, {"max_beams": 30}, {"log": scans()}),
    "many-beams-in-product": ({"laser_model_type": "likelihood_field_prob", "max_beams": 60}, {},
                              {"laser_model_type": "likelihood_field_prob", "max_beams": 12}, {}),
    "range-limit-above-sensor": ({"stack": "beluga", "laser_max_range": 100.0}, {"log": scans()},
                                 {"stack": "beluga", "laser_max_range": 10.0}, {"log": scans()}),
    "range-limit-above-sensor not in nav2": ({"stack": "beluga"}, {"log": scans()}, {}, {"log": scans()}),
    "range-limit-hides-readings": ({"laser_max_range": 5.0}, {"log": scans(some(6.0, 0.1))},
                                   {"laser_max_range": 5.0}, {"log": scans(some(6.0, 0.01))}),
    "min-range-hides-readings": ({"laser_min_range": 0.5}, {"log": scans(some(0.4, 0.1))},
                                 {"laser_min_range": 0.3}, {"log": scans(some(0.4, 0.1))}),
    "z-max-unreachable of Beluga": ({"stack": "beluga", "laser_model_type": "beam"}, {"log": scans(some(np.inf, 0.1))},
                                    {"stack": "beluga", "laser_model_type": "beam", "laser_max_range": 10.0},
                                    {"log": reporting_the_limit(some(np.inf, 0.1))}),
    "z-max-unreachable behind laser_max_range": (
        {"laser_model_type": "beam", "laser_max_range": 8.0}, {"log": reporting_the_limit(some(np.inf, 0.1))},
        {"laser_model_type": "beam", "laser_max_range": 12.0}, {"log": reporting_the_limit(some(np.inf, 0.1))}),
    "many-beams-in-product of MRPT": (
        {"stack": "mrpt", "name": "p.ini", "text": "[a_likelihoodOpts]\nLF_decimation = 2\n"}, {"log": scans()},
        {"stack": "mrpt", "name": "p.ini", "text": "[a_likelihoodOpts]\nLF_decimation = 5\n"}, {"log": scans()}),
    "z-max-unreachable": ({"laser_model_type": "beam"}, {"log": scans(some(np.inf, 0.1))},
                          {"laser_model_type": "beam"}, {"log": scans()}),
    "no-obstacles": ({}, {"grid": OccupancyGrid.from_ros(np.zeros((9, 9)), resolution=0.1)}, {}, {"grid": room()}),
    "map-yaw-ignored": ({}, {"grid": turned_room()}, {"stack": "beluga"}, {"grid": turned_room()}),
    "half-cell-shift": ({}, {"grid": room()}, {"stack": "beluga"}, {"grid": room()}),
    "map-painted-black": ({}, {"grid": painted_black}, {}, {"grid": room()}),
    "map-painted-black in fields only": ({"stack": "ros1", "laser_z_hit": 0.9}, {"grid": painted_black},
                                         {"laser_model_type": "beam"}, {"grid": painted_black}),
    "map-painted-black unless only surfaces count": (
        {"stack": "beluga", "only_obstacle_boundaries": "false"}, {"grid": painted_black},
        {"stack": "beluga"}, {"grid": painted_black}),
    "unknown-stops-rays": ({"laser_model_type": "beam"}, {"grid": room(unknown=True)},
                           {"laser_model_type": "beam"}, {"grid": room()}),
    "unknown-attracts": ({"stack": "beluga", "model_unknown_space": "true"}, {"grid": room(unknown=True)},
                         {"stack": "beluga"}, {"grid": room(unknown=True)}),
    "unknown-is-free": ({}, {"grid": room(unknown=True)}, {}, {"grid": room()}),
    "unknown-read-as-free": ({}, {"grid": room(), "map_file": MapFile("m.yaml", notes=("all grey",))},
                             {}, {"grid": room(), "map_file": MapFile("m.yaml")}),
    "map-mode-loses-cells": (
        {}, {"grid": OccupancyGrid(np.full((9, 9), 0.7, np.float32), 0.1), "map_file": MapFile("m.yaml", "raw")},
        {}, {"grid": OccupancyGrid(np.full((9, 9), 0.7, np.float32), 0.1), "map_file": MapFile("m.yaml")}),
    "thresholds-lose-cells": ({}, {"grid": room(), "map_file": MapFile("m.yaml", between_share=0.1)},
                              {}, {"grid": room(), "map_file": MapFile("m.yaml", between_share=0.01)}),
    "calibrated": ({"text": RECORDED}, {}, {"text": RECORDED.replace("0.6", "0.7")}, {}),
}  # fmt: skip


# The same for other files: who writes them, their values and what else there is.
OTHERS = {
    "foreign-name in MRPT": (mrpt, {"z_hit": 0.5}, {}, {"LF_zHit": 0.5, "rayTracing_stdHit": 0.5}, {}),
    "foreign-name in F1TENTH": (f1tenth, {"max_beams": 60}, {}, {"angle_step": 18}, {}),
    "weights-sum in MRPT": (mrpt, {"LF_zHit": 0.9, "LF_zRandom": 0.2}, {}, {"LF_zHit": 0.9, "LF_zRandom": 0.1}, {}),
    "weights-sum in F1TENTH": (f1tenth, {}, {}, {"z_hit": 0.8}, {}),
    "unused-parameters of another MRPT model": (mrpt, {"rayTracing_stdHit": 0.3}, {}, {"LF_stdHit": 0.3}, {}),
    "unused-parameters of rayTracing": (mrpt, {"method": 1, "LF_stdHit": 0.3}, {},
                                        {"method": "lmRayTracing", "rayTracing_stdHit": 0.3}, {}),
    "unused-parameters of F1TENTH": (f1tenth, {"range_method": "rm", "theta_discretization": 112}, {},
                                     {"range_method": "glt", "theta_discretization": 112}, {}),
    "out-of-range in MRPT": (mrpt, {"LF_stdHit": 0.0}, {}, {"LF_stdHit": 0.1}, {}),
    "unknown-name in F1TENTH": (f1tenth, {"range_method": "sphere"}, {}, {"range_method": "cddt"}, {}),
    "misspelt-name in MRPT": (mrpt, {"LF_maxCorrDistance": 0.3}, {}, {"LF_maxCorrsDistance": 0.3}, {}),
    "distance-limit in MRPT": (mrpt, {}, {}, {"LF_maxCorrsDistance": 1.0}, {}),
    "no-random-readings in MRPT": (mrpt, {"LF_zRandom": 0.0}, {}, {"LF_zRandom": 0.05}, {}),
    "sigma-below-resolution in F1TENTH": (f1tenth, {"sigma_hit": 0.4}, {"grid": room()}, {"sigma_hit": 0.6},
                                          {"grid": room()}),
    "sigma-huge in F1TENTH": (f1tenth, {"sigma_hit": 8.0}, {"grid": room(0.1)}, {"sigma_hit": 8.0},
                              {"grid": room(0.05)}),
    "nearly-flat in MRPT": (mrpt, {"method": 1}, {}, {"method": 1, "rayTracing_stdHit": 0.3}, {}),
    "nearly-flat in F1TENTH": (f1tenth, {"squash_factor": 900.0}, {}, {}, {}),
    "absurdly-sharp in F1TENTH": (f1tenth, {"squash_factor": 1.0, "sigma_hit": 1.0, "angle_step": 1}, {"log": scans()},
                                  {"angle_step": 18}, {"log": scans()}),
    "range-limit-above-sensor in MRPT": (mrpt, {}, {"log": scans()}, {"LF_maxRange": 10.0}, {"log": scans()}),
    "range-limit-hides-readings in F1TENTH": (f1tenth, {"max_range": 5.0}, {"log": scans(some(6.0, 0.1))},
                                              {"max_range": 7.0}, {"log": scans(some(6.0, 0.1))}),
    "unknown-is-free in F1TENTH": (f1tenth, {}, {"grid": room(unknown=True)}, {}, {"grid": room()}),
    "unknown-ends-rays in MRPT": (mrpt, {"method": 1}, {"grid": room(unknown=True)}, {}, {"grid": room(unknown=True)}),
    "map-yaw-ignored in MRPT": (mrpt, {}, {"grid": turned_room()}, {}, {"grid": room()}),
}  # fmt: skip


@pytest.mark.parametrize("case", OTHERS)
def test_a_finding_in_files_of_mrpt_and_f1tenth(tmp_path, case):
    name = case.split()[0]
    write, sick, with_sick, well, with_well = OTHERS[case]
    found = [item for item in examine(write(tmp_path, **sick), **with_sick) if item.name == name]
    assert len(found) == 1
    assert all((found[0].text, found[0].why, found[0].do))
    assert name not in [item.name for item in examine(write(tmp_path, **well), **with_well)]


def test_what_is_only_for_other_stacks_is_not_said_of_mrpt_and_f1tenth(tmp_path):
    """MRPT's LF_maxRange drops no reading; F1TENTH's common factor changes nothing."""
    far = examine(mrpt(tmp_path, LF_maxRange=5.0), log=scans(some(6.0, 0.5)))
    assert "range-limit-hides-readings" not in [item.name for item in far]
    sums = next(item for item in examine(f1tenth(tmp_path)) if item.name == "weights-sum")
    assert (sums.severity, sums.values["total"]) == ("info", pytest.approx(0.95))


def test_sharpness_counts_the_beams_that_a_step_leaves(tmp_path):
    def effective(step):
        found = {item.name: item for item in examine(f1tenth(tmp_path, angle_step=step, sigma_hit=1.0), log=scans())}
        return found["absurdly-sharp"].values["effective_sample_size"] if "absurdly-sharp" in found else np.inf

    assert effective(1) < effective(30)


# Numbers that a finding says and that follow from the case.
SAID = {
    "half-cell-shift": ("sees every wall 0.025 m too low", "with 0.025 m added"),
    "map-yaw-ignored": ("a yaw of 5.73 degrees",),
    "range-limit-above-sensor": ("score 10.0 times too little",),
}


@pytest.mark.parametrize("case", SAID)
def test_a_finding_says_its_numbers(tmp_path, case):
    sick, others, _, _ = FINDINGS[case]
    (found,) = [item for item in examine(amcl(tmp_path, **sick), **made(others)) if item.name == case]
    for words in SAID[case]:
        assert words in f"{found.text} {found.why} {found.do}"


@pytest.mark.parametrize("case", FINDINGS)
def test_a_finding_comes_where_it_is_due_and_not_elsewhere(tmp_path, case):
    name = case.split()[0]
    sick, with_sick, well, with_well = FINDINGS[case]
    found = [item for item in examine(amcl(tmp_path, **sick), **made(with_sick)) if item.name == name]
    assert len(found) == 1
    assert all((found[0].text, found[0].why, found[0].do))
    assert name not in [item.name for item in examine(amcl(tmp_path, **well), **made(with_well))]


def test_every_check_has_a_test(tmp_path):
    """Run each check on all the cases that trigger something: none may stay silent."""
    silent = set(CHECKS)
    for sick, others, _, _ in FINDINGS.values():
        from beamfield.stacks.doctor.subject import Subject
        from beamfield.stacks.files.typed_values import typed_values

        file = amcl(tmp_path, **sick)
        subject = Subject(file, typed_values(file), **made(others))
        silent -= {check for check in silent if list(check(subject))}
    assert not silent


def test_a_misspelt_model_is_named_with_the_right_one_and_examined_as_the_program_runs_it(tmp_path):
    wrong = {"laser_model_type": "likelihood_feild_prob", "sigma_hit": 1.0}
    found = examine(amcl(tmp_path, **wrong))
    unknown = found[0]
    assert (unknown.name, unknown.severity, unknown.parameter, unknown.line) == (
        "unknown-model", "error", "laser_model_type", 3,
    )  # fmt: skip
    assert "laser_model_type is 'likelihood_feild_prob'" in unknown.text
    assert "nav2 runs likelihood_field instead, without a message" in unknown.why
    assert unknown.do == "write likelihood_field_prob"
    assert {"sigma-huge", "nearly-flat"} <= {item.name for item in found}
    assert "logs a warning" in texts(examine(amcl(tmp_path, stack="ros1", **wrong)), "unknown-model")
    assert "stops" in texts(examine(amcl(tmp_path, stack="beluga", **wrong)), "unknown-model")
    far = texts(examine(amcl(tmp_path, laser_model_type="xyz")), "unknown-model")
    assert far.endswith("write one of likelihood_field, likelihood_field_prob, beam")


def test_whoever_writes_values_still_refuses_a_misspelt_model(tmp_path):
    path = tmp_path / "params.yaml"
    path.write_text("amcl:\n  ros__parameters:\n    laser_model_type: likelihood_feild\n")
    with pytest.raises(FormatError, match="no model of nav2 that beamfield knows"):
        read_stack_file(path, stack="nav2")


def texts(found, name):
    return next(f"{item.text} {item.why} {item.do}" for item in found if item.name == name)


def test_what_a_sum_other_than_one_does_depends_on_the_model(tmp_path):
    """In 1 + a sum of cubes a factor of 1.1 counts 1.331 times; in products and bare sums of cubes it cancels."""
    values = {"z_hit": 0.5, "z_rand": 0.6}
    assert "count 1.3 times as much against that 1" in texts(examine(amcl(tmp_path, **values)), "weights-sum")
    for more in ({"laser_model_type": "likelihood_field_prob"}, {"laser_model_type": "beam", "stack": "beluga"}):
        found = examine(amcl(tmp_path, **values, **more))
        assert "all poses' weights alike" in texts(found, "weights-sum")
        assert next(item for item in found if item.name == "weights-sum").severity == "info"


def test_defaults_do_not_stand_in_for_values_that_are_wrong(tmp_path):
    """With nav2's default of 0.5 for z_rand the sum would be 1.4."""
    assert "weights-sum" not in [item.name for item in examine(amcl(tmp_path, z_hit=0.9, z_rand=".nan"))]
    assert "sigma-below-resolution" not in [
        item.name for item in examine(amcl(tmp_path, sigma_hit="wide"), grid=room(0.5))
    ]


def test_weights_that_are_nan_by_a_reading_are_not_put_down_to_values(tmp_path):
    ranges = np.where(np.arange(N_BEAMS) < 12, np.nan, walls())
    log = scans(ranges, poses=MIDDLE)
    found = examine(amcl(tmp_path, "ros1", laser_model_type="beam"), grid=room(), log=log)
    assert [item.name for item in found if item.severity == "error"] == ["nan-readings"]


def test_a_range_limit_that_hides_readings_comes_before_the_few_beams_that_it_leaves(tmp_path):
    names = [
        item.name for item in examine(amcl(tmp_path, laser_max_range=2.0, max_beams=30), log=scans(some(1.0, 0.1)))
    ]
    assert names.index("range-limit-hides-readings") < names.index("few-usable-beams")


@pytest.mark.parametrize(("noise", "severity"), [(0.4, "info"), (0.9, "warning")])
def test_motion_noise_that_is_wider_than_the_way_is_a_warning(tmp_path, noise: float, severity: str):
    found = examine(amcl(tmp_path, **alphas(noise)), log=noisy_drive())
    assert [one.severity for one in found if one.name == "motion-noise-wide"] == [severity]


def test_what_makes_the_weights_flat_comes_before_the_flat_weights(tmp_path):
    found = examine(amcl(tmp_path, laser_max_range=0.5, max_beams=30), grid=room(), log=scans(poses=MIDDLE))
    names = [item.name for item in found if item.severity == "warning"]
    assert names.index("range-limit-hides-readings") < names.index("nearly-flat")


def test_an_infinite_longest_range_is_the_sensors_own_in_amcl_only(tmp_path):
    severities = {
        stack: next(
            f.severity for f in examine(amcl(tmp_path, stack, laser_max_range=".inf")) if f.name == "not-finite"
        )
        for stack in ("nav2", "ros1", "beluga")
    }
    assert severities == {"nav2": "info", "ros1": "info", "beluga": "error"}


def test_parameters_of_beam_skipping_in_belugas_file_are_one_finding(tmp_path):
    skipping = {"do_beamskip": "false", "beam_skip_distance": 0.5, "beam_skip_threshold": 0.3}
    found = [item for item in examine(amcl(tmp_path, "beluga", **skipping)) if item.name == "foreign-name"]
    assert [item.severity for item in found] == ["info"]
    assert found[0].text.startswith("do_beamskip, beam_skip_distance, beam_skip_threshold are parameters of nav2")
    skipping["do_beamskip"] = "true"
    found = [item for item in examine(amcl(tmp_path, "beluga", **skipping)) if item.name == "foreign-name"]
    assert [item.severity for item in found] == ["warning"]


def test_advice_on_names_fits_the_stacks(tmp_path):
    assert "call it z_hit (values mean the same" in texts(examine(amcl(tmp_path, laser_z_hit=0.5)), "foreign-name")
    assert "call it z_hit if meant for beluga; if meant for ros1: beamfield translate" in texts(
        examine(amcl(tmp_path, "beluga", laser_z_hit=0.5)), "foreign-name"
    )
    both = texts(examine(amcl(tmp_path, laser_z_hit=0.5, z_hit=0.5)), "foreign-name")
    assert "default" not in both
    # As where a file for ROS 1 was put into one for nav2.
    ported = examine(amcl(tmp_path, laser_z_hit=0.5, laser_z_rand=0.5, laser_sigma_hit=0.1, z_rand=0.5))
    assert [item.name for item in ported].count("foreign-name") == 1
    assert "uses defaults for z_hit, sigma_hit call them z_hit, z_rand, sigma_hit (values" in texts(
        ported, "foreign-name"
    )


def test_names_of_another_motion_model_come_with_what_runs_instead(tmp_path):
    found = texts(examine(amcl(tmp_path, odom_alpha1=0.05, odom_alpha2=0.05, alpha2=0.1)), "foreign-name")
    assert found.startswith(
        "odom_alpha1, odom_alpha2 are no parameters of nav2 it silently ignores them and takes the default of alpha1 "
        "call them alpha1, alpha2;"
    )


def test_belugas_node_for_ros_1_is_known_by_its_own_names(tmp_path):
    text = "odom_alpha1: 0.1\nlaser_z_hit: 1\nlaser_z_rand: 0.0\nlaser_sigma_hit: -0.1\nexecution_policy: seq\n"
    file = amcl(tmp_path, None, text=f"{text}laser_z_hti: 0.5\n")
    assert file.stack == "beluga"
    found = {item.name: item for item in examine(file)}
    # ROS 1 takes integers for doubles, reads no ros__parameters, and has these names.
    assert found.keys() & {"wrong-type", "no-ros-parameters-key", "foreign-name"} == set()
    assert (found["out-of-range"].parameter, found["out-of-range"].line) == ("laser_sigma_hit", 4)


def test_the_worst_comes_first_with_its_line(tmp_path):
    found = examine(amcl(tmp_path, z_short=0.1, z_rand=".nan", laser_z_hit=0.4))
    assert [item.severity for item in found] == sorted(
        [item.severity for item in found], key=["error", "warning", "info"].index
    )
    assert (found[0].name, found[0].parameter, found[0].line) == ("not-finite", "z_rand", 4)
    assert {item.line for item in found if item.name == "foreign-name"} == {5}
    assert {item.line for item in examine(amcl(tmp_path, text=NODE, **ROBOT)) if item.name == "loaded-elsewhere"} == {6}


def test_a_file_says_which_others_its_node_takes_parameters_from(tmp_path):
    (note,) = amcl(tmp_path, text=NODE, **ROBOT).unread
    assert note.endswith(
        "amcl.launch:6: the node also takes parameters from $(find robot)/amcl.yaml, which is not read here"
    )
    assert amcl(tmp_path, text=WITHOUT, **ROBOT).unread == ()


def test_parameters_keep_the_names_of_their_stack(tmp_path):
    found = examine(amcl(tmp_path, stack="ros1", laser_z_hit=0.5))
    sums = next(item for item in found if item.name == "weights-sum")
    assert sums.parameter == "laser_z_hit"
    assert sums.text == "the weights that likelihood_field uses sum to 0.55: laser_z_hit 0.5 + laser_z_rand 0.05"


def test_sharpness_is_measured_on_the_log_if_there_are_poses(tmp_path):
    grid = room()
    file = amcl(tmp_path, laser_model_type="likelihood_field_prob", sigma_hit=0.05, z_hit=0.99, z_rand=0.01)
    log = scans(walls(), poses=MIDDLE)
    found = {item.name: item for item in examine(file, grid=grid, log=log)}
    assert "in the log" in found["absurdly-sharp"].text
    without = {item.name: item for item in examine(file, grid=grid, log=replace(log, poses=np.full((10, 3), np.nan)))}
    assert "in a plain room" in without["absurdly-sharp"].text


def test_an_integer_for_a_double_does_not_hide_what_else_is_wrong(tmp_path):
    found = [item.name for item in examine(amcl(tmp_path, z_hit=1, z_rand=0.5))]
    assert "wrong-type" in found
    assert "nearly-flat" in found
    assert texts(examine(amcl(tmp_path, z_hit=1, z_rand=0.5)), "weights-sum").startswith("the weights that")
    assert "out-of-range" in [item.name for item in examine(amcl(tmp_path, sigma_hit=0))]


@pytest.mark.parametrize("stack", ["nav2", "beluga", "ros1"])
def test_wrong_types_of_parameters_that_no_model_uses_are_errors_where_the_node_refuses_them(tmp_path, stack):
    wrong = "z_hit: 0.5\ntransform_tolerance: 1\ntf_broadcast: 1\nscan_topic: 5\ninitial_pose: {x: 0, y: 0.5}\n"
    lines = [f"    {line}\n" for line in wrong.splitlines()]
    text = "".join(["amcl:\n  ros__parameters:\n", *lines, "    initial_pose.yaw: 0\n    set_initial_pose: yes\n"])
    found = examine(amcl(tmp_path, stack, text=text.replace("z_hit", "laser_z_hit") if stack == "ros1" else text))
    seen = {item.parameter: (item.line, item.do) for item in found if item.name == "wrong-type"}
    typed = "write a value of the right type"
    assert seen == ({} if stack == "ros1" else {
        "transform_tolerance": (4, "write 1.0"), "tf_broadcast": (5, typed), "scan_topic": (6, typed),
        "initial_pose.x": (7, "write 0.0"), "initial_pose.yaw": (8, "write 0.0"),
    })  # fmt: skip


@pytest.mark.parametrize(
    ("name", "value", "bounds"),
    [("laser_min_range", -1.0, "0 or more"), ("z_hit", 1.2, "0 to 1"), ("update_min_a", 7.0, "0 to 6.283")],
)
def test_what_beluga_refuses_is_an_error_there_alone(tmp_path, name, value, bounds):
    refused = {
        stack: [item.text for item in examine(amcl(tmp_path, stack, **{name: value})) if item.name == "out-of-range"]
        for stack in ("beluga", "nav2")
    }
    assert refused == {"beluga": [f"{name} is {value:g}, and Beluga takes {bounds}"], "nav2": []}
    ros_1 = amcl(tmp_path, None, text="laser_z_hit: 0.5\nexecution_policy: seq\nlaser_min_range: -1.0\n")
    assert (ros_1.stack, ros_1.is_typed) == ("beluga", False)
    assert "out-of-range" not in [item.name for item in examine(ros_1)]


def test_the_mean_of_mrpts_average_method_forbids_nothing(tmp_path):
    text = "[a_likelihoodOpts]\nLF_zRandom = 0\nLF_alternateAverageMethod = {}\n"
    names = {
        switch: [f.name for f in examine(amcl(tmp_path, "mrpt", name="p.ini", text=text.format(switch)))]
        for switch in (0, 1)
    }
    assert "no-random-readings" in names[0]
    assert "no-random-readings" not in names[1]


def test_calibrated_values_are_not_advised_to_be_calibrated(tmp_path):
    names = {item.name for item in examine(amcl(tmp_path, text=RECORDED))}
    assert names & {"sigma-huge", "nearly-flat"} == set()
    # Anything changed voids the record, even where the model never reads it.
    for changed in ("z_short: 0.06", "alpha1: 0.5", "alpha1: 1"):
        edited = {item.name for item in examine(amcl(tmp_path, text=f"{RECORDED}    {changed}\n"))}
        assert {"sigma-huge", "nearly-flat"} <= edited
        assert "calibrated" not in edited


def test_what_a_map_for_amcl_alone_undoes_is_no_problem_of_the_file_that_was_chosen_for_it(tmp_path):
    chosen = amcl(tmp_path, text=RECORDED.rstrip() + "; chosen for the map amcl_map.yaml\n")
    found = {item.name: item for item in examine(chosen, grid=painted_black())}
    assert "half-cell-shift" not in found
    assert found["map-painted-black"].severity == "info"
    assert "nothing where amcl takes amcl_map.yaml" in found["map-painted-black"].do
    # What beamfield noted last counts.
    again = amcl(tmp_path, text=f"{RECORDED}# chosen for the map amcl_map.yaml\n# chosen for the map as it is\n")
    found = {item.name: item for item in examine(again, grid=painted_black())}
    assert found["map-painted-black"].severity == "warning"
    assert "half-cell-shift" in found


def test_a_scan_that_says_nothing_at_all_is_a_warning(tmp_path):
    severities = {
        sigma: next(item.severity for item in examine(amcl(tmp_path, sigma_hit=sigma)) if item.name == "nearly-flat")
        for sigma in (0.2, 5.0)
    }
    assert severities == {0.2: "info", 5.0: "warning"}
