"""What of a stack's parameters is fitted, and which numbers of beams are tried."""

from __future__ import annotations

from typing import Any

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.models.beam_parameters import BeamParameters
from beamfield.sensors import RangeFinder
from beamfield.stacks.coordinates import FitInputs, FitSpace
from beamfield.stacks.registry import model_named

# Numbers of beams that are tried, few first.
BEAM_COUNTS = (4, 6, 9, 13, 20, 30, 60, 120)


def fit_space(
    stack: str, model: str, start: Any, finder: RangeFinder, grid: OccupancyGrid, learned: BeamParameters | None
) -> FitSpace:
    """Return what to fit of a stack's model.

    Parameters
    ----------
    stack, model
        Which.
    start
        The stack's parameters.
    finder
        The sensor.
    grid
        The map.
    learned
        The chapter's beam model by maximum likelihood, without range_offset and sigma_slope, which no stack has; None
        if it is not known.
    """
    counts = [n for n in BEAM_COUNTS if n <= finder.n_beams] or [finder.n_beams]
    described = model_named(stack, model)
    return described.fit_space(described, FitInputs(start, finder, grid, counts, learned))
