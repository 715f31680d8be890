"""likelihood_field.yaml: what is written is read back to six digits, and what is wrong is named with its line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from beamfield.errors import FormatError
from beamfield.io.parameters.likelihood_field_file import (
    likelihood_field_text,
    read_likelihood_field,
)
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.models.likelihood_field import LikelihoodFieldModel
from beamfield.sensors import RangeFinder

FINDER = RangeFinder.from_bearings([0.0, 0.1], max_range=12.5, min_range=0.15, name="laser")
PARAMETERS = LikelihoodFieldParameters(0.1 + 0.2, 1.0 / 3.0, 0.07)


@pytest.fixture
def text() -> str:
    intervals = {"z_hit": (0.2, 0.4), "exponent": (0.0, float("inf"))}
    return likelihood_field_text(
        PARAMETERS, FINDER, exponent=1.0 / 7.0, single_scan_exponent=0.5, n_beams=60, intervals=intervals
    )


def written(folder: Path, text: str) -> Path:
    path = folder / "likelihood_field.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_reading_returns_what_was_written(tmp_path, text):
    path = written(tmp_path, text)
    saved = read_likelihood_field(path)
    assert saved.parameters == LikelihoodFieldParameters(0.3, 0.333333, 0.07)
    assert (saved.exponent, saved.n_beams, saved.max_range, saved.min_range) == (0.142857, 60, 12.5, 0.15)
    assert saved.single_scan_exponent == 0.5
    # Older files have one exponent.
    one = read_likelihood_field(written(tmp_path, text.replace("  single_scan_exponent: 0.5\n", "", 1)))
    assert one.single_scan_exponent == one.exponent == 0.142857
    assert "  exponent: null\n" in text.split("intervals_95")[1]


def test_a_small_z_rand_is_not_rounded_away_which_would_make_poses_impossible(tmp_path):
    for z_hit, z_rand in ((1.0 - 1e-7, 1e-7), (1e-7, 1.0 - 1e-7)):
        text = likelihood_field_text(LikelihoodFieldParameters(z_hit, z_rand, 0.1), FINDER, exponent=1.0, n_beams=1)
        saved = read_likelihood_field(written(tmp_path, text))
        assert (saved.z_hit, saved.z_rand) == pytest.approx((z_hit, z_rand), rel=1e-6)


def test_numbers_have_no_more_digits_than_are_known(tmp_path):
    finder = RangeFinder.from_bearings([0.0, 0.1], max_range=12.5, min_range=float(np.float32(0.15)), name="laser")
    weights = LikelihoodFieldParameters(0.6666666, 1.0 - 0.6666666, 0.07)
    text = likelihood_field_text(weights, finder, exponent=0.5, n_beams=60, intervals={"z_hit": (1.2e-4 + 1e-19, 0.4)})
    assert "min_range: 0.15\n" in text
    assert "- 0.00012\n" in text
    saved = read_likelihood_field(written(tmp_path, text)).parameters
    assert (saved.z_hit, saved.z_rand) == (0.666667, 0.333333)


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("  exponent: 0.142857", "  exponent: 1.5", 11, r"expected a number in \(0, 1\], got 1.5"),
        ("  exponent: 0.142857", "  exponent: 0", 11, "expected a number in"),
        ("  single_scan_exponent: 0.5", "  single_scan_exponent: 2", 12, r"expected a number in \(0, 1\], got 2"),
        ("  n_beams: 60", "  n_beams: 2.5", 13, "expected a whole number >= 1, got 2.5"),
        ("  n_beams: 60", "  n_beams: 0", 13, "expected a whole number >= 1, got 0"),
        ("  n_beams: 60\n", "", None, "n_beams"),
        ("  n_beams: 60", "  n_beans: 60", 13, "unknown parameter 'n_beans'"),
        ("  sigma_hit: 0.07", "  sigma_hit: -1", 7, "sigma_hit: expected a positive number"),
        ("  sigma_hit: 0.07", "  sigma_hit: wide", 10, "wide"),
        ("  min_range: 0.15", "  min_range: 13", 16, "expected 0 <= min_range < max_range = 12.5, got 13"),
        ("likelihood_field:", "something_else:", None, "expected a likelihood_field.yaml of beamfield$"),
        ("likelihood_field:", "beam_model:", None, "a likelihood_field.yaml of beamfield, got a beam_model.yaml$"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, text, old, new, line, message):
    assert old in text
    with pytest.raises(FormatError, match=message) as caught:
        read_likelihood_field(written(tmp_path, text.replace(old, new, 1)))
    if line is not None:
        assert caught.value.line == line


def test_a_model_takes_what_was_read_and_keeps_what_it_is_given(tmp_path, text):
    grid = OccupancyGrid.from_ros([[0, 0, 100]], 0.5)
    saved = read_likelihood_field(written(tmp_path, text))
    model = LikelihoodFieldModel(grid, saved)
    assert (model.parameters, model.exponent, model.n_beams) == (saved.parameters, 0.142857, 60)
    assert type(model.parameters) is LikelihoodFieldParameters
    given = LikelihoodFieldModel(grid, saved, exponent=1.0, n_beams=5)
    assert (given.exponent, given.n_beams) == (1.0, 5)
    assert (LikelihoodFieldModel(grid, PARAMETERS).exponent, LikelihoodFieldModel(grid, PARAMETERS).n_beams) == (
        1.0,
        None,
    )
    assert likelihood_field_text(
        saved, FINDER, exponent=saved.exponent, n_beams=saved.n_beams
    ) == likelihood_field_text(PARAMETERS, FINDER, exponent=1.0 / 7.0, n_beams=60)
