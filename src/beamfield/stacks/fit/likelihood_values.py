"""The chapter's beam model, learned by maximum likelihood, in a stack's own parameters."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder
from beamfield.stacks.ros1.parameters import ros1_name

SQRT_2PI = math.sqrt(2.0 * math.pi)
# Stacks' short readings vanish at rate 0 instead of becoming uniform.
LEAST_RATE = 0.01
# Where a stack leaves out the normaliser of short readings, it is that of an expected range of this share of max_range.
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
    """
    if learned is None:
        return parameters, False
    values = beam_values(stack, learned, TYPICAL_SHARE * finder.max_range, grid.resolution)
    return replace(parameters, **values), True


def beam_values(stack: str, learned: BeamParameters, typical_range: float, cell: float) -> dict[str, float]:
    """Return the chapter's beam model in a stack's own parameters, by their names.

    Parameters
    ----------
    stack
        nav2, ros1, beluga or f1tenth.
    learned
        The chapter's parameters; range_offset and sigma_slope are left out.
    typical_range
        The expected range, metres, at which short readings keep their share where a stack does not normalise them.
    cell
        Side of the map's cells, metres, in which F1TENTH counts.

    Notes
    -----
    nav2's and ROS 1's hit has no constant, so that its weight is the height of its peak; their z_short lacks the
    normaliser 1 / (1 - exp(-lambda_short z*)). F1TENTH's short readings sum to z_short (d + 1) where d pixels are
    expected. The weights are scaled to sum to 1. In Beluga the densities are the chapter's.
    """
    sigma, rate = max(learned.sigma_hit, 1e-3), max(learned.lambda_short, LEAST_RATE)
    hit, short, most, rand = learned.weights
    if stack == "f1tenth":
        short /= typical_range / cell + 1.0
        sigma /= cell
    elif stack != "beluga":
        hit /= SQRT_2PI * sigma
        short /= -math.expm1(-rate * typical_range)
    # The chapter's weights sum to 1 as they are.
    total = 1.0 if stack == "beluga" else hit + short + most + rand
    values = {"z_hit": hit / total, "z_short": short / total, "z_max": most / total, "z_rand": rand / total}
    values["sigma_hit"] = sigma
    if stack != "f1tenth":
        values["lambda_short"] = rate
    return {ros1_name(name) if stack == "ros1" else name: value for name, value in values.items()}
