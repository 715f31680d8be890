"""beam_model.yaml: what is written is read back to six digits, and what is wrong is named."""

from __future__ import annotations

import re
from dataclasses import asdict

import numpy as np
import pytest

from beamfield.errors import FormatError
from beamfield.io.parameters.beam_model_file import beam_model_text, read_beam_model
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder

EQUAL = BeamParameters(0.25, 0.25, 0.25, 0.25, 0.5, 1.0)


@pytest.mark.parametrize("min_range", [0.0, 0.1 / 3])
def test_a_beam_model_file_has_six_digits_and_weights_that_sum_to_one(tmp_path, min_range):
    values = np.random.default_rng(1).dirichlet(np.ones(4))
    parameters = BeamParameters(*values, 0.1 / 3, 2.0 / 3, -0.01 / 7, 1e-3 / 3)
    finder = RangeFinder.from_bearings([0.0], 29.999999, min_range=min_range, name="/sc: an")
    path = tmp_path / "beam_model.yaml"
    text = beam_model_text(parameters, finder, intervals={"z_hit": (0.1 / 3, 0.2), "lambda_short": (0.0, np.inf)})
    path.write_text(text)
    read = read_beam_model(path)
    for name, value in asdict(parameters).items():
        assert getattr(read, name) == pytest.approx(value, abs=1e-6), name
    assert sum(read.weights) == pytest.approx(1.0, abs=1e-11)
    assert (read.max_range, read.min_range) == (29.999999, pytest.approx(min_range, abs=1e-6))
    numbers = re.findall(r"^  z_\w+: (\S+)$", text, flags=re.MULTILINE)
    assert len(numbers) == 4
    assert sum(len(number) > len("0.123456") + 2 for number in numbers) <= 1  # the largest weight takes the rest
    assert "- 0.0333333\n" in text
    assert "lambda_short: null" in text


def test_exponents_come_back_from_a_beam_model_file(tmp_path):
    finder, path = RangeFinder.from_bearings([0.0], 10.0), tmp_path / "beam_model.yaml"
    path.write_text(beam_model_text(EQUAL, finder, exponent=0.05, single_scan_exponent=0.2, n_beams=30))
    read = read_beam_model(path)
    assert (read.exponent, read.single_scan_exponent, read.n_beams) == (0.05, 0.2, 30)
    assert read.parameters == EQUAL
    # Written before there were exponents, or without a map: the beams count whole.
    path.write_text(beam_model_text(EQUAL, finder))
    read = read_beam_model(path)
    assert (read.exponent, read.single_scan_exponent, read.n_beams) == (1.0, 1.0, None)


@pytest.mark.parametrize(
    ("limits", "written"),
    [
        # A laser's limits as float32 messages have them.
        ((np.float32(0.15), np.float32(3.5)), ("0.15", "3.5")),
        # Rounded up, a reading of the same float32 would be nearer than the limit.
        ((np.float32(0.06), np.float32(5.6)), ("0.06", "5.599999904632568")),
    ],
)
def test_limits_of_float32_are_written_short_unless_no_returns_would_become_readings(limits, written):
    low, high = (float(limit) for limit in limits)
    finder = RangeFinder.from_bearings([0.0], high, min_range=low, name="s")
    text = beam_model_text(EQUAL, finder)
    assert f"min_range: {written[0]}\n" in text
    assert f"max_range: {written[1]}\n" in text


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("z_hit: ", "z_hitt: ", "z_hit"),
        ("sigma_hit: 0.5", "sigma_hit: -0.5", "sigma_hit"),
        ("sigma_hit: 0.5", "sigma_hit: wide", "sigma_hit"),
        ("z_rand: 0.25", "z_rand: 0.5", "expected 1"),
        ("beam_model:", "model:", "beam_model"),
        ("min_range: 0.0", "min_range: 10.0", "sensor.min_range"),
        ("  exponent: 0.1", "  exponent: 0.0", r"beam_model\.exponent"),
        ("  exponent: 0.1", "  exponent: 1.5", r"beam_model\.exponent"),
        ("single_scan_exponent: 0.2", "single_scan_exponent: -1", r"single_scan_exponent"),
        ("n_beams: 30", "n_beams: 2.5", "n_beams"),
    ],
)
def test_a_damaged_beam_model_file_names_file_and_field(tmp_path, old, new, words):
    finder = RangeFinder.from_bearings([0.0], 10.0, name="s")
    text = beam_model_text(EQUAL, finder, exponent=0.1, single_scan_exponent=0.2, n_beams=30)
    assert old in text
    path = tmp_path / "beam_model.yaml"
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(FormatError, match=rf"beam_model\.yaml.*{words}"):
        read_beam_model(path)
