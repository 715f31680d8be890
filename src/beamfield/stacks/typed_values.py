"""Turn the values of a parameter file into the stack's parameters, and say which cannot be."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import Field, fields
from typing import Any, NamedTuple

from beamfield.errors import FormatError, InvalidInputError
from beamfield.stacks.parameter_file import StackFile
from beamfield.stacks.parameter_text import Entry, Value
from beamfield.stacks.registry import parameter_class

# These declare each parameter's type, and stop if a file has another.
STRICT_STACKS = ("nav2", "beluga")
# A number or a name in the file; `file.model` says what it stands for.
MRPT_MODEL = "likelihoodMethod"


class Unusable(NamedTuple):
    """A value that its stack cannot take."""

    name: str
    message: str


class TypedValues(NamedTuple):
    """A file's values as the stack's parameters."""

    parameters: Any
    """Of the stack's dataclass; its defaults where the file says nothing, or nothing usable."""
    unusable: tuple[Unusable, ...]


def typed_values(file: StackFile) -> TypedValues:
    """Return the stack's parameters that a file asks for, and the values that cannot be used."""
    kind = parameter_class(file.stack, file.model)
    usable: dict[str, Value] = {}
    unusable: list[Unusable] = []
    for item in fields(kind):
        entry = file.section.entries.get(item.name)
        if entry is None or item.name == MRPT_MODEL:
            continue
        value, message = _convert(entry, item, strict=file.stack in STRICT_STACKS)
        if not message:
            message = _refusal(kind, {**usable, item.name: value})
        if message:
            unusable.append(Unusable(item.name, message))
        else:
            usable[item.name] = value
    if "laser_model_type" in {item.name for item in fields(kind)}:
        usable["laser_model_type"] = file.model
    return TypedValues(kind(**usable), tuple(unusable))


def checked_values(file: StackFile) -> Any:
    """Return the stack's parameters that a file asks for.

    Raises
    ------
    FormatError
        If a value cannot be used; names the line.
    """
    typed = typed_values(file)
    for name, message in typed.unusable:
        raise file.section.error(name, message)
    return typed.parameters


def _convert(entry: Entry, item: Field[Any], *, strict: bool) -> tuple[Any, str]:
    """Return the value in the type of the parameter, and what is wrong with it, if anything."""
    value, default = entry.value, item.default
    if isinstance(default, bool):
        if isinstance(value, bool):
            return value, ""
        if value in (0, 1) and not strict:
            return bool(value), ""
        return value, f"expected true or false, got {value!r}"
    if isinstance(default, str):
        return (value, "") if isinstance(value, str) else (value, f"expected text, got {value!r}")
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return value, f"expected a number, got {value!r}"
    if not math.isfinite(value):
        return value, f"expected a finite number, got {value!r}"
    if isinstance(default, int):
        if isinstance(value, int):
            return value, ""
        if value.is_integer() and not strict:
            return int(value), ""
        return value, f"expected a whole number, got {value!r}"
    if strict and isinstance(value, int):
        return (
            value,
            f"expected a number with a point ({value}.0): ROS 2 declares it as double, got the integer {value}",
        )
    return float(value), ""


def _refusal(kind: type[Any], values: Mapping[str, Any]) -> str:
    try:
        kind(**values)
    except (InvalidInputError, FormatError) as error:
        return str(error).split(": ", 1)[-1]
    return ""
