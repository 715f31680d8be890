"""Read a stack's parameter file: which stack and model it is for, and its values; write changed values back."""

from __future__ import annotations

import math
import shutil
import stat
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.files.atomic import atomic_files
from beamfield.io.files.yaml_file import shorten
from beamfield.stacks.files.calibration_record import with_record
from beamfield.stacks.files.ini_sections import ini_sections
from beamfield.stacks.files.launch_sections import launch_sections
from beamfield.stacks.files.other_files import EXPECTED, read_parameter_yaml
from beamfield.stacks.files.parameter_text import ParameterSection, Value
from beamfield.stacks.files.yaml_sections import ROS_2_KEY, yaml_sections
from beamfield.stacks.ros1.parameters import PREFIXED, ros1_name

Stack = Literal["nav2", "ros1", "beluga", "mrpt", "f1tenth"]
STACKS: tuple[Stack, ...] = ("nav2", "ros1", "beluga", "mrpt", "f1tenth")

_AMCL_MODELS = ("likelihood_field", "likelihood_field_prob", "beam")
MODELS: Mapping[Stack, tuple[str, ...]] = {
    "nav2": _AMCL_MODELS,
    "ros1": _AMCL_MODELS,
    "beluga": _AMCL_MODELS,
    "mrpt": ("LF_Thrun", "rayTracing"),
    "f1tenth": ("table",),
}

# Names that only this stack has.
_SIGNS: Mapping[Stack, frozenset[str]] = {
    "beluga": frozenset(
        ("model_unknown_space", "only_obstacle_boundaries", "execution_policy", "spatial_resolution_x",
         "spatial_resolution_y", "spatial_resolution_theta", "selective_resampling", "point_cloud_topic")
    ),
    "f1tenth": frozenset(("squash_factor", "range_method", "theta_discretization", "angle_step")),
    "ros1": frozenset(map(ros1_name, PREFIXED)),
    "mrpt": frozenset(
        ("likelihoodMethod", "LF_stdHit", "LF_zHit", "LF_zRandom", "LF_maxRange", "LF_decimation",
         "LF_maxCorrsDistance", "LF_useSquareDist", "LF_alternateAverageMethod", "rayTracing_stdHit",
         "rayTracing_decimation", "rayTracing_useDistanceFilter", "enableLikelihoodCache")
    ),
}  # fmt: skip
_SHARED = frozenset(
    ("laser_model_type", *PREFIXED, "laser_likelihood_max_dist", "laser_max_range", "laser_min_range", "do_beamskip",
     "beam_skip_distance")
)  # fmt: skip
_NAV2_ONLY = frozenset(PREFIXED)
_KNOWN = _SHARED.union(*_SIGNS.values())
# MRPT numbers its models, or spells them with "lm" in front.
_MRPT_MODELS = {
    "1": "rayTracing", "lmRayTracing": "rayTracing", "4": "LF_Thrun", "lmLikelihoodField_Thrun": "LF_Thrun",
}  # fmt: skip


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
    is_prefixed
        Whether the file has ROS 1's names (laser_z_hit) for parameters that the stack's dataclass calls as nav2 does
        (z_hit): files of Beluga's node for ROS 1.
    """

    stack: Stack
    model: str
    section: ParameterSection
    possible: tuple[Stack, ...] = ()
    stack_is_said: bool = False
    is_prefixed: bool = False

    @property
    def stack_is_certain(self) -> bool:
        """False if the file can be another stack's, and nobody said whose it is."""
        return self.stack_is_said or len(self.possible) < 2

    def name_in_file(self, name: str) -> str:
        """Return what this file calls a parameter of the stack's dataclass."""
        return ros1_name(name) if self.is_prefixed else name

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
    if stack is not None:
        check_stack(stack)
    source = Path(path)
    chosen = _only(source, _sections(source), section)
    possible = _possible_stacks(chosen)
    found = possible[0] if stack is None else check_stack(stack)
    name = model or _model_of(found, chosen, unknown_model)
    is_prefixed = found == "beluga" and _has_prefixed_names(chosen)
    return StackFile(found, check_model(found, name), chosen, possible, stack is not None, is_prefixed)


def check_stack(name: str) -> Stack:
    """Return the stack of this name, or say which there are."""
    for stack in STACKS:
        if stack == name:
            return stack
    raise InvalidInputError(f"stack: expected one of {', '.join(STACKS)}, got {name!r}")


def check_model(stack: str, model: str) -> str:
    """Return the model if the stack has it, or say which it has."""
    models = MODELS[check_stack(stack)]
    if model not in models:
        raise InvalidInputError(f"model: {stack} has {', '.join(models)}, got {model!r}")
    return model


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
    InvalidInputError
        If the file has changed since it was read, or would not read as it should afterwards.
    FormatError
        If there is no place for a new parameter.
    OSError
        As the file system says; the file is then as it was.
    """
    path = section.path
    _refuse_read_only(path)
    before = path.read_bytes()
    mark = b"\xef\xbb\xbf" if before.startswith(b"\xef\xbb\xbf") and not section.text.startswith("\ufeff") else b""
    if before != mark + section.text.encode():
        raise InvalidInputError(f"{path}: the file has changed since it was read")
    after = section.with_values(values)
    if record:
        after = with_record(after, record, section.syntax)
    backup = _free_name(path)
    with atomic_files([backup, path]) as (old, part):
        old.write_bytes(before)
        shutil.copymode(path, old)
        part.write_bytes(mark + after.encode())
        if not _reads_as(part, section, values):
            raise InvalidInputError(
                f"{path}: the new values cannot be put into it without changing more; it is left as it is"
            )
    return backup


def check_patch_target(file: StackFile) -> None:
    """Say if a file is not one to write this stack's values into.

    Parameters
    ----------
    file
        From `read_stack_file`, with the stack whose values are to be written.

    Raises
    ------
    InvalidInputError
        If it is another stack's file.
    PermissionError
        If it is read-only.
    """
    if file.possible and file.stack not in file.possible and not file.is_prefixed:
        raise InvalidInputError(
            f"{file.section.path}: expected a file of {file.stack}, this is one of {' or '.join(file.possible)}"
        )
    _refuse_read_only(file.section.path)


def _refuse_read_only(path: Path) -> None:
    """Raise PermissionError if a file is read-only.

    Renaming a new file over it would work, but whoever made it read-only meant it.
    """
    if not path.stat().st_mode & (stat.S_IWUSR | stat.S_IWGRP | stat.S_IWOTH):
        raise PermissionError(13, "the file is read-only", str(path))


def _sections(path: Path) -> list[ParameterSection]:
    suffix = path.suffix.lower()
    if suffix == ".py":
        raise FormatError(path, "launch files in Python are not read; give the YAML file that it loads")
    if suffix in (".launch", ".xml"):
        return launch_sections(path, _KNOWN)
    if suffix in (".ini", ".cfg"):
        return ini_sections(path, _KNOWN)
    return yaml_sections(read_parameter_yaml(path), _KNOWN)


def _only(path: Path, sections: list[ParameterSection], label: str | None) -> ParameterSection:
    if label is not None:
        named = [section for section in sections if section.label == label]
        if len(named) != 1:
            named = [section for section in sections if str(section.line) == label] or named
        if not named:
            known = ", ".join(repr(section.label) for section in sections) or "none"
            raise FormatError(
                path, f"no section {shorten(label)} with parameters of a measurement model; there are {known}"
            )
        sections = named
    if not sections:
        raise FormatError(
            path,
            "no parameters of a measurement model found (z_hit, laser_z_hit, LF_stdHit, ... or an amcl node); "
            + EXPECTED,
        )
    if len(sections) > 1:
        labels = ", ".join(f"{section.label!r} (line {section.line})" for section in sections)
        raise FormatError(path, f"several sections have such parameters, choose by label or line one of {labels}")
    return sections[0]


def _possible_stacks(section: ParameterSection) -> tuple[Stack, ...]:
    if section.syntax == "ini":
        return ("mrpt",)
    names = set(section.entries)
    counts = {stack: len(names & signs) for stack, signs in _SIGNS.items()}
    if counts["f1tenth"] > counts["ros1"] + counts["beluga"] or "particle_filter" in (section.label, section.package):
        return ("f1tenth",)
    # Only ROS 2 has this key. Stray names of another stack do not change whose file it is.
    if section.package == "nav2_amcl":
        return ("nav2",)
    if section.label.rsplit(".", 1)[-1] == ROS_2_KEY:
        return ("beluga",) if counts["beluga"] else _by_label(section.label)
    if section.package == "beluga_amcl" and not counts["ros1"]:
        return ("beluga",)
    if section.syntax == "launch" or counts["ros1"]:
        # Beluga's node for ROS 1 has amcl's names, and some of its own.
        is_amcl = section.package == "amcl" or not (counts["beluga"] or section.package == "beluga_amcl")
        return ("ros1",) if is_amcl else ("beluga",)
    if counts["mrpt"]:
        return ("mrpt",)
    if counts["beluga"]:
        return ("beluga",)
    # What is left are names that both ROS versions have, unless nav2's own weights are among them.
    return ("nav2", "beluga") if names & _NAV2_ONLY else ("ros1",)


def _by_label(label: str) -> tuple[Stack, ...]:
    return ("f1tenth",) if "particle_filter" in label else ("nav2", "beluga")


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
    )


def _same(found: Value | None, expected: Value | None) -> bool:
    if isinstance(found, float) and isinstance(expected, float):
        # Files have six digits. NaN, which only old values can be, stays NaN.
        return math.isclose(found, expected, rel_tol=1e-5) or (math.isnan(found) and math.isnan(expected))
    numbers = isinstance(found, (int, float)) and isinstance(expected, (int, float))
    return found == expected and (numbers or type(found) is type(expected))


def _has_prefixed_names(section: ParameterSection) -> bool:
    """Whether a file of Beluga has the names of its node for ROS 1, or say that it mixes them with the other node's."""
    prefixed = [name for name in map(ros1_name, PREFIXED) if name in section.entries]
    # Where ROS 2 looks, ROS 1's names are only ignored.
    if not prefixed or section.label.rsplit(".", 1)[-1] == ROS_2_KEY:
        return False
    for name in PREFIXED:
        if name in section.entries:
            raise section.error(
                name, f"is a name of Beluga's node for ROS 2, {prefixed[0]} one of its node for ROS 1: keep one kind"
            )
    return True


def _model_of(stack: str, section: ParameterSection, unknown_model: str) -> str:
    if stack == "f1tenth":
        return "table"
    name = "likelihoodMethod" if stack == "mrpt" else "laser_model_type"
    entry = section.entries.get(name)
    if entry is None or entry.value is None:
        if entry is not None and entry.filled_in:
            message = f"expected the name of a model, got {entry.filled_in!r}, which is filled in elsewhere: say which"
            raise section.error(name, message)
        return "LF_Thrun" if stack == "mrpt" else "likelihood_field"
    model = str(entry.value)
    model = _MRPT_MODELS.get(model, model) if stack == "mrpt" else model
    if model not in MODELS[check_stack(stack)]:
        if stack != "mrpt" and unknown_model == "default":
            return MODELS[check_stack(stack)][0]
        known = ", ".join(MODELS[check_stack(stack)])
        raise section.error(name, f"no model of {stack} that beamfield knows ({known}), got {shorten(entry.value)}")
    return model


def _free_name(path: Path) -> Path:
    """Return a name for a backup beside the file; earlier backups stay."""
    candidate, number = path.with_name(path.name + ".bak"), 1
    while candidate.exists():
        number += 1
        candidate = path.with_name(f"{path.name}.bak{number}")
    return candidate
