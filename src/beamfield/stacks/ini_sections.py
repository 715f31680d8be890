"""Find the parameters of MRPT's likelihood models in its ini files."""

from __future__ import annotations

import re
from collections.abc import Set
from pathlib import Path

from beamfield.errors import FormatError
from beamfield.stacks.parameter_text import Entry, ParameterSection, Value

MAX_BYTES = 2_000_000
_SECTION = re.compile(r"\s*\[([^\]]*)\]")
_PAIR = re.compile(r"\s*([A-Za-z_][\w.]*)\s*=[ \t]*(.*?)[ \t]*(//.*|;.*|#.*)?$")


def ini_sections(path: Path, known: Set[str]) -> list[ParameterSection]:
    """Return the sections with a known parameter, in the order of the file.

    Parameters
    ----------
    path
        The file: ``[section]``, ``name = value``, comments behind ``//``, ``;`` or ``#``.
    known
        Names of parameters; one is enough.

    Raises
    ------
    FormatError
        If the file is too large or no text, a name is there twice in a section, or a line is neither section, pair,
        comment nor empty.
    """
    with path.open("rb") as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise FormatError(path, f"expected an ini file of at most {MAX_BYTES} bytes, got more")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(path, f"no text in UTF-8: byte {content[error.start : error.start + 1]!r}") from error
    sections: list[tuple[str, int, dict[str, Entry]]] = [("", 1, {})]
    at = 0
    for number, line in enumerate(text.splitlines(keepends=True), start=1):
        body = line.rstrip("\r\n")
        if header := _SECTION.match(body):
            sections.append((header.group(1).strip(), number, {}))
        elif (pair := _PAIR.match(body)) and body.strip():
            name, entries = pair.group(1), sections[-1][2]
            if name in entries:
                raise FormatError(path, f"is there twice in [{sections[-1][0]}]", line=number, field=name)
            entries[name] = Entry(name, _plain(pair.group(2)), number, at + pair.start(2), at + pair.end(2))
        elif body.strip() and not body.lstrip().startswith(("//", ";", "#", "@", "%")):
            raise FormatError(path, f"expected [section], name = value or a comment, got {body.strip()[:60]!r}",
                              line=number)  # fmt: skip
        at += len(line)
    chosen = [item for item in sections if not known.isdisjoint(item[2])]
    return [_section(path, text, *item) for item in chosen]


def _section(path: Path, text: str, label: str, line: int, entries: dict[str, Entry]) -> ParameterSection:
    last = max(entries.values(), key=lambda entry: entry.stop)
    end = text.find("\n", last.stop)
    end = len(text) if end < 0 else end - (text[end - 1 : end] == "\r")
    newline = "\r\n" if "\r\n" in text else "\n"
    return ParameterSection(path, "ini", label, line, text, entries, end, newline)


def _plain(word: str) -> Value | None:
    if not word:
        return None
    if word.lower() in ("true", "false"):
        return word.lower() == "true"
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            continue
    return word
