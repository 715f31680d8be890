"""What a result or a file says about itself: named findings that people read and programs test for."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Literal

Severity = Literal["error", "warning", "info"]
_ORDER: Mapping[Severity, int] = {"error": 0, "warning": 1, "info": 2}


@dataclass(frozen=True)
class Finding:
    """Something a user should know before trusting a result or a parameter file.

    Parameters
    ----------
    name
        Short stable name in kebab-case, for programs.
    severity
        "error": a program stops, hangs or computes nonsense; "warning": the result is affected; "info": worth knowing.
    text
        What was seen, with its numbers, for people. Where `why` and `do` are empty it says that, too.
    values
        The numbers behind the text, in SI units.
    why
        Why it matters.
    do
        What to do.
    parameter
        The parameter it is about; "" for several or none.
    line
        That parameter's line in its file, from 1; None if it is in no file.
    """

    name: str
    severity: Severity
    text: str
    values: Mapping[str, float] = field(default_factory=dict)
    why: str = ""
    do: str = ""
    parameter: str = ""
    line: int | None = None

    @property
    def full_text(self) -> str:
        """What was seen, why it matters and what to do, as one paragraph."""
        return " ".join(part for part in (self.text, self.why, self.do) if part)


def worst_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return findings by severity, and as they were found within one."""
    return tuple(sorted(findings, key=lambda finding: _ORDER[finding.severity]))
