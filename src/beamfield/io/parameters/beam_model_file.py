"""Files of model parameters: beamfield's own beam_model.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from beamfield.io.parameters.document import counting_section, document_text, read_saved, sensor_section, six_digits
from beamfield.models.beam_parameters import EXTENSIONS, WEIGHTS, BeamParameters, SavedBeamModel
from beamfield.sensors import RangeFinder

HEADER = """\
# Beam model p(z | x, m) of a range finder: parameters, their 95% intervals, and where they come from.
# An interval of null: the log does not determine that parameter.
# z_hit + z_short + z_max + z_rand = 1; sigma_hit and range_offset in metres, lambda_short in 1/metre.
# A hit is a Gaussian around expected range + range_offset with variance sigma_hit^2 + (sigma_slope * expected range)^2.
# max_range is the range in metres from which a reading means "no return"; opening_angle is the cone's in radians.
# Readings below min_range (metres) are dropped: each density is cut to [min_range, max_range], and the weights are
# shares of the readings that are left.
# Beams depend on each other: with n_beams beams of a scan, each beam's value counts to the power of exponent in a
# filter, which multiplies the values of scan after scan, and to that of single_scan_exponent for one scan on its own,
# which is worth about single_scan_exponent * n_beams independent beams.
"""


def beam_model_text(
    parameters: BeamParameters,
    finder: RangeFinder,
    *,
    exponent: float = 1.0,
    single_scan_exponent: float | None = None,
    n_beams: int | None = None,
    intervals: Mapping[str, tuple[float, float]] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> str:
    """Return the text of a beam_model.yaml of this sensor.

    Parameters have six digits; the largest weight has more, so that the weights sum to 1. The exponents say how much
    beams count, with n_beams of each scan, and are written if there are n_beams. The rest is as for
    `beamfield.io.parameters.document.document_text`.
    """
    counting = {} if n_beams is None else counting_section(exponent, single_scan_exponent, n_beams)
    document: dict[str, Any] = {"beam_model": {**_rounded(parameters), **counting}, "sensor": sensor_section(finder)}
    if finder.opening_angle > 0.0:
        # Radians: parameters of cones mean nothing to a model of beams.
        document["sensor"]["opening_angle"] = float(finder.opening_angle)
    return document_text(HEADER, document, intervals=intervals, provenance=provenance)


def _rounded(parameters: BeamParameters) -> dict[str, float]:
    values = {item.name: getattr(parameters, item.name) for item in fields(BeamParameters)}
    rounded = {name: six_digits(value) for name, value in values.items()}
    largest = max(WEIGHTS, key=lambda name: rounded[name])
    rounded[largest] = round(1.0 - sum(rounded[name] for name in WEIGHTS if name != largest), 12)
    return rounded


def read_beam_model(path: str | Path) -> SavedBeamModel:
    """Read a beam_model.yaml, as `BeamModel` and `SonarModel` take it: exponent and n_beams included.

    Parameters
    ----------
    path
        The file.

    Returns
    -------
    The parameters, how much each beam counts, and the limits of the sensor. A file without exponent has 1.

    Raises
    ------
    FormatError
        If a parameter is missing, no number, or outside its range, or a limit of the sensor is; names the line.
    """
    names = [item.name for item in fields(BeamParameters)]
    # Left out, extensions have the defaults of `BeamParameters`.
    required = [name for name in names if name not in EXTENSIONS]
    return read_saved(path, "beam_model", names, SavedBeamModel, required=required)
