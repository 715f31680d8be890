"""One thing that is wrong with a parameter file, or worth knowing about it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

Severity = Literal["error", "warning", "info"]
_ORDER: Mapping[Severity, int] = {"error": 0, "warning": 1, "info": 2}


@dataclass(frozen=True)
class Diagnosis:
    """A finding of the doctor.

    Parameters
    ----------
    name
        Short stable name in kebab-case; docs/doctor.md has a section of that name.
    severity
        "error": the program stops, hangs or computes nonsense; "warning": it localises worse than it could; "info":
        worth knowing.
    seen
        What was found, with its numbers.
    why
        Why it matters.
    remedy
        What to do.
    parameter
        The parameter it is about; "" for several or none.
    line
        Its line in the parameter file, from 1; None if it is not there.
    values
        The numbers behind it, in SI units.
    """

    name: str
    severity: Severity
    seen: str
    why: str
    remedy: str
    parameter: str = ""
    line: int | None = None
    values: Mapping[str, float] = field(default_factory=dict)


def worst_first(found: list[Diagnosis]) -> tuple[Diagnosis, ...]:
    """Return diagnoses by severity, and as they were found within one."""
    return tuple(sorted(found, key=lambda item: _ORDER[item.severity]))
