"""Lines of plain and compressed text files within limits."""

from __future__ import annotations

import gzip
import os
from pathlib import Path

import pytest

from beamfield.errors import FormatError
from beamfield.io.files import text_lines
from beamfield.io.files.text_lines import Line, read_lines


def test_plain_and_compressed_text_give_the_same_lines_whatever_the_name(tmp_path):
    text = b"first 1\r\nsecond 2\nlast without end"
    (tmp_path / "plain.gz").write_bytes(text)
    (tmp_path / "packed.log").write_bytes(gzip.compress(text))
    expected = [(1, "first 1\r\n"), (2, "second 2\n"), (3, "last without end")]
    assert list(read_lines(tmp_path / "plain.gz")) == expected
    assert list(read_lines(tmp_path / "packed.log")) == expected


def test_a_byte_order_mark_is_no_text(tmp_path):
    (tmp_path / "a.csv").write_text("id,x\n1,2\n", encoding="utf-8-sig")
    assert list(read_lines(tmp_path / "a.csv")) == [(1, "id,x\n"), (2, "1,2\n")]


def test_missing_file_is_the_file_systems_error(tmp_path):
    with pytest.raises(FileNotFoundError):
        list(read_lines(tmp_path / "nothing.log"))


@pytest.mark.skipif(not Path("/dev/fd").is_dir(), reason="no names for open files")
def test_a_pipe_is_refused_by_its_name():
    reading, writing = os.pipe()
    os.close(writing)
    try:
        with pytest.raises(FormatError, match=rf"^/dev/fd/{reading}: expected a file, got a pipe"):
            list(read_lines(f"/dev/fd/{reading}"))
    finally:
        os.close(reading)


def test_binary_junk_is_refused_with_its_bytes(tmp_path):
    path = tmp_path / "junk.log"
    path.write_bytes(b"text\nmore \x00\x01\x02")
    with pytest.raises(FormatError, match=r"junk\.log:2: expected text, got binary data: b'more \\x00"):
        list(read_lines(path))


@pytest.mark.parametrize("cut", [8, 200])
def test_truncated_gzip_names_the_line_it_reached(tmp_path, cut):
    packed = gzip.compress(b"".join(b"line %d\n" % i for i in range(5000)))
    path = tmp_path / "cut.log.gz"
    path.write_bytes(packed[:-cut])
    with pytest.raises(FormatError, match="gzip stream is damaged or ends early") as caught:
        list(read_lines(path))
    assert caught.value.line is not None


def test_damaged_gzip_is_refused(tmp_path):
    packed = bytearray(gzip.compress(b"".join(b"line %d\n" % i for i in range(5000))))
    packed[len(packed) // 2] ^= 0xFF
    path = tmp_path / "damaged.log.gz"
    path.write_bytes(packed)
    with pytest.raises(FormatError, match="damaged"):
        list(read_lines(path))


def test_gzip_bomb_is_refused_before_it_is_unpacked(tmp_path, monkeypatch):
    monkeypatch.setattr(text_lines, "FREE_BYTES", 100_000)
    path = tmp_path / "bomb.log.gz"
    path.write_bytes(gzip.compress(b"0 0 0 0 0 0 0\n" * 200_000))
    seen: list[int] = []
    with pytest.raises(FormatError, match="200 times the size of the file: refused"):
        seen.extend(len(line) for _, line in read_lines(path))
    assert 0 < sum(seen) <= max(100_000, 200 * path.stat().st_size)


def test_a_line_without_end_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(text_lines, "MAX_LINE_BYTES", 1000)
    path = tmp_path / "long.log"
    path.write_bytes(b"short\n" + b"1 " * 600)
    with pytest.raises(FormatError, match=r"long\.log:2: the line is longer than 1000 bytes"):
        list(read_lines(path))


def test_a_word_that_is_no_number_is_quoted(tmp_path):
    with pytest.raises(FormatError, match=r":7: FLASER: expected a number, got '1\.2x'"):
        Line(tmp_path, 7, ["FLASER", "1.0", "1.2x"]).numbers()


@pytest.mark.parametrize("word", ["-1", "1.5", "", "\u0663", "9999999999"])
def test_a_count_must_be_a_whole_number(tmp_path, word):
    with pytest.raises(FormatError, match="expected a number of readings"):
        Line(tmp_path, 1, ["FLASER", word]).count(1)
