"""Find the sections of a YAML file that hold a stack's parameters."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Set
from dataclasses import replace
from typing import Any

from beamfield.errors import FormatError
from beamfield.io.files.yaml_file import Place, YamlFile, shorten
from beamfield.stacks.syntax.line_ends import end_of_line, line_break, start_of_line, start_of_yaml_line
from beamfield.stacks.syntax.parameter_text import ROS_2_KEY, Entry, ParameterSection, Signs

# ROS 2 gives the parameters here to every node.
FOR_ALL: Place = ("/**", ROS_2_KEY)
# With it a launch file's argument or variable begins, which launch puts in (ROS 2: allow_substs; ROS 1: subst_value).
SUBSTITUTION = "$("
_DIGITS = r"\d+(?:\.\d*)?"
_ANGLE = re.compile(rf"(deg|rad)\(\s*(?:({_DIGITS})\s*\*\s*)?(pi|{_DIGITS})(?:\s*/\s*([1-9]\d*))?\s*\)")
# Both ROS read it so, as YAML 1.1 and C do; to YAML 1.2 it is decimal.
_OCTAL = re.compile(r"[-+]?0[0-7]+")


def yaml_sections(file: YamlFile, signs: Signs) -> list[ParameterSection]:
    """Return the sections that hold parameters of a measurement model, in the order of the file.

    A node's section holds those that the file gives to all nodes, too. Nodes count whatever they are called before and
    behind the signs. The file is read with `number_keys`.

    FormatError if a key without value is written in a way that is not found, or it depends on the release of ROS, or on
    how the file is loaded, which of two values a node gets.
    """
    maps = [(place, values) for place, values in _maps(file.values, ()) if place or values]
    chosen = [item for item in maps if not signs.names.isdisjoint(_scalars(item[1]))]
    for_all = next((item for item in maps if item[0] == FOR_ALL), None)
    if chosen == [for_all]:
        chosen = [item for item in maps if item[0][-2:] in {(node, ROS_2_KEY) for node in signs.nodes}] or chosen
    else:
        chosen = [item for item in chosen if not any(_covers(item[0], place) for place, _ in chosen)]
    # nav2's files have further nodes with amcl in their names; they only count where no node says anything.
    chosen = chosen or [item for item in maps if _is_node(item[0], signs.nodes)]
    return [
        _with_shared(
            _section(file, place, values, signs.names),
            [_section(file, *item, signs.names) for item in maps if _covers(item[0], place)],
        )
        for place, values in chosen
    ]


def _covers(pattern: Place, place: Place) -> bool:
    """Return whether ROS 2 gives a node the parameters of a pattern with wildcards, such as /** or /robot1/*."""
    if pattern == place or pattern[-1:] != (ROS_2_KEY,) or place[-1:] != (ROS_2_KEY,):
        return False
    if pattern == FOR_ALL:
        return True
    names, node = _full_name(pattern), _full_name(place)
    parts = (re.escape(part) for part in re.split(r"(/\*\*|/\*(?=/|$))", names))
    wild = {re.escape("/**"): r"(/[^/]+)*", re.escape("/*"): r"/[^/]+"}
    return "*" in names and re.fullmatch("".join(wild.get(part, part) for part in parts), node) is not None


def _full_name(place: Place) -> str:
    return "".join("/" + str(key).strip("/") for key in place[:-1])


def _with_shared(node: ParameterSection, shared: list[ParameterSection]) -> ParameterSection:
    """Return a node's section with the parameters for several nodes that it does not set itself."""
    given: dict[str, Entry] = {}
    for each in shared:
        both = [name for name in each.entries if name in node.entries]
        twice = next((name for name in both if each.entries[name].value != node.entries[name].value), "")
        if twice and each.line > node.line:
            # In some the node's own section counts, in others what comes last.
            raise each.error(twice, f"is in {node.label!r}, too: which one counts depends on ROS's release, keep one")
        # Behind these a node's own value counts in every release, so that theirs need not change for it.
        is_shared = each.line < node.line
        given |= {name: replace(entry, is_shared=is_shared) for name, entry in each.entries.items()}
    return replace(node, entries={**given, **node.entries})


def _maps(values: Any, place: Place) -> Iterator[tuple[Place, dict[str, Any]]]:
    if isinstance(values, dict):
        yield place, values
        for key, value in values.items():
            yield from _maps(value, (*place, key))


def _scalars(values: dict[str, Any]) -> Iterator[str]:
    return (name for name, value in values.items() if not isinstance(value, (dict, list)))


def _is_node(place: Place, nodes: tuple[str, ...]) -> bool:
    owner = str(place[-2]) if len(place) > 1 and place[-1] == ROS_2_KEY else ""
    return any(node in owner for node in nodes)


def _section(file: YamlFile, place: Place, values: dict[str, Any], known: Set[str]) -> ParameterSection:
    _refuse_repeated(file, place)
    entries = {}
    for name, value in values.items():
        is_scalar = not isinstance(value, (dict, list))
        if not is_scalar and name not in known:
            continue
        start, stop = file.spans[(*place, name)]
        line = file.lines[(*place, name)]
        if start == stop:
            # The parser finds a missing value at the next key; it belongs behind this one's colon.
            start = stop = _behind_colon(file, line, name)
        if isinstance(value, str) and SUBSTITUTION in value:
            entry = Entry(name, None, line, start, stop, filled_in=value)
        elif isinstance(value, str) and place[-1:] != (ROS_2_KEY,) and (angle := _angle(value)) is not None:
            entry = Entry(name, angle, line, start, stop, filled_in=value)
        else:
            if isinstance(value, int) and _OCTAL.fullmatch(written := file.source[start:stop].strip()):
                value = int(written, 8)
            entry = Entry(name, value if is_scalar else shorten(value), line, start, stop)
        entries[name] = replace(entry, others=file.earlier.get((*place, name), ()))
    label = ".".join(str(key) for key in place)
    at, before, after = _insertion(file, place, entries)
    return ParameterSection(file.path, "yaml", label, file.lines[place], file.source, entries, at, before, after,
                            nested=_nested(file, place, values))  # fmt: skip


def _angle(text: str) -> float | None:
    """Return the radians that ROS 1 reads in ``deg(10)`` or ``rad(pi/6)``; None for other text."""
    found = _ANGLE.fullmatch(text)
    if found is None:
        return None
    unit, factor, number, divisor = found.groups()
    size = float(factor or 1.0) * (math.pi if number == "pi" else float(number)) / float(divisor or 1.0)
    return math.radians(size) if unit == "deg" else size


def _nested(file: YamlFile, place: Place, values: dict[str, Any]) -> dict[str, Entry]:
    """Return the parameters in maps of a section."""
    found = {}
    for key, inner in values.items():
        for name in _scalars(inner) if isinstance(inner, dict) else ():
            at = (*place, key, name)
            found[f"{key}.{name}"] = Entry(f"{key}.{name}", inner[name], file.lines[at], *file.spans[at])
    return found


def _refuse_repeated(file: YamlFile, place: Place) -> None:
    """Refuse a section that stands in the file twice: some readers merge the two, others only take the last."""
    for depth in range(1, len(place) + 1):
        for line, _ in file.earlier.get(place[:depth], ()):
            message = f"duplicate key {place[depth - 1]!r}, as in line {line}: depending on how the file is loaded"
            raise FormatError(
                file.path, f"{message}, ROS merges both or drops the first; keep one", line=file.lines[place[:depth]]
            )


def _behind_colon(file: YamlFile, line: int, name: str) -> int:
    key = re.compile(rf"""(?<![\w."'])["']?{re.escape(name)}["']?\s*:""")
    found = key.search(file.source, start_of_yaml_line(file.source, line))
    if found is None:
        raise FormatError(file.path, "the line of its missing value was not found", line=line, field=name)
    return found.end()


def _insertion(file: YamlFile, place: Place, entries: dict[str, Entry]) -> tuple[int, str, str]:
    """Return where a new key goes, and what stands before and after it."""
    text, start = file.source, file.spans[place][0]
    newline = line_break(text)
    if text[start : start + 1] == "{":
        # A comma behind the last pair is allowed.
        return start + 1, "", ", "
    indent = " " * (start - start_of_line(text, start))
    if not entries:
        # Only maps and lists inside: before the first of them, whose key begins the section.
        return start, "", newline + indent
    # Behind the last parameter, which stands on lines of its own. Entries are in the file's order.
    last = max(entries.values(), key=lambda entry: entry.stop)
    if text[last.start : last.start + 1] in ("|", ">"):
        # The end of a text in lines is somewhere below it.
        return start, "", newline + indent
    return end_of_line(text, last.stop), newline + indent, ""
