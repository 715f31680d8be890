"""Values that a program cannot use, and names that it does not know."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Set
from dataclasses import replace
from typing import Any

from beamfield.io.files.yaml_file import shorten
from beamfield.stacks.doctor.diagnosis import Diagnosis
from beamfield.stacks.doctor.patient import Patient
from beamfield.stacks.files.parameter_file import MODELS, STACKS
from beamfield.stacks.files.parameter_text import Entry
from beamfield.stacks.files.typed_values import MOST, is_strict
from beamfield.stacks.files.yaml_sections import ROS_2_KEY
from beamfield.stacks.registry import parameter_names

# Names that differ by so little are a slip of the pen (difflib's ratio).
SIMILAR = 0.88
BEAM_SKIPPING = ("do_beamskip", "beam_skip_distance", "beam_skip_threshold", "beam_skip_error_threshold")
_OFF = Entry("do_beamskip", False, 0, 0, 0)
# Nodes share their section with parameters that beamfield does not know: motion model, frames, topics.
_OTHER_PREFIXES = (
    "alpha",
    "odom_alpha",
    "recovery_",
    "save_",
    "set_",
    "always_",
    "initial_",
    "tf_",
    "base_",
    "global_",
)


def unusable_values(patient: Patient) -> Iterator[Diagnosis]:
    """Find values of the wrong type, out of range, infinite or NaN, and models that the program does not have."""
    for name, fault, message in patient.typed.unusable:
        value: Any = patient.file.section.entries[name].value
        if fault == "filled-in":
            yield patient.finds(
                "filled-in-at-start", "info", f"{name} {message}",
                "the value is not known here, so it is not examined",
                "put the value in the file, or give the argument a default", own=name,
            )  # fmt: skip
        elif fault == "not-finite":
            yield _not_finite(patient, name, value)
        elif fault == "integer":
            yield patient.finds(
                "wrong-type", "error", f"{name} is the integer {value}",
                "ROS 2 declares it as a double and refuses an integer: the node does not start",
                f"write {value}.0", own=name,
            )  # fmt: skip
        elif fault == "range":
            yield patient.finds(
                "out-of-range", "error", f"{name} is {shorten(value)}: {message}", _out_of_range(patient, name),
                "see what it means and choose a value in its range", own=name,
                values={"value": float(value)} if abs(value) <= MOST else {},
            )  # fmt: skip
        elif fault == "model":
            yield _unknown_model(patient, value)
        else:
            yield patient.finds(
                "wrong-type", "error", f"{name}: {message}",
                "ROS 2 refuses the value: the node does not start" if is_strict(patient.file)
                else "amcl uses its default without a message" if patient.file.stack == "ros1"
                else "the program stops, or uses another value without a message",
                "write a value of the right type", own=name,
            )  # fmt: skip


def loaded_elsewhere(patient: Patient) -> Iterator[Diagnosis]:
    """Say that a launch file loads more parameters from another file."""
    for line, source in patient.file.section.elsewhere:
        yield replace(patient.finds(
            "loaded-elsewhere", "info", f"the node also takes parameters from {source}",
            "that file is not read here: parameters that this one lacks are taken to have their defaults",
            "examine that file as well",
        ), line=line)  # fmt: skip


def missing_ros_key(patient: Patient) -> Iterator[Diagnosis]:
    """Find parameters of a ROS 2 node that do not stand where ROS 2 reads them."""
    section = patient.file.section
    if not is_strict(patient.file) or section.syntax != "yaml":
        return
    if section.label.rsplit(".", 1)[-1] == ROS_2_KEY or "ros1" in patient.file.possible:
        return
    yield patient.finds(
        "no-ros-parameters-key", "error", f"the parameters do not stand below the key {ROS_2_KEY}",
        "ROS 2 reads a node's parameters only there, and takes the file for broken: the node does not start",
        f"put them below 'amcl:' and '{ROS_2_KEY}:'; if this is for ROS 1, the weights' names begin with laser_",
    )  # fmt: skip


def foreign_names(patient: Patient) -> Iterator[Diagnosis]:
    """Find parameters of another stack, and names one letter off."""
    own = {patient.file.name_in_file(name) for name in parameter_names(patient.file.stack)}
    entries = patient.file.section.entries
    strange = [
        name for name, entry in entries.items() if name not in own and (entry.value is not None or entry.filled_in)
    ]
    foreign = {name: stack for name in strange if (stack := _stack_with(name)) is not None}
    for name in foreign:
        if other := _counterpart(name, own):
            yield _foreign(patient, [name], foreign[name], other, other in entries)
    rest = [name for name in foreign if not _counterpart(name, own)]
    for stack in dict.fromkeys(foreign[name] for name in rest):
        yield _foreign(patient, [name for name in rest if foreign[name] == stack], stack, "", False)
    for name in strange:
        near = difflib.get_close_matches(name, own, n=1, cutoff=SIMILAR)
        if name not in foreign and near and near[0] not in entries and not name.startswith(_OTHER_PREFIXES):
            yield patient.finds(
                "misspelt-name", "warning", f"{name} looks like {near[0]}, which the file does not have",
                "parameters with unknown names are ignored silently",
                f"write {near[0]}, if that is meant", own=name,
            )  # fmt: skip


def stack_guess(patient: Patient) -> Iterator[Diagnosis]:
    """Say that a file could be another stack's."""
    if patient.file.stack_is_certain:
        return
    yield patient.finds(
        "stack-uncertain", "info", "read as nav2's, though nav2's and Beluga's files have the same names",
        "the same values mean different things there: Beluga's hit has the constant of a normal density",
        "say --stack beluga if that is what the robot runs",
    )  # fmt: skip


def _unknown_model(patient: Patient, value: str) -> Diagnosis:
    models = MODELS[patient.file.stack]
    near = difflib.get_close_matches(value, models, n=1)
    return patient.finds(
        "unknown-model", "error", f"laser_model_type is {shorten(value)}, which is no model of {patient.file.stack}",
        {
            "nav2": f"nav2 runs {models[0]} instead, without a message",
            "ros1": f"amcl runs {models[0]} instead; it only logs a warning",
            "beluga": "Beluga stops with an error: the robot does not localise",
        }[patient.file.stack] + f". The file is examined as one for {patient.file.model}",
        f"write {near[0]}" if near else f"write one of {', '.join(models)}", own="laser_model_type",
    )  # fmt: skip


def _not_finite(patient: Patient, name: str, value: float) -> Diagnosis:
    if name == "laser_max_range" and value > 0.0 and patient.file.stack in ("nav2", "ros1"):
        return patient.finds(
            "not-finite", "info", f"{name} is {value}", "the sensor's own limit holds then, as with -1.0",
            "write -1.0", own=name,
        )  # fmt: skip
    return patient.finds(
        "not-finite", "error", f"{name} is {value}",
        "programs compute on with it: weights become NaN, infinite or all the same. nav2 has crashed on it",
        "write a number", own=name,
    )  # fmt: skip


def _out_of_range(patient: Patient, name: str) -> str:
    if patient.name_of("max_beams") == name:
        if patient.file.stack == "beluga":
            return "without a beam there is nothing to weigh poses by"
        return "with fewer than two beams amcl does not look at scans at all"
    return "the model's formula means nothing with it"


def _stack_with(name: str) -> str | None:
    return next((stack for stack in STACKS if name in parameter_names(stack)), None)


def _foreign(patient: Patient, names: list[str], stack: str, other: str, has_other: bool) -> Diagnosis:
    are = "is a parameter" if len(names) == 1 else "are parameters"
    instead = f" and uses its default for {other}" if other and not has_other else ""
    # What is switched off there does nothing here either.
    is_off = set(names) <= set(BEAM_SKIPPING) and not patient.file.section.entries.get("do_beamskip", _OFF).value
    return patient.finds(
        "foreign-name", "info" if is_off else "warning",
        f"{', '.join(names)} {are} of {stack}, not of {patient.file.stack}",
        f"{patient.file.stack} silently ignores {'it' if len(names) == 1 else 'them'}{instead}",
        _rename(patient.file.stack, stack, other), own=names[0],
    )  # fmt: skip


def _counterpart(name: str, own: Set[str]) -> str:
    """Return the stack's own name for the same thing; "" if there is none."""
    other = name.removeprefix("laser_") if name.startswith("laser_") else f"laser_{name}"
    return other if other in own else ""


def _rename(stack: str, other_stack: str, name: str) -> str:
    if name and {stack, other_stack} <= {"nav2", "ros1"}:
        return f"call it {name} (values keep their meaning between ROS 1 and nav2)"
    if name:
        return f"call it {name} if the value is meant for {stack}; if it is {other_stack}'s: beamfield translate"
    return "leave it out; if the values are from there, beamfield translate gives those for this stack"
