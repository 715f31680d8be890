"""Convert the values of a parameter file to the stack's parameters, and report those that are not valid."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import fields, replace
from typing import Any, Literal, NamedTuple

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.files.yaml_file import shorten
from beamfield.stacks.files.parameter_file import StackFile
from beamfield.stacks.syntax.parameter_text import Entry

# Truth values of YAML 1.1, which ROS reads.
_TRUE, _FALSE = ("yes", "on", "y", "true"), ("no", "off", "n", "false")
# What YAML 1.1 reads as a number with an exponent.
_EXPONENT_1_1 = re.compile(r"[-+]?(\d[\d_]*\.[\d_]*|\.\d[\d_]*)[eE][-+]\d+")
# What YAML 1.2 reads as a number, and ROS 2 as text.
_NOT_TO_ROS_2 = re.compile(r"[-+]?(0o[0-7]+|[\d.]*_[\w.+-]*)")
# What is wrong with a value: known only when the robot starts; an integer where ROS 2 wants a double; of another type;
# NaN or infinite; outside its range; a name that the program does not know; no measurement model of it.
Fault = Literal["filled-in", "integer", "type", "not-finite", "range", "name", "model"]
MOST = 2**63 - 1
# Smaller ones are taken as 0, which they mean; squares and cubes of this still are numbers.
LEAST = 1e-12


class Unusable(NamedTuple):
    """A value that its stack cannot take."""

    name: str
    """As in the file."""
    fault: Fault
    message: str

    @property
    def is_clear(self) -> bool:
        """Whether it is clear what the program runs with, and the parameters have that."""
        return self.fault in ("integer", "model")


class TypedValues(NamedTuple):
    """A file's values as the stack's parameters."""

    parameters: Any
    """Of the stack's dataclass; its defaults where the file says nothing, or nothing usable."""
    unusable: tuple[Unusable, ...]


def typed_values(file: StackFile) -> TypedValues:
    """Return the parameters of the measurement model that a file asks for, and the values that cannot be used."""
    model, key = file.described_model, file.program.model_key
    typed = typed_fields(file, model.parameters, key)
    # The program runs its default where the file names no model of it.
    return typed._replace(parameters=replace(typed.parameters, **{key: model.in_file[0]})) if key else typed


def typed_fields(file: StackFile, kind: type[Any], key: str = "") -> TypedValues:
    """Return parameters that a file asks for, and the values that cannot be used.

    The defaults of the parameters' dataclass hold where the file says nothing; the key names the measurement model, if
    that is among them.
    """
    usable = file.defaults_of(kind)
    unusable: list[Unusable] = []
    for item in fields(kind):
        name = file.name_in_file(item.name)
        entry = file.section.entries.get(name)
        is_model = bool(key) and item.name == key
        # Files of a program that refuses unknown models were refused before; `file.model` says what theirs is.
        if entry is None or (is_model and not file.program.unknown_model):
            continue
        value, wrong = _read(file, entry, item.default)
        if wrong is None or wrong[0] == "integer":
            wrong = _refusal(kind, usable, item.name, value, is_model=is_model) or wrong
        if wrong is not None:
            unusable.append(Unusable(name, *wrong))
        if wrong is None or wrong[0] == "integer":
            usable[item.name] = value
    return TypedValues(kind(**usable), tuple(unusable))


def wrong_types(file: StackFile) -> Iterator[tuple[Entry, Unusable]]:
    """Yield the parameters that no model uses whose type the program refuses; none for one that declares no types."""
    for name, default in file.program.declares.items() if file.is_typed else ():
        entry = file.section.entries.get(name) or file.section.nested.get(name)
        wrong = None if entry is None else _read(file, entry, default)[1]
        if entry is not None and wrong is not None and wrong[0] in ("integer", "type"):
            yield entry, Unusable(name, *wrong)


def checked_values(file: StackFile) -> Any:
    """Return the parameters of the measurement model that a file asks for.

    Raises
    ------
    FormatError
        If a value cannot be used; names the line.
    """
    return _checked(file, typed_values(file))


def checked_fields(file: StackFile, kind: type[Any]) -> Any:
    """Return other parameters of the stack that a file asks for: of its motion model, or of its filter.

    FormatError names the line of a value that cannot be used.
    """
    return _checked(file, typed_fields(file, kind))


def _checked(file: StackFile, typed: TypedValues) -> Any:
    for item in typed.unusable:
        raise file.section.error(item.name, item.message)
    return typed.parameters


def _read(file: StackFile, entry: Entry, default: Any) -> tuple[Any, tuple[Fault, str] | None]:
    """Return the value in the type of the parameter, and what is wrong with it, if anything."""
    if entry.filled_in and entry.value is None:
        return None, ("filled-in", f"is substituted at launch: {entry.filled_in!r}")
    text = _plain_text(file, entry)
    if isinstance(entry.value, float) and _is_text_to_ros_1(file, entry, text):
        message = "expected a number as ROS 1 reads it (1.0e-3: with a point and a signed exponent), got the text"
        return entry.value, ("type", f"{message} {text!r}")
    if isinstance(entry.value, (int, float)) and file.section.is_ros_2 and _NOT_TO_ROS_2.fullmatch(text):
        message = "expected a number as ROS 2 reads it (1000: digits without _ or 0o), got the text"
        return entry.value, ("type", f"{message} {text!r}")
    value = entry.value
    if isinstance(default, int) and isinstance(value, float) and file.is_roscpp and math.isfinite(value):
        return math.floor(value + 0.5), None
    if isinstance(default, bool) and not isinstance(value, (bool, str)) and file.is_roscpp:
        return value, ("type", f"expected true or false, got {shorten(value)}")
    return _convert(entry, text, default, strict=file.is_typed)


def _is_text_to_ros_1(file: StackFile, entry: Entry, number: str) -> bool:
    """Whether ROS 1 takes a number with an exponent for text: rosparam without a sign, both without a point."""
    if entry.filled_in or "e" not in number.lower():
        return False
    if file.section.syntax == "launch":
        return not file.is_typed and "." not in number
    return file.section.syntax == "yaml" and not file.section.is_ros_2 and not _EXPONENT_1_1.fullmatch(number)


def _plain_text(file: StackFile, entry: Entry) -> str:
    """Return what stands in the file; "" if it is in quotes, which make it text."""
    text = file.section.text[entry.start : entry.stop].strip()
    return "" if file.section.syntax == "yaml" and text[:1] in ("'", '"') else text


def _convert(entry: Entry, text: str, default: Any, *, strict: bool) -> tuple[Any, tuple[Fault, str] | None]:
    value = entry.value
    if isinstance(default, bool):
        if isinstance(value, bool):
            return value, None
        if value in (0, 1) and not strict:
            return bool(value), None
        if isinstance(value, str) and text.lower() in _TRUE + _FALSE:
            return text.lower() in _TRUE, None
        return value, ("type", f"expected true or false, got {shorten(value)}")
    if isinstance(default, str):
        return value, (None if isinstance(value, str) else ("type", f"expected text, got {shorten(value)}"))
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return value, ("type", f"expected a number, got {shorten(value)}")
    if isinstance(value, int) and abs(value) > MOST:
        return value, ("range", f"expected a number that fits into 64 bits, got {shorten(value)}")
    if not math.isfinite(value):
        return value, ("not-finite", f"expected a finite number, got {value!r}")
    if abs(value) > 1.0 / LEAST and not isinstance(default, int):
        return value, ("range", f"expected a number of at most {1.0 / LEAST:g}, got {value!r}")
    if isinstance(default, int):
        if isinstance(value, int):
            return value, None
        if value.is_integer() and not strict:
            return int(value), None
        return value, ("type", f"expected a whole number, got {value!r}")
    if strict and isinstance(value, int):
        message = f"expected a number with a point ({value}.0): ROS 2 declares it as double, got the integer {value}"
        return float(value), ("integer", message)
    return (float(value) if abs(value) >= LEAST else 0.0), None


def _refusal(
    kind: type[Any], usable: Mapping[str, Any], name: str, value: Any, *, is_model: bool
) -> tuple[Fault, str] | None:
    """Return why the stack's parameters cannot have a value; None if they can."""
    try:
        kind(**{**usable, name: value})
    except (InvalidInputError, FormatError) as error:
        fault: Fault = "model" if is_model else "name" if isinstance(value, str) else "range"
        return fault, str(error).removeprefix(f"{name}: ")
    return None
