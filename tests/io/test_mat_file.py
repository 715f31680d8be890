"""MATLAB 5 files: written by SciPy and by hand, read, and refused."""

from __future__ import annotations

import struct
import zlib

import numpy as np
import pytest
from scipy.io import savemat

from beamfield.errors import FormatError
from beamfield.io.landmarks.mat_file import read_mat_arrays
from beamfield.io.landmarks.mat_table import mat_ids, mat_table

HEADER = b"MATLAB 5.0 MAT-file".ljust(124) + b"\x00\x01IM"
TABLE = np.array([[1.0, 2.5], [3.0, -4.0], [5.0, 6.0]])


def element(kind: int, data: bytes) -> bytes:
    return struct.pack("<II", kind, len(data)) + data + bytes(-len(data) % 8)


def matrix(name: bytes = b"a", shape=(1, 2), values: bytes | None = None, kind: int = 9, flags: int = 6) -> bytes:
    parts = element(6, struct.pack("<II", flags, 0)) + element(5, struct.pack(f"<{len(shape)}i", *shape))
    parts += element(1, name)
    if values is None:
        values = struct.pack("<2d", 1.5, 2.5)
    return element(14, parts + (element(kind, values) if kind else b""))


@pytest.mark.parametrize("compressed", [False, True])
def test_what_scipy_writes_is_read(compressed, tmp_path):
    values = {
        "doubles": TABLE,
        "singles": TABLE.astype(np.float32),
        "small": np.array([[1, 2, 3]], dtype=np.uint8),
        "signed": np.array([[-5], [70000]], dtype=np.int32),
        "a_name_of_some_length": np.zeros((0, 3)),
    }
    others = {
        "text": "hello",
        "cell": np.array([1, "x"], dtype=object),
        "complex": TABLE * 1j,
        "deep": np.ones((2, 2, 2)),
    }
    savemat(tmp_path / "a.mat", {**values, **others}, do_compression=compressed)
    arrays = read_mat_arrays(tmp_path / "a.mat")
    assert set(arrays) == set(values)
    for name, expected in values.items():
        assert arrays[name].dtype == np.float64
        np.testing.assert_array_equal(arrays[name], expected)


def test_big_endian_files_are_read(tmp_path):
    def swapped(kind: int, data: bytes) -> bytes:
        return struct.pack(">II", kind, len(data)) + data + bytes(-len(data) % 8)

    parts = swapped(6, struct.pack(">II", 6, 0)) + swapped(5, struct.pack(">ii", 1, 2)) + swapped(1, b"a")
    parts += swapped(9, struct.pack(">2d", 1.5, -2.0))
    (tmp_path / "a.mat").write_bytes(HEADER[:124] + b"\x01\x00MI" + swapped(14, parts))
    assert read_mat_arrays(tmp_path / "a.mat")["a"].tolist() == [[1.5, -2.0]]


BAD = {
    "no MATLAB file": (b"id,x,y\n1,2,3\n", "expected a MATLAB 5 file, got one that begins with b'id,x,y"),
    "HDF5": (b"\x89HDF\r\n\x1a\n" + bytes(600), "this is a MATLAB 7.3 file"),
    "HDF5 behind a header": (HEADER + bytes(384) + b"\x89HDF" + bytes(8), "this is a MATLAB 7.3 file"),
    "ends in a tag": (HEADER + matrix() + b"\x0e\x00", "byte 208: the file ends within an element"),
    "ends in an element": (HEADER + matrix()[:-8], "byte 128: an element of 72 bytes, where 64 are left"),
    "no array": (HEADER + element(9, bytes(8)), "byte 128: expected an array, got an element of type 9"),
    "short element": (
        HEADER + struct.pack("<II", (7 << 16) | 14, 0),
        "expected at most 4 bytes in a short element, got 7",
    ),
    "empty array": (HEADER + element(14, b""), "byte 128: an array without flags, dimensions and name"),
    "name": (HEADER + matrix(b"../x"), "expected a variable's name, got '../x'"),
    "too few numbers": (HEADER + matrix(shape=(3, 2)), "a: byte .* expected 3 x 2 numbers of 8 bytes, got 16 bytes"),
    "negative size": (HEADER + matrix(shape=(-1, -2)), "a: byte .* expected -1 x -2 numbers"),
    "huge size": (HEADER + matrix(shape=(2**31 - 1, 2**31 - 1)), "got 16 bytes"),
    "no numbers": (HEADER + matrix(kind=0), "a: byte 128: the array has no numbers"),
    "numbers of no type": (HEADER + matrix(kind=11), "a: byte 128: the array has no numbers"),
    "damaged": (HEADER + element(15, b"nothing"), "byte 128: the compressed array is damaged"),
    "early end": (HEADER + element(15, zlib.compress(matrix())[:-6]), "byte 128: the compressed array ends early"),
    "compressed nothing": (HEADER + element(15, zlib.compress(b"")), "expected an array, got an element of type 15"),
    "bomb": (HEADER + element(15, zlib.compress(bytes(2**25))), "holds more than .* bytes: refused"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_is_no_mat_file_is_refused(case, tmp_path):
    content, message = BAD[case]
    (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(FormatError, match=message) as caught:
        read_mat_arrays(tmp_path / "a.mat")
    assert str(tmp_path / "a.mat") in str(caught.value)


def test_dimensions_that_are_no_whole_numbers_are_refused(tmp_path):
    parts = element(6, struct.pack("<II", 6, 0)) + element(9, bytes(8)) + element(1, b"a") + element(9, bytes(16))
    (tmp_path / "a.mat").write_bytes(HEADER + element(14, parts))
    with pytest.raises(FormatError, match=r"a: byte .*: the dimensions are no whole numbers"):
        read_mat_arrays(tmp_path / "a.mat")


def test_a_file_too_large_is_refused_unread(tmp_path):
    with (tmp_path / "a.mat").open("wb") as file:
        file.truncate(2**28 + 1)
    with pytest.raises(FormatError, match="expected at most 268435456 bytes, got 268435457"):
        read_mat_arrays(tmp_path / "a.mat")


def test_a_missing_file_passes_through(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_mat_arrays(tmp_path / "none.mat")


@pytest.mark.parametrize(
    ("name", "columns", "message"),
    [
        ("other", "a b", "a.mat: other: the variable is missing; arrays in the file: t"),
        ("t", "a b c", r"t: expected rows of a, b, c, got shape \(3, 2\)"),
        ("empty", "a b", r"empty: expected rows of a, b, got shape \(0, 2\)"),
        ("bad", "a b", "bad: row 2: expected a finite b, got 'nan'"),
    ],
    ids=["missing", "columns", "empty", "nan"],
)
def test_tables_are_checked(name, columns, message, tmp_path):
    bad = TABLE.copy()
    bad[1, 1] = np.nan
    arrays = {"t": TABLE} if name == "other" else {"t": TABLE, "empty": np.zeros((0, 2)), "bad": bad}
    with pytest.raises(FormatError, match=message):
        mat_table(tmp_path / "a.mat", arrays, name, columns)


@pytest.mark.parametrize("value", [1.5, -1.0, 2.0**60])
def test_ids_are_whole_numbers(value, tmp_path):
    with pytest.raises(FormatError, match="t: row 2: expected a whole number >= 0 as id, got"):
        mat_ids(tmp_path / "a.mat", np.array([[1.0], [value]]), 0, "t", "id")
