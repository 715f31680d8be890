"""Real sonars and wide rangers without a map: cones explain them, beams do not, and the right width is best."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from benchmarks.sonar import crazyflie, held_out_score

from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.calibration.cross_fit import build_cross_fit_maps
from beamfield.cli.main import main
from beamfield.io.read_log import read_log
from beamfield.sensors import SensorLog

pytestmark = pytest.mark.real


@pytest.fixture(scope="module")
def corridor(data: Path) -> SensorLog:
    return read_log(data / "sonar_corridor").only_sensor()


@cache
def drone(data: Path, name: str) -> SensorLog:
    return crazyflie(data / "crazyflie_multiranger" / f"{name}.bag")


def gain(log: SensorLog, width_deg: float) -> float:
    """Return the nats per held-out reading by which a fit of such cones is ahead of a uniform."""
    return held_out_score(log, np.radians(width_deg))["gain"]


def test_cones_explain_the_corridors_sonars_and_beams_do_not(corridor: SensorLog):
    assert np.degrees(corridor.finder.opening_angle) == pytest.approx(20.0)
    beams, narrow, declared, wide = (gain(corridor, width) for width in (0.0, 5.0, 20.0, 45.0))
    assert declared > 0.9
    assert declared > beams + 0.7
    assert declared > narrow + 0.05
    assert declared > wide + 0.2


@pytest.mark.parametrize("name", ["olsson-3loop", "rice"])
def test_the_drones_rangers_are_as_wide_as_their_data_sheet_says(data: Path, name: str):
    log = drone(data, name)
    assert np.degrees(log.finder.opening_angle) == pytest.approx(27.0)
    beams, narrow, declared, wide = (gain(log, width) for width in (0.0, 10.0, 27.0, 55.0))
    assert declared > 0.5
    assert declared > beams + 0.6
    assert declared > narrow + 0.05
    assert declared > wide + 0.05


def test_the_main_job_calibrates_the_corridors_sonars_without_a_map(corridor: SensorLog):
    result = calibrate(corridor, build_cross_fit_maps(corridor), CalibrationOptions(refine=False))
    assert result.converged
    assert {"cones", "cross-fitted-map"} <= {finding.name for finding in result.findings}
    assert all(score.behind_fit > 2.0 * score.behind_fit_se > 0.0 for score in result.scores[1:])
    uniform = next(score for score in result.scores if score.name == "uniform")
    assert uniform.behind_fit > 1.0
    fit = result.parameters
    # A third of the log's readings has no echo; more of them where the corridor is out of reach.
    assert 0.15 < fit.z_max < 0.32
    assert 0.02 < np.hypot(fit.sigma_hit, 2.0 * fit.sigma_slope) < 0.1
    assert abs(fit.range_offset) < 0.05
    assert fit.z_hit > 0.35


def test_the_main_job_calibrates_the_drones_rangers_without_a_map(data: Path):
    log = drone(data, "olsson-3loop")
    result = calibrate(log, build_cross_fit_maps(log), CalibrationOptions(refine=False))
    # Drifting odometry makes the noise about as large as the defaults have it; they are behind all the same.
    assert all(score.behind_fit > score.behind_fit_se > 0.0 for score in result.scores[1:])
    uniform = next(score for score in result.scores if score.name == "uniform")
    assert uniform.behind_fit > 0.7
    assert result.parameters.z_max < 0.02
    assert result.parameters.z_hit > 0.5


def test_a_ring_without_poses_is_calibrated_on_its_odometry(data: Path, tmp_path: Path, capsys, monkeypatch) -> None:
    monkeypatch.setattr("beamfield.report.html.report_figures", lambda *_, **__: [])
    bag = str(data / "crazyflie_multiranger" / "rice.bag")
    common = ["--quiet", "--out", str(tmp_path / "out"), "--no-refine"]
    assert main(["calibrate", bag, *common]) == 1
    assert "with --poses, or --odometry to take the odometry for them" in capsys.readouterr().err
    assert main(["calibrate", bag, "--odometry", "--map", "map.yaml", *common]) == 2
    assert "--odometry: only without --map" in capsys.readouterr().err
    assert main(["calibrate", bag, "--odometry", *common]) == 0
    document = json.loads((tmp_path / "out" / "calibration.json").read_text())
    # The map is drawn at the drone's odometry, and narrower than its readings say, but not surely by a scale.
    assert "walls-too-thin" in [finding["name"] for finding in document["findings"]]
    ahead = {score["name"]: score["behind_fit"] for score in document["scores"]}
    assert ahead["nav2 defaults"] > 0.0
    assert ahead["uniform"] > 0.3
