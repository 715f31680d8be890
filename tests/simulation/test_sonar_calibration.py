"""Simulated rings of sonars, calibrated: truth comes back where the model holds; elsewhere the weights tell why not."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from beamfield.calibration.calibrate import CalibrationOptions, calibrate
from beamfield.cli.main import main
from beamfield.models.beam_parameters import BeamParameters
from beamfield.simulation.log import simulate_log
from beamfield.simulation.sonar import sonar_ring
from tests.few_poses import few_poses
from tests.simulation.plans import plan

TRUTH = BeamParameters(z_hit=0.62, z_short=0.16, z_max=0.13, z_rand=0.09, sigma_hit=0.12, lambda_short=0.45)
WEIGHTS = ("z_hit", "z_short", "z_max", "z_rand")
OPTIONS = CalibrationOptions(refine=False)


def fitted(roughness: float) -> BeamParameters:
    """Return what is learned from two minutes of a ring of 16 sonars."""
    log = simulate_log(plan(1), sonar_ring(16), TRUTH, duration=120.0, scan_rate=4.0, seed=3, roughness=roughness)
    return calibrate(log.only_sensor(), plan(1), OPTIONS).parameters


def test_rings_that_measure_as_the_model_says_give_the_truth_back() -> None:
    log = simulate_log(plan(1), sonar_ring(24), TRUTH, duration=60.0, scan_rate=10.0, seed=3)
    result = calibrate(log.only_sensor(), plan(1), OPTIONS)
    n = len(result.table)
    assert n > 8_000
    for name in WEIGHTS:
        truth = getattr(TRUTH, name)
        # Four standard errors of a share, and as much again for telling causes apart.
        margin = 8.0 * np.sqrt(truth * (1.0 - truth) / n)
        assert getattr(result.parameters, name) == pytest.approx(truth, abs=margin), name
    assert result.parameters.sigma_hit == pytest.approx(TRUTH.sigma_hit, rel=0.05)
    assert result.parameters.lambda_short == pytest.approx(TRUTH.lambda_short, abs=0.25)


def test_smooth_walls_move_hits_to_z_max() -> None:
    rough, smooth = fitted(1.0), fitted(0.1)
    lost = rough.z_hit - smooth.z_hit
    assert lost > 0.2
    assert smooth.z_max - rough.z_max == pytest.approx(lost, abs=0.05)


def test_what_simulate_writes_calibrate_reads_with_its_cones(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("beamfield.report.html.report_figures", lambda *_, **__: [])

    def run(*words: str) -> int:
        return main([*words, "--quiet"])

    world, out = tmp_path / "world", tmp_path / "out"
    rough = ("--roughness", "1", "--z-hit", "0.8", "--z-short", "0", "--z-max", "0.1", "--z-rand", "0.1")
    assert run("simulate", "--out", str(world), "--sonar", "--ring", "12", "--duration", "36", *rough) == 0
    log, where = str(world / "log.carmen"), str(world / "map.yaml")
    with few_poses():
        assert run("calibrate", log, "--map", where, "--out", str(out), "--no-refine") == 0
    found = json.loads((out / "calibration.json").read_text())
    values = {name: entry["value"] if isinstance(entry, dict) else entry for name, entry in found["parameters"].items()}
    assert values["z_hit"] == pytest.approx(0.8, abs=0.025)
    assert values["z_max"] == pytest.approx(0.1, abs=0.02)
    assert values["sigma_hit"] == pytest.approx(0.04, rel=0.1)
