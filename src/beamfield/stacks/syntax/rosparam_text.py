"""Find the parameters in the YAML text that a launch file has between ``<rosparam>`` and ``</rosparam>``."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from beamfield.errors import FormatError
from beamfield.io.files.yaml_file import shorten
from beamfield.stacks.syntax.line_ends import lines_with_places

_PAIR = re.compile(r"""([ \t]*)(["']?)([A-Za-z_][\w./-]*)\2[ \t]*:(?:[ \t]+|$)(.*)""")
_COMMENT = re.compile(r"(?:^|[ \t]+)#.*$")
# What a value begins with that goes on in further lines, if it is not empty.
_GOES_ON = ("[", "{", "|", ">")


class WrittenValue(NamedTuple):
    """A parameter as it stands in the text."""

    name: str
    written: str
    line: int
    start: int
    """Where the value begins in the text."""


def rosparam_values(path: Path, text: str, first_line: int) -> Iterator[WrittenValue]:
    """Yield the parameters in a text of lines ``name: value``, which begins at a line of a launch file, counted from 1.

    Maps and lists inside are other parameters, and are passed over. FormatError if a line is no such pair, for example
    of a map in braces, or the text has comments or entities of XML.
    """
    indent: str | None = None
    goes_on = False
    for line, (whole, begin) in enumerate(lines_with_places(text), start=first_line):
        body = _COMMENT.sub("", whole).rstrip()
        found = _PAIR.fullmatch(body)
        if not body:
            continue
        if goes_on and indent is not None and (body.startswith(f"{indent} ") or body.lstrip()[0] in "-]}"):
            continue
        if found is None or found.group(1) != (found.group(1) if indent is None else indent) or set(body) & set("<&"):
            message = f"expected lines 'name: value' in the text of <rosparam>, got {shorten(body.strip())}"
            raise FormatError(path, f"{message}: write it so, or as <param> tags", line=line)
        indent, written = found.group(1), found.group(4)
        goes_on = not written or written.startswith(_GOES_ON)
        yield WrittenValue(found.group(3), written, line, begin + found.start(4))
