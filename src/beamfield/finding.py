"""What a result says about itself: named findings that people read and programs test for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class Finding:
    """Something a user should know before trusting a result.

    Parameters
    ----------
    name
        Short stable name in kebab-case, for programs.
    severity
        "info": worth knowing; "warning": the result is affected.
    text
        One or two sentences for people: what was seen, why it matters, what to do.
    values
        The numbers behind the text, in SI units.
    """

    name: str
    severity: Literal["info", "warning"]
    text: str
    values: Mapping[str, float] = field(default_factory=dict)
