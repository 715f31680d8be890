"""Find amcl's parameters in a launch file (XML)."""

from __future__ import annotations

import re
from collections.abc import Iterable, Set
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple
from xml.parsers import expat

from beamfield.errors import FormatError
from beamfield.io.files.text_lines import read_at_most
from beamfield.io.files.yaml_file import shorten
from beamfield.stacks.syntax.launch_arguments import LaunchArguments
from beamfield.stacks.syntax.line_ends import line_break, start_of_line
from beamfield.stacks.syntax.parameter_text import Entry, ParameterSection, Signs, Value, decoded, plain_value
from beamfield.stacks.syntax.rosparam_text import rosparam_values

MAX_BYTES = 2_000_000
# How a node's program may be called: what ROS 1 calls type, ROS 2 exec.
_ENDINGS = ("", "_node", ".py")
# What stands in the names of launch files with such a node.
_LIKELY = ("amcl", "locali")
# What stands where a file's name would be: tags of this file that are not read.
_TEXT, _OUTSIDE = "the text of <rosparam>", "a <param> outside of it"
_TAG = re.compile(r"<[^\s/>]+")
_ATTRIBUTE = re.compile(r"""\s+([^\s=<>"']+)\s*=\s*("[^"]*"|'[^']*')""")


def launch_sections(path: Path, signs: Signs) -> list[ParameterSection]:
    """Return one section per ``<node>`` with amcl's parameters.

    ``$(arg z_hit)`` is filled in with its default if the file has one; a value that nobody knows before the start is
    None. The text of ``<rosparam>`` counts like tags. Nodes and parameters whose ``if`` or ``unless`` takes them out by
    default are left out. A node with a parameter of the signs counts whatever its type is called. Of a parameter that
    is given several times the last counts, a tag more than text, as for roslaunch: amcl's own example gives two of them
    twice.

    FormatError if the file is too large, no UTF-8, no XML, or declares entities (which can expand without bound); if a
    node has text of ``<rosparam>`` that is not understood, or all its parameters in another file or in tags outside of
    it, or if there is no such node but an included file may have it.
    """
    content = read_at_most(path, MAX_BYTES, "a launch file").removeprefix(b"\xef\xbb\xbf")
    text = decoded(path, content)
    parser = _Parser(path, signs)
    nodes = parser.nodes(content)
    chosen = [node for node in nodes if not signs.names.isdisjoint(node.params)]
    chosen = chosen or [node for node in nodes if node.localises]
    if not chosen and parser.included:
        likely = [name for name in parser.included if _is_likely(name)]
        files = ", ".join(list(dict.fromkeys(map(repr, likely or parser.included)))[:5])
        raise FormatError(
            path,
            f"no node with parameters of a measurement model, give the one of the included files that has it: {files}",
        )
    for node in nodes:
        if node.fault is not None and (node.localises or node in chosen):
            raise node.fault
    offsets = [at for node in chosen for at in (node.end, *(p.offset for p in node.params.values()))]
    places = _characters(content, offsets)
    return [_section(path, text, node, signs.names, places) for node in chosen]


def _is_likely(file: str) -> bool:
    return any(word in file.rsplit("/", 1)[-1] for word in _LIKELY)


class _Param(NamedTuple):
    value: Value | None
    filled_in: str
    line: int
    # Byte offset of its tag, or of the text that it stands in.
    offset: int
    # Whether it depends on a condition that is known only at the start whether it is there.
    is_unsure: bool
    # Where its value begins and ends in that text, in characters; None for that of a tag.
    span: tuple[int, int] | None = None
    others: tuple[tuple[int, Value | None], ...] = ()


@dataclass
class _Node:
    label: str
    package: str
    localises: bool
    line: int
    # Byte offset of its end tag.
    end: int = 0
    params: dict[str, _Param] = field(default_factory=dict)
    elsewhere: list[tuple[int, str]] = field(default_factory=list)
    # What is wrong with the text of its <rosparam>: of other programs' nodes, their business.
    fault: FormatError | None = None


class _Parser:
    """Collects nodes while expat walks through the file."""

    def __init__(self, path: Path, signs: Signs) -> None:
        self.path, self.signs = path, signs
        self.arguments = LaunchArguments()
        self.found: list[_Node] = []
        # Of each open tag: whether it is there, its namespace, and its node.
        self.open: list[tuple[bool, str, _Node | None]] = []
        # Of an open <rosparam> with text: its attributes, and where the text begins.
        self.rosparam: dict[str, str] | None = None
        self.text_begins: tuple[int, int] | None = None
        # Whether within <include>, whose arguments are the other file's.
        self.including = False
        self.included: list[str] = []
        # Of what sets parameters outside of the nodes: line, namespace and source.
        self.outside: list[tuple[int, str, str]] = []

    def nodes(self, content: bytes) -> list[_Node]:
        self.content = content
        self.expat = expat.ParserCreate("utf-8")
        self.expat.CharacterDataHandler = self.characters
        self.expat.StartElementHandler = self.begin
        self.expat.EndElementHandler = self.finish
        self.expat.StartDoctypeDeclHandler = self.refuse
        try:
            self.expat.Parse(content, True)
        except expat.ExpatError as error:
            message = f"not valid XML: {expat.ErrorString(error.code)}"
            raise FormatError(self.path, message, line=error.lineno) from error
        for node in self.found:
            for line, namespace, source in self.outside:
                # A file for the namespaces around the node may have its parameters: its name tells.
                is_around = f"/{node.label}/".startswith(f"/{namespace}/" if namespace else "/")
                if namespace == node.label or (is_around and _is_likely(source)):
                    node.elsewhere.append((line, source))
        return self.found

    def begin(self, tag: str, attributes: dict[str, str]) -> None:
        there, namespace, node = self.open[-1] if self.open else (True, "", None)
        there = there and self.arguments.is_there(attributes)
        self.including = self.including or tag == "include"
        if tag in ("group", "node"):
            given = attributes.get("ns", "")
            given = self.arguments.fill_in(given) or given
            namespace = "/".join(part for part in (namespace, given.strip("/")) if part)
        if there and tag == "arg" and not self.including:
            self.arguments.declare(attributes)
        elif there and tag == "include":
            self.included.append(attributes.get("file", ""))
        elif there and tag == "node":
            node = self.new_node(namespace, attributes)
        elif there and node is not None:
            self.inside(node, tag, attributes)
        elif there and tag in ("rosparam", "param"):
            self.outside_of_nodes(namespace, tag, attributes)
        self.open.append((there, namespace, node))

    def finish(self, tag: str) -> None:
        there, _, node = self.open.pop()
        self.including = self.including and tag != "include"
        if tag == "node" and there and node is not None:
            node.end = self.expat.CurrentByteIndex
        if tag == "rosparam" and node is not None and self.rosparam is not None and self.text_begins is not None:
            try:
                self.rosparam_text(node, self.rosparam, *self.text_begins)
            except FormatError as fault:
                node.fault = node.fault or fault
        self.rosparam = self.text_begins = None

    def characters(self, _: str) -> None:
        if self.rosparam is not None and self.text_begins is None:
            self.text_begins = self.expat.CurrentByteIndex, self.expat.CurrentLineNumber

    def rosparam_text(self, node: _Node, attributes: dict[str, str], begin: int, line: int) -> None:
        text = self.content[begin : self.expat.CurrentByteIndex].decode()
        is_unsure = not self.arguments.is_known(attributes)
        for name, written, at, start in rosparam_values(self.path, text, line):
            quoted = written[:1] in ("'", '"')
            filled = self.arguments.fill_in(written) if attributes.get("subst_value", "").lower() == "true" else written
            value = written[1:-1] if quoted else None if filled is None else plain_value(filled)
            filled_in = written if filled != written else ""
            self.add(node, name, _Param(value, filled_in, at, begin, is_unsure, (start, start + len(written))))

    def refuse(self, name: str, *_: object) -> None:
        line = self.expat.CurrentLineNumber
        raise FormatError(
            self.path, f"document types are not supported, got <!DOCTYPE {shorten(name)[1:-1]} ...>", line=line
        )

    def new_node(self, namespace: str, attributes: dict[str, str]) -> _Node:
        names = (self.arguments.fill_in(attributes.get(key, "")) for key in ("pkg", "type", "exec"))
        package, *programs = (name or "" for name in names)
        label = "/".join(part for part in (namespace, attributes.get("name", "")) if part)
        known = {node + ending for node in self.signs.nodes for ending in _ENDINGS}
        localises = package in self.signs.packages or not known.isdisjoint(programs)
        node = _Node(label, package, localises, self.expat.CurrentLineNumber)
        self.found.append(node)
        return node

    def inside(self, node: _Node, tag: str, attributes: dict[str, str]) -> None:
        line = self.expat.CurrentLineNumber
        if tag == "rosparam" and attributes.get("command", "load") != "load":
            return  # stores parameters in a file, or deletes some
        if tag == "rosparam" and not {"file", "param", "ns"} & attributes.keys():
            self.rosparam = attributes
        elif tag == "rosparam" or (tag == "param" and "from" in attributes):
            source = attributes.get("file", attributes.get("from"))
            node.elsewhere.append((line, _TEXT if source is None else source))
        elif tag == "param" and "value" in attributes:
            name = (self.arguments.fill_in(attributes.get("name", "")) or "").removeprefix("~")
            is_unsure = not self.arguments.is_known(attributes)
            written = attributes["value"]
            filled = self.arguments.fill_in(written)
            value, filled_in = None if filled is None else plain_value(filled), written if filled != written else ""
            self.add(node, name, _Param(value, filled_in, line, self.expat.CurrentByteIndex, is_unsure))

    def outside_of_nodes(self, namespace: str, tag: str, attributes: dict[str, str]) -> None:
        if tag == "rosparam" and attributes.get("command", "load") == "load":
            given, source = [attributes.get("ns", ""), attributes.get("param", "")], attributes.get("file", _TEXT)
        elif attributes.get("name", "").rpartition("/")[2] in self.signs.names:
            given, source = [attributes["name"].rpartition("/")[0]], attributes.get("from", _OUTSIDE)
        else:
            return
        parts = (namespace, *(self.arguments.fill_in(part) or part for part in given))
        where = "/".join(part.strip("/") for part in parts if part.strip("/"))
        self.outside.append((self.expat.CurrentLineNumber, where, source))

    def add(self, node: _Node, name: str, param: _Param) -> None:
        known = node.params.get(name)
        if known is not None and known.is_unsure and param.is_unsure and known.value != param.value:
            given = known.filled_in if known.value is None else known.value
            param = param._replace(value=None, filled_in=f"{given} or {param.filled_in or param.value}")
        if known is None or known.is_unsure:
            node.params[name] = param
        elif not param.is_unsure:
            # roslaunch sets what stands in tags when it has set all texts.
            is_tag_before_text = known.span is None and param.span is not None
            kept, other = (known, param) if is_tag_before_text else (param, known)
            node.params[name] = kept._replace(others=(*known.others, (other.line, other.value)))


def _section(path: Path, text: str, node: _Node, known: Set[str], places: dict[int, int]) -> ParameterSection:
    if node.elsewhere and known.isdisjoint(node.params):
        line = node.elsewhere[0][0]
        files = " and ".join(repr(source) for _, source in node.elsewhere if source not in (_TEXT, _OUTSIDE))
        here = f"inside it but in {node.elsewhere[0][1]}, which is not read: move them into the node"
        where = f"in this file but in {files}: give that file" if files else here
        raise FormatError(path, f"the parameters of the node {node.label!r} are not {where}", line=line)
    entries = {}
    for name, param in node.params.items():
        at = places[param.offset]
        start, stop = (
            _value_place(path, text, at, name, param.line)
            if param.span is None
            else (at + param.span[0], at + param.span[1])
        )
        entries[name] = Entry(name, param.value, param.line, start, stop, param.filled_in, param.others)
    end = places[node.end]
    insert_at: int | None = None
    before = line_break(text)
    if text.startswith("</", end):
        begin = start_of_line(text, end)
        indent = text[begin:end]
        if indent.strip() or begin == 0:
            insert_at, before = end, ""
        else:
            # On a line of its own before the end tag. No comment reaches there: the line has nothing but the tag.
            insert_at = begin - (2 if text[begin - 2 : begin] == "\r\n" else 1)
            before += _indent(text, entries.values()) or indent + "  "
    return ParameterSection(path, "launch", node.label, node.line, text, entries, insert_at, before,
                            package=node.package, elsewhere=tuple(node.elsewhere))  # fmt: skip


def _value_place(path: Path, text: str, begin: int, name: str, line: int) -> tuple[int, int]:
    """Return where the value of a tag stands, between its quotes."""
    at = _TAG.match(text, begin)
    while at is not None:
        at = _ATTRIBUTE.match(text, at.end())
        if at is not None and at.group(1) == "value":
            return at.start(2) + 1, at.end(2) - 1
    raise FormatError(path, "the value was not found in the text", line=line, field=name)


def _indent(text: str, entries: Iterable[Entry]) -> str:
    last = max(entries, key=lambda entry: entry.start, default=None)
    if last is None:
        return ""
    tag = text.rfind("<", 0, last.start)
    indent = text[start_of_line(text, tag) : tag]
    return "" if indent.strip() else indent


def _characters(content: bytes, offsets: list[int]) -> dict[int, int]:
    """Return the places in the decoded text that belong to places in the bytes, each byte decoded once."""
    places, done, count = {}, 0, 0
    for offset in sorted(set(offsets)):
        count += len(content[done:offset].decode("utf-8", errors="ignore"))
        places[offset], done = count, offset
    return places
