"""Values that a program cannot use, and names that it does not know."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator
from dataclasses import fields, replace
from typing import Any

from beamfield.finding import Finding
from beamfield.io.files.yaml_file import shorten
from beamfield.stacks.doctor.subject import Subject
from beamfield.stacks.files.typed_values import MOST, Unusable, typed_fields, wrong_types
from beamfield.stacks.registry import STACKS
from beamfield.stacks.stack import Stack, counterpart
from beamfield.stacks.syntax.parameter_text import ROS_2_KEY, Entry

# Names that differ by so little are a slip of the pen (difflib's ratio).
SIMILAR = 0.88
BEAM_SKIPPING = ("do_beamskip", "beam_skip_distance", "beam_skip_threshold", "beam_skip_error_threshold")
# Pairs of names of motion model and particles, of ROS 1 and of ROS 2.
_OF_FILTERS = {
    "odom_model_type": "robot_model_type", "kld_err": "pf_err", "kld_z": "pf_z",
    **{f"odom_alpha{i}": f"alpha{i}" for i in range(1, 6)},
}  # fmt: skip
_OFF = Entry("do_beamskip", False, 0, 0, 0)
# Nodes share their section with parameters that beamfield does not know: motion model, frames, topics.
_OTHER_PREFIXES = (
    "alpha", "odom_alpha", "recovery_", "save_", "set_", "always_", "initial_", "tf_", "base_", "global_",
)  # fmt: skip


def unusable_values(subject: Subject) -> Iterator[Finding]:
    """Find values of the wrong type, out of range, infinite or NaN, and models that the program does not have."""
    for entry, (name, fault, message) in _unusable(subject):
        value: Any = entry.value
        if fault == "filled-in":
            yield subject.finding(
                "filled-in-at-start", "info", f"{name} {message}",
                "the value is unknown here, so it is not checked",
                "put the value in the file, or give the argument a default", own=name,
            )  # fmt: skip
        elif fault == "not-finite":
            yield _not_finite(subject, name, value)
        elif fault == "integer":
            yield replace(subject.finding(
                "wrong-type", "error", f"{name} is the integer {value}",
                "ROS 2 declares it as a double and refuses an integer: the node does not start",
                f"write {value}.0", own=name,
            ), line=entry.line)  # fmt: skip
        elif fault == "range":
            is_count = subject.name_of("max_beams") == name
            yield subject.finding(
                "out-of-range", "error", f"{name} is {shorten(value)}: {message}",
                subject.stack.too_few_beams if is_count else "the model's formula is meaningless with it",
                "look up its meaning and choose a valid value", own=name,
                values={"value": float(value)} if abs(value) <= MOST else {},
            )  # fmt: skip
        elif fault == "model":
            yield _unknown_model(subject, value)
        elif fault == "name":
            yield subject.finding(
                "unknown-name", "error", f"{name}: {message}",
                "the node does not start, unless a plugin of yours has that name" if subject.file.is_typed
                else subject.stack.wrong_type,
                "write one of these names", own=name,
            )  # fmt: skip
        else:
            yield replace(subject.finding(
                "wrong-type", "error", f"{name}: {message}",
                "ROS 2 refuses the value: the node does not start" if subject.file.is_typed
                else subject.stack.wrong_type,
                "write a value of the right type", own=name,
            ), line=entry.line)  # fmt: skip


def beyond_limits(subject: Subject) -> Iterator[Finding]:
    """Find values that the program can compute with but refuses."""
    entries, known = subject.file.section.entries, {item.name for _, item in _unusable(subject)}
    for name, (least, most) in subject.stack.limits.items() if subject.file.is_typed else ():
        value = entries[name].value if name in entries and name not in known else None
        if isinstance(value, int | float) and not least <= value <= most:
            bounds = f"{least:g} or more" if most == math.inf else f"{least:g} to {most:.4g}"
            yield subject.finding(
                "out-of-range", "error", f"{name} is {value:g}, and {subject.stack.title} takes {bounds}",
                "ROS 2 refuses the value: the node does not start", f"write a value of {bounds}", own=name,
                values={"value": float(value)},
            )  # fmt: skip


def given_again(subject: Subject) -> Iterator[Finding]:
    """Find parameters that the file gives several times with different values, of which one counts."""
    own = {subject.file.name_in_file(name) for name in subject.stack.parameter_names}
    for entry in subject.file.section.entries.values():
        others = [(line, value) for line, value in entry.others if value != entry.value]
        if others:
            given = ", ".join(f"{value} in line {line}" for line, value in others)
            yield subject.finding(
                "given-again", "warning" if entry.name in own else "info",
                f"{entry.name} is {given}, and {entry.filled_in or entry.value} here",
                "only this one counts, without a message: changes to the others have no effect",
                "keep one", own=entry.name,
            )  # fmt: skip


def loaded_elsewhere(subject: Subject) -> Iterator[Finding]:
    """Report a launch file whose node gets more parameters from another file, or from tags outside of it."""
    for line, source in subject.file.section.elsewhere:
        yield replace(subject.finding(
            "loaded-elsewhere", "info", f"the node also takes parameters from {source}",
            "those are not read here: parameters missing from the node are assumed at their defaults",
            "check them as well",
        ), line=line)  # fmt: skip


def missing_ros_key(subject: Subject) -> Iterator[Finding]:
    """Find parameters of a ROS 2 node that do not stand where ROS 2 reads them."""
    section = subject.file.section
    if not subject.file.is_typed or section.syntax != "yaml":
        return
    if section.is_ros_2 or not any(STACKS[name].is_typed for name in subject.file.possible):
        return
    yield subject.finding(
        "no-ros-parameters-key", "error", f"the parameters are not below the key {ROS_2_KEY}",
        "ROS 2 reads a node's parameters only there and rejects the file: the node does not start",
        f"put them below 'amcl:' and '{ROS_2_KEY}:'; if this is for ROS 1, the weights' names begin with laser_",
    )  # fmt: skip


def foreign_names(subject: Subject) -> Iterator[Finding]:
    """Find parameters of another stack, and names one letter off."""
    own = {subject.file.name_in_file(name) for name in subject.stack.parameter_names}
    entries = subject.file.section.entries
    strange = [
        name for name, entry in entries.items() if name not in own and (entry.value is not None or entry.filled_in)
    ]
    owners = {name: stack.name for stack in reversed(STACKS.values()) for name in stack.parameter_names}
    foreign = {name: owners[name] for name in strange if name in owners}
    for stack in dict.fromkeys(foreign.values()):
        names = [name for name, owner in foreign.items() if owner == stack]
        named = [name for name in names if counterpart(name, own)]
        if named:
            yield _foreign(subject, named, stack, [counterpart(name, own) for name in named])
        if rest := [name for name in names if name not in named]:
            yield _foreign(subject, rest, stack, [])
    yield from _foreign_names_of_filter(subject)
    for name in strange:
        near = [one for one in own if sorted(one.lower()) == sorted(name.lower())]  # two letters swapped, or large
        near = near or difflib.get_close_matches(name, own, n=1, cutoff=SIMILAR)
        if name not in foreign and near and near[0] not in entries and not name.startswith(_OTHER_PREFIXES):
            yield subject.finding(
                "misspelt-name", "warning", f"{name} looks like {near[0]}, which the file does not have",
                "parameters with unknown names are ignored silently",
                f"write {near[0]}, if that is intended", own=name,
            )  # fmt: skip


def _foreign_names_of_filter(subject: Subject) -> Iterator[Finding]:
    """Find names of motion model and particles that ROS 1 has in a file for ROS 2, and the other way round."""
    described = subject.stack.filter
    kinds = () if described is None else (described.motion, described.parameters)
    own = {subject.file.name_in_file(item.name) for kind in kinds for item in fields(kind)}
    pairs = _OF_FILTERS | {name: other for other, name in _OF_FILTERS.items()}
    entries = subject.file.section.entries
    instead = {name: pairs[name] for name in entries if name in pairs and name not in own and pairs[name] in own}
    if instead:
        they, are = ("it", "is no parameter") if len(instead) == 1 else ("them", "are no parameters")
        missing = [name for name in instead.values() if name not in entries]
        yield subject.finding(
            "foreign-name", "warning", f"{', '.join(instead)} {are} of {subject.file.stack}",
            f"it silently ignores {they}" + (f" and takes the default of {', '.join(missing)}" if missing else ""),
            f"call {they} {', '.join(instead.values())}; motion models of the two may read a value differently, so "
            "compare with beamfield evaluate", own=next(iter(instead)),
        )  # fmt: skip


def _unusable(subject: Subject) -> Iterator[tuple[Entry, Unusable]]:
    """Yield what cannot be used of the measurement model's values, the motion model's, the particles' and others."""
    for item in subject.typed.unusable:
        yield subject.file.section.entries[item.name], item
    described, file = subject.stack.filter, subject.file.of_filter
    for kind in () if described is None else (described.motion, described.parameters):
        for item in typed_fields(file, kind).unusable:
            yield file.section.entries[item.name], item
    yield from wrong_types(subject.file)


def _unknown_model(subject: Subject, value: str) -> Finding:
    models, key = tuple(subject.stack.models), subject.stack.model_key
    near = difflib.get_close_matches(value, models, n=1)
    return subject.finding(
        "unknown-model", "error", f"{key} is {shorten(value)}, which is not a model of {subject.stack.name}",
        f"{subject.stack.unknown_model}. The file is examined as one for {subject.model.name}",
        f"write {near[0]}" if near else f"write one of {', '.join(models)}", own=key,
    )  # fmt: skip


def _not_finite(subject: Subject, name: str, value: float) -> Finding:
    if name == "laser_max_range" and value > 0.0 and subject.stack.takes_lesser_limit:
        return subject.finding(
            "not-finite", "info", f"{name} is {value}", "the sensor's own limit then applies, as with -1.0",
            "write -1.0", own=name,
        )  # fmt: skip
    return subject.finding(
        "not-finite", "error", f"{name} is {value}",
        "programs keep computing with it: weights become NaN, infinite or all the same. nav2 has crashed on it",
        "write a number", own=name,
    )  # fmt: skip


def _foreign(subject: Subject, names: list[str], stack: str, others: list[str]) -> Finding:
    """Return the finding of names of another stack, and of what they are called here, if they have such names."""
    are = "is a parameter" if len(names) == 1 else "are parameters"
    missing = [other for other in others if other not in subject.file.section.entries]
    instead = (
        f" and uses {'its default' if len(missing) == 1 else 'defaults'} for {', '.join(missing)}" if missing else ""
    )
    # What is switched off there does nothing here either.
    is_off = set(names) <= set(BEAM_SKIPPING) and not subject.file.section.entries.get("do_beamskip", _OFF).value
    return subject.finding(
        "foreign-name", "info" if is_off else "warning",
        f"{', '.join(names)} {are} of {stack}, not of {subject.file.stack}",
        f"{subject.file.stack} silently ignores {'it' if len(names) == 1 else 'them'}{instead}",
        _rename(subject.stack, STACKS[stack], others), own=names[0],
    )  # fmt: skip


def _rename(stack: Stack, other: Stack, names: list[str]) -> str:
    call = f"call {'it' if len(names) == 1 else 'them'} {', '.join(names)}"
    if names and stack.has_same_formulas(other):
        return f"{call} (values mean the same in {other.name} and {stack.name})"
    if names:
        return f"{call} if meant for {stack.name}; if meant for {other.name}: beamfield translate"
    return "leave it out; if the values are from there, beamfield translate gives those for this stack"
