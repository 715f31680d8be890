"""A comment in a parameter file that says which values beamfield calibrated, and a check that they are still there."""

from __future__ import annotations

import hashlib
import re
from dataclasses import asdict
from typing import Any

from beamfield.stacks.syntax.line_ends import line_break
from beamfield.stacks.syntax.parameter_text import Syntax

# A copy of the map for amcl alone, with the origin that makes it see walls where they are; and a picture of its own, if
# what is black and no wall is unknown there.
MOVED_MAP, MOVED_PICTURE = "amcl_map.yaml", "amcl_map.pgm"
_MARK = "calibrated by beamfield"
_OF_MAP = re.compile(rf"{_MARK}|chosen for the map|for the map {re.escape(MOVED_MAP)}")
_RECORD = re.compile(rf"{_MARK} [^\n]*?checksum ([0-9a-f]{{16}})")


def record_text(stack: str, model: str, parameters: Any, motion: Any, version: str, judged: str) -> str:
    """Return the text of a record: of all parameters of both models, and how well they did, for the reader.

    `motion` is the motion model; None where its parameters are not written.
    """
    checksum = values_checksum(stack, model, parameters, motion)
    return f"{stack} {model}: {_MARK} {version}, {judged}; checksum {checksum} of the values"


def is_as_calibrated(text: str, stack: str, model: str, parameters: Any, motion: Any) -> bool:
    """Whether the text of a file has a record of these very parameters: any change since then voids it."""
    return values_checksum(stack, model, parameters, motion) in _RECORD.findall(text)


def notes_values(record: str) -> bool:
    """Whether a record is of values, not only of a map."""
    return _RECORD.search(record) is not None


def is_noted(record: str, text: str) -> bool:
    """Whether the text of a file says already what a record would: of these values, and chosen for this map."""
    same_values = set(_RECORD.findall(record)) <= set(_RECORD.findall(text))
    return not record or (same_values and goes_with_moved_map(record) == goes_with_moved_map(text))


def goes_with_moved_map(text: str) -> bool:
    """Whether the last that beamfield noted in the text of a file is that its values were chosen for the moved map."""
    noted = [line for line in text.splitlines() if _OF_MAP.search(line)]
    return bool(noted) and f"for the map {MOVED_MAP}" in noted[-1]


def values_checksum(stack: str, model: str, parameters: Any, motion: Any) -> str:
    """Return 16 hexadecimal digits that stand for parameters with the six digits that files hold."""
    values = sorted((asdict(parameters) | ({} if motion is None else asdict(motion))).items())
    words = [f"{name}={value:.6g}" if isinstance(value, float) else f"{name}={value!r}" for name, value in values]
    return hashlib.sha256("\n".join([stack, model, *words]).encode()).hexdigest()[:16]


def with_record(text: str, record: str, syntax: Syntax) -> str:
    """Return the text of a file with a record as a comment in its last line, or as it is if it has that comment."""
    newline = line_break(text)
    comment = {"yaml": f"# {record}", "ini": f"// {record}", "launch": f"<!-- {record} -->"}[syntax]
    if comment in text.splitlines():
        return text
    before = "" if not text or text.endswith(("\n", "\r")) else newline
    return f"{text}{before}{comment}{newline}"
