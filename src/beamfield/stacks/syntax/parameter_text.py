"""The parameters in a stack's own file, with their places in its text, so that a value can change and nothing else."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, NamedTuple

from beamfield.errors import FormatError, InvalidInputError

# How bytes that are no UTF-8 are kept, where a file may have them (Python's name for it).
ODD_BYTES = "surrogateescape"
# ROS 2 puts a node's parameters under this key.
ROS_2_KEY = "ros__parameters"

Value = float | int | bool | str
Syntax = Literal["yaml", "launch", "ini"]

# Longer ones are not counts, and Python refuses to convert very long ones.
_WHOLE = re.compile(r"[-+]?\d{1,30}", re.ASCII)
# One way to match each digit: with two, a long row of digits takes a time that grows with its square.
_NUMBER = re.compile(r"[-+]?((\d+(\.\d*)?|\.\d+)(e[-+]?\d+)?|inf|infinity|nan)", re.ASCII | re.IGNORECASE)


class Signs(NamedTuple):
    """By what the parameters of a program that localises are known in a file."""

    names: frozenset[str]
    """Names of parameters; a section with one of them counts."""
    nodes: tuple[str, ...]
    """Nodes that localise; where no section has such a name, theirs count."""
    packages: tuple[str, ...]
    """Packages of nodes that localise."""


@dataclass(frozen=True)
class Entry:
    """One parameter as the file has it.

    Parameters
    ----------
    name
        As in the file, without node or section.
    value
        Its plain value; None where the file has no value, or one that is known only when the robot starts.
    line
        Counted from 1.
    start, stop
        Where the value stands in the text; what lies between is replaced when the value changes.
    filled_in
        What stands in the file instead of the value, such as ``$(arg z_hit)``; "" if it is the value itself.
    others
        (line, value) of each other place that gives the same parameter; they do not count.
    is_shared
        Whether other nodes get the value from here, too, unless they set it themselves, as this one may.
    """

    name: str
    value: Value | None
    line: int
    start: int
    stop: int
    filled_in: str = ""
    others: tuple[tuple[int, Value | None], ...] = ()
    is_shared: bool = False


@dataclass(frozen=True, eq=False)
class ParameterSection:
    """The part of a file that holds one node's parameters.

    Parameters
    ----------
    path
        The file.
    syntax
        "yaml" (ROS 1 and 2, F1TENTH), "launch" (ROS 1 XML) or "ini" (MRPT).
    label
        The keys, node or section that hold the parameters; "" at the top level of a file.
    line
        Where it begins, counted from 1.
    text
        The whole file.
    entries
        The parameters by name.
    insert_at
        Where a new parameter goes in the text; None if there is no place for one.
    insert_before, insert_after
        What stands before and after a new parameter: line break and indentation, or a comma.
    package
        The package of the node, if the file says it (launch files).
    elsewhere
        (line, text) of what loads further parameters from somewhere else.
    nested
        Parameters in maps within a YAML section, by their names in ROS 2: "initial_pose.x".
    """

    path: Path
    syntax: Syntax
    label: str
    line: int
    text: str
    entries: Mapping[str, Entry]
    insert_at: int | None
    insert_before: str
    insert_after: str = ""
    package: str = ""
    elsewhere: tuple[tuple[int, str], ...] = ()
    nested: Mapping[str, Entry] = field(default_factory=dict)

    @property
    def is_ros_2(self) -> bool:
        """Whether the parameters stand where only ROS 2 looks for them."""
        return self.label.rsplit(".", 1)[-1] == ROS_2_KEY

    def count(self, names: Iterable[str]) -> int:
        """Return how many of these parameters the section has."""
        return sum(name in self.entries for name in names)

    def arguments_replaced_by(self, values: Iterable[str]) -> str:
        """Return what to say where parameters that a launch argument or the like gives get values; "" for none."""
        replaced = dict.fromkeys(self.entries[name].filled_in for name in values if name in self.entries)
        given = ", ".join(text for text in replaced if text)
        return f"replaced {given} by values, which arguments at launch no longer change" if given else ""

    def error(self, name: str, message: str) -> FormatError:
        """Return the error of one parameter."""
        entry = self.entries.get(name)
        return FormatError(self.path, message, line=self.line if entry is None else entry.line, field=name)

    def with_values(self, values: Mapping[str, Value]) -> str:
        """Return the file's text with these values; parameters that it lacks are added, all else stays as it is.

        A value that other nodes share stays as well: this node gets its own.

        InvalidInputError if a text value cannot stand in the file, FormatError if it has no place for a new parameter.
        """
        edits: list[tuple[int, int, str]] = []
        added = ""
        for name, value in values.items():
            written = value_text(value, self.syntax)
            entry = self.entries.get(name)
            if entry is not None and _is_written(entry, value):
                continue  # the user's own way of writing it stays
            if entry is None or entry.is_shared:
                added += self.insert_before + pair(name, value, self.syntax) + self.insert_after
                continue
            if entry.start == entry.stop and self.syntax == "yaml":
                written = " " + written
            edits.append((entry.start, entry.stop, written))
        if added:
            if self.insert_at is None:
                # <node .../> has no inside to write into.
                raise FormatError(
                    self.path, "has no end tag before which to insert parameters", line=self.line, field=self.label
                )
            edits.append((self.insert_at, self.insert_at, added))
        text = self.text
        for start, stop, written in sorted(edits, reverse=True):
            text = text[:start] + written + text[stop:]
        return text


def _is_written(entry: Entry, value: Value) -> bool:
    return entry.value == value and type(entry.value) is type(value) and not entry.filled_in


def decoded(path: Path, content: bytes) -> str:
    """Return the text of a file in UTF-8, or say which byte is none of it."""
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(path, f"not valid UTF-8: byte {content[error.start : error.start + 1]!r}") from error


def plain_value(word: str) -> Value | None:
    """Return the value that a word in a launch or ini file stands for; None for no word.

    Examples
    --------
    >>> plain_value("1e-3"), plain_value("30"), plain_value("True"), plain_value("beam")
    (0.001, 30, True, 'beam')
    """
    word = word.strip()
    if not word:
        return None
    if word.lower() in ("true", "false"):
        return word.lower() == "true"
    if _WHOLE.fullmatch(word):
        return int(word)
    if _NUMBER.fullmatch(word):
        return float(word)
    return word


def value_text(value: Value, syntax: Syntax) -> str:
    """Return a value as the file's reader takes it.

    Whole floating-point numbers keep their point: ROS 2 refuses an integer where it declared a double.

    Examples
    --------
    >>> value_text(1.0, "yaml"), value_text(True, "ini"), value_text(0.1 + 0.2, "yaml")
    ('1.0', 'true', '0.3')
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return _float_text(value, syntax)
    if not value or any(character in value for character in "\n\r\"'<>&#{}[],"):
        raise InvalidInputError(f"value: expected plain text on one line, got {value!r}")
    return f'"{value}"' if syntax == "yaml" else value


def pair(name: str, value: Value, syntax: Syntax) -> str:
    """Return a parameter and its value as one line of a file."""
    written = value_text(value, syntax)
    if syntax == "launch":
        return f'<param name="{name}" value="{written}"/>'
    return f"{name} = {written}" if syntax == "ini" else f"{name}: {written}"


def _float_text(value: float, syntax: Syntax) -> str:
    if value != value or value in (float("inf"), float("-inf")):
        raise InvalidInputError(f"value: expected a finite number, got {value!r}")
    # Six digits are more than any calibration knows.
    short = f"{value:.6g}"
    if "e" in short:
        mantissa, exponent = short.split("e")
        # YAML 1.1 readers take 1e-05 for text: the mantissa needs a point.
        return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{exponent}"
    return short if "." in short or syntax == "ini" else short + ".0"
