"""Files of lines: read, written, and refused."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from beamfield.errors import FormatError
from beamfield.io.landmarks.line_files import read_line_map, write_line_map
from beamfield.maps.lines import LineMap


@pytest.mark.parametrize(
    "lines",
    [LineMap([[0.1, 1.0 / 3.0], [3e5, -2e-9]], ids=[9, 0]), LineMap.from_segments([[0.1, 1.0 / 3.0, -2e-9, 3e5]])],
    ids=["lines", "segments"],
)
def test_what_is_written_is_read_back_to_the_last_bit(lines, tmp_path):
    write_line_map(tmp_path / "map.csv", lines)
    back = read_line_map(tmp_path / "map.csv")
    assert back.ids.tolist() == lines.ids.tolist()
    assert back.lines.tolist() == lines.lines.tolist()
    assert (back.segments is None) is (lines.segments is None)
    if lines.segments is not None:
        assert back.segments.tolist() == lines.segments.tolist()


def test_csv_may_have_blanks_comments_and_gzip(tmp_path):
    text = "# walls\nID, Rho, Alpha\n\n4, 1.5, 0\n5, -2, 0\n"
    (tmp_path / "map.csv.gz").write_bytes(gzip.compress(text.encode()))
    lines = read_line_map(tmp_path / "map.csv.gz")
    assert lines.ids.tolist() == [4, 5]
    np.testing.assert_allclose(lines.lines, [[1.5, 0.0], [2.0, np.pi]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "expected the header"),
        ("id,rho\n", "got 'id,rho'"),
        ("id,rho,alpha\n", "no lines"),
        ("id,rho,alpha\n1,2\n", ":2: expected 3 values, got 2"),
        ("id,rho,alpha\n-1,2,3\n", "id: expected a whole number >= 0, got '-1'"),
        ("id,rho,alpha\n1,2,3\n1,2,3\n", ":3: expected each id once, got 1 again after line 2"),
        ("id,rho,alpha\n1,inf,3\n", "expected a finite number, got 'inf'"),
        ("id,rho,alpha\n1,wide,3\n", "'wide'"),
        ("id,x1,y1,x2,y2\n1,2,3,2,3\n", r":2: expected two different ends, got \[2.0, 3.0, 2.0, 3.0\]"),
    ],
    ids=["empty", "header", "no rows", "short", "id", "twice", "infinite", "word", "point"],
)
def test_bad_csv_is_refused_with_its_line(text, message, tmp_path):
    (tmp_path / "map.csv").write_text(text)
    with pytest.raises(FormatError, match=message):
        read_line_map(tmp_path / "map.csv")
