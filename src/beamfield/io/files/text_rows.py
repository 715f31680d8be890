"""Tables in text files: rows of words or of comma-separated values, with checked numbers and ids, and writing them."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray
from beamfield.io.files.atomic import write_file
from beamfield.io.files.text_lines import parse_numbers, read_lines

# Larger whole numbers are not exact as floating point.
MAX_ID = 2**53


def word_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield line number and words, split at blanks, of each line that is neither blank nor begins with #.

    Raises
    ------
    FormatError, OSError
        As for `beamfield.io.files.text_lines.read_lines`.
    """
    for number, text in read_lines(path):
        if text.strip() and not text.lstrip().startswith("#"):
            yield number, text.split()


def csv_rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Yield the same with values split at commas, without the blanks around them."""
    for number, text in read_lines(path):
        if text.strip() and not text.lstrip().startswith("#"):
            yield number, [word.strip() for word in text.split(",")]


def finite_numbers(path: Path, line: int, words: Sequence[str], what: str) -> FloatArray:
    """Return words as finite numbers.

    Parameters
    ----------
    path, line
        For the error.
    words
        The texts of the numbers.
    what
        Name of the row, for the error.

    Raises
    ------
    FormatError
        If a word is no finite number; it is quoted.
    """
    numbers = parse_numbers(path, line, words, what)
    if not np.isfinite(numbers).all():
        bad = words[int((~np.isfinite(numbers)).argmax())]
        raise FormatError(path, f"expected a finite number, got {bad[:40]!r}", line=line, field=what)
    return numbers


def expect_columns(path: Path, line: int, words: Sequence[str], columns: Sequence[str]) -> None:
    """Say if a row has not one value per column.

    Parameters
    ----------
    path, line
        For the error.
    words
        The row.
    columns
        Names of the columns.

    Raises
    ------
    FormatError
        If there are more or fewer.
    """
    if len(words) != len(columns):
        raise FormatError(path, f"expected {', '.join(columns)}, got {len(words)} values", line=line)


class IdRows:
    """Collects rows of an id and numbers, each id once, line by line.

    Parameters
    ----------
    path
        The file, for errors.
    what
        What a row is, for errors: "landmark".
    """

    def __init__(self, path: Path, what: str) -> None:
        self.path, self.what = path, what
        self._line_of: dict[int, int] = {}
        self._rows: list[FloatArray] = []

    def add(self, line: int, words: Sequence[str]) -> FloatArray:
        """Add a row, its id first, and return its numbers.

        Raises
        ------
        FormatError
            If the id is none or came before, or another word is no finite number; line and value are named.
        """
        which = parse_id(self.path, line, words[0])
        if which in self._line_of:
            text = f"expected each id once, got {which} again after line {self._line_of[which]}"
            raise FormatError(self.path, text, line=line)
        numbers = finite_numbers(self.path, line, words[1:], self.what)
        self._line_of[which] = line
        self._rows.append(numbers)
        return numbers

    def table(self) -> tuple[NDArray[np.int64], FloatArray]:
        """Return the ids (n,) and the numbers (n, d).

        Raises
        ------
        FormatError
            If there is no row.
        """
        if not self._rows:
            raise FormatError(self.path, f"no {self.what}s: the file has no rows")
        return np.array(list(self._line_of)), np.array(self._rows)


def is_id(word: str) -> bool:
    """Say whether a word is an id: a whole number from 0 to 2^53."""
    return re.fullmatch(r"[0-9]{1,16}", word) is not None and int(word) <= MAX_ID


def parse_id(path: Path, line: int, word: str) -> int:
    """Return a word as an id.

    Raises
    ------
    FormatError
        If it is no whole number from 0 to 2^53; it is quoted.
    """
    if not is_id(word):
        raise FormatError(path, f"expected a whole number >= 0, got {word[:40]!r}", line=line, field="id")
    return int(word)


def write_csv(path: str | Path, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    """Write comma-separated values; an existing file is replaced.

    Parameters
    ----------
    path
        The file.
    header
        Names of the columns.
    rows
        Their values; numbers as `repr` writes them lose nothing.

    Raises
    ------
    OSError
        As the file system says; the old file is left as it was.
    """
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    write_file(path, text.getvalue())
