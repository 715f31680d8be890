"""Read a stack's parameter file: which stack and model it is for, and its values; write changed values back."""

from __future__ import annotations

import math
import re
import shutil
import stat
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, Literal

from beamfield.errors import FormatError
from beamfield.io.files.atomic import atomic_files
from beamfield.io.files.yaml_file import shorten
from beamfield.stacks.files.calibration_record import with_record
from beamfield.stacks.files.other_files import expected_files, read_parameter_yaml
from beamfield.stacks.registry import STACKS, stack_named
from beamfield.stacks.stack import Model, OtherNode, Stack
from beamfield.stacks.syntax.ini_sections import ini_sections
from beamfield.stacks.syntax.launch_sections import launch_sections
from beamfield.stacks.syntax.parameter_text import ODD_BYTES, ParameterSection, Signs, Value
from beamfield.stacks.syntax.yaml_sections import yaml_sections


@dataclass(frozen=True, eq=False)
class StackFile:
    """A parameter file of another program.

    Parameters
    ----------
    stack, model
        Whose file it is, and the measurement model that it chooses (or the stack's default).
    section
        The parameters and their places in the text.
    possible
        Whose file it can be by what stands in it, the likeliest first: nav2's and Beluga's look alike.
    stack_is_said
        Whether `stack` was said, not found out.
    is_of_other_node
        Whether the file has the names of the program's other node: Beluga's for ROS 1 has laser_z_hit for z_hit.
    """

    stack: str
    model: str
    section: ParameterSection
    possible: tuple[str, ...] = ()
    stack_is_said: bool = False
    is_of_other_node: bool = False

    @property
    def stack_is_certain(self) -> bool:
        """False if the file can be another stack's, and nobody said whose it is."""
        return self.stack_is_said or len(self.possible) < 2

    @property
    def program(self) -> Stack:
        """Whose file it is."""
        return stack_named(self.stack)

    @property
    def described_model(self) -> Model:
        """The measurement model that it chooses."""
        return self.program.model(self.model)

    @property
    def is_typed(self) -> bool:
        """Whether the program declares each parameter's type and stops if the file has another."""
        return self.program.is_typed and not self.is_of_other_node

    @property
    def is_roscpp(self) -> bool:
        """Whether ROS 1's C++ library reads the program's parameters."""
        return self.program.is_roscpp or self.is_of_other_node

    @property
    def of_filter(self) -> StackFile:
        """The file with the parameters of motion model and particles, which some programs keep elsewhere in it."""
        described = self.program.filter
        if described is None or described.section is None:
            return self
        return replace(self, section=described.section(self.section))

    @property
    def unread(self) -> tuple[str, ...]:
        """A note for each place from which the node takes more parameters: they are not read, and count as defaults."""
        where = self.section.path
        return tuple(
            f"{where}:{line}: the node also takes parameters from {source}, which is not read here"
            for line, source in self.section.elsewhere
        )

    def name_in_file(self, name: str) -> str:
        """Return what this file calls a parameter of the stack's dataclass."""
        other = self.program.other_node if self.is_of_other_node else None
        return name if other is None else other.names.get(name, name)

    def defaults_of(self, kind: type[Any]) -> dict[str, Value]:
        """Return the defaults for a dataclass of the stack's that this file's node has, where they are others."""
        other = self.program.other_node if self.is_of_other_node else None
        known = {} if other is None else other.defaults
        return {item.name: known[item.name] for item in fields(kind) if item.name in known}

    def by_names_in_file(self, values: Mapping[str, Value]) -> dict[str, Value]:
        """Return values of the stack's parameters under the names that this file has for them."""
        return {self.name_in_file(name): value for name, value in values.items()}


def read_stack_file(
    path: str | Path,
    *,
    stack: str | None = None,
    model: str | None = None,
    section: str | None = None,
    unknown_model: Literal["refuse", "default"] = "refuse",
) -> StackFile:
    """Read a parameter file of nav2, ROS 1 amcl, Beluga, MRPT or F1TENTH.

    Parameters
    ----------
    path
        A YAML file, a ROS 1 launch file (.launch or .xml) or an MRPT .ini file.
    stack, model
        What it is for; None finds out.
    section
        Label of the section to take if there are several: "amcl.ros__parameters", the name of a node, an ini section;
        or its line, where labels are the same.
    unknown_model
        "refuse" a file with a laser_model_type that there is not, or take the "default", as nav2 and ROS 1 do.

    Raises
    ------
    InvalidInputError
        If there is no such stack or model.
    FormatError
        If the file cannot be read, is one of another kind, has no parameters of a measurement model, or several
        sections that have; or if a file of Beluga has names of both its nodes, for ROS 1 and ROS 2.
    OSError
        As the file system says.
    """
    said = None if stack is None else stack_named(stack)
    source = Path(path)
    chosen = _only(source, _sections(source), section)
    possible = _possible_stacks(chosen)
    found = said or stack_named(possible[0])
    name = model or _model_of(found, chosen, unknown_model)
    is_other = found.other_node is not None and _has_other_names(found, found.other_node, chosen)
    return StackFile(found.name, found.model(name).name, chosen, possible, said is not None, is_other)


def write_values(section: ParameterSection, values: Mapping[str, Value], *, record: str = "") -> Path:
    """Change parameters in the user's file, keeping everything else, and return the path of a backup.

    Parameters
    ----------
    section
        From `read_stack_file`.
    values
        By name, as in the file.
    record
        A comment for the file's last line; "" for none.

    Raises
    ------
    PermissionError
        If the file is read-only.
    FormatError
        If the file has changed since it was read, would not read as it should afterwards, or has no place for a new
        parameter.
    OSError
        As the file system says; the file is then as it was.
    """
    path = section.path
    _refuse_read_only(path)
    before = path.read_bytes()
    mark = b"\xef\xbb\xbf" if before.startswith(b"\xef\xbb\xbf") and not section.text.startswith("\ufeff") else b""
    if before != mark + section.text.encode("utf-8", ODD_BYTES):
        raise FormatError(path, "the file has changed since it was read")
    after = section.with_values(values)
    if record:
        after = with_record(after, record, section.syntax)
    backup = _free_name(path)
    with atomic_files([backup, path]) as (old, part):
        old.write_bytes(before)
        shutil.copymode(path, old)
        part.write_bytes(mark + after.encode("utf-8", ODD_BYTES))
        if not _reads_as(part, section, values):
            raise FormatError(
                path, "the new values cannot be written without changing other parts; the file is unchanged"
            )
    return backup


def check_patch_target(file: StackFile) -> None:
    """Refuse a file that is another stack's than that whose values are to be written (FormatError), or read-only."""
    if file.possible and file.stack not in file.possible and not file.is_of_other_node:
        raise FormatError(
            file.section.path, f"expected a file of {file.stack}, this is one of {' or '.join(file.possible)}"
        )
    _refuse_read_only(file.section.path)


def _refuse_read_only(path: Path) -> None:
    """Raise PermissionError if a file is read-only.

    Renaming a new file over it would work, but whoever made it read-only meant it.
    """
    if not path.stat().st_mode & (stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH):
        raise PermissionError(13, "the file is read-only", str(path))


def _sections(path: Path) -> list[ParameterSection]:
    # A backup that `write_values` kept is read as the file it was.
    suffix, signs = Path(re.sub(r"\.bak\d*$", "", path.name)).suffix.lower(), _signs()
    if suffix == ".py":
        raise FormatError(path, "Python launch files are not supported; give the YAML file that it loads")
    if suffix in (".launch", ".xml"):
        return launch_sections(path, signs)
    if suffix in (".ini", ".cfg"):
        return ini_sections(path, signs.names)
    return yaml_sections(read_parameter_yaml(path), signs)


def _signs() -> Signs:
    """Return by what the files of all stacks are recognised."""
    stacks = STACKS.values()
    return Signs(
        frozenset().union(*(stack.signs for stack in stacks)),
        tuple({node: None for stack in stacks for node in stack.nodes}),
        tuple({package: None for stack in stacks for package in stack.packages}),
    )


def _only(path: Path, sections: list[ParameterSection], label: str | None) -> ParameterSection:
    if label is not None:
        named = [section for section in sections if section.label == label]
        if len(named) != 1:
            named = [section for section in sections if str(section.line) == label] or named
        if not named:
            known = ", ".join(repr(section.label) for section in sections) or "none"
            raise FormatError(
                path, f"no section {shorten(label)} with parameters of a measurement model; known sections: {known}"
            )
        sections = named
    if not sections:
        raise FormatError(
            path,
            "no parameters of a measurement model found (z_hit, laser_z_hit, LF_stdHit, ... or an amcl node); "
            + expected_files(),
        )
    if len(sections) > 1:
        labels = ", ".join(f"{section.label!r} (line {section.line})" for section in sections)
        raise FormatError(path, f"several sections have such parameters, give section by label or line: {labels}")
    return sections[0]


def _possible_stacks(section: ParameterSection) -> tuple[str, ...]:
    """Return whose section it can be, the likeliest first."""
    likeness = {name: stack.likeness(section) for name, stack in STACKS.items()}
    return tuple(name for name, value in likeness.items() if value == max(likeness.values()))


def _reads_as(path: Path, section: ParameterSection, values: Mapping[str, Value]) -> bool:
    """Whether the section in this file has the new values, and the old ones where there are no new ones."""
    try:
        found = [item for item in _sections(path) if (item.label, item.line) == (section.label, section.line)]
    except FormatError:
        return False
    expected = {name: entry.value for name, entry in section.entries.items()} | dict(values)
    return (
        len(found) == 1
        and found[0].entries.keys() == expected.keys()
        and all(_same(found[0].entries[name].value, value) for name, value in expected.items())
        and all(len(found[0].entries[name].others) == len(old.others) for name, old in section.entries.items())
    )


def _same(found: Value | None, expected: Value | None) -> bool:
    if isinstance(found, float) and isinstance(expected, float):
        # Files have six digits. NaN, which only old values can be, stays NaN.
        return math.isclose(found, expected, rel_tol=1e-5) or (math.isnan(found) and math.isnan(expected))
    # True is not 1 to the programs.
    return found == expected and isinstance(found, bool) == isinstance(expected, bool)


def _has_other_names(stack: Stack, node: OtherNode, section: ParameterSection) -> bool:
    """Whether a file has the names of the program's node for ROS 1, or say that it mixes them with the other node's."""
    others = [name for name in node.names.values() if name in section.entries]
    # Where ROS 2 looks, ROS 1's names are only ignored.
    if not others or section.is_ros_2:
        return False
    for name in node.names:
        if name in section.entries:
            raise section.error(
                name,
                f"is a name of {stack.title}'s node for ROS 2, {others[0]} one of its node for ROS 1: keep one kind",
            )
    return True


def _model_of(stack: Stack, section: ParameterSection, unknown_model: str) -> str:
    entry = section.entries.get(stack.model_key)
    if entry is None or entry.value is None:
        if entry is not None and entry.filled_in:
            message = (
                f"expected the name of a model, got {entry.filled_in!r}, which is substituted at launch: write the name"
            )
            raise section.error(stack.model_key, message)
        return stack.default_model
    for name, model in stack.models.items():
        if str(entry.value) in map(str, model.in_file):
            return name
    if stack.unknown_model and unknown_model == "default":
        return stack.default_model
    known = ", ".join(stack.models)
    message = f"no model of {stack.name} that beamfield knows ({known}), got {shorten(entry.value)}"
    raise section.error(stack.model_key, message)


def _free_name(path: Path) -> Path:
    """Return a name for a backup beside the file; earlier backups stay."""
    candidate, number = path.with_name(path.name + ".bak"), 1
    while candidate.exists():
        number += 1
        candidate = path.with_name(f"{path.name}.bak{number}")
    return candidate
