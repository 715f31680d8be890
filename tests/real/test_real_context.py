"""Exponents learned from one real log keep their promise in others of the same place."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.calibration.context.exponent import learn_exponent, scan_log_likelihoods, score_exponents
from beamfield.calibration.pose_windows import WindowOptions, cut_windows, draw_rivals_of_each
from beamfield.io.read_map import read_map
from beamfield.models.beam import BeamModel
from beamfield.models.beam_parameters import BeamParameters
from tests.real.posed_logs import wean_log

pytestmark = pytest.mark.real

# As `calibrate` fits them to log 1.
LOG_1 = BeamParameters(0.881, 0.0667, 0.0037, 0.0486, 0.081, 0.392, range_offset=0.259, sigma_slope=0.135)


def test_exponents_of_one_log_cover_the_truth_in_another(data):
    grid = read_map(data / "wean_hall/derived_wean.yaml")
    logs = [wean_log(data, number) for number in (1, 3)]
    model = BeamModel(grid, LOG_1, n_beams=30)
    learned = learn_exponent(model, logs[0], grid)
    assert 4.0 < learned.independent_beams < 7.0
    assert 1.0 < learned.independent_beams_in_drive < 2.5
    # Other guesses at the truth than those that the exponents were learned with.
    options = WindowOptions(seed=1)
    windows = cut_windows(logs[1], grid, draw_rivals_of_each(options, grid), options)
    values, rivals = scan_log_likelihoods(model, logs[1], windows), [window.rivals for window in windows]
    for each, power in ((values[:, 0], learned.single.value), (values.sum(axis=1), learned.drive.value)):
        (scores,) = score_exponents(each, np.array([power]), rivals)
        # Ninety posteriors: 3% of a standard error.
        assert 0.85 < scores.coverage_at(0.9) < 0.95
