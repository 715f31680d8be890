"""Lines of text files, plain or compressed with gzip, within limits that a hostile file cannot exceed."""

from __future__ import annotations

import codecs
import gzip
import io
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray

# A scan of 100,000 beams has about 1 MB of text.
MAX_LINE_BYTES = 8 * 2**20
# Logs of ranges shrink to a fifth or a tenth; even constant ranges do not reach 1/200. A bomb reaches 1/1000.
MAX_EXPANSION = 200
FREE_BYTES = 64 * 2**20
# Seconds, metres, radians, or nanoseconds by mistake: squares of anything beyond overflow.
ABSURD = 1e100


def read_lines(path: str | Path) -> Iterator[tuple[int, str]]:
    """Yield the number, counted from 1, and the text of each line; nothing but the current line is kept in memory.

    The file may be compressed with gzip, whatever its name. The text is ASCII; other bytes pass as Latin-1. FormatError
    if a line has a NUL byte (the file is binary) or more than `MAX_LINE_BYTES`; if the gzip stream is damaged or ends
    early, or holds more than `FREE_BYTES` and more than `MAX_EXPANSION` times the size of the file; or if it is a pipe,
    which cannot be read twice.
    """
    source = Path(path)
    with source.open("rb") as file:
        if not file.seekable():
            raise FormatError(source, "expected a file, got a pipe: write what comes from it into a file first")
        compressed = file.read(2) == b"\x1f\x8b"
        file.seek(0)
        if not compressed:
            yield from _decode(source, file, None)
            return
        limit = most_bytes(source)
        with io.BufferedReader(gzip.GzipFile(fileobj=file), 2**18) as stream:
            yield from _decode(source, stream, limit)


def most_bytes(path: Path) -> int:
    """Return how many bytes `read_lines` takes from a file at most: its size, or the limit on what gzip unpacks to."""
    with path.open("rb") as file:
        compressed = file.read(2) == b"\x1f\x8b"
        size = file.seek(0, io.SEEK_END)
    return max(FREE_BYTES, MAX_EXPANSION * size) if compressed else size


def read_at_most(path: Path, max_bytes: int, what: str) -> bytes:
    """Return the content of a file that is no larger than it may be, or raise FormatError without reading more.

    `what` names its kind for the error: "a YAML file".
    """
    with path.open("rb") as file:
        content = file.read(max_bytes + 1)
    if len(content) > max_bytes:
        raise FormatError(path, f"expected {what} of at most {max_bytes} bytes, got more")
    return content


def _decode(path: Path, stream: io.BufferedIOBase, limit: int | None) -> Iterator[tuple[int, str]]:
    number, total = 0, 0
    while True:
        number += 1
        try:
            raw = stream.readline(MAX_LINE_BYTES + 1)
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise FormatError(path, f"the gzip stream is damaged or ends early: {error}", line=number) from error
        if not raw:
            return
        total += len(raw)
        if limit is not None and total > limit:
            raise FormatError(
                path,
                f"the gzip stream holds more than {limit} bytes, {MAX_EXPANSION} times the size of the file: refused",
                line=number,
            )
        if len(raw) > MAX_LINE_BYTES:
            raise FormatError(path, f"the line is longer than {MAX_LINE_BYTES} bytes", line=number)
        nul = raw.find(b"\0")
        if nul >= 0:
            raise FormatError(
                path, f"expected text, got binary data: {raw[max(0, nul - 12) : nul + 12]!r}", line=number
            )
        # Spreadsheets begin a text with a byte order mark.
        yield number, (raw.removeprefix(codecs.BOM_UTF8) if number == 1 else raw).decode("latin-1")


class Line(NamedTuple):
    """A line of a text file, cut into words.

    Parameters
    ----------
    path, number
        The file, and the number of the line from 1.
    words
        Its words; in most formats the first is the name of the message.
    """

    path: Path
    number: int
    words: list[str]

    def error(self, text: str, field: str | None = None) -> FormatError:
        """Return the error that says what is wrong with this line."""
        return FormatError(self.path, text, line=self.number, field=field)

    def numbers(self, start: int = 1, stop: int | None = None, field: str | None = None) -> FloatArray:
        """Return words [start, stop) as numbers; "nan" and "inf" are numbers.

        FormatError quotes a word that is none, after the message's name if no other `field` is given.
        """
        words = self.words[start:stop]
        try:
            return np.array(list(map(float, words)))
        except ValueError:
            bad = next(word for word in words if not is_number(word))
            raise self.error(f"expected a number, got {bad[:40]!r}", field or self.words[0]) from None

    def finite(self, start: int, field: str | None = None) -> FloatArray:
        """Return the words from `start` on as `numbers`, which must be finite."""
        numbers = self.numbers(start, field=field)
        absurd = ~(np.abs(numbers) < ABSURD)
        if absurd.any():
            bad = self.words[start:][int(np.argmax(absurd))]
            limit = f"up to {ABSURD:g}, " if np.isfinite(float(bad)) else ""
            raise self.error(f"expected a finite number, {limit}got {bad[:40]!r}", field or self.words[0])
        return numbers

    def pick(self, indices: Sequence[int]) -> Line:
        """Return the line with these words only."""
        return self._replace(words=[self.words[i] for i in indices])

    def count(self, index: int) -> int:
        """Return a word as a count of readings; FormatError if it is no whole number >= 0 or not there."""
        if index >= len(self.words):
            raise self.error(f"the line is truncated after {len(self.words)} words", self.words[0])
        word = self.words[index]
        if not word.isascii() or not word.isdigit() or len(word) > 9:
            raise self.error(f"expected a number of readings, got {word[:40]!r}", self.words[0])
        return int(word)

    def expect_words(self, expected: int, what: str = "") -> None:
        """Raise a FormatError if the line does not have the number of words that its counts declare."""
        if len(self.words) != expected:
            text = f"expected {expected} words{what and f' ({what})'}, got {len(self.words)}"
            raise self.error(f"{text}: the line is truncated, or its count is wrong", self.words[0])


def word_lines(path: str | Path, separator: str | None = None) -> Iterator[Line]:
    """Yield the lines of `read_lines` that are neither blank nor begin with #, cut at blanks or at a separator."""
    source = Path(path)
    for number, text in read_lines(source):
        if text.strip() and not text.lstrip().startswith("#"):
            yield Line(source, number, [word.strip() for word in text.split(separator)])


def is_number(word: str) -> bool:
    """Return whether `Line.numbers` accepts a word."""
    try:
        float(word)
    except ValueError:
        return False
    return True
