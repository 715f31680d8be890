"""The one place that prints: names in files may hold characters that a terminal obeys."""

from __future__ import annotations

import json
import os
import shutil
import sys
import textwrap
from typing import Any, TextIO

from beamfield.printable import printable


def say(text: str) -> None:
    """Print lines on stdout; names that come from files have been through `printable`, as they may hold line ends."""
    print(printable(text, keep="\n"))


def say_json(document: Any) -> None:
    """Print a document as JSON."""
    # Its writer escapes all control characters but this one.
    print(json.dumps(document, indent=1, allow_nan=False).replace("\x7f", "\\u007f"))


def line_width() -> int | None:
    """Return the characters in a line of the terminal; None where output is no terminal's: there no line is broken."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def filled(sentences: str) -> str:
    """Return sentences broken into lines for a terminal; elsewhere they are one line."""
    width = line_width()
    return sentences if width is None else textwrap.fill(sentences, width)


def complain(text: str) -> None:
    """Print a warning, an error or a stage of the work on stderr: always one line."""
    try:
        print(printable(" ".join(text.split())), file=sys.stderr, flush=True)
    except OSError:  # its reader (head) has gone, or its disk is full: no reason to give up the work
        silence(sys.stderr)


def silence(stream: TextIO) -> None:
    """Let go of what could not be written to a stream, and of what comes."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
