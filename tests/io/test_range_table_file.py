"""Files of pre-cached ranges: kept while they are right, built anew when not, and never half there."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from beamfield.errors import FormatError, InvalidInputError
from beamfield.io.maps import range_table_file
from beamfield.io.maps.range_table_file import PAGE, precompute_ranges, read_range_table
from beamfield.io.read_log import read_log
from beamfield.maps.occupancy import OccupancyGrid
from beamfield.maps.range_table import RangeTable
from beamfield.sensors import RangeFinder

CELLS = np.zeros((20, 30))
CELLS[[0, -1]], CELLS[:, [0, -1]], CELLS[8:11, 12:20] = 100, 100, 100
GRID = OccupancyGrid.from_ros(CELLS, 0.1, (1.0, 2.0, 0.3))
OTHER = OccupancyGrid.from_ros(np.maximum(CELLS, 100 * np.eye(20, 30)), 0.1)
HOW = {"headings": 12, "max_range": 4.0}
PROGRAM = """\
import sys
import numpy as np
from beamfield.io.maps.range_table_file import precompute_ranges
from tests.io.test_range_table_file import GRID, HOW
for _ in range(3):
    assert precompute_ranges(sys.argv[1], GRID, **HOW).codes.any()
    precompute_ranges(sys.argv[1], GRID, **{**HOW, "headings": 9})
"""


@pytest.fixture(scope="module")
def whole(tmp_path_factory) -> bytes:
    path = tmp_path_factory.mktemp("table") / "a.ranges"
    precompute_ranges(path, GRID, **HOW)
    return path.read_bytes()


def test_a_table_is_no_log(tmp_path, whole):
    (tmp_path / "a.ranges").write_bytes(whole)
    with pytest.raises(FormatError, match="this is a range table: give it with --range-table"):
        read_log(tmp_path / "a.ranges")


def test_a_file_gives_the_ranges_of_a_table_in_memory_and_is_kept(tmp_path, whole):
    path = tmp_path / "deep" / "a.ranges"
    table = precompute_ranges(path, GRID, **HOW)
    built = RangeTable.build(GRID, **HOW)
    np.testing.assert_array_equal(table.codes, built.codes)
    assert table.error == built.error
    assert path.read_bytes() == whole
    assert json.loads(whole[:PAGE].split(b"\n")[1])["max_range"] == 4.0
    finder = RangeFinder.from_bearings([0.0, 1.0], 4.0)
    poses = np.random.default_rng(1).uniform([1.5, 2.5, -3.0], [3.0, 4.0, 3.0], (50, 3))
    read = read_range_table(path, replace(GRID, origin=(1.0, 2.0, 0.3)))
    np.testing.assert_array_equal(read.expected_ranges(poses, finder), built.expected_ranges(poses, finder))
    before = path.stat()

    def built_again(done: int, total: int) -> None:
        raise AssertionError((done, total))

    precompute_ranges(path, GRID, **HOW, progress=built_again)
    assert path.stat().st_mtime_ns == before.st_mtime_ns


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda _: b"%PDF-1.7 and so on", "expected a range table of beamfield precompute, got b'%PDF-1.7 and so on'"),
        (lambda _: b"", "expected a range table of beamfield precompute, got b''"),
        (lambda b: b[:-1], "the table is not whole: expected {n} bytes, got {n_less}"),
        (lambda b: b + b"\0\0", "the table is not whole"),
        (lambda b: b[:3000], "the table is not whole"),
        (lambda b: b[:100], "the first page of the table is damaged"),
        (lambda b: b.replace(b'"version": 1', b'"version": 2'), "expected version 1 of range tables, got 2"),
        (lambda b: b[:22] + b"[" * 4074 + b[PAGE:], "the first page of the table is damaged"),
        (lambda b: b.replace(b'"headings": 12', b'"headings": -1'), "expected the options and the error of a range"),
        (lambda b: b.replace(b'"error"', b'"terror"'), "expected the options and the error of a range table: 'error'"),
        (lambda b: b.replace(b'"median": ', b'"median": -'), "median: expected a finite number of at least 0"),
    ],
)
def test_a_file_that_is_no_whole_table_is_refused_and_built_anew(tmp_path, whole, damage, message):
    path = tmp_path / "a.ranges"
    path.write_bytes(damage(whole))
    with pytest.raises(FormatError) as caught:
        read_range_table(path, GRID)
    assert message.format(n=len(whole), n_less=len(whole) - 1) in str(caught.value)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)
    precompute_ranges(path, GRID, **HOW)
    assert path.read_bytes() == whole
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.ranges"]


def test_a_table_of_another_map_is_refused_and_built_anew_while_who_uses_it_keeps_it(tmp_path):
    path = tmp_path / "a.ranges"
    old = precompute_ranges(path, GRID, **HOW)
    codes = np.array(old.codes)
    with pytest.raises(FormatError, match="the table is of another map, or the map has changed since; build it again"):
        read_range_table(path, OTHER)
    assert precompute_ranges(path, OTHER, **HOW).grid is OTHER
    assert read_range_table(path, OTHER).error.n_rays > 0
    np.testing.assert_array_equal(old.codes, codes)


def test_what_ends_half_way_leaves_the_old_table(tmp_path, monkeypatch):
    path = tmp_path / "a.ranges"
    precompute_ranges(path, GRID, **HOW)
    old = path.read_bytes()

    def stop(*_: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        precompute_ranges(path, OTHER, **HOW, progress=stop)
    with pytest.raises(InvalidInputError, match="max_gigabytes"):
        precompute_ranges(path, OTHER, **HOW, max_gigabytes=1e-9)
    usage = shutil.disk_usage(tmp_path)._replace(free=5000)
    monkeypatch.setattr(range_table_file.shutil, "disk_usage", lambda _: usage)
    with pytest.raises(OSError, match=r"No space left on device: the table takes .* GB, the disk has 5e-06 GB left"):
        precompute_ranges(path, OTHER, **HOW)
    assert path.read_bytes() == old
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.ranges"]


def test_two_processes_at_once_both_get_whole_tables(tmp_path, whole):
    path = tmp_path / "a.ranges"
    root = Path(__file__).parents[2]
    with subprocess.Popen([sys.executable, "-c", PROGRAM, str(path)], cwd=root, stderr=subprocess.PIPE) as other:
        while not path.exists() and other.poll() is None:
            time.sleep(0.01)
        for _ in range(6):
            # The other one replaces it by one with other options time and again.
            table = precompute_ranges(path, GRID, **HOW)
            assert table.codes.tobytes() == whole[PAGE:]
        other.wait()
        assert other.returncode == 0, other.stderr.read().decode()
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.ranges"]
