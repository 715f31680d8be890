"""Simulated rings of sonars, calibrated: truth comes back where the model holds; elsewhere the weights tell why not."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from beamfield.calibration.calibrate import Calibration, CalibrationOptions, calibrate
from beamfield.cli.main import main
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import SensorLog
from beamfield.simulation.floor_plan import draw_floor_plan
from beamfield.simulation.log import simulate_log
from beamfield.simulation.sonar import SonarPhysics, sonar_ring
from beamfield.simulation.sonar_log import simulate_sonar_log

OFFICE = draw_floor_plan(seed=1)
TRUTH = BeamParameters(z_hit=0.62, z_short=0.16, z_max=0.13, z_rand=0.09, sigma_hit=0.12, lambda_short=0.45)
DIFFUSE = SonarPhysics.diffuse(sigma=0.06, dropout=0.08, phantoms=0.05)
WEIGHTS = ("z_hit", "z_short", "z_max", "z_rand")
OPTIONS = CalibrationOptions(refine=False)


@cache
def log_of(physics: SonarPhysics) -> SensorLog:
    """Return two minutes of a ring of 16 sonars."""
    return simulate_sonar_log(OFFICE, sonar_ring(16), physics, duration=120.0, seed=3)[0].only_sensor()


@cache
def fitted(physics: SonarPhysics) -> Calibration:
    return calibrate(log_of(physics), OFFICE, OPTIONS)


def fitted_weights(physics: SonarPhysics) -> np.ndarray:
    return np.array([getattr(fitted(physics).parameters, name) for name in WEIGHTS])


@pytest.mark.parametrize("n_sensors", [8, 16, 24])
def test_rings_that_measure_as_the_model_says_give_the_truth_back(n_sensors: int) -> None:
    log = simulate_log(OFFICE, sonar_ring(n_sensors), TRUTH, duration=1440.0 / n_sensors, scan_rate=10.0, seed=3)
    result = calibrate(log.only_sensor(), OFFICE, OPTIONS)
    n = len(result.table)
    assert n > 8_000
    for name in WEIGHTS:
        truth = getattr(TRUTH, name)
        # Four standard errors of a share, and as much again for telling causes apart.
        margin = 8.0 * np.sqrt(truth * (1.0 - truth) / n)
        assert getattr(result.parameters, name) == pytest.approx(truth, abs=margin), name
    assert result.parameters.sigma_hit == pytest.approx(TRUTH.sigma_hit, rel=0.05)
    assert result.parameters.lambda_short == pytest.approx(TRUTH.lambda_short, abs=0.25)


def test_among_rough_walls_the_physics_comes_back_as_the_mixture() -> None:
    result = fitted(DIFFUSE)
    assert result.converged
    np.testing.assert_allclose(fitted_weights(DIFFUSE), [0.95 * 0.92, 0.0, 0.95 * 0.08, 0.05], atol=0.015)
    assert result.parameters.sigma_hit == pytest.approx(0.06, rel=0.06)


def test_taken_as_beams_the_same_readings_fit_worse() -> None:
    log = log_of(DIFFUSE)
    as_beams = calibrate(replace(log, finder=replace(log.finder, opening_angle=0.0)), OFFICE, OPTIONS)
    assert as_beams.parameters.z_hit < fitted(DIFFUSE).parameters.z_hit - 0.2


def test_smooth_walls_raise_z_max_and_late_echoes_z_rand() -> None:
    diffuse, smooth = fitted_weights(DIFFUSE), fitted_weights(SonarPhysics(roughness=0.1, cross_talk=0.0))
    assert smooth[2] > diffuse[2] + 0.3
    assert smooth[3] > diffuse[3] + 0.05
    assert smooth[0] < 0.5
    # No return where something is in the cone: the fit counts what the simulator knows.
    silent = np.isposinf(log_of(SonarPhysics(roughness=0.1, cross_talk=0.0)).ranges).mean()
    assert smooth[2] == pytest.approx(silent, abs=0.05)


def test_cross_talk_raises_z_short_and_z_rand() -> None:
    quiet, loud = (fitted_weights(SonarPhysics(roughness=0.6, cross_talk=share)) for share in (0.0, 0.6))
    assert (loud[1] + loud[3]) > (quiet[1] + quiet[3]) + 0.1


def test_what_simulate_writes_calibrate_reads_with_its_cones(tmp_path: Path) -> None:
    def run(*words: str) -> int:
        return main([*words, "--quiet"])

    world, out = tmp_path / "world", tmp_path / "out"
    rough = ("--roughness", "1", "--cross-talk", "0", "--dropout", "0.1", "--phantoms", "0.04", "--sigma", "0.05")
    assert run("simulate", "--out", str(world), "--sonar", "--ring", "12", "--duration", "90", *rough) == 0
    log, where = str(world / "log.carmen"), str(world / "map.yaml")
    assert run("calibrate", log, "--map", where, "--out", str(out), "--no-refine") == 0
    found = json.loads((out / "calibration.json").read_text())
    values = {name: entry["value"] if isinstance(entry, dict) else entry for name, entry in found["parameters"].items()}
    assert values["z_hit"] == pytest.approx(0.96 * 0.9, abs=0.025)
    assert values["z_max"] == pytest.approx(0.96 * 0.1, abs=0.02)
    # The slope of the noise is 0.005 here.
    assert values["sigma_hit"] == pytest.approx(0.05, rel=0.1)
