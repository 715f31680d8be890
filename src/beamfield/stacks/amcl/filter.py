"""AMCL's particle filter with one of its measurement models."""

from __future__ import annotations

from typing import Any

from beamfield.models.differential_motion import DifferentialMotion
from beamfield.stacks.emulation.stack_motion import StackMotion
from beamfield.stacks.filters.amcl_filter import AmclFilter, AmclFilterParameters


def amcl_filter(
    model: Any, motion: StackMotion, parameters: AmclFilterParameters, *, selective_resampling: bool = False
) -> AmclFilter:
    """Return the filter that runs one of AMCL's models on its map, with the program's own motion; see `AmclFilter`."""
    wraps = isinstance(motion.formula, DifferentialMotion)
    return AmclFilter(model, model.seen, motion, parameters, selective_resampling, wraps)
