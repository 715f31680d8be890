"""``beamfield calibrate --odometry-noise`` as a user runs it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from beamfield.cli.main import main
from tests.cli.simulated import on_map, simulated

pytestmark = pytest.mark.usefixtures("short_stack_fit", "without_figures")


@pytest.fixture(scope="module")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return simulated(tmp_path_factory.mktemp("world"), "--duration 60 --scan-rate 3 --beams 15")


def calibrate(world: Path, out: Path, *more: str) -> int:
    noise = ("--odometry-noise", "--reference-error", "0.005")
    return on_map("calibrate", world, "log.carmen", out, "--no-refine", *noise, *more)


def test_noise_and_errors_are_printed_reported_and_patched_into_the_users_file(world, tmp_path, capsys):
    mine = tmp_path / "mine.yaml"
    mine.write_text(
        "amcl:\n  ros__parameters:\n    robot_model_type: nav2_amcl::DifferentialMotionModel\n"
        "    min_particles: 100\n    max_particles: 200\n    laser_model_type: likelihood_field_prob\n"
        "    alpha1: 0.2 # shipped\n    alpha2: 0.2\n    alpha3: 0.2\n    alpha4: 0.2\n    alpha5: 0.2\n"
    )
    out = tmp_path / "out"
    assert calibrate(world, out, "--stack", "nav2", "--patch", str(mine)) == 0
    printed = capsys.readouterr().out
    assert "one alpha" in printed
    assert "Chosen levels with 95% intervals: " in printed
    assert "distance_scale" in printed
    # The motion noise of the program that was asked for, not that of the others.
    assert "nav2_amcl::DifferentialMotionModel" in printed
    assert "mmGaussian" not in printed
    document = json.loads((out / "calibration.json").read_text())["odometry"]
    scale = document["systematic"]["distance_scale"]
    assert scale["low"] < 1 / 1.005 - 1 < scale["high"]  # the simulator's wheels are half a percent too large
    alphas = document["alphas"]
    assert all(0.02 <= value < 0.1 for value in alphas.values())
    assert f"alpha1: {alphas['alpha1']:.3g} # shipped" in mine.read_text()
    assert "alpha5: 0.2\n" in mine.read_text()
    assert f"alpha4: {alphas['alpha4']:.3g}\n" in (out / "nav2.yaml").read_text()
    assert set(document["programs"]) == {"nav2", "ros1", "beluga", "mrpt"}
    assert 'id="odometry"' in (out / "report.html").read_text()


def test_a_log_that_shows_too_little_keeps_the_rest_and_says_so(tmp_path, capsys):
    simulated(tmp_path, "--duration 8 --scan-rate 4 --beams 61")
    assert calibrate(tmp_path, tmp_path / "out") == 3
    captured = capsys.readouterr()
    assert "odometry not calibrated: expected at least 12 windows" in captured.out + captured.err
    assert "missing" in json.loads((tmp_path / "out" / "calibration.json").read_text())["odometry"]


def test_odometry_is_not_compared_with_itself(world, tmp_path, capsys):
    log = str(next(world.glob("log.*")))
    code = main(["calibrate", log, "--odometry", "--odometry-noise", "--out", str(tmp_path / "out"), "--quiet"])
    assert code == 2
    assert "--odometry-noise: needs reference poses that are not the odometry" in capsys.readouterr().err
