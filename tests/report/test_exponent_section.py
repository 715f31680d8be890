"""What is said of independent beams."""

from __future__ import annotations

from dataclasses import replace

import pytest

from beamfield.calibration.context.exponent import ExponentLearning, LearnedExponent
from beamfield.report.exponent_section import exponent_sentence

GOOD = LearnedExponent(0.2, (0.15, 0.25), 0.2, 0.9, 2.5, 0.2, -3.0)


def _sentence(single: LearnedExponent) -> str:
    return exponent_sentence(ExponentLearning(GOOD, single, 30, 180, 4, 0.04))


def test_a_scan_that_tells_poses_apart_is_worth_independent_beams():
    assert _sentence(GOOD).startswith("A scan of 180 beams is worth about 6 independent ones")


@pytest.mark.parametrize(("score", "error"), [(-2.17, 0.32), (0.0, 0.0), (0.1, 0.2), (-1.0, float("nan"))])
def test_posteriors_no_better_than_nothing_are_worth_no_number(score, error):
    """In a wrong map 36 beams were "worth about 3.9", and beams that no pose changes were worth 36."""
    said = _sentence(replace(GOOD, score=score, score_se=error))
    assert "cannot be told" in said
    assert "is worth about" not in said
    assert "nan" not in said
