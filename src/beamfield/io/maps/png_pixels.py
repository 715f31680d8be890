"""Whether a PNG holds all the pixels that its header declares: decoders fill in missing rows without a word."""

from __future__ import annotations

import os
import struct
import zlib
from pathlib import Path
from typing import BinaryIO

from beamfield.errors import FormatError

# A byte of deflated data stands for at most 1032 bytes: two bits for a repetition of 258.
_LARGEST_RATIO = 1032
_CHANNELS = {0: 1, 2: 3, 3: 1, 4: 2, 6: 4}
# First column and row, and the steps to the next, of Adam7's seven passes.
_INTERLACED = ((0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2))
_WHOLE = ((0, 0, 1, 1),)
_BLOCK = 2**18


def require_all_pixels(file: BinaryIO, path: Path, data_start: int) -> None:
    """Check that the compressed data of a PNG holds every pixel; takes no memory, however large the picture.

    Parameters
    ----------
    file
        The open file; it may be read from anywhere afterwards.
    path
        Its name, for errors.
    data_start
        Where the content of the first IDAT chunk begins.

    Raises
    ------
    FormatError
        If pixels are missing, or the data is damaged.

    References
    ----------
    Portable Network Graphics (third edition), sections 7.2, 8 and 10.
    """
    file.seek(0)
    start = file.read(29)
    if start[12:16] != b"IHDR" or len(start) < 29:
        raise FormatError(path, f"damaged picture: expected its header at the start, got {start[8:24]!r}")
    width, height, depth, colour, _, _, interlaced = struct.unpack(">IIBBBBB", start[16:])
    if colour not in _CHANNELS:
        raise FormatError(path, f"damaged picture: expected a colour type of PNG, got {colour}")
    needed = _unpacked_bytes(width, height, depth * _CHANNELS[colour], _INTERLACED if interlaced else _WHOLE)
    packed = os.fstat(file.fileno()).st_size - data_start
    found = 0
    if needed <= _LARGEST_RATIO * packed:
        try:
            found = _count_unpacked(file, data_start, needed)
        except zlib.error as error:
            raise FormatError(path, f"damaged picture: {error}") from error
    if found < needed:
        raise FormatError(
            path, f"damaged picture: truncated, {width} x {height} pixels take {needed} bytes unpacked, it has less"
        )


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
