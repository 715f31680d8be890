"""Values that a program cannot use, and names that it does not know."""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterator, Set

from beamfield.stacks.doctor.diagnosis import Diagnosis
from beamfield.stacks.doctor.patient import Patient
from beamfield.stacks.parameter_file import STACKS
from beamfield.stacks.registry import parameter_names

# Names that differ by so little are a slip of the pen (difflib's ratio).
SIMILAR = 0.88
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
    """Find values of the wrong type, out of range, infinite or NaN."""
    for name, message in patient.typed.unusable:
        value = patient.file.section.entries[name].value
        if isinstance(value, float) and not math.isfinite(value):
            yield patient.finds(
                "not-finite", "error", f"{name} is {value}",
                "every weight computed with it is NaN or infinite; nav2 has crashed on it",
                "write a number", own=name,
            )  # fmt: skip
        elif "ROS 2 declares" in message:
            yield patient.finds(
                "wrong-type", "error", f"{name} is the integer {value}",
                "ROS 2 declares it as a double and refuses an integer: the node does not start",
                f"write {value}.0", own=name,
            )  # fmt: skip
        elif isinstance(value, (int, float)) and not isinstance(value, bool) and "whole number" not in message:
            yield patient.finds(
                "out-of-range", "error", f"{name} is {value}: {message}",
                "the weights that come of it mean nothing",
                "see what it means and choose a value in its range", own=name, values={"value": float(value)},
            )  # fmt: skip
        else:
            yield patient.finds(
                "wrong-type", "error", f"{name}: {message}",
                "the program stops, or takes its default without a word",
                "write a value of the right type", own=name,
            )  # fmt: skip


def foreign_names(patient: Patient) -> Iterator[Diagnosis]:
    """Find parameters of another stack, and names one letter off."""
    own = parameter_names(patient.file.stack)
    for name, entry in patient.file.section.entries.items():
        if name in own or entry.value is None:
            continue
        for stack in STACKS:
            if stack != patient.file.stack and name in parameter_names(stack):
                yield patient.finds(
                    "foreign-name", "warning", f"{name} is a parameter of {stack}, not of {patient.file.stack}",
                    f"{patient.file.stack} ignores it without a word and uses its own default",
                    _own_name(name, own), own=name,
                )  # fmt: skip
                break
        else:
            near = difflib.get_close_matches(name, own, n=1, cutoff=SIMILAR)
            if near and near[0] not in patient.file.section.entries and not name.startswith(_OTHER_PREFIXES):
                yield patient.finds(
                    "misspelt-name", "warning", f"{name} looks like {near[0]}, which the file does not have",
                    "a parameter with an unknown name is ignored without a word",
                    f"write {near[0]}, if that is meant", own=name,
                )  # fmt: skip


def stack_guess(patient: Patient) -> Iterator[Diagnosis]:
    """Say that a file could be another stack's."""
    if not patient.file.stack_is_certain:
        yield patient.finds(
            "nav2-or-beluga", "info", "read as nav2's; nothing in it tells nav2 from Beluga",
            "the same values mean different things there: Beluga's hit has the constant of a normal density",
            "say --stack beluga if that is what the robot runs",
        )  # fmt: skip


def _own_name(name: str, own: Set[str]) -> str:
    other = name.removeprefix("laser_") if name.startswith("laser_") else f"laser_{name}"
    if other in own:
        return f"call it {other} (values keep their meaning between ROS 1 and nav2)"
    return "remove it, or translate the file: beamfield translate"
