"""One reading, or the readings of one scan, as a beam model has them: densities of the range."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from beamfield.explorer.parameter_set import ParameterSet
from beamfield.geometry import FloatArray
from beamfield.maps.raycast import RayCaster
from beamfield.models.beam_density import beam_components, beam_log_density, beam_responsibilities
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import Scan, usable_ranges

CURVE_POINTS = 300
Values = Mapping[str, float]


def beam_parameters(values: Values) -> BeamParameters:
    """Return the parameters of a set of kind "beam"."""
    return BeamParameters(**{name: value for name, value in values.items() if name != "exponent"})


def reading_density(
    one: ParameterSet, values: Values, scan: Scan, pose: FloatArray, beam: int, caster: RayCaster
) -> dict[str, Any]:
    """Return the density of one beam's range at a pose (3,), and its reading's causes; no curves but of beam models."""
    finder = scan.finder.subset([beam])
    expected = float(caster.expected_ranges(pose, finder)[0])
    measured = float(usable_ranges(scan.ranges, scan.finder)[beam])
    answer = {"measured": measured if np.isfinite(measured) else None, "expected": expected, "curves": None}
    if one.kind != "beam":
        return answer
    parameters = beam_parameters(values)
    ranges = np.linspace(max(finder.min_range, 0.0), finder.max_range, CURVE_POINTS, endpoint=False)
    # The peak of hits is often narrower than the step.
    sigma = float(np.hypot(parameters.sigma_hit, parameters.sigma_slope * expected))
    near = expected + parameters.range_offset + sigma * np.linspace(-4.0, 4.0, 81)
    ranges = np.unique(np.concatenate([ranges, near[(near >= finder.min_range) & (near < finder.max_range)]]))
    parts = beam_components(ranges, expected, finder.max_range, parameters, min_range=finder.min_range)
    weighted = parts * np.array(parameters.weights)
    return {
        **answer,
        "ranges": ranges,
        "curves": {"hit": weighted[:, 0], "short": weighted[:, 1], "rand": weighted[:, 3]},
        "max_share": parameters.z_max,
        "shares": beam_responsibilities(
            measured, expected, finder.max_range, parameters, min_range=finder.min_range
        ).tolist(),
    }


def reading_score(one: ParameterSet, values: Values, scan: Scan, pose: FloatArray, caster: RayCaster) -> float | None:
    """Return the mean log density of a reading of a scan at a pose, nats; None for other than beam models.

    The set's exponent does not matter.
    """
    if one.kind != "beam":
        return None
    finder, usable = scan.finder, usable_ranges(scan.ranges, scan.finder)
    expected = caster.expected_ranges(pose, finder)
    each = beam_log_density(usable, expected, finder.max_range, beam_parameters(values), min_range=finder.min_range)
    each = each[np.isfinite(usable)]
    return float(each.mean()) if len(each) and np.isfinite(each).all() else None
