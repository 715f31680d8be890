"""Wean Hall's .dat maps."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.files import text_lines
from beamfield.io.maps.wean_map import read_wean_map

HEADER = (
    "robot_specifications->global_mapsize_x   30\n"
    "robot_specifications->resolution         10\n"
    "robot_specifications->autoshifted_x      0\n"
    "\n"
)
# Two lines, so two cells in x; three numbers each, so three in y. The value is the probability of being free.
CELLS = "global_map[0]: 2 3\n1.000 0.789 -1.000\n0.000 0.100 0.5 \n"


@pytest.fixture
def write(tmp_path):
    def write_it(content: str | bytes, name: str = "a.dat"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write_it


def test_lines_are_x_numbers_are_y_and_values_are_free(write):
    grid = read_wean_map(write(HEADER + CELLS))
    expected = np.array([[0.0, 1.0], [1 - 0.789, 0.9], [np.nan, 0.5]]).astype(np.float32)
    np.testing.assert_array_equal(grid.probability, expected)
    assert grid.resolution == 0.1
    assert grid.origin.tolist() == [0.0, 0.0, 0.0]
    # The point x = 0.15 m, y = 0.05 m: second line, first number.
    assert grid.look_up(grid.occupied, [0.15, 0.05])


def test_a_compressed_file_is_the_same_whatever_its_name(write):
    plain = read_wean_map(write(HEADER + CELLS))
    for name in ("b.dat.gz", "b.dat"):
        packed = read_wean_map(write(gzip.compress((HEADER + CELLS).encode()), name))
        np.testing.assert_array_equal(packed.probability, plain.probability)


def test_windows_line_ends_and_a_last_line_without_end_are_read(write):
    text = (HEADER + CELLS).rstrip("\n").replace("\n", "\r\n")
    assert read_wean_map(write(text)).shape == (3, 2)


@pytest.mark.parametrize(
    ("content", "line", "message"),
    [
        ("", 1, "got the end of the file"),
        ("hello\n", 1, r"got 'hello\n'"),
        (HEADER, 5, "got the end of the file"),
        (CELLS, 1, "expected 'robot_specifications->resolution' before the map"),
        (HEADER.replace("10\n", "ten\n") + CELLS, 2, "resolution: expected a number, got 'ten'"),
        (HEADER.replace("10\n", "nan\n") + CELLS, 2, "resolution: expected a number, got 'nan'"),
        (HEADER.replace("10\n", "0\n") + CELLS, None, "resolution: expected a positive number of centimetres, got 0.0"),
        (HEADER.replace("10\n", "-5\n") + CELLS, None, "got -5.0"),
        (HEADER.replace("     0\n", "     50\n") + CELLS, None, "autoshifted_x: expected a map without a shift"),
        (HEADER + "global_map[0]: 0 3\n", 5, "expected a map with cells, got 0 x 3"),
        (HEADER + "global_map[0]: 99999 99999\n", 5, "99999 x 99999 cells exceed the limit of 400000000"),
        (HEADER + CELLS.replace("2 3", "3 3"), None, "truncated: expected 3 lines of numbers, got 2"),
        (HEADER + CELLS.replace("2 3", "1 3"), 7, "expected 1 lines of numbers, got more: '0.000"),
        (HEADER + CELLS.replace("2 3", "2 4"), 6, "expected 4 numbers, got 3"),
        (HEADER + CELLS.replace("0.789", "x"), 6, "expected a number, got 'x'"),
        (HEADER + CELLS.replace("0.5", "nan"), 7, "expected -1 or a probability in [0, 1], got 'nan'"),
        (HEADER + CELLS.replace("0.5", "1.5"), 7, "got '1.5'"),
        (HEADER + CELLS.replace("0.5", "-0.5"), 7, "got '-0.5'"),
        ("\n" * 200, None, "within 100 lines"),
    ],
)
def test_a_damaged_map_is_named_with_its_line(write, content, line, message):
    path = write(content)
    with pytest.raises(FormatError) as caught:
        read_wean_map(path)
    assert caught.value.line == line
    assert message in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_damaged_gzip_file_is_named(write):
    packed = gzip.compress((HEADER + CELLS).encode())
    no_such_block = packed[:10] + b"\xff" + packed[11:]
    wrong_checksum = packed[:-8] + b"\0\0\0\0" + packed[-4:]
    for content in (packed[:-12], packed[:5], no_such_block, wrong_checksum):
        with pytest.raises(FormatError, match=r"a\.dat:\d+: the gzip stream is damaged or ends early"):
            read_wean_map(write(content))


def test_the_limit_of_cells_can_be_set(write):
    with pytest.raises(FormatError, match="2 x 3 cells exceed the limit of 5"):
        read_wean_map(write(HEADER + CELLS), max_cells=5)
    with pytest.raises(InvalidInputError, match="max_cells"):
        read_wean_map(write(HEADER + CELLS), max_cells=0)


def test_a_file_of_one_endless_line_is_refused_without_reading_it_all(write):
    packed = gzip.compress((HEADER + "global_map[0]: 2 3\n").encode() + b"0 " * 10_000_000)
    with pytest.raises(FormatError, match="the line is longer than 8388608 bytes"):
        read_wean_map(write(packed))


def test_a_bomb_is_refused(write, monkeypatch):
    monkeypatch.setattr(text_lines, "FREE_BYTES", 2**16)
    bomb = gzip.compress((HEADER + "global_map[0]: 500 500\n" + ("0 " * 500 + "\n") * 500).encode())
    with pytest.raises(FormatError, match="cells are more than the file can hold"):
        read_wean_map(write(bomb))
    bomb = gzip.compress((HEADER + "global_map[0]: 2 2\n1 1\n1 1\n" + "\n" * 100_000).encode())
    with pytest.raises(FormatError, match="the gzip stream holds more than 65536 bytes"):
        read_wean_map(write(bomb))


def test_a_size_that_the_file_cannot_hold_is_refused_before_memory_is_taken(write, monkeypatch):
    monkeypatch.setattr(np, "empty", lambda *_: pytest.fail("room was made"))
    for content in (text := (HEADER + "global_map[0]: 20000 20000\n0 0").encode(), gzip.compress(text)):
        with pytest.raises(FormatError, match="truncated: 20000 x 20000 cells are more than the file can hold"):
            read_wean_map(write(content))
