"""Find the parameters of MRPT's likelihood models in its ini files."""

from __future__ import annotations

import re
from collections.abc import Set
from dataclasses import dataclass
from pathlib import Path

from beamfield.errors import FormatError
from beamfield.io.files.text_lines import read_at_most
from beamfield.io.files.yaml_file import shorten
from beamfield.stacks.syntax.line_ends import end_of_line, line_break, lines_with_places
from beamfield.stacks.syntax.parameter_text import ODD_BYTES, Entry, ParameterSection, plain_value

MAX_BYTES = 2_000_000
_NAME = re.compile(r"[A-Za-z_][\w.]*")
_COMMENTS = ("//", ";", "#")


def ini_sections(path: Path, known: Set[str]) -> list[ParameterSection]:
    """Return the sections with at least one known parameter, in the order of the file.

    It holds ``[section]``, ``name = value``, and comments behind ``//``, ``;`` or ``#``. FormatError if it is too
    large, or in a section that counts a name appears twice or a line is neither section, pair, comment nor empty.
    """
    # MRPT's own examples have a name in Latin-1 in a comment; such bytes come back as they were.
    content = read_at_most(path, MAX_BYTES, "an ini file")
    text = content.decode("utf-8", ODD_BYTES).removeprefix("\ufeff")
    sections = _parse(text)
    chosen = [section for section in sections if not known.isdisjoint(section.entries)]
    # Other sections of the file are other programs' business, unless there is nothing else to say.
    for section in chosen or sections:
        if section.fault is not None:
            line, field, message = section.fault
            raise FormatError(path, message, line=line, field=field)
    return [_section(path, text, section) for section in chosen]


@dataclass
class _Section:
    label: str
    line: int
    entries: dict[str, Entry]
    # The first thing that is wrong with it: line, field, message.
    fault: tuple[int, str | None, str] | None = None


def _parse(text: str) -> list[_Section]:
    sections = [_Section("", 1, {})]
    for number, (line, start) in enumerate(lines_with_places(text), start=1):
        body = line.strip()
        section = sections[-1]
        name, assign, rest = line.partition("=")
        if body.startswith("["):
            label, bracket, _ = body[1:].partition("]")
            if bracket:
                sections.append(_Section(label.strip(), number, {}))
                continue
        if not body or body.startswith(_COMMENTS) or body.startswith(("@", "%")):
            continue
        key = name.strip()
        if not assign or _NAME.fullmatch(key) is None:
            fault = f"expected [section], name = value or a comment, got {shorten(body)}"
            section.fault = section.fault or (number, None, fault)
        elif key in section.entries:
            section.fault = section.fault or (number, key, f"duplicate name in [{section.label}]")
        else:
            value = _without_comment(rest)
            begin = start + len(name) + 1 + len(rest) - len(rest.lstrip(" \t"))
            begin = begin if value else start + len(name) + 1
            section.entries[key] = Entry(key, plain_value(value), number, begin, begin + len(value))
    return sections


def _without_comment(rest: str) -> str:
    places = [place for mark in _COMMENTS if (place := rest.find(mark)) >= 0]
    return rest[: min(places, default=len(rest))].strip(" \t")


def _section(path: Path, text: str, section: _Section) -> ParameterSection:
    last = max(section.entries.values(), key=lambda entry: entry.stop)
    at = end_of_line(text, last.stop)
    return ParameterSection(path, "ini", section.label, section.line, text, section.entries, at, line_break(text))
