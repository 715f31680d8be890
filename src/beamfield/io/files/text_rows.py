"""Tables of comma-separated values: rows with checked numbers and ids, and writing them."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray
from beamfield.io.files.atomic import write_file
from beamfield.io.files.text_lines import Line, word_lines

# Larger whole numbers are not exact as floating point.
MAX_ID = 2**53


def id_table(
    path: Path,
    what: str,
    is_header: Callable[[list[str]], bool],
    expected: str,
    check: Callable[[Line, FloatArray], None] = lambda _row, _numbers: None,
) -> tuple[list[str], NDArray[np.int64], FloatArray]:
    """Read a table with a header, whose rows are an id and finite numbers: the header, ids (n,) and values (n, d).

    `is_header` says whether the names of the columns, in lower case, are those of such a table; `check` may refuse a
    row. For errors, `what` names a row ("landmark"), and `expected` the headers.

    FormatError names line and value if the header is another, a row has another length, an id is not a whole number
    from 0 to 2^53 or appears twice, a value is not a finite number, or there is no row.
    """
    rows = word_lines(path, ",")
    header = next(rows, Line(path, 1, []))
    names = [name.lower() for name in header.words]
    if not is_header(names):
        raise header.error(f"expected the header {expected}; got {','.join(header.words)[:80]!r}")
    line_of: dict[int, int] = {}
    values: list[FloatArray] = []
    for row in rows:
        if len(row.words) != len(names):
            raise row.error(f"expected {len(names)} values, got {len(row.words)}")
        if not is_id(row.words[0]):
            raise row.error(f"expected a whole number >= 0, got {row.words[0][:40]!r}", "id")
        which = int(row.words[0])
        if which in line_of:
            raise row.error(f"expected each id once, got {which} again after line {line_of[which]}")
        line_of[which] = row.number
        values.append(row.finite(1, field=what))
        check(row, values[-1])
    if not values:
        raise FormatError(path, f"no {what}s: the file has no rows")
    return names, np.array(list(line_of)), np.array(values)


def is_id(word: str) -> bool:
    """Return whether a word is an id: a whole number from 0 to 2^53."""
    return re.fullmatch(r"[0-9]{1,16}", word) is not None and int(word) <= MAX_ID


def write_csv(path: str | Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write comma-separated values, whole or not at all. Numbers as `repr` writes them lose nothing."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_file(path, text.getvalue())
