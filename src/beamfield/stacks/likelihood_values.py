"""The chapter's beam model, learned by maximum likelihood, in a stack's own parameters."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder

SQRT_2PI = math.sqrt(2.0 * math.pi)
# Stacks' short readings vanish at rate 0 instead of becoming uniform.
LEAST_RATE = 0.01
# Where nav2 leaves out the normaliser of short readings, it is that of an expected range of this share of max_range.
TYPICAL_SHARE = 0.4


def from_likelihood(
    stack: str, parameters: Any, learned: BeamParameters | None, finder: RangeFinder, grid: OccupancyGrid
) -> tuple[Any, bool]:
    """Return a stack's parameters that give its beams the learned densities, up to a common factor.

    Parameters
    ----------
    stack
        nav2, ros1, beluga or f1tenth.
    parameters
        The stack's own; what has no counterpart stays.
    learned
        The chapter's parameters without range_offset and sigma_slope, which no stack has; None leaves all as it is.
    finder
        The sensor.
    grid
        The map: F1TENTH measures sigma in its cells.

    Returns
    -------
    The parameters, and whether anything was learned.

    Notes
    -----
    nav2's and ROS 1's hit has no constant, so that its weight is the height of its peak; their z_short lacks the
    normaliser 1 / (1 - exp(-lambda_short z*)), which is taken at one typical expected range. The weights are scaled to
    sum to 1. In Beluga the densities are the chapter's.
    """
    if learned is None:
        return parameters, False
    sigma, rate = max(learned.sigma_hit, 1e-3), max(learned.lambda_short, LEAST_RATE)
    weights = {
        "z_hit": learned.z_hit, "z_short": learned.z_short, "z_max": learned.z_max, "z_rand": learned.z_rand
    }  # fmt: skip
    if stack == "f1tenth":
        return replace(parameters, **weights, sigma_hit=sigma / grid.resolution), True
    values = {"sigma_hit": sigma, "lambda_short": rate}
    if stack == "beluga":
        return replace(parameters, **weights, **values), True
    typical = TYPICAL_SHARE * finder.max_range
    weights["z_hit"] /= SQRT_2PI * sigma
    weights["z_short"] /= -math.expm1(-rate * typical)
    total = sum(weights.values())
    values |= {name: weight / total for name, weight in weights.items()}
    prefix = "laser_" if stack == "ros1" else ""
    return replace(parameters, **{prefix + name: value for name, value in values.items()}), True
