"""Recognise files that users give by mistake for a stack's parameter file."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from beamfield.errors import FormatError
from beamfield.io.files.yaml_file import YamlFile, read_yaml
from beamfield.stacks.registry import STACKS

_YAML = (".yaml", ".yml")
# Keys that only such files have at their top level, and what they are.
_KINDS: Mapping[frozenset[str], str] = {
    frozenset(("beam_model",)): (
        "this is beamfield's own beam model: `beamfield translate` converts it, and "
        "`beamfield calibrate LOG --map MAP --stack nav2` (or another stack) fits that program's own formula"
    ),
    frozenset(("likelihood_field",)): (
        "this is beamfield's own likelihood field: the same names have other meanings in these programs' formulas, and "
        "`beamfield calibrate LOG --map MAP --stack nav2` (or another stack) fits those"
    ),
    frozenset(("landmark_model",)): "this is beamfield's own landmark model, which none of these programs has",
    frozenset(("image", "resolution", "origin")): "this is the YAML file of a map (give it with --map)",
    frozenset(("rosbag2_bagfile_information",)): "this is the metadata of a ROS 2 bag (give its folder with --log)",
}
# TUM: a stamp, a position and a quaternion.
_TUM = re.compile(rb"(\s*#[^\n]*\n)*\s*([-+.\deE]+[ \t]+){7}[-+.\deE]+[ \t]*\r?(\n|$)")
_CARMEN = re.compile(rb"^(PARAM|ODOM|[FR]LASER|(ROBOT|RAW)LASER\d) ", re.MULTILINE)
_HEADINGS = {b"theta", b"yaw", b"qw", b"map_theta"}
_SNIFFED = 2000


def expected_files() -> str:
    """Return what was expected instead, for the end of a message."""
    *most, last = (stack.title for stack in STACKS.values())
    return f"expected a parameter file of {', '.join(most)} or {last}"


def own_model(path: Path) -> str:
    """Return which of beamfield's own models a file has by its top-level key, "likelihood_field" or "beam_model".

    "" for other files; FormatError if a .yaml is no YAML.
    """
    if path.suffix.lower() not in _YAML:
        return ""
    keys = read_yaml(path, number_keys=True, last_counts=True).values
    return next((model for model in ("likelihood_field", "beam_model") if model in keys), "")


def read_parameter_yaml(path: Path) -> YamlFile:
    """Read a YAML file that should hold a stack's parameters; FormatError says what a file of another kind is."""
    if path.suffix.lower() == ".json":
        raise FormatError(path, f"this is JSON, in which beamfield writes results, not parameters; {expected_files()}")
    try:
        file = read_yaml(path, number_keys=True, last_counts=True)
    except FormatError:
        kind = _kind_of_text(path)
        if kind:
            raise FormatError(path, f"{kind}; {expected_files()}") from None
        raise
    kind = next((kind for keys, kind in _KINDS.items() if keys <= file.values.keys()), "")
    if kind:
        raise FormatError(path, f"{kind}; {expected_files()}")
    return file


def _kind_of_text(path: Path) -> str:
    with path.open("rb") as stream:
        begin = stream.read(_SNIFFED)
    if begin.startswith((b"#ROSBAG", b"\x89MCAP")):
        return "this is a bag (give it with --log)"
    if _CARMEN.search(begin):
        return "this is a log (give it with --log)"
    columns = {word.strip(b' \t\r"') for word in begin.partition(b"\n")[0].lower().split(b",")}
    if _TUM.match(begin) or ({b"x", b"y"} <= columns and columns & _HEADINGS):
        return "this is a file of poses (give it with --poses)"
    return ""
