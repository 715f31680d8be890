"""Files of a likelihood field: beamfield's own likelihood_field.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from beamfield.io.parameters.document import counting_section, document_text, read_saved, sensor_section, six_digits
from beamfield.models.field_parameters import LikelihoodFieldParameters, SavedLikelihoodField
from beamfield.sensors import RangeFinder

HEADER = """\
# Likelihood field q(z | x, m) of a range finder: parameters, their 95% intervals, and where they come from.
# An interval of null: the log does not determine that parameter.
# sigma_hit in metres, z_hit + z_rand <= 1. Each beam's value counts to the power of exponent, with n_beams beams of a
# scan, in a filter, which multiplies the values of scan after scan: each is worth about exponent * n_beams independent
# beams. One scan on its own is worth as much or more, single_scan_exponent * n_beams.
# max_range is the range in metres from which a reading means "no return"; readings below min_range are dropped.
"""
PARAMETERS = ("z_hit", "z_rand", "sigma_hit")
REQUIRED = (*PARAMETERS, "exponent", "n_beams")


def likelihood_field_text(
    parameters: LikelihoodFieldParameters,
    finder: RangeFinder,
    *,
    exponent: float,
    n_beams: int,
    single_scan_exponent: float | None = None,
    intervals: Mapping[str, tuple[float, float]] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> str:
    """Return the text of a likelihood_field.yaml of this sensor, with six digits.

    The single-scan exponent is that for one scan on its own; None: the same. The rest is as for
    `beamfield.io.parameters.document.document_text`.
    """
    rounded = {name: six_digits(getattr(parameters, name)) for name in PARAMETERS}
    if rounded["z_hit"] + rounded["z_rand"] > 1.0:
        # The larger gives way: without z_rand, a beam far from all walls would make a pose impossible.
        larger, other = sorted(("z_hit", "z_rand"), key=rounded.__getitem__, reverse=True)
        rounded[larger] = round(1.0 - rounded[other], 12)
    document = {
        "likelihood_field": {**rounded, **counting_section(exponent, single_scan_exponent, n_beams)},
        "sensor": sensor_section(finder),
    }
    return document_text(HEADER, document, intervals=intervals, provenance=provenance)


def read_likelihood_field(path: str | Path) -> SavedLikelihoodField:
    """Read a likelihood_field.yaml, as `LikelihoodFieldModel` takes it: exponent and n_beams included.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    FormatError
        If a parameter is missing, unknown, no number, or outside its range, or a limit of the sensor is; names the
        line.
    """
    return read_saved(path, "likelihood_field", PARAMETERS, SavedLikelihoodField, required=REQUIRED)
