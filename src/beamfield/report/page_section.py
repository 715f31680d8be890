"""A section that a command adds to the report."""

from __future__ import annotations

from dataclasses import dataclass


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
    """

    anchor: str
    title: str
    markup: str
