"""``beamfield demo``: the whole chain on short drives, and the tables at its end."""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import pytest

from beamfield.cli import calibrate, demo
from beamfield.cli.main import main
from beamfield.cli.outcome import Outcome
from beamfield.io.read_log import read_log

VALUES = """\
amcl:
  ros__parameters:
    laser_model_type: likelihood_field_prob
    z_hit: 0.08
    z_rand: 0.92
    alpha1: 0.02
    alpha2: 0.02
    alpha3: 0.02
    alpha4: 0.02
"""
TRUTH = {
    "parameters": {"z_hit": 0.8, "sigma_hit": 0.05},
    "odometry_noise": {"distance_scale": 0.25, "turn_scale": -0.5},
}
FOUND = {
    "parameters": {
        "z_hit": {"value": 0.79, "interval_95": [0.78, 0.83]},
        "sigma_hit": {"value": 0.03, "interval_95": [0.02, 0.035]},
        "sigma_slope": {"value": 0.0, "interval_95": None},
    },
    "odometry": {"systematic": {"turn_scale": {"value": 0.9, "low": 0.0, "high": 1.2}}},
    "stack": {"replay": None},
}


def test_truth_is_set_beside_the_fit_of_sensor_and_odometry():
    truth, fit = demo.true_parameters(TRUTH), demo.fitted_parameters(FOUND)
    # Odometry a quarter too long, and half the turns: the truth is a fifth shorter, and turns twice as far.
    scales = {"distance_scale": -0.2, "turn_scale": 1.0}
    assert truth == pytest.approx({"z_hit": 0.8, "sigma_hit": 0.05, **scales, "drift": 0.0, "yaw": 0.0})
    lines = demo.parameter_comparison(truth, fit).splitlines()
    assert lines[2].split() == ["z_hit", "0.8000", "0.7900", "[0.7800,", "0.8300]", "yes"]
    assert lines[3].split() == ["sigma_hit", "0.0500", "0.0300", "[0.0200,", "0.0350]", "NO"]
    assert lines[4].split()[:3] == ["turn_scale", "1.0000", "0.9000"]
    assert lines[5:] == ["2 of 3 intervals hold the truth"]


@pytest.fixture
def calibrated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have `calibrate` write what it found once; the whole chain runs before each release, from a fresh wheel."""

    def write(arguments: argparse.Namespace) -> Outcome:
        assert (arguments.lone_poses, arguments.stack, arguments.odometry_noise) == ("odometry", "nav2", True)
        arguments.out.mkdir()
        (arguments.out / "calibration.json").write_text(json.dumps(FOUND))
        (arguments.out / demo.AFTER).write_text(VALUES)
        return Outcome("")

    monkeypatch.setattr(calibrate, "run", write)


@pytest.mark.usefixtures("calibrated")
def test_the_chain_ends_with_truth_beside_fit_and_the_error_before_and_after(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.setattr(demo, "SEEDS", 3)
    out = tmp_path / "demo"
    assert main(["demo", "--out", str(out), "--duration", "40"]) == 0
    printed = capsys.readouterr().out
    for command in ("simulate", "calibrate", "evaluate"):
        assert f"   beamfield {command} " in printed
    assert "2 of 3 intervals hold the truth" in printed
    # The log that is calibrated from holds no poses, and what is printed is what was computed.
    log = read_log(out / "drive" / "log.carmen", lone_poses="odometry").only_sensor()
    assert not log.has_poses
    assert log.has_odometry
    runs = json.loads((out / "evaluation" / "evaluation.json").read_text())["filters"]
    before, after = (runs[name]["tracking"][0]["means"]["mean"] for name in (demo.BEFORE, demo.AFTER))
    (line,) = (line for line in printed.splitlines() if line.startswith("position error"))
    assert line.split()[3:5] == [f"{before:.3f}", f"{after:.3f}"]
    assert line.split()[5] == f"{after - before:+.3f}"
    assert after < before
    assert (out / demo.BEFORE).read_text() == demo.DEFAULTS


@pytest.mark.usefixtures("calibrated")
def test_a_drive_too_short_to_calibrate_is_refused(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.setitem(FOUND, "stack", {"missing": "too few"})
    assert main(["demo", "--out", str(tmp_path / "demo"), "--duration", "5", "--quiet"]) == 3
    assert "too few; give a longer --duration" in capsys.readouterr().err
