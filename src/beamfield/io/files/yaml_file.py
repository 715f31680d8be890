"""Read a YAML file as hostile input: plain values only, and every error names the line."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MantissaNoDotYAML1_1Warning, MarkedYAMLError, YAMLError
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent, DocumentStartEvent
from ruamel.yaml.nodes import MappingNode, Node, ScalarNode, SequenceNode

from beamfield.errors import FormatError
from beamfield.io.files.text_lines import read_at_most

MAX_BYTES = 200_000
# A parser in pure Python takes 30 to 60 microseconds for each. A bag of 200 topics has 12,000.
MAX_EVENTS = 15_000
MAX_DEPTH = 50

# Where a value stands: the keys (and indices of lists) on the way to it.
Place = tuple[str | int, ...]

_TAG = "tag:yaml.org,2002:"
# Tags of angles in files for ROS 1, which has another way to write them, too.
_ANGLES = {"!degrees": "deg", "!radians": "rad"}
_SCALARS = ("null", "bool", "int", "float", "str")


@dataclass(frozen=True, eq=False)
class YamlFile:
    """The values of a YAML file whose top level has keys.

    Parameters
    ----------
    path
        The file.
    values
        Plain values: dict, list, str, int, float, bool, None.
    lines
        Line number, from 1, of each value by its keys.
    source
        The file's text as it stands, without a byte order mark.
    spans
        (start, stop) of each value in the text, by its keys; of a list or map that is not in brackets, the stop lies
        anywhere behind its last value.
    earlier
        (line, value) of each place further up with the same keys; empty unless `read_yaml` allows that.
    """

    path: Path
    values: dict[str, Any]
    lines: Mapping[Place, int]
    source: str = ""
    spans: Mapping[Place, tuple[int, int]] = field(default_factory=dict)
    earlier: Mapping[Place, tuple[tuple[int, Any], ...]] = field(default_factory=dict)

    def error(self, message: str, *place: str | int) -> FormatError:
        """Return the error that says what is wrong with the value at a place."""
        field = ".".join(str(key) for key in place) or None
        return FormatError(self.path, message, line=self.lines.get(place), field=field)

    def value(self, *place: str | int) -> Any:
        """Return the value at a place, for example ``value("amcl", "ros__parameters")``.

        Raises
        ------
        FormatError
            If a key is missing.
        """
        found: Any = self.values
        for depth, key in enumerate(place):
            is_there = key in found if isinstance(found, dict) else isinstance(found, list) and key in range(len(found))
            if not is_there:
                parent = ".".join(str(k) for k in place[:depth])
                raise FormatError(
                    self.path,
                    f"the key {key!r} is missing" + (f" in {parent!r}" if parent else ""),
                    line=self.lines.get(place[:depth]) if depth else None,
                )
            found = found[key]
        return found

    def number(self, *place: str | int) -> float:
        """Return the finite number at a place; FormatError if it is missing or none (true and false are none)."""
        value = self.value(*place)
        if isinstance(value, bool) or not isinstance(value, (int, float)):
            raise self.error(f"expected a number, got {shorten(value)}", *place)
        try:
            number = float(value)
        except OverflowError:
            raise self.error("expected a number, got one too large for floating point", *place) from None
        if not math.isfinite(number):
            raise self.error(f"expected a finite number, got {value!r}", *place)
        return number

    def text(self, *place: str | int) -> str:
        """Return the text at a place; FormatError if it is missing, no text, or empty."""
        value = self.value(*place)
        if not isinstance(value, str) or not value:
            raise self.error(f"expected text, got {shorten(value)}", *place)
        return value


def read_yaml(
    path: str | os.PathLike[str], *, max_bytes: int = MAX_BYTES, number_keys: bool = False, last_counts: bool = False
) -> YamlFile:
    """Read a YAML file whose top level has keys.

    Parameters
    ----------
    path
        The file, UTF-8.
    max_bytes
        Larger files are refused.
    number_keys
        Whether keys may be numbers and the like; they are taken as the text that stands there.
    last_counts
        Whether a key may be given again: the last value counts, and maps are merged. ROS's readers of parameters do so.

    Raises
    ------
    FormatError
        If the file is empty, too large, has too many keys and values, no UTF-8, no YAML, several documents, duplicate
        keys, keys that are not text, anchors and aliases (they can expand without bound, and ROS 2 refuses aliases),
        or tags of program objects; or if its top level has no keys.
    OSError
        As the file system says.

    Notes
    -----
    Values follow YAML 1.2: ``yes`` and ``on`` are text, ``1e-3`` is a number. An angle of ROS 1, ``!degrees 10``, is
    the text ``deg(10)``.
    """
    source = Path(path)
    text = _read_text(source, max_bytes)
    yaml = YAML(typ="safe", pure=True)
    try:
        root = _compose(yaml, text, source)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        raise FormatError(
            source, f"not valid YAML: {error.problem or error.context}", line=mark.line + 1 if mark else None
        ) from error
    except FormatError:
        raise
    except (AssertionError, KeyError) as error:  # what ruamel.yaml says of other versions
        raise FormatError(source, "expected YAML 1.1 or 1.2, got another version") from error
    except (YAMLError, ValueError) as error:
        raise FormatError(source, f"not valid YAML: {' '.join(str(error).split())}") from error
    if root is None:
        raise FormatError(source, "the file is empty")
    if not isinstance(root, MappingNode):
        kind = "a list" if isinstance(root, SequenceNode) else f"the text {shorten(root.value)}"
        raise FormatError(source, f"expected keys with values, got {kind}", line=root.start_mark.line + 1)
    if number_keys:
        _make_keys_text(root)
    with warnings.catch_warnings():
        # Files that declare YAML 1.1 need a point there; ours are read either way.
        warnings.simplefilter("ignore", MantissaNoDotYAML1_1Warning)
        built = _Values(yaml, source, last_counts)
        values = built.construct(root, ())
    return YamlFile(source, values, built.lines, text, built.spans, built.earlier)


def shorten(value: object) -> str:
    """Return a value as one short line for an error message."""
    shown = repr(value)
    return shown if len(shown) <= 60 else f"{shown[:60]}..."


def _read_text(path: Path, max_bytes: int) -> str:
    content = read_at_most(path, max_bytes, "a YAML file")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = content.count(b"\n", 0, error.start) + 1
        raise FormatError(
            path, f"not valid UTF-8: byte {content[error.start : error.start + 1]!r}", line=line
        ) from error


def _compose(yaml: YAML, text: str, path: Path) -> Node | None:
    next_event = yaml.parser.get_event
    events = depth = documents = 0

    # On the flat stream of events, because the composer recurses into what is nested.
    def checked_event() -> Any:
        nonlocal events, depth, documents
        event = next_event()
        line = event.start_mark.line + 1
        events += 1
        documents += isinstance(event, DocumentStartEvent)
        depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        if events > MAX_EVENTS:
            raise FormatError(path, f"more than {MAX_EVENTS} keys, values and brackets: refused", line=line)
        if documents > 1:
            raise FormatError(path, "expected one YAML document, got a second one", line=line)
        if depth > MAX_DEPTH:
            raise FormatError(path, f"nested deeper than {MAX_DEPTH} levels", line=line)
        if getattr(event, "anchor", None) is not None:
            mark = "*" if isinstance(event, AliasEvent) else "&"
            raise FormatError(
                path,
                f"anchors and aliases are not supported, got {mark + str(event.anchor)!r}: write the values out",
                line=line,
            )
        return event

    yaml.parser.get_event = checked_event
    root: Node | None = yaml.compose(text)
    return root


def _make_keys_text(node: Node) -> None:
    # The depth has been checked.
    if isinstance(node, MappingNode):
        for key, value in node.value:
            if isinstance(key, ScalarNode) and _kind(key) in _SCALARS:
                key.tag = f"{_TAG}str"
            _make_keys_text(value)
    elif isinstance(node, SequenceNode):
        for item in node.value:
            _make_keys_text(item)


class _Values:
    """Makes plain values of nodes, and notes where they stand."""

    def __init__(self, yaml: YAML, path: Path, last_counts: bool) -> None:
        self.yaml, self.path, self.last_counts = yaml, path, last_counts
        self.lines: dict[Place, int] = {}
        self.spans: dict[Place, tuple[int, int]] = {}
        self.earlier: dict[Place, tuple[tuple[int, Any], ...]] = {}

    def construct(self, node: Node, place: Place) -> Any:
        self.lines[place] = node.start_mark.line + 1
        self.spans[place] = node.start_mark.index, node.end_mark.index
        if isinstance(node, MappingNode):
            return self.mapping(node, place)
        if isinstance(node, SequenceNode):
            _check_tag(node, "seq", self.path)
            return [self.construct(item, (*place, i)) for i, item in enumerate(node.value)]
        if isinstance(node, ScalarNode):
            return _construct_scalar(self.yaml, node, self.path)
        raise _tag_error(node, self.path)

    def mapping(self, node: MappingNode, place: Place) -> dict[str, Any]:
        _check_tag(node, "map", self.path)
        values: dict[str, Any] = {}
        for key_node, value_node in node.value:
            line = key_node.start_mark.line + 1
            key = _construct_scalar(self.yaml, key_node, self.path) if isinstance(key_node, ScalarNode) else None
            if not isinstance(key, str):
                found = shorten(key_node.value) if isinstance(key_node, ScalarNode) else "a list or map"
                raise FormatError(self.path, f"expected text as a key, got {found}", line=line)
            here = (*place, key)
            if key in values and not self.last_counts:
                raise FormatError(self.path, f"duplicate key {key!r}", line=line)
            if key in values:
                self.earlier[here] = (*self.earlier.get(here, ()), (self.lines[here], values[key]))
            value = self.construct(value_node, here)
            values[key] = _merged(values.get(key), value)
            self.lines[here] = line
        return values


def _merged(before: Any, value: Any) -> Any:
    """Return a value that is given again; of maps, all keys of both."""
    if not isinstance(before, dict) or not isinstance(value, dict):
        return value
    return before | {key: _merged(before.get(key), item) for key, item in value.items()}


def _construct_scalar(yaml: YAML, node: ScalarNode, path: Path) -> Any:
    kind = _kind(node)
    if kind in ("timestamp", "merge", "value"):
        return node.value
    if kind in _ANGLES:
        return f"{_ANGLES[kind]}({node.value})"
    if kind not in _SCALARS:
        raise _tag_error(node, path)
    try:
        return getattr(yaml.constructor, f"construct_yaml_{kind}")(node)
    except (YAMLError, ValueError, KeyError, IndexError) as error:
        raise FormatError(
            path, f"expected a value of type {kind}, got {shorten(node.value)}", line=node.start_mark.line + 1
        ) from error


def _check_tag(node: Node, kind: str, path: Path) -> None:
    if _kind(node) != kind:
        raise _tag_error(node, path)


def _kind(node: Node) -> str:
    tag = str(node.tag)
    return tag.removeprefix(_TAG) if tag.startswith(_TAG) else tag


def _tag_error(node: Node, path: Path) -> FormatError:
    return FormatError(
        path, f"expected plain values, got the tag {shorten(str(node.tag))}", line=node.start_mark.line + 1
    )
