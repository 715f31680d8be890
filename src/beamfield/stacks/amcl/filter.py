"""AMCL's particle filter with one of its measurement models."""

from __future__ import annotations

from typing import Any

from beamfield.models.motion import MotionModel
from beamfield.stacks.amcl.scan import amcl_grid
from beamfield.stacks.filters.amcl_filter import AmclFilter, AmclFilterParameters


def amcl_filter(
    model: Any, motion: MotionModel, parameters: AmclFilterParameters, *, selective_resampling: bool = False
) -> AmclFilter:
    """Return the filter that runs one of AMCL's models.

    Parameters
    ----------
    model
        `AmclField`, `AmclFieldProb` or `AmclBeam` on its map.
    motion, parameters, selective_resampling
        As for `AmclFilter`.
    """
    seen = amcl_grid(model.grid, model.map_mode)
    return AmclFilter(model, seen, motion, parameters, selective_resampling=selective_resampling)
