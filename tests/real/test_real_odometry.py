"""Odometry of real robots: far better than the stacks' defaults, and with errors that last."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.calibration.odometry.learning import calibrate_odometry
from beamfield.io.read_log import read_log
from tests.real.posed_logs import wean_log


@pytest.mark.real
@pytest.mark.parametrize("number", [1, 3])
def test_wean_halls_robot_needs_no_more_noise_than_the_floor(data, number):
    result = calibrate_odometry(wean_log(data, number))
    alphas = [getattr(result.alphas, f"alpha{i}") for i in range(1, 5)]
    np.testing.assert_allclose(alphas, 0.02)
    assert result.candidates[1].levels[0].high < 0.02
    assert result.chosen.gain > 3.0 * result.chosen.gain_se
    assert len(result.fault_stamps) == 0


@pytest.mark.real
def test_intels_robot_pulls_to_one_side(data):
    result = calibrate_odometry(read_log(data / "intel_gfs/derived_intel_rawodom.log.gz").only_sensor())
    assert result.systematic["drift"].low > 0.05
    assert "odometry-drift" in {finding.name for finding in result.findings}
    assert result.corrected_alpha < 0.3 * result.candidates[1].levels[0].value
