"""Texts of errors are safe to show."""

from __future__ import annotations

from beamfield.errors import FormatError, InvalidInputError


def test_what_a_file_says_begins_no_line_and_moves_no_cursor() -> None:
    error = FormatError("a.bag", "got 'é' after \x1b[2J", line=3, field="/scan\n\u202e")
    assert str(error) == r"a.bag:3: /scan\n\u202e: got 'é' after \x1b[2J"
    assert str(InvalidInputError("topic: got 'a\nb'")) == r"topic: got 'a\nb'"
