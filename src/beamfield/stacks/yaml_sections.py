"""Find the sections of a YAML file that hold a stack's parameters."""

from __future__ import annotations

from collections.abc import Iterator, Set
from pathlib import Path
from typing import Any

from beamfield.io.yaml_file import Place, YamlFile, read_yaml
from beamfield.stacks.parameter_text import Entry, ParameterSection

# ROS 2 puts a node's parameters under this key.
ROS_2_KEY = "ros__parameters"
# Nodes that localise, whatever they are called before and behind.
_NODES = ("amcl", "particle_filter")


def yaml_sections(path: Path, known: Set[str]) -> list[ParameterSection]:
    """Return the sections that hold parameters of a measurement model, in the order of the file.

    Parameters
    ----------
    path
        The file.
    known
        Names by which a section is recognised; one is enough. So is a node name with "amcl" or "particle_filter" in it.

    Raises
    ------
    FormatError
        If the file is no YAML that `read_yaml` takes.
    """
    file = read_yaml(path)
    return [
        _section(file, place, values) for place, values in _maps(file.values, ()) if _is_model(place, values, known)
    ]


def _maps(values: Any, place: Place) -> Iterator[tuple[Place, dict[str, Any]]]:
    if isinstance(values, dict):
        yield place, values
        for key, value in values.items():
            yield from _maps(value, (*place, key))


def _is_model(place: Place, values: dict[str, Any], known: Set[str]) -> bool:
    if not known.isdisjoint(name for name, value in values.items() if not isinstance(value, (dict, list))):
        return True
    owner = str(place[-2]) if len(place) > 1 and place[-1] == ROS_2_KEY else ""
    return any(node in owner for node in _NODES)


def _section(file: YamlFile, place: Place, values: dict[str, Any]) -> ParameterSection:
    entries = {}
    for name, value in values.items():
        start, stop = file.spans[(*place, name)]
        line = file.lines[(*place, name)]
        if start == stop:
            # The parser finds a missing value at the next key; it belongs behind this one's colon.
            start = stop = _behind_colon(file.source, line, name)
        if isinstance(value, (dict, list)):
            continue
        entries[name] = Entry(name, value, line, start, stop)
    label = ".".join(str(key) for key in place)
    return ParameterSection(
        file.path, "yaml", label, file.lines[place], file.source, entries, *_insertion(file, place, entries)
    )


def _behind_colon(text: str, line: int, name: str) -> int:
    begin = sum(len(part) for part in text.split("\n")[: line - 1]) + line - 1
    return text.index(":", text.index(name, begin) + len(name)) + 1


def _insertion(file: YamlFile, place: Place, entries: dict[str, Entry]) -> tuple[int, str, str]:
    """Return where a new key goes, and what stands before and after it."""
    text, start = file.source, file.spans[place][0]
    newline = "\r\n" if "\r\n" in text else "\n"
    if text[start : start + 1] == "{":
        return (start + 1, "", ", ") if entries else (start + 1, "", "")
    if not entries:
        # Only maps and lists inside: before the first of them, whose key begins the section.
        indent = _indent(text, start)
        return start, "", newline + indent
    # Behind the last parameter that stands on a line of its own. Entries are in the file's order.
    last = max(entries.values(), key=lambda entry: entry.stop)
    end = text.find("\n", last.stop)
    end = len(text) if end < 0 else end - (text[end - 1 : end] == "\r")
    return end, newline + _indent(text, start), ""


def _indent(text: str, at: int) -> str:
    line_start = text.rfind("\n", 0, at) + 1
    # A section that is an item of a list would begin with a dash; parameters never do.
    return " " * (at - line_start)
