"""What learning one more model adds to the outputs of ``beamfield calibrate``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from beamfield.finding import Finding
    from beamfield.report.page_section import PageSection


@dataclass(frozen=True)
class ReportPart:
    """A model that is learned beside the beam model.

    Parameters
    ----------
    name
        In calibration.json.
    table
        For the terminal.
    document
        For calibration.json.
    section
        For the report.
    files
        Parameter files by name; none if there was too little to learn from.
    findings
        What to know before trusting it.
    problem
        Why a model that was asked for could not be learned: the exit code is 3 then.
    """

    name: str
    table: str
    document: Mapping[str, Any]
    section: PageSection
    files: Mapping[str, str | bytes] = field(default_factory=dict)
    findings: tuple[Finding, ...] = ()
    problem: str = ""


@dataclass(frozen=True)
class StackPart(ReportPart):
    """Another program's model, fitted in its own formula.

    Parameters
    ----------
    values
        The parameters that changed, for a file that is patched.
    record
        The comment by which `beamfield doctor` knows the values again; "" if they did not do well.
    doubt
        Why no file may be changed; empty if one may.
    """

    values: Mapping[str, Any] | None = None
    record: str = ""
    doubt: str = ""
