"""How much a bag unpacks to: found out, and refused if it is a bomb, before anything makes room for it.

Blocks of zstd and lz4 say in their headers how long they are, and cannot hold more than a limit each: counting them
bounds what comes out without unpacking it, whatever the lengths claim that stand beside them. Where that bound is too
much, the content is unpacked to be counted. bzip2 has no such headers and is unpacked up to the limit.
"""

from __future__ import annotations

import bz2
import importlib
import math
import os
import sqlite3
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from contextvars import ContextVar
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple

from beamfield.errors import FormatError, InvalidInputError, MissingDependencyError

# Scans shrink to a third, empty maps and costmaps to a hundredth; a bomb reaches 1/30,000.
MAX_EXPANSION = 500
FREE_BYTES = 96 * 2**20  # a map of 10,000 x 10,000 cells
# A chunk is in memory as a whole. Recorders make them of a megabyte; but one message, a huge map, is never cut.
MAX_CHUNK_BYTES = 2**30

_MCAP = b"\x89MCAP0\r\n"
_ZSTD_BLOCK = 128 * 2**10
_LZ4_BLOCKS = {4: 2**16, 5: 2**18, 6: 2**20, 7: 2**22}
_LZ4_EXPANSION = 255
_BLOCK = 2**20
# Of all bags, whatever reads them: logs, maps, reference poses, pictures.
_LIMIT: ContextVar[int | None] = ContextVar("max_unpacked", default=None)


@contextmanager
def max_unpacked(gigabytes: float) -> Iterator[None]:
    """Let each bag that is read meanwhile unpack to so much, instead of in proportion to its size.

    Parameters
    ----------
    gigabytes
        The limit in 10^9 bytes.

    Raises
    ------
    InvalidInputError
        If it is not a positive finite number.

    Examples
    --------
    >>> from beamfield.io.read_log import read_log
    >>> with max_unpacked(20):
    ...     log = read_log("recorded_by_myself.bag")  # doctest: +SKIP
    """
    if isinstance(gigabytes, bool) or not isinstance(gigabytes, int | float) or not 0.0 < gigabytes < math.inf:
        raise InvalidInputError(f"max_unpacked: expected a positive number of gigabytes, got {gigabytes!r}")
    token = _LIMIT.set(int(gigabytes * 1e9))
    try:
        yield
    finally:
        _LIMIT.reset(token)


class Allowance:
    """How many bytes a bag may unpack to: in proportion to its size, or as `max_unpacked` says.

    Parameters
    ----------
    path
        The bag, for errors.
    packed
        The size of its file in bytes.
    """

    def __init__(self, path: Path, packed: int) -> None:
        self._path, self._packed = path, packed
        given = _LIMIT.get()
        self._total = max(FREE_BYTES, MAX_EXPANSION * packed) if given is None else given
        self.chunk = min(self._total, MAX_CHUNK_BYTES) if given is None else given
        self._spent = 0

    def spend(self, unpacked: int) -> None:
        """Count a chunk; FormatError if it, or all so far, are more than is allowed."""
        self._spent += unpacked
        if unpacked > self.chunk or self._spent > self._total:
            what, limit = ("one chunk of it", self.chunk) if unpacked > self.chunk else ("it", self._total)
            raise FormatError(
                self._path,
                f"{self._packed} bytes, but {what} unpacks to more than {limit / 1e9:.3g} GB: refused as a bomb; if "
                "you trust the bag, allow more gigabytes with max_unpacked",
            )


def check_storage(path: Path, unpacked_from: Path | None = None) -> None:
    """Check an .mcap or .db3 file before it is opened, perhaps unpacked from one that the user knows; others may pass.

    FormatError if chunks unpack to more than is allowed, or a database makes up its rows when they are asked for;
    OSError, sqlite3.Error or struct.error if it cannot be read, or is damaged.
    """
    with path.open("rb") as file:
        magic = file.read(16)
        if magic.startswith(_MCAP):
            _check_chunks(file, unpacked_from or path)
    if magic.startswith(b"SQLite format 3"):
        _check_tables(path)


def _check_chunks(file: BinaryIO, path: Path) -> None:
    size, packed = os.fstat(file.fileno()).st_size, path.stat().st_size
    # Readers go by the index if there is one, which need not list the chunks that are there.
    for chunks in (list(_chunks_of_file(file, size)), list(_chunks_of_index(file, size))):
        try:
            _spend(chunks, Allowance(path, packed), partial(unpacked_bound, file))
        except FormatError:
            # Bounds count every block as full.
            _spend(chunks, Allowance(path, packed), partial(_unpacked_size, file))


def _spend(chunks: Sequence[_Chunk], allowance: Allowance, size_of: Callable[..., int]) -> None:
    sizes: dict[_Chunk, int] = {}
    for chunk in chunks:
        if chunk not in sizes:
            sizes[chunk] = size_of(*chunk, enough=allowance.chunk)
        allowance.spend(sizes[chunk])


def unpack_file(path: Path, target: Path) -> None:
    """Unpack a zstd file, as rosbag2 makes them of whole storage files; FormatError if more comes out than allowed."""
    allowance = Allowance(path, path.stat().st_size)
    with _zstd().open(path, "rb") as packed, target.open("wb") as file:
        while block := packed.read(_BLOCK):
            allowance.spend(len(block))
            file.write(block)


def unpack_message(data: bytes, allowance: Allowance) -> bytes:
    """Unpack a message of a bag that compresses each; FormatError if more comes out than is allowed."""
    unpacked = bytearray()
    with _zstd().open(BytesIO(data), "rb") as packed:
        while len(unpacked) <= allowance.chunk and (block := packed.read(_BLOCK)):
            unpacked += block
    allowance.spend(len(unpacked))
    return bytes(unpacked)


def limit_chunks(reader: Any, path: Path) -> None:
    """Have rosbags' open reader of a ROS 1 bag unpack its chunks within what is allowed."""
    allowance = Allowance(path, path.stat().st_size)
    seen: set[int] = set()

    def limited(position: int, unpack: Callable[[bytes], bytes]) -> Callable[[bytes], bytes]:
        def unpack_within(data: bytes) -> bytes:
            if data.startswith(b"BZh"):
                unpacked = _bunzip(data, allowance)
                size = len(unpacked)
            else:
                size = unpacked_bound(BytesIO(data), 0, len(data), "lz4", enough=allowance.chunk)
            # Readers come back to chunks whose times overlap.
            if position not in seen:
                seen.add(position)
                allowance.spend(size)
            return unpacked if data.startswith(b"BZh") else unpack(data)

        return unpack_within

    for position, chunk in reader.chunks.items():
        reader.chunks[position] = chunk._replace(decompressor=limited(position, chunk.decompressor))


def unpacked_bound(file: BinaryIO, start: int, length: int, compression: str, *, enough: int) -> int:
    """Return how many bytes a part of a file unpacks to at most, 0 if it is not packed; counting ends above `enough`.

    Damage ends the count as well, and unpacking.
    """
    blocks = {"zstd": _zstd_blocks, "lz4": _lz4_blocks}.get(compression)
    if blocks is None:
        return 0
    total = 0
    with suppress(struct.error, KeyError):
        for size in blocks(file, start, start + length):
            total += size
            if total > enough:
                break
    return total


def _unpacked_size(file: BinaryIO, start: int, length: int, compression: str, *, enough: int) -> int:
    """Return how many bytes a part of a file unpacks to, by unpacking it without keeping it."""
    if compression != "zstd":
        return unpacked_bound(file, start, length, compression, enough=enough)
    file.seek(start)
    total = 0
    with _zstd().open(BytesIO(file.read(length)), "rb") as packed:
        while total <= enough and (block := packed.read(_BLOCK)):
            total += len(block)
    return total


# --------------------------------------------------------------------------------------------------------------- MCAP


class _Chunk(NamedTuple):
    """Where the compressed records of a chunk are."""

    start: int
    length: int
    compression: str


def _records(file: BinaryIO, position: int, size: int) -> Iterator[tuple[int, int, int]]:
    """Yield where each record begins, its kind and its length; the file stands at its content."""
    while position + 9 <= size:
        file.seek(position)
        kind, length = struct.unpack("<BQ", file.read(9))
        yield position, kind, length
        position += 9 + length


def _chunks_of_file(file: BinaryIO, size: int) -> Iterator[_Chunk]:
    for position, kind, _ in _records(file, len(_MCAP), size):
        if kind == 0x06:
            start = file.read(32)  # times, size, checksum; then the compression, a text with its length before it
            name_length = struct.unpack_from("<I", start, 28)[0]
            name = file.read(min(name_length, 100))
            (packed,) = struct.unpack("<Q", file.read(8))
            yield _chunk(position + 9 + 40 + name_length, packed, name, size)


def _chunks_of_index(file: BinaryIO, size: int) -> Iterator[_Chunk]:
    file.seek(max(0, size - 28))
    (position,) = struct.unpack("<Q", file.read(8))
    for _, kind, length in _records(file, position, size):
        if kind in (0x02, 0x0E):
            return
        if kind == 0x08:
            record = file.read(min(length, 10 * _BLOCK))
            chunk_start, _, offsets = struct.unpack_from("<QQI", record, 16)
            at = 36 + offsets + 8
            (name_length,) = struct.unpack_from("<I", record, at)
            name = record[at + 4 : at + 4 + name_length]
            (packed,) = struct.unpack_from("<Q", record, at + 4 + name_length)
            yield _chunk(chunk_start + 9 + 40 + name_length, packed, name, size)


def _chunk(start: int, length: int, name: bytes, size: int) -> _Chunk:
    return _Chunk(start, min(length, max(0, size - start)), name.decode(errors="replace"))


# ------------------------------------------------------------------------------------------------------------- blocks


def _zstd_blocks(file: BinaryIO, position: int, stop: int) -> Iterator[int]:
    """Yield what each block holds at most (RFC 8878, section 3.1)."""
    while position < stop:
        file.seek(position)
        magic, size = struct.unpack("<II", file.read(8))
        if magic >> 4 == 0x184D2A5:  # a frame to skip
            position += 8 + size
            continue
        if magic != 0xFD2FB528:
            return
        largest, declared, has_checksum, header = _zstd_frame(file, position + 4)
        position += 4 + header
        last = 0
        while not last and position < stop:
            file.seek(position)
            low, high = struct.unpack("<HB", file.read(3))
            word = low | high << 16
            last, kind, size = word & 1, word >> 1 & 3, word >> 3
            bound = size if kind < 2 else largest  # kind 0 stands as it is, 1 repeats one byte
            yield bound
            declared -= bound
            position += 3 + (1 if kind == 1 else size)
        yield max(0, declared)  # libraries make room for this
        position += 4 * has_checksum


def _zstd_frame(file: BinaryIO, position: int) -> tuple[int, int, int, int]:
    """Return the largest block, the declared size of all, whether a checksum follows, and the length of the header."""
    file.seek(position)
    (descriptor,) = file.read(1) or b"\0"
    single, size_flag = descriptor >> 5 & 1, descriptor >> 6
    skipped = (0 if single else 1) + (0, 1, 2, 4)[descriptor & 3]
    size_bytes = (single, 2, 4, 8)[size_flag]
    fields = file.read(skipped + size_bytes).ljust(skipped + size_bytes, b"\0")
    declared = int.from_bytes(fields[skipped:], "little") + (256 if size_bytes == 2 else 0)
    window = declared if single else (1 << 10 + (fields[0] >> 3)) * (8 + (fields[0] & 7)) // 8
    return min(window, _ZSTD_BLOCK), declared, descriptor >> 2 & 1, 1 + skipped + size_bytes


def _lz4_blocks(file: BinaryIO, position: int, stop: int) -> Iterator[int]:
    """Yield what each block holds at most (LZ4 frame format, version 1.6)."""
    while position < stop:
        file.seek(position)
        magic, size = struct.unpack("<II", file.read(8))
        if magic >> 4 == 0x184D2A5:
            position += 8 + size
            continue
        if magic != 0x184D2204:
            return
        flags, largest = size & 0xFF, _LZ4_BLOCKS[size >> 12 & 7]
        position += 7 + 8 * (flags >> 3 & 1) + 4 * (flags & 1)
        size = 1
        while size and position < stop:
            file.seek(position)
            (word,) = struct.unpack("<I", file.read(4))
            size = word & 0x7FFFFFFF
            yield min(largest, size if word >> 31 else _LZ4_EXPANSION * size)
            position += 4 + size + (4 * (flags >> 4 & 1) if size else 0)
        position += 4 * (flags >> 2 & 1)


def _bunzip(data: bytes, allowance: Allowance) -> bytes:
    unpacked = b""
    while data.startswith(b"BZh"):
        stream = bz2.BZ2Decompressor()
        unpacked += stream.decompress(data, max_length=allowance.chunk + 1 - len(unpacked))
        if len(unpacked) > allowance.chunk:
            allowance.spend(len(unpacked))
        if not stream.eof:
            raise EOFError("the bzip2 stream ends early")
        data = stream.unused_data
    return unpacked


def _zstd() -> Any:
    """Return the zstd library that rosbags depends on, which changed between its versions."""
    for name in ("compression.zstd", "backports.zstd", "zstandard"):
        with suppress(ImportError):
            return importlib.import_module(name)
    raise MissingDependencyError("zstandard", "ros", "reading a compressed bag")


# ------------------------------------------------------------------------------------------------------------- SQLite


def _check_tables(path: Path) -> None:
    address = f"{path.absolute().as_uri()}?immutable=1"
    with closing(sqlite3.connect(address, uri=True)) as base:
        odd = base.execute(
            "SELECT name FROM sqlite_master WHERE name IN ('messages', 'topics') AND (type != 'table' OR rootpage = 0)"
        ).fetchone()
        made_up = (
            odd
            or base.execute(
                "SELECT name FROM pragma_table_xinfo('messages') WHERE hidden > 0 UNION "
                "SELECT name FROM pragma_table_xinfo('topics') WHERE hidden > 0"
            ).fetchone()
        )
    if made_up:
        raise FormatError(path, f"expected plain tables, but {made_up[0]!r} is computed on reading: refused")
