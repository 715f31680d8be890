"""Which parameters and which emulator belong to a stack's model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from beamfield.maps.occupancy import OccupancyGrid
from beamfield.stacks.beluga.models import BelugaBeam, BelugaField, BelugaFieldProb
from beamfield.stacks.beluga.parameters import BelugaParameters
from beamfield.stacks.emulation.emulator import StackModel
from beamfield.stacks.f1tenth.parameters import F1tenthParameters
from beamfield.stacks.f1tenth.table import F1tenthTable
from beamfield.stacks.files.parameter_file import MODELS, Stack, check_model, check_stack
from beamfield.stacks.mrpt.field import MrptField
from beamfield.stacks.mrpt.parameters import MrptFieldParameters, MrptRayParameters
from beamfield.stacks.mrpt.rays import MrptRays
from beamfield.stacks.nav2.models import Nav2Beam, Nav2Field, Nav2FieldProb
from beamfield.stacks.nav2.parameters import Nav2Parameters
from beamfield.stacks.ros1.models import Ros1Beam, Ros1Field, Ros1FieldProb
from beamfield.stacks.ros1.parameters import Ros1Parameters

_MODELS: Mapping[Stack, Mapping[str, type[StackModel[Any, Any]]]] = {
    "nav2": {"likelihood_field": Nav2Field, "likelihood_field_prob": Nav2FieldProb, "beam": Nav2Beam},
    "ros1": {"likelihood_field": Ros1Field, "likelihood_field_prob": Ros1FieldProb, "beam": Ros1Beam},
    "beluga": {"likelihood_field": BelugaField, "likelihood_field_prob": BelugaFieldProb, "beam": BelugaBeam},
    "mrpt": {"LF_Thrun": MrptField, "rayTracing": MrptRays},
    "f1tenth": {"table": F1tenthTable},
}
# Of each model, or one for all models of a stack; MRPT's models share no name.
_PARAMETERS: Mapping[Stack, Mapping[str, type[Any]] | type[Any]] = {
    "nav2": Nav2Parameters,
    "ros1": Ros1Parameters,
    "beluga": BelugaParameters,
    "mrpt": {"LF_Thrun": MrptFieldParameters, "rayTracing": MrptRayParameters},
    "f1tenth": F1tenthParameters,
}


def parameter_class(stack: str, model: str | None = None) -> type[Any]:
    """Return the dataclass of a model's parameters: its fields have the names of the stack's files.

    Parameters
    ----------
    stack
        For example "mrpt".
    model
        For example "rayTracing"; None takes the stack's default, which matters for MRPT only.

    Raises
    ------
    InvalidInputError
        If there is no such stack, or it has no such model.
    """
    kinds = _PARAMETERS[check_stack(stack)]
    chosen = check_model(stack, MODELS[check_stack(stack)][0] if model is None else model)
    return kinds[chosen] if isinstance(kinds, Mapping) else kinds


def parameter_names(stack: str) -> frozenset[str]:
    """Return the names of all parameters that a stack's models have."""
    return frozenset(
        item.name for model in MODELS[check_stack(stack)] for item in fields(parameter_class(stack, model))
    )


def emulator(stack: str, model: str) -> type[StackModel[Any, Any]]:
    """Return the class that emulates a stack's model.

    Raises
    ------
    InvalidInputError
        If there is no such stack, or it has no such model.
    """
    return _MODELS[check_stack(stack)][check_model(stack, model)]


def build_model(stack: str, model: str, grid: OccupancyGrid, parameters: Any, **options: Any) -> StackModel[Any, Any]:
    """Return the emulator of a stack's model on a map.

    Parameters
    ----------
    stack, model
        For example "nav2" and "likelihood_field".
    grid
        The map.
    parameters
        Of the class `parameter_class` gives.
    **options
        Of the emulator: distance, rays, map_mode.
    """
    kind: Any = emulator(stack, model)
    made: StackModel[Any, Any] = kind(grid, parameters, **options)
    return made
