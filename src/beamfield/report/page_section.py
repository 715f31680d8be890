"""A section that a command adds to the report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from beamfield.report.escape import escaped

Level = Literal["good", "care", "bad"]


@dataclass(frozen=True)
class PageSection:
    """Part of the page with a heading of its own.

    Parameters
    ----------
    anchor
        Its name in the page, in kebab-case.
    title
        Its heading; plain text.
    markup
        HTML below the heading.
    verdict, level
        The answer, if this is the part that was asked for: it then opens the page. Empty for other parts.
    folded
        Whether it shows its heading alone until a click unfolds it: for evidence that few readers ask for.
    """

    anchor: str
    title: str
    markup: str
    verdict: str = ""
    level: Level = "good"
    folded: bool = False

    @classmethod
    def without(cls, anchor: str, title: str, reason: str) -> PageSection:
        """Return the section of a report whose log does not suffice for it."""
        return cls(anchor, title, f"<p>{escaped(reason)}</p>")
