"""Whether a PNG holds all the pixels that its header declares: decoders fill in missing rows without a word."""

from __future__ import annotations

import os
import struct
import zlib
from typing import BinaryIO

from PIL.PngImagePlugin import PngImageFile

# What Pillow raises for pictures that are damaged or made to be; found by reading 60,000 of them.
DAMAGE = (OSError, SyntaxError, ValueError, EOFError, IndexError, KeyError, TypeError, AssertionError, struct.error)
# A byte of deflated data stands for at most 1032 bytes: two bits for a repetition of 258.
_LARGEST_RATIO = 1032
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
# First column and row, and the steps to the next, of Adam7's seven passes.
_INTERLACED = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
_WHOLE = ((0, 0, 1, 1),)
_BLOCK = 2**18


def require_all_pixels(file: BinaryIO, picture: PngImageFile) -> None:
    """Check that a PNG holds what its chunks and its header declare, before Pillow makes room for it.

    Takes no memory, however large the picture, and leaves the file where it stood. ValueError if pixels are missing, or
    the data is damaged; the text says how. See Portable Network Graphics (third edition), sections 7.2, 8 and 10.
    """
    if len(picture.tile) != 1 or picture.tile[0][1] != (0, 0, *picture.size):
        raise ValueError("truncated, some pixels have no data")
    where, size = file.tell(), file.seek(0, os.SEEK_END)
    _require_whole_chunks(file, size)
    file.seek(0)
    start = file.read(29)
    if start[12:16] != b"IHDR" or len(start) < 29:
        raise ValueError(f"expected the PNG header at the start, got {start[8:24]!r}")
    width, height, depth, colour, _, _, interlaced = struct.unpack(">IIBBBBB", start[16:])
    if colour not in _CHANNELS:
        raise ValueError(f"expected a PNG colour type, got {colour}")
    needed = _unpacked_bytes(width, height, depth * _CHANNELS[colour], _INTERLACED if interlaced else _WHOLE)
    data_start, found = picture.tile[0][2], 0
    if needed <= _LARGEST_RATIO * (size - data_start):
        try:
            found = _count_unpacked(file, data_start, needed)
        except zlib.error as error:
            raise ValueError(str(error)) from error
    if found < needed:
        raise ValueError(f"truncated, {width} x {height} pixels take {needed} bytes unpacked, it has less")
    file.seek(where)


def _require_whole_chunks(file: BinaryIO, size: int) -> None:
    """Refuse a chunk that is longer than the rest of the file: Pillow makes room for what it declares."""
    at, name = 8, b""
    while at + 8 <= size and name != b"IEND":
        file.seek(at)
        length, name = struct.unpack(">I4s", file.read(8))
        at += 12 + length
        # Some programs leave out the checksum of the last chunk.
        if at > size + 4:
            raise ValueError(f"truncated, a chunk {name!r} declares {length} bytes")


def _unpacked_bytes(width: int, height: int, bits: int, passes: tuple[tuple[int, int, int, int], ...]) -> int:
    total = 0
    for col, row, col_step, row_step in passes:
        cols, rows = -((col - width) // col_step), -((row - height) // row_step)
        if cols > 0 and rows > 0:
            total += rows * (1 + (cols * bits + 7) // 8)  # each row begins with the number of its filter
    return total


def _count_unpacked(file: BinaryIO, data_start: int, needed: int) -> int:
    """Return how many bytes the first run of IDAT chunks holds; counting ends where it is enough."""
    unpack = zlib.decompressobj()
    found, position = 0, data_start - 8
    while found < needed and not unpack.eof:
        file.seek(position)
        length, name = struct.unpack(">I4s", file.read(8).ljust(8, b"\0"))
        if name != b"IDAT":
            break
        position += 12 + length
        while length > 0 and found < needed and not unpack.eof:
            packed = file.read(min(length, _BLOCK))
            if not packed:
                return found
            length -= len(packed)
            while packed and found < needed:
                found += len(unpack.decompress(packed, _BLOCK))
                packed = unpack.unconsumed_tail
    return found
