"""Learning against an independent maximisation on frozen sets, simulated and real."""

from __future__ import annotations

import json

import numpy as np
import pytest

from beamfield.calibration.intrinsic.em import LearningResult, learn_intrinsic_parameters
from tests.reference import table_6_2

pytestmark = pytest.mark.oracle


@pytest.fixture(scope="module")
def solutions(oracle):
    return json.loads((oracle / "calibration" / "solutions.json").read_text())


def load(path):
    with np.load(path, allow_pickle=False) as file:
        return file["z"], file["zs"], float(file["zmax"]), (file["init"] if "init" in file.files else None)


def assert_reaches(result: LearningResult, theta: list[float], log_likelihood: float) -> None:
    p = result.parameters
    assert result.converged
    assert result.log_likelihood >= log_likelihood - 1e-7
    assert p.weights == pytest.approx(theta[:4], abs=5e-4)
    assert p.sigma_hit == pytest.approx(theta[4], rel=2e-3)
    # Others keep lambda above 1e-6; here it may be 0.
    assert p.lambda_short == pytest.approx(theta[5], rel=2e-3, abs=2e-6)
    assert np.all(np.diff(result.trace) >= -1e-9 * np.abs(result.trace[:-1]))


@pytest.mark.parametrize("name", list("ABCDE"))
def test_simulated_sets_reach_the_independent_maximum(name, oracle, solutions):
    z, expected, max_range, _ = load(oracle / "calibration" / f"sim_{name}.npz")
    want = solutions["simulated"][name]["direct"]
    result = learn_intrinsic_parameters(z, expected, max_range)
    assert_reaches(result, want["theta"], want["ll"])
    assert result.parameters.z_max == pytest.approx(np.mean(z >= max_range), rel=1e-12)


@pytest.mark.parametrize("name", ["uob", "intel"])
def test_real_sets_reach_the_independent_maximum(name, oracle, solutions):
    z, expected, max_range, _ = load(oracle / "calibration" / f"set_{name}_train.npz")
    want = solutions["real"][name]["fits"]["direct"]
    theta = [want[key] for key in ("w_hit", "w_short", "w_max", "w_rand", "sigma", "lam")]
    result = learn_intrinsic_parameters(z, expected, max_range)
    assert_reaches(result, theta, want["ll_per_beam"])
    assert result.parameters.lambda_short == 0.0
    assert "shorts-uniform" in {finding.name for finding in result.findings}


@pytest.mark.parametrize("name", ["uob", "intel"])
def test_offset_and_slope_gain_likelihood_on_real_sets(name, oracle):
    z, expected, max_range, _ = load(oracle / "calibration" / f"set_{name}_train.npz")
    forms = [
        learn_intrinsic_parameters(z, expected, max_range, fit_offset=offset, fit_sigma_slope=slope)
        for offset, slope in ((False, False), (True, False), (True, True))
    ]
    gains = np.diff([form.log_likelihood for form in forms])
    assert np.all(gains > 0.0)
    for form in forms:
        assert form.converged
        assert np.all(np.diff(form.trace) >= -1e-9 * np.abs(form.trace[:-1]))
    if name == "intel":
        assert gains[0] > 0.05
        assert 0.02 < forms[2].parameters.range_offset < 0.04


@pytest.mark.parametrize("name", list("ABCDE"))
def test_literal_table_6_2_ends_where_another_transcription_ends(name, oracle, solutions):
    z, expected, max_range, start = load(oracle / "calibration" / f"sim_{name}.npz")
    thetas = table_6_2.learn_intrinsic_parameters(z, expected, max_range, start[4], start[5], 150)
    want = solutions["simulated"][name]
    assert thetas[-1] == pytest.approx(want["book"]["theta"], rel=1e-3)
    assert table_6_2.log_likelihood(z, expected, max_range, thetas[-1]) < want["direct"]["ll"] - 0.01
