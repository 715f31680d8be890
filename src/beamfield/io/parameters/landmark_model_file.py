"""Files of a landmark sensor's noise: beamfield's own landmark_model.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beamfield.errors import InvalidInputError
from beamfield.io.files.yaml_file import read_yaml
from beamfield.io.parameters.document import document_text, named_numbers
from beamfield.models.landmark_parameters import LandmarkParameters

HEADER = """\
# Landmark model p(r, phi | x, m): parameters, their 95% intervals, and where they come from. Metres and radians.
# measured range = range_scale * range + range_bias + noise(sigma_range); measured bearing = bearing + bearing_bias +
# noise(sigma_bearing). With spurious_rate a feature is of no landmark: any range up to max_range, any bearing.
# null: never measured.
"""
REQUIRED = ("sigma_range", "sigma_bearing")
NUMBERS = (*REQUIRED, "range_bias", "bearing_bias", "range_scale", "spurious_rate", "max_range", "sigma_signature")
MAY_BE_NULL = (*REQUIRED, "max_range", "sigma_signature")


def landmark_model_text(
    parameters: LandmarkParameters,
    *,
    intervals: Mapping[str, tuple[float, float]] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> str:
    """Return the text of a landmark_model.yaml, so that reading returns the same bits; see `document.document_text`.

    InvalidInputError if there is a signature covariance or a confusion matrix, for which the file has no place.
    """
    if parameters.signature_covariance is not None or parameters.confusion is not None:
        raise InvalidInputError("parameters: a signature covariance or confusion matrix cannot be written to this file")
    document = {"landmark_model": {name: getattr(parameters, name) for name in NUMBERS}}
    return document_text(HEADER, document, intervals=intervals, provenance=provenance)


def read_landmark_model(path: str | Path) -> LandmarkParameters:
    """Read a landmark_model.yaml.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    FormatError
        If a parameter is missing, unknown, no number, or outside its range; names the line.
    OSError
        As the file system says.
    """
    file = read_yaml(path)
    values = named_numbers(file, "landmark_model", NUMBERS, required=REQUIRED, may_be_null=MAY_BE_NULL)
    try:
        return LandmarkParameters(**values)
    except InvalidInputError as error:
        raise file.error(str(error), "landmark_model") from error
