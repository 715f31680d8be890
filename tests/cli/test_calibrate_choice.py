"""Which exponent a model's file gives a filter, by what our own does with both on the log."""

from __future__ import annotations

from dataclasses import fields

import pytest

from beamfield.calibration.context.exponent import ExponentLearning, LearnedExponent
from beamfield.cli.calibrate_choice import name_of, with_better_exponent
from beamfield.localization.model_choice import ModelChoice
from beamfield.localization.replay import ReplayErrors
from beamfield.localization.replay_comparison import ReplayTrials
from beamfield.report.exponent_section import taken_sentence
from beamfield.report.results import exponent_intervals

OF_DRIVES = LearnedExponent(0.05, (0.04, 0.06), 0.05, 0.9, 3.0, 0.1, -9.0)
OF_SCANS = LearnedExponent(0.2, (0.1, 0.3), 0.2, 0.9, 2.0, 0.1, -5.0)


def runs(error: float) -> ReplayTrials:
    values = {field.name: error for field in fields(ReplayErrors)} | {"lost": False, "updates": 1}
    return ReplayTrials("log", (0,), (ReplayErrors(**values),))


@pytest.mark.parametrize(("error", "taken"), [(0.094, OF_SCANS), (0.096, OF_DRIVES), (0.2, OF_DRIVES)])
def test_the_surer_exponent_is_for_a_filter_that_errs_less_with_it_by_5_percent(error, taken):
    learned = ExponentLearning(OF_DRIVES, OF_SCANS, n_beams=30, beams_of_scan=180, n_scans=4, reference_error=0.04)
    tried = ModelChoice({name_of("a.yaml", 0.05): runs(0.1), name_of("a.yaml", 0.2): runs(error)})
    better = with_better_exponent("a.yaml", learned, tried)
    assert better.in_filter == taken
    assert (better.drive, better.single) == (OF_DRIVES, OF_SCANS)
    assert exponent_intervals(better) == {"exponent": taken.interval, "single_scan_exponent": OF_SCANS.interval}
    assert bool(taken_sentence(better)) == (taken is OF_SCANS)
