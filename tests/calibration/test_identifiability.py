"""What the data cannot tell is named, and nothing is named where they can."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.calibration.intrinsic.em import learn_intrinsic_parameters
from beamfield.calibration.intrinsic.identifiability import Mode, identifiability_findings
from beamfield.calibration.intrinsic.learning_problem import learning_problem
from beamfield.calibration.intrinsic.likelihood import IntrinsicLikelihood, theta_of
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.beam_sampling import sample_beams

MAX_RANGE = 8.0


def names(truth: BeamParameters, expected: tuple[float, float] = (1.0, 7.0), n: int = 20_000, **options) -> set[str]:
    rng = np.random.default_rng(6)
    z_star = rng.uniform(*expected, n)
    z = sample_beams(z_star, MAX_RANGE, truth, rng)
    result = learn_intrinsic_parameters(z, z_star, MAX_RANGE, **options)
    assert all(finding.text and finding.severity in ("info", "warning") for finding in result.findings)
    return {finding.name for finding in result.findings}


def test_nothing_is_named_where_the_data_tell_all():
    assert names(BeamParameters(0.7, 0.15, 0.05, 0.1, 0.05, 0.8)) == set()


def test_no_shorts():
    found = names(BeamParameters(0.85, 0.0, 0.05, 0.1, 0.05, 0.8), n=3000)
    assert found & {"no-shorts", "lambda-undetermined", "shorts-and-random-confounded", "shorts-uniform"}
    expected = np.linspace(1.0, 7.0, 2000)
    z = expected + 0.05 * np.abs(np.sin(np.arange(2000.0)))
    result = learn_intrinsic_parameters(z, expected, MAX_RANGE)
    assert {"no-shorts", "lambda-undetermined"} <= {finding.name for finding in result.findings}


@pytest.mark.parametrize(("share", "is_named"), [(0.0, False), (0.0004, False), (0.002, True), (0.02, True)])
@pytest.mark.parametrize("min_range", [0.0, 0.2])
def test_readings_at_the_near_limit_are_named_before_they_spoil_the_rate(share, is_named, min_range):
    rng = np.random.default_rng(6)
    expected = rng.uniform(1.0, 7.0, 20_000)
    truth = BeamParameters(0.75, 0.1, 0.05, 0.1, 0.05, 0.5)
    z = sample_beams(expected, MAX_RANGE, truth, rng, min_range=min_range)
    z[: round(share * z.size)] = min_range
    result = learn_intrinsic_parameters(z, expected, MAX_RANGE, min_range=min_range)
    found = [finding for finding in result.findings if finding.name == "readings-at-near-limit"]
    assert len(found) == is_named
    if share == 0.02:
        assert result.parameters.lambda_short > 0.8
        assert f"2% of the readings are exactly {min_range:g} m" in found[0].text
        assert found[0].severity == "warning"


def test_no_max_readings():
    assert names(BeamParameters(0.75, 0.15, 0.0, 0.1, 0.05, 0.8)) == {"no-max-readings"}


def test_uniform_shorts():
    rng = np.random.default_rng(2)
    expected = rng.uniform(1.0, 7.0, 3000)
    z = rng.normal(expected, 0.05)
    z[:600] = expected[:600] * np.sqrt(rng.random(600))  # more of them far from the sensor than near
    result = learn_intrinsic_parameters(z, expected, MAX_RANGE)
    assert result.parameters.lambda_short == 0.0
    assert "shorts-uniform" in {finding.name for finding in result.findings}


def test_hits_so_wide_that_they_look_random():
    found = names(BeamParameters(0.5, 0.0, 0.1, 0.4, 3.0, 0.5), n=3000)
    assert found >= {"hits-and-random-confounded", "sigma-confounded"}


def test_shorts_and_random_readings_beyond_the_same_wall():
    # All walls near the maximum range: uniform shorts and random readings cover the same ground.
    found = names(BeamParameters(0.8, 0.1, 0.05, 0.05, 0.05, 0.0), expected=(7.9, 7.99), n=5000)
    assert "shorts-and-random-confounded" in found


def test_held_parameters_are_not_questioned():
    found = names(
        BeamParameters(0.85, 0.0, 0.0, 0.15, 0.05, 0.8),
        n=3000,
        hold={"z_short": 0.0, "z_max": 0.0, "lambda_short": 0.8},
    )
    assert found == set()


@pytest.mark.parametrize(("gap", "named"), [(1e-4, True), (0.5, False)])
def test_modes_of_nearly_equal_likelihood(gap, named):
    rng = np.random.default_rng(6)
    expected = rng.uniform(1.0, 7.0, 5000)
    truth = BeamParameters(0.7, 0.15, 0.05, 0.1, 0.05, 0.8)
    likelihood = IntrinsicLikelihood(sample_beams(expected, MAX_RANGE, truth, rng), expected, MAX_RANGE)
    modes = (Mode(truth, -1.0), Mode(BeamParameters(0.5, 0.35, 0.05, 0.1, 0.2, 0.8), -1.0 - gap))
    findings = identifiability_findings(likelihood, learning_problem(MAX_RANGE), theta_of(truth), modes)
    assert ("several-modes" in {finding.name for finding in findings}) == named


def test_hits_all_far_behind_the_walls_leave_the_offset_at_its_limit():
    rng = np.random.default_rng(7)
    expected = rng.uniform(1.0, 6.0, 3000)
    result = learn_intrinsic_parameters(rng.normal(expected + 1.0, 0.05), expected, MAX_RANGE, fit_offset=True)
    assert "offset-at-limit" in {finding.name for finding in result.findings}


def test_shorts_all_next_to_the_sensor_leave_their_rate_at_its_ceiling():
    rng = np.random.default_rng(8)
    expected = rng.uniform(1.0, 7.0, 3000)
    z = rng.normal(expected, 0.05)
    z[:600] = 1e-6
    result = learn_intrinsic_parameters(z, expected, MAX_RANGE)
    assert "lambda-at-ceiling" in {finding.name for finding in result.findings}


@pytest.mark.oracle
def test_the_set_where_components_trade_places_says_so(oracle):
    with np.load(oracle / "calibration" / "sim_C.npz", allow_pickle=False) as file:
        result = learn_intrinsic_parameters(file["z"], file["zs"], float(file["zmax"]))
    assert "shorts-and-random-confounded" in {finding.name for finding in result.findings}
