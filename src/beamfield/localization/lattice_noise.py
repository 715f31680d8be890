"""Noise that a lattice of poses adds to a sensor: what lies between its poses must not be missed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from beamfield.arguments import require
from beamfield.errors import InvalidInputError
from beamfield.models.beam_parameters import BeamParameters
from beamfield.models.field_parameters import LikelihoodFieldParameters
from beamfield.sensors import Scan, usable_ranges


def widened_for_lattice(parameters: BeamParameters, *, resolution: float, headings: int) -> BeamParameters:
    """Return the parameters with hits as uncertain as a lattice of poses leaves them.

    A robot somewhere in a cell of side s, with a heading somewhere in a step d, sees walls at ranges that differ from
    those at the lattice's pose. With errors uniform over cell and step and walls at 45 degrees on average, the variance
    of a hit grows by s^2 / 6 + (z* d)^2 / 12.

    Use it to draw or search a likelihood over a lattice whose steps are not much finer than sigma_hit; peaks narrower
    than a step would fall between its poses. For scores, use the calibrated parameters.

    Parameters
    ----------
    parameters
        The calibrated parameters.
    resolution
        Side of a cell, metres.
    headings
        Number of headings over the circle.

    Returns
    -------
    The parameters with sigma_hit and sigma_slope grown.

    Raises
    ------
    InvalidInputError
        If a number is not positive.

    Examples
    --------
    >>> calibrated = BeamParameters(0.8, 0.1, 0.05, 0.05, sigma_hit=0.03, lambda_short=0.5)
    >>> widened = widened_for_lattice(calibrated, resolution=0.1, headings=72)
    >>> round(widened.sigma_hit, 3), round(widened.sigma_slope, 3)
    (0.051, 0.025)
    """
    step = _heading_step(resolution, headings)
    return replace(
        parameters,
        sigma_hit=float(np.hypot(parameters.sigma_hit, resolution / np.sqrt(6.0))),
        sigma_slope=float(np.hypot(parameters.sigma_slope, step / np.sqrt(12.0))),
    )


def widened_field_for_lattice(
    parameters: LikelihoodFieldParameters, scan: Scan, *, resolution: float, headings: int
) -> LikelihoodFieldParameters:
    """Return the same for a likelihood field, whose sigma_hit is one for all ranges: that of the scan's r.m.s. range.

    Readings without return do not count. InvalidInputError if a number is not positive.
    """
    step = _heading_step(resolution, headings)
    z = usable_ranges(scan.ranges, scan.finder)
    z = z[z < scan.finder.max_range]
    mean_square = float(np.mean(z**2)) if z.size else 0.0
    added = resolution**2 / 6.0 + mean_square * step**2 / 12.0
    return replace(parameters, sigma_hit=float(np.sqrt(parameters.sigma_hit**2 + added)))


def _heading_step(resolution: float, headings: int) -> float:
    require(0.0 < resolution < np.inf, "resolution", "a positive number of metres", resolution)
    if headings < 1:
        raise InvalidInputError(f"headings: expected at least 1, got {headings}")
    return 2.0 * np.pi / headings
