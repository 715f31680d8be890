"""Text in a page: escaped, and without characters that do not print."""

from __future__ import annotations

import html

from beamfield.printable import printable


def escaped(value: object) -> str:
    r"""Return a value as text for HTML or SVG, in elements and in attributes; it may come from a file.

    Examples
    --------
    >>> escaped("<b>\x1b[31m")
    '&lt;b&gt;\\x1b[31m'
    """
    return html.escape(printable(str(value), keep="\n\t"), quote=True)
