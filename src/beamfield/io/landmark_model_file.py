"""Files of a landmark sensor's noise: beamfield's own landmark_model.yaml."""

from __future__ import annotations

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.yaml_file import read_yaml
from beamfield.models.landmark_parameters import LandmarkParameters

HEADER = """\
# Landmark model p(r, phi | x, m): parameters, their 95 % intervals, and where they come from. Metres and radians.
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
    """Return the text of a landmark_model.yaml.

    Parameters
    ----------
    parameters
        The parameters, written so that reading returns the same bits.
    intervals
        95 % interval per parameter.
    provenance
        Plain values that say where the parameters come from.

    Raises
    ------
    InvalidInputError
        If there is a signature covariance or a confusion matrix, for which the file has no place.
    """
    if parameters.signature_covariance is not None or parameters.confusion is not None:
        raise InvalidInputError("parameters: a signature covariance or confusion matrix has no place in the file")
    document: dict[str, Any] = {"landmark_model": {name: getattr(parameters, name) for name in NUMBERS}}
    if intervals:
        document["intervals_95"] = {name: [float(low), float(high)] for name, (low, high) in intervals.items()}
    if provenance:
        document["provenance"] = dict(provenance)
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style = False
    yaml.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    stream = io.StringIO()
    yaml.dump(document, stream)
    return HEADER + stream.getvalue()


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
    section = file.value("landmark_model")
    if not isinstance(section, dict):
        raise file.error(f"expected the parameters' names and values, got {section!r}", "landmark_model")
    for name in section:
        if name not in NUMBERS:
            raise file.error(f"unknown parameter {name!r}; known are {', '.join(NUMBERS)}", "landmark_model", name)
    values: dict[str, Any] = {}
    for name in {**dict.fromkeys(REQUIRED), **section}:
        is_null = file.value("landmark_model", name) is None and name in MAY_BE_NULL
        values[name] = None if is_null else file.number("landmark_model", name)
    try:
        return LandmarkParameters(**values)
    except InvalidInputError as error:
        line = file.lines.get(("landmark_model",))
        raise FormatError(path, str(error), line=line, field="landmark_model") from error
