"""Turn the values of a parameter file into the stack's parameters, and say which cannot be."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import Field, fields
from typing import Any, NamedTuple

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.yaml_file import shorten
from beamfield.stacks.parameter_file import StackFile
from beamfield.stacks.parameter_text import Entry, Value
from beamfield.stacks.registry import parameter_class
from beamfield.stacks.yaml_sections import ROS_2_KEY

# These declare each parameter's type, and stop if a file has another.
STRICT_STACKS = ("nav2", "beluga")
# Truth values of YAML 1.1, which ROS reads.
_TRUE, _FALSE = ("yes", "on", "y", "true"), ("no", "off", "n", "false")
# What YAML 1.1 reads as a number with an exponent.
_EXPONENT_1_1 = re.compile(r"[-+]?(\d[\d_]*\.[\d_]*|\.\d[\d_]*)[eE][-+]\d+")
# A number or a name in the file; `file.model` says what it stands for.
MRPT_MODEL = "likelihoodMethod"
MODEL_NAME = "laser_model_type"
# How a message begins about a value that is known only when the robot starts.
FILLED_IN = "is filled in when the robot starts:"
# And about an integer where ROS 2 wants a double.
INTEGER = "expected a number with a point"
MOST = 2**63 - 1
# No distance, weight or rate of a robot is smaller; squares and cubes of it still are numbers.
LEAST = 1e-12


class Unusable(NamedTuple):
    """A value that its stack cannot take."""

    name: str
    message: str
    is_clear: bool = False
    """Whether it is clear what is meant, and the parameters have that."""


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
        value, message = entry.value, _unread(file, entry)
        if not message:
            value, message = _convert(entry, _plain_text(file, entry), item, strict=file.stack in STRICT_STACKS)
        is_clear = message.startswith(INTEGER)
        if not message or is_clear:
            refusal = _refusal(kind, {**usable, item.name: value})
            message, is_clear = refusal or message, is_clear and not refusal
        if item.name == MODEL_NAME and message:
            # The program runs its default, which is the file's model then.
            is_clear = isinstance(value, str)
        elif value is not None and (is_clear or not message):
            usable[item.name] = value
        if message:
            unusable.append(Unusable(item.name, message, is_clear))
    if MODEL_NAME in {item.name for item in fields(kind)}:
        usable[MODEL_NAME] = file.model
    return TypedValues(kind(**usable), tuple(unusable))


def checked_values(file: StackFile) -> Any:
    """Return the stack's parameters that a file asks for.

    Raises
    ------
    FormatError
        If a value cannot be used; names the line.
    """
    typed = typed_values(file)
    for item in typed.unusable:
        raise file.section.error(item.name, item.message)
    return typed.parameters


def _plain_text(file: StackFile, entry: Entry) -> str:
    """Return what stands in the file; "" if it is in quotes, which make it text."""
    text = file.section.text[entry.start : entry.stop].strip()
    return "" if file.section.syntax == "yaml" and text[:1] in ("'", '"') else text


def _unread(file: StackFile, entry: Entry) -> str:
    """Return why the program gets no value, or another one than YAML 1.2 says; "" if it does."""
    if entry.filled_in and entry.value is None:
        return f"{FILLED_IN} {entry.filled_in!r}"
    text = _plain_text(file, entry)
    by_ros_1 = file.section.syntax == "yaml" and file.section.label.rsplit(".", 1)[-1] != ROS_2_KEY
    if by_ros_1 and isinstance(entry.value, float) and "e" in text.lower() and not _EXPONENT_1_1.fullmatch(text):
        return (
            f"expected a number as ROS 1 reads it (1.0e-3: with a point and a signed exponent), got the text {text!r}"
        )
    return ""


def _convert(entry: Entry, text: str, item: Field[Any], *, strict: bool) -> tuple[Any, str]:
    """Return the value in the type of the parameter, and what is wrong with it, if anything."""
    value, default = entry.value, item.default
    if isinstance(default, bool):
        if isinstance(value, bool):
            return value, ""
        if value in (0, 1) and not strict:
            return bool(value), ""
        if isinstance(value, str) and text.lower() in _TRUE + _FALSE:
            return text.lower() in _TRUE, ""
        return value, f"expected true or false, got {shorten(value)}"
    if isinstance(default, str):
        return (value, "") if isinstance(value, str) else (value, f"expected text, got {shorten(value)}")
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return value, f"expected a number, got {shorten(value)}"
    if isinstance(value, int) and abs(value) > MOST:
        return value, f"expected a number that fits into 64 bits, got {shorten(value)}"
    if not math.isfinite(value):
        return value, f"expected a finite number, got {value!r}"
    if value and not LEAST <= abs(value) <= 1.0 / LEAST and not isinstance(default, int):
        return value, f"expected 0 or a number between {LEAST:g} and {1.0 / LEAST:g}, got {value!r}"
    if isinstance(default, int):
        if isinstance(value, int):
            return value, ""
        if value.is_integer() and not strict:
            return int(value), ""
        return value, f"expected a whole number, got {value!r}"
    if strict and isinstance(value, int):
        return float(value), f"{INTEGER} ({value}.0): ROS 2 declares it as double, got the integer {value}"
    return float(value), ""


def _refusal(kind: type[Any], values: Mapping[str, Any]) -> str:
    try:
        kind(**values)
    except (InvalidInputError, FormatError) as error:
        return str(error).split(": ", 1)[-1]
    return ""
