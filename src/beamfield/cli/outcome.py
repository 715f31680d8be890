"""What a command found, and the one place that says it: as text, on one line, or as JSON."""

from __future__ import annotations

import argparse
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from beamfield.cli.terminal import complain, say, say_json
from beamfield.cli.wording import in_options

# Keys of a document under which people are told what was seen and what to do.
SENTENCES = ("notes", "text", "why", "do", "explanation")


@dataclass(frozen=True)
class Outcome:
    """What a command found.

    Parameters
    ----------
    line
        The last line: what was written, or the result on one line.
    text
        What comes before it.
    document
        The result for --json, by name.
    notes
        What else is worth knowing; on stderr, as stdout may go into a file.
    wrote
        Files and folders written, or addresses.
    code, problem
        The exit code, and if it is 3, why.
    brief
        The result on one line, all that --quiet leaves; `line` if it is empty.
    """

    line: str
    text: str = ""
    document: Mapping[str, Any] | None = None
    notes: Sequence[str] = ()
    wrote: Sequence[Path | str] = ()
    code: int = 0
    problem: str = ""
    brief: str = ""


def show_notes(notes: Iterable[str], arguments: argparse.Namespace) -> None:
    """Print what is worth knowing, each note once, unless --quiet was given."""
    if not arguments.quiet:
        for note in dict.fromkeys(notes):
            complain(f"note: {in_options(note)}")


def show(outcome: Outcome, arguments: argparse.Namespace) -> None:
    """Print an outcome in the form asked for."""
    show_notes(outcome.notes, arguments)
    if arguments.json:
        said = {"command": arguments.command, "exit_code": outcome.code, "notes": list(outcome.notes)}
        wrote = [str(path) for path in outcome.wrote]
        say_json(_sentences_in_options({**said, "wrote": wrote, **(outcome.document or {})}))
    else:
        if outcome.text and not arguments.quiet:
            say(f"{outcome.text}\n")
        say(outcome.brief if arguments.quiet and outcome.brief else outcome.line)
    if outcome.problem:
        complain(f"beamfield: warning: {in_options(outcome.problem)}")


def _sentences_in_options(value: Any, key: str = "") -> Any:
    """Return a document in which sentences name options; names, such as a sensor's, stay as they are."""
    if isinstance(value, Mapping):
        return {name: _sentences_in_options(one, name) for name, one in value.items()}
    if isinstance(value, list | tuple):
        return [_sentences_in_options(one, key) for one in value]
    return in_options(value) if key in SENTENCES and isinstance(value, str) else value
