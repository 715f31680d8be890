"""Find amcl's parameters in a ROS 1 launch file (XML)."""

from __future__ import annotations

import re
from collections.abc import Set
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from beamfield.errors import FormatError
from beamfield.stacks.parameter_text import Entry, ParameterSection, Value

MAX_BYTES = 2_000_000
_ATTRIBUTE = re.compile(r"""\bvalue\s*=\s*("([^"]*)"|'([^']*)')""")


def launch_sections(path: Path, known: Set[str]) -> list[ParameterSection]:
    """Return one section per ``<node>`` with amcl's parameters.

    Parameters
    ----------
    path
        The file. Values that roslaunch fills in, such as ``$(arg z_hit)``, stay text.
    known
        Names of parameters; a node with one of them counts whatever its type is called.

    Raises
    ------
    FormatError
        If the file is too large, no UTF-8, no XML, or declares entities (which can expand without bound).
    """
    with path.open("rb") as file:
        content = file.read(MAX_BYTES + 1)
    if len(content) > MAX_BYTES:
        raise FormatError(path, f"expected a launch file of at most {MAX_BYTES} bytes, got more")
    try:
        text = content.decode("utf-8")
    except UnicodeDecodeError as error:
        raise FormatError(path, f"no XML in UTF-8: byte {content[error.start : error.start + 1]!r}") from error
    nodes = _parse(path, content)
    chosen = [node for node in nodes if node.kind == "amcl" or not known.isdisjoint(name for name, *_ in node.params)]
    return [_section(path, content, text, node) for node in chosen]


@dataclass
class _Node:
    kind: str
    name: str
    line: int
    # Byte offsets: of the node's end tag, and (name, value, line, offset) of each parameter's tag.
    end: int = 0
    params: list[tuple[str, str, int, int]] = field(default_factory=list)


def _parse(path: Path, content: bytes) -> list[_Node]:
    parser = expat.ParserCreate("utf-8")
    nodes: list[_Node] = []
    open_nodes: list[_Node] = []

    def begin(tag: str, attributes: dict[str, str]) -> None:
        if tag == "node":
            node = _Node(attributes.get("type", ""), attributes.get("name", ""), parser.CurrentLineNumber)
            nodes.append(node)
            open_nodes.append(node)
        elif tag == "param" and open_nodes and "value" in attributes:
            name = attributes.get("name", "").removeprefix("~")
            if any(name == other for other, *_ in open_nodes[-1].params):
                raise FormatError(path, "the parameter is there twice", line=parser.CurrentLineNumber, field=name)
            param = (name, attributes["value"], parser.CurrentLineNumber, parser.CurrentByteIndex)
            open_nodes[-1].params.append(param)

    def finish(tag: str) -> None:
        if tag == "node":
            open_nodes.pop().end = parser.CurrentByteIndex

    def refuse(name: str, *_: object) -> None:
        raise FormatError(
            path, f"a document type is not read, got <!DOCTYPE {name} ...>", line=parser.CurrentLineNumber
        )

    parser.StartElementHandler = begin
    parser.EndElementHandler = finish
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(content, True)
    except expat.ExpatError as error:
        raise FormatError(path, f"no valid XML: {expat.ErrorString(error.code)}", line=error.lineno) from error
    return nodes


def _section(path: Path, content: bytes, text: str, node: _Node) -> ParameterSection:
    entries = {}
    for name, value, line, offset in node.params:
        begin = _characters(content, offset)
        found = _ATTRIBUTE.search(text, begin)
        if found is None:  # expat has seen the attribute
            raise FormatError(path, "the value's place in the text was not found", line=line, field=name)
        group = 2 if found.group(2) is not None else 3
        entries[name] = Entry(name, _plain(value), line, found.start(group), found.end(group))
    end = _characters(content, node.end)
    newline = "\r\n" if "\r\n" in text else "\n"
    if node.params:
        last = _characters(content, node.params[-1][3])
        indent = text[text.rfind("\n", 0, last) + 1 : last]
        indent = indent if not indent.strip() else ""
        close = text.find("\n", max(entry.stop for entry in entries.values()))
        at = close - (text[close - 1 : close] == "\r") if 0 <= close <= end else end
        return ParameterSection(path, "launch", node.name, node.line, text, entries, at, newline + indent)
    if text[end : end + 2] != "</":
        # <node .../> has no inside to write into.
        raise FormatError(path, f"the node {node.name!r} has no parameters and no end tag to put them before",
                          line=node.line, field="node")  # fmt: skip
    return ParameterSection(path, "launch", node.name, node.line, text, entries, end, "  ", newline)


def _characters(content: bytes, offset: int) -> int:
    return len(content[:offset].decode("utf-8", errors="ignore"))


def _plain(text: str) -> Value:
    word = text.strip()
    if word.lower() in ("true", "false"):
        return word.lower() == "true"
    for kind in (int, float):
        try:
            return kind(word)
        except ValueError:
            continue
    return text
