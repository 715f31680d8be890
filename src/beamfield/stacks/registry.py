"""The programs that beamfield knows."""

from __future__ import annotations

from typing import Any

from beamfield.errors import InvalidInputError
from beamfield.localization.replay import ReplayedFilter
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.stacks.beluga.stack import BELUGA
from beamfield.stacks.emulation.emulator import StackModel
from beamfield.stacks.f1tenth.stack import F1TENTH
from beamfield.stacks.mrpt.stack import MRPT
from beamfield.stacks.nav2.stack import NAV2
from beamfield.stacks.ros1.stack import ROS1
from beamfield.stacks.stack import Model, Stack

# By the names that commands take. Where a file can be of several, the first is the likeliest.
STACKS: dict[str, Stack] = {stack.name: stack for stack in (NAV2, ROS1, BELUGA, MRPT, F1TENTH)}


def stack_named(name: str) -> Stack:
    """Return the stack of this name; raise with the known names."""
    if name not in STACKS:
        raise InvalidInputError(f"stack: expected one of {', '.join(STACKS)}, got {name!r}")
    return STACKS[name]


def model_named(stack: str, model: str | None = None) -> Model:
    """Return a stack's model, by default the one that it runs if its file names none; refuse unknown names."""
    found = stack_named(stack)
    return found.model(found.default_model if model is None else model)


def parameter_class(stack: str, model: str | None = None) -> type[Any]:
    """Return the dataclass of a model's parameters: its fields have the names of the stack's files."""
    return model_named(stack, model).parameters


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
    kind: Any = model_named(stack, model).emulator
    made: StackModel[Any, Any] = kind(grid, parameters, **options)
    return made


def build_filter(stack: str, model: StackModel[Any, Any], motion: Any = None, parameters: Any = None) -> ReplayedFilter:
    """Return a stack's particle filter with one of its measurement models on a map.

    Motion and parameters are of the classes that its description names; by default the program's defaults.
    InvalidInputError if there is no such stack, its filter is not emulated, or the map has no free cell.
    """
    described = stack_named(stack).filter
    if described is None:
        known = ", ".join(name for name, one in STACKS.items() if one.filter is not None)
        raise InvalidInputError(f"stack: the filter of {stack} is not emulated, only those of {known}")
    chosen = described.motion() if motion is None else motion
    return described.build(model, chosen, described.parameters() if parameters is None else parameters)
