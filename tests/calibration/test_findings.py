"""What is said of readings that do not count as they should."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import beamfield
from beamfield.calibration.beam_table import BeamTable
from beamfield.calibration.findings import blind_findings, left_out_findings, noise_findings
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder, SensorLog

FINDER = RangeFinder.from_bearings(np.radians(np.arange(-180.0, 180.0, 10.0)), 8.0)
N_SCANS = 80


def log_and_table(ranges: np.ndarray, expected: float = 3.0) -> tuple[SensorLog, BeamTable]:
    zeros = np.zeros((N_SCANS, 3))
    log = SensorLog(FINDER, 0.1 * np.arange(N_SCANS), ranges, zeros, zeros)
    there = ~np.isnan(ranges)
    scan, beam = np.nonzero(there)
    table = BeamTable(
        ranges[there], np.full(len(scan), expected), scan.astype(np.int32), beam.astype(np.int32), 0.1 * scan, 8.0,
        n_no_measurement=int((~there).sum()),
    )  # fmt: skip
    return log, table


def readings(rng: np.random.Generator) -> np.ndarray:
    """A tenth of the readings is lost anywhere; three beams at -160 to -140 degrees and one at 170 see the robot."""
    ranges = np.where(rng.random((N_SCANS, FINDER.n_beams)) < 0.1, 8.0, 3.0)
    ranges[:, [2, 3, 4, 35]] = 8.0
    return ranges


def test_hits_anywhere_are_no_hits(rng):
    _, table = log_and_table(readings(rng))
    good = BeamParameters(0.9, 0.05, 0.0, 0.05, sigma_hit=0.3, lambda_short=0.5, sigma_slope=0.2)
    assert list(noise_findings(good, table)) == []
    (finding,) = noise_findings(replace(good, sigma_slope=0.4), table)
    assert "by 1.24 m at a range of 3.00 m" in finding.text


def test_beams_that_never_return_are_named_with_the_mask_that_leaves_them_out(rng):
    log, table = log_and_table(readings(rng))
    (finding,) = blind_findings(table, log)
    assert finding.name == "blind-beams"
    assert "2..4 (bearings -160.1 to -139.9 degrees), 35..35 (bearings 169.9 to 170.1 degrees)" in finding.text
    assert "(--mask=-160.1:-139.9 --mask=169.9:170.1)" in finding.do
    assert finding.values == {"n_beams": 4.0, "share": pytest.approx(4 / 36)}


def test_nothing_is_blind_that_returns_or_sees_nothing_or_is_masked(rng):
    ranges = readings(rng)
    masked = np.where((ranges == 8.0).all(axis=0), np.nan, ranges)
    assert not list(blind_findings(*reversed(log_and_table(masked))))
    seldom = ranges.copy()
    seldom[::20] = 3.0
    assert not list(blind_findings(*reversed(log_and_table(seldom))))
    assert not list(blind_findings(*reversed(log_and_table(ranges, expected=8.0))))
    assert not list(blind_findings(*reversed(log_and_table(np.full_like(ranges, 8.0)))))


def test_masked_beams_are_not_taken_for_lost_measurements(rng):
    ranges = readings(rng)
    ranges[:, :6] = np.nan
    assert not list(left_out_findings(*reversed(log_and_table(ranges))))
    ranges[::5, 6:] = np.nan
    (finding,) = left_out_findings(*reversed(log_and_table(ranges)))
    assert finding.name == "nan-readings"
    assert finding.values["share"] == pytest.approx(30 / 36 / 5)


def test_every_warning_says_why_it_matters_and_what_to_do():
    """Findings are made by literal calls: those in the source are all that a user can meet."""
    root = Path(beamfield.__file__).parent
    sources = [path for part in ("calibration", "landmark_noise", "scan_fit") for path in (root / part).rglob("*.py")]
    calls = [
        node
        for path in [*sources, root / "report" / "stack_findings.py"]
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id == "Finding"
    ]
    severe = [call for call in calls if not isinstance(call.args[1], ast.Constant) or call.args[1].value != "info"]
    assert len(severe) > 25
    for call in severe:
        given = {keyword.arg for keyword in call.keywords}
        assert {"why", "do"} <= given, ast.unparse(call.args[0])
