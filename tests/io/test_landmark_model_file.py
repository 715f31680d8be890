"""landmark_model.yaml."""

from __future__ import annotations

import numpy as np
import pytest

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.parameters.landmark_model_file import landmark_model_text, read_landmark_model
from beamfield.models.landmark_parameters import LandmarkParameters

BOTH = LandmarkParameters(
    0.1 + 1e-17, 1 / 3, 0.5, spurious_rate=0.1, max_range=12.5, range_bias=-2e-9, bearing_bias=3.0, range_scale=1.07
)


@pytest.mark.parametrize("parameters", [BOTH, LandmarkParameters(None, 0.2), LandmarkParameters(0.2, None)],
                         ids=["both", "bearing only", "range only"])  # fmt: skip
def test_what_is_written_is_read_back_to_the_last_bit(parameters, tmp_path):
    text = landmark_model_text(parameters, intervals={"sigma_range": (0.1, 0.2)}, provenance={"seed": 3})
    (tmp_path / "a.yaml").write_text(text)
    back = read_landmark_model(tmp_path / "a.yaml")
    for name in LandmarkParameters.__dataclass_fields__:
        assert getattr(back, name) == getattr(parameters, name)


def test_a_file_by_hand_needs_only_the_sigmas(tmp_path):
    (tmp_path / "a.yaml").write_text("landmark_model:\n  sigma_range: 0.2\n  sigma_bearing: null\n")
    assert read_landmark_model(tmp_path / "a.yaml").sigma_bearing is None


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("other: 1\n", "the key 'landmark_model' is missing"),
        ("landmark_model: 3\n", "a.yaml:1: landmark_model: expected the parameters' names and values, got 3"),
        (f"landmark_model: {'x' * 1000}\n", r"names and values, got 'x{59}\.\.\.$"),
        ("landmark_model:\n  sigma_range: 0.1\n", "the key 'sigma_bearing' is missing in 'landmark_model'"),
        ("landmark_model:\n  sigma: 1\n", "a.yaml:2: .* unknown parameter 'sigma'; known parameters are sigma_range"),
        ("landmark_model:\n  sigma_range: wide\n  sigma_bearing: 1\n", "a.yaml:2: .* expected a number, got 'wide'"),
        ("landmark_model: {sigma_range: 1, sigma_bearing: 1, range_bias: null}\n", "range_bias: expected a number"),
        ("landmark_model: {sigma_range: -1, sigma_bearing: 1}\n", "landmark_model: sigma_range: expected a positive"),
    ],
    ids=["key", "number", "long text", "missing", "unknown", "word", "null bias", "negative"],
)
def test_what_is_no_landmark_model_is_refused(text, message, tmp_path):
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(FormatError, match=message):
        read_landmark_model(tmp_path / "a.yaml")


def test_matrices_have_no_place_in_the_file():
    with pytest.raises(InvalidInputError, match="a signature covariance or confusion matrix cannot be written"):
        landmark_model_text(LandmarkParameters(0.1, 0.1, confusion=np.eye(2)))
