"""Numeric arrays of MATLAB 5 files, read as hostile input: no objects, and nothing allocated beyond what is there."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from beamfield.errors import FormatError
from beamfield.geometry import FloatArray

MAX_BYTES = 256 * 2**20
# A compressed array may not grow beyond this, nor beyond so many times its size; logs shrink to a half or a fifth.
FREE_BYTES, MAX_EXPANSION = 16 * 2**20, 200
HEADER_BYTES = 128
_MATRIX, _COMPRESSED = 14, 15
# Types of the elements of a file, and the classes of arrays that hold plain numbers: double to uint64.
_DTYPES = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_NUMERIC_CLASSES = range(6, 16)
_COMPLEX = 0x0800


class _Element(NamedTuple):
    kind: int
    data: memoryview
    place: int


def read_mat_arrays(path: str | Path) -> dict[str, FloatArray]:
    """Return the real two-dimensional arrays of a MATLAB 5 file (save -v5, -v6, -v7) by name, as doubles.

    Texts, structures, cells, objects, sparse and complex arrays are left out.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    FormatError
        If the file is too large or no MATLAB 5 file (-v7.3 is HDF5), an element ends beyond the file, is damaged or
        grows beyond 200 times its size, or an array has not as many numbers as its dimensions say; the variable and
        the place in bytes are named.
    OSError
        As the file system says.
    """
    source = Path(path)
    size = source.stat().st_size
    if size > MAX_BYTES:
        raise FormatError(source, f"expected at most {MAX_BYTES} bytes, got {size}")
    content = source.read_bytes()
    order = _byte_order(source, content)
    arrays: dict[str, FloatArray] = {}
    for element in _elements(source, memoryview(content)[HEADER_BYTES:], order, HEADER_BYTES):
        inner = element
        if element.kind == _COMPRESSED:
            inner = next(_elements(source, _inflated(source, element), order, element.place), element)
        if inner.kind != _MATRIX:
            raise FormatError(source, f"byte {element.place}: expected an array, got an element of type {inner.kind}")
        found = _array(source, inner, order)
        if found is not None:
            arrays[found[0]] = found[1]
    return arrays


def _byte_order(path: Path, content: bytes) -> str:
    mark = content[126:128]
    if content[:4] == b"\x89HDF" or content[512:516] == b"\x89HDF":
        raise FormatError(path, "this is a MATLAB 7.3 file (HDF5): save it with -v7")
    if len(content) < HEADER_BYTES or mark not in (b"IM", b"MI"):
        raise FormatError(path, f"expected a MATLAB 5 file, got one that begins with {content[:16]!r}")
    return "<" if mark == b"IM" else ">"


def _elements(path: Path, data: memoryview, order: str, place: int) -> Iterator[_Element]:
    """Yield the data elements one after the other; each begins at a multiple of 8 bytes."""
    at = 0
    while at < len(data):
        if len(data) - at < 8:
            raise FormatError(path, f"byte {place + at}: the file ends within an element")
        kind, size = struct.unpack_from(order + "II", data, at)
        start = at + 8
        if kind >> 16:  # up to four bytes stand in the tag itself
            kind, size, start = kind & 0xFFFF, kind >> 16, at + 4
            if size > 4:
                raise FormatError(path, f"byte {place + at}: expected at most 4 bytes in a short element, got {size}")
        if size > len(data) - start:
            left = len(data) - start
            raise FormatError(path, f"byte {place + at}: an element of {size} bytes, where {left} are left")
        yield _Element(kind, data[start : start + size], place + at)
        # A compressed element is not padded.
        at = start + size if kind == _COMPRESSED else start + size + (-(start + size - at)) % 8


def _inflated(path: Path, element: _Element) -> memoryview:
    limit = max(FREE_BYTES, MAX_EXPANSION * len(element.data))
    stream = zlib.decompressobj()
    try:
        data = stream.decompress(element.data, limit)
    except zlib.error as error:
        raise FormatError(path, f"byte {element.place}: the compressed array is damaged: {error}") from error
    if stream.unconsumed_tail:
        raise FormatError(path, f"byte {element.place}: the compressed array holds more than {limit} bytes: refused")
    if not stream.eof:
        raise FormatError(path, f"byte {element.place}: the compressed array ends early")
    return memoryview(data)


def _array(path: Path, element: _Element, order: str) -> tuple[str, FloatArray] | None:
    """Return name and values of a numeric matrix; None for other classes."""
    parts = _elements(path, element.data, order, element.place)
    flags, dimensions, label = (next(parts, None) for _ in range(3))
    if flags is None or dimensions is None or label is None or len(flags.data) != 8:
        raise FormatError(path, f"byte {element.place}: an array without flags, dimensions and name")
    (bits,) = struct.unpack_from(order + "I", flags.data)
    if bits & 0xFF not in _NUMERIC_CLASSES or bits & _COMPLEX:
        return None
    name = bytes(label.data).decode("latin-1")
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_]{0,62}", name):
        raise FormatError(path, f"byte {label.place}: expected a variable's name, got {name[:40]!r}")
    if dimensions.kind != 5 or len(dimensions.data) % 4:
        raise FormatError(path, f"byte {dimensions.place}: the dimensions are no whole numbers", field=name)
    shape = struct.unpack(f"{order}{len(dimensions.data) // 4}i", dimensions.data)
    if len(shape) != 2:
        return None
    values = next(parts, None)
    if values is None or values.kind not in _DTYPES:
        raise FormatError(path, f"byte {element.place}: the array has no numbers", field=name)
    dtype = np.dtype(order + _DTYPES[values.kind])
    if min(shape) < 0 or shape[0] * shape[1] * dtype.itemsize != len(values.data):
        raise FormatError(
            path,
            f"byte {values.place}: expected {shape[0]} x {shape[1]} numbers of {dtype.itemsize} bytes, "
            f"got {len(values.data)} bytes",
            field=name,
        )
    return name, np.frombuffer(values.data, dtype).reshape(shape, order="F").astype(np.float64)
