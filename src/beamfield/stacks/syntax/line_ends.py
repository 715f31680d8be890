"""Lines of a text whose line ends may be any of three kinds."""

from __future__ import annotations

import re

_BREAK = re.compile(r"\r\n|\r|\n")
# YAML's reader counts these as line breaks, too.
_YAML_BREAK = re.compile("\r\n|[\r\n\x85\u2028\u2029]")


def line_break(text: str) -> str:
    r"""Return the line break that a text uses first; a line feed if it has none.

    Examples
    --------
    >>> line_break("a\r\nb\n")
    '\r\n'
    """
    found = _BREAK.search(text)
    return found.group() if found else "\n"


def end_of_line(text: str, at: int) -> int:
    """Return where the line that holds position `at` ends, before its line break."""
    found = _BREAK.search(text, at)
    return found.start() if found else len(text)


def start_of_line(text: str, at: int) -> int:
    """Return where the line that holds position `at` begins."""
    return 1 + max(text.rfind("\n", 0, at), text.rfind("\r", 0, at))


def lines_with_places(text: str) -> list[tuple[str, int]]:
    """Return each line without its break, and where it begins."""
    lines, start = [], 0
    for found in _BREAK.finditer(text):
        lines.append((text[start : found.start()], start))
        start = found.end()
    return [*lines, (text[start:], start)]


def start_of_yaml_line(text: str, line: int) -> int:
    """Return where a line, counted from 1 as YAML's reader counts, begins."""
    start = 0
    for number, found in enumerate(_YAML_BREAK.finditer(text), start=2):
        if number > line:
            break
        start = found.end()
    return start
