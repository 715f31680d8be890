"""Text that may come from a file, made safe to show."""

from __future__ import annotations


def printable(text: str, *, keep: str = "") -> str:
    r"""Return a text with every character that does not print, but for those to keep, as a backslash escape.

    Control characters move a terminal's cursor, change its title or hide what stands before them; marks of direction
    turn the rest of a line around. Line ends are among them: a name must not begin a line of its own.

    Examples
    --------
    >>> print(printable("/scan\x1b[2J\n\u202eerror"))
    /scan\x1b[2J\n\u202eerror
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in keep else c.encode("unicode_escape").decode("ascii") for c in text)
