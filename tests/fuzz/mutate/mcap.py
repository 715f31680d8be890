"""Changes to MCAP files: records, messages in their chunk, schemas, channels, the summary; offsets follow or not."""

from __future__ import annotations

import random
import struct
import sys
import zlib

import lz4.frame

from tests.fuzz.mutate.havoc import havoc, overwrite_number, reordered
from tests.fuzz.mutate.message import mutate_definition, mutate_message

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

MAGIC = b"\x89MCAP0\r\n"
HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK, INDEX, CHUNK_INDEX, STATISTICS, DATA_END = (
    1,
    2,
    3,
    4,
    5,
    6,
    7,
    8,
    11,
    15,
)
_MESSAGE_HEAD = 22
_PACK = {b"": bytes, b"lz4": lz4.frame.compress, b"zstd": zstd.compress}
_UNPACK = {b"": bytes, b"lz4": lz4.frame.decompress, b"zstd": zstd.decompress}

Records = list[tuple[int, bytes]]


def mutate_mcap(content: bytes, rng: random.Random) -> bytes:
    """Change one thing of an MCAP file."""
    records = mcap_records(content[len(MAGIC) : -len(MAGIC)])
    if len(records) < 3 or rng.random() < 0.08:
        return havoc(content, rng)
    step = rng.choice((_messages,) * 6 + (_data, _data, _data, _order, _text, _text, _summary, _repacked))
    return mcap_bytes(step(records, rng), offsets=rng.random() < 0.9)


def mcap_records(content: bytes) -> Records:
    """Return code and data of each record, up to the first that is not whole."""
    records, at = [], 0
    while at + 9 <= len(content):
        op, size = struct.unpack_from("<BQ", content, at)
        if at + 9 + size > len(content):
            break
        records.append((op, content[at + 9 : at + 9 + size]))
        at += 9 + size
    return records


def mcap_bytes(records: Records, *, offsets: bool) -> bytes:
    """Return a file; where chunks and summary are is put right, or left as it was."""
    if offsets:
        records = _with_offsets(records)
    return MAGIC + b"".join(_record_bytes(*record) for record in records) + MAGIC


def _record_bytes(op: int, data: bytes) -> bytes:
    return struct.pack("<BQ", op, len(data)) + data


def _with_offsets(records: Records) -> Records:
    chunks: list[tuple[int, int]] = []
    summary, at = 0, len(MAGIC)
    for op, data in records:
        if op == CHUNK:
            chunks.append((at, 9 + len(data)))
        at += 9 + len(data)
        if op == DATA_END:
            summary = at
    found, changed = iter(chunks), []
    for op, data in records:
        if op == CHUNK_INDEX and len(data) >= 32 and (chunk := next(found, None)) is not None:
            data = _chunk_index(data, chunk)
        elif op == FOOTER and len(data) == 20 and data[:8] != bytes(8):
            data = struct.pack("<QQI", summary, 0, 0)
        changed.append((op, data))
    return changed


def _chunk_index(data: bytes, chunk: tuple[int, int]) -> bytes:
    """Return an index of a chunk whose offsets of channels keep their places behind it."""
    start, length = struct.unpack_from("<QQ", data, 16)
    (size,) = struct.unpack_from("<I", data, 32)
    shift = sum(chunk) - (start + length)
    entries = b"".join(
        struct.pack("<HQ", channel, (place + shift) % 2**64)
        for channel, place in struct.iter_unpack("<HQ", data[36 : 36 + size - size % 10])
    )
    return data[:16] + struct.pack("<QQ", *chunk) + data[32:36] + entries + data[36 + size - size % 10 :]


def _messages(records: Records, rng: random.Random) -> Records:
    i = _one(records, rng, CHUNK)
    parts = _chunk_parts(records[i][1])
    if parts is None:
        return records
    head, kind, raw = parts
    inner = mcap_records(raw)
    places = [j for j, (op, _) in enumerate(inner) if op == MESSAGE]
    if not places:
        return records
    for _ in range(rng.choice((1, 1, 2, 5))):
        j = rng.choice(places)
        data = inner[j][1]
        if rng.random() < 0.1:
            changed = overwrite_number(data[:_MESSAGE_HEAD], rng) + data[_MESSAGE_HEAD:]
        else:
            changed = data[:_MESSAGE_HEAD] + mutate_message(data[_MESSAGE_HEAD:], rng)
        inner[j] = (MESSAGE, changed)
    return _with_chunk(records, i, head, kind, b"".join(_record_bytes(*record) for record in inner))


def _data(records: Records, rng: random.Random) -> Records:
    i = _one(
        records, rng, *rng.choice(((CHANNEL, SCHEMA), (CHUNK_INDEX, STATISTICS, FOOTER), (CHUNK,), (HEADER, INDEX)))
    )
    op, data = records[i]
    return _with(records, i, op if rng.random() < 0.95 else rng.randrange(20), overwrite_number(data, rng))


def _order(records: Records, rng: random.Random) -> Records:
    return reordered(records, rng, first=1)


def _text(records: Records, rng: random.Random) -> Records:
    """Change what schemas and channels say, keeping the lengths of their texts true."""
    i = _one(records, rng, SCHEMA, CHANNEL)
    op, data = records[i]
    head = 2 if op == SCHEMA else 4
    texts = _texts(data[head:], 3)
    j = rng.randrange(len(texts))
    if op == SCHEMA and rng.random() < 0.5:
        texts[2] = mutate_definition(texts[2], rng)
    else:
        texts[j] = rng.choice((
            b"", b"cdr", b"json", b"ros2msg", b"ros2idl", b"omgidl", b"sensor_msgs/msg/LaserScan",
            b"nav_msgs/msg/OccupancyGrid",
            b"/scan", b"/tf", b"scan", b"\xff", b"\x1b[2J\n", b"x" * 3000, b"float32[] ranges",
            b"module a { struct b { float c; }; };",
            b"uint8 a\nuint8 a", texts[j] + texts[j], havoc(texts[j], rng), havoc(texts[j], rng),
            texts[j][: len(texts[j]) // 2],
        ))  # fmt: skip
    return _with(records, i, op, data[:head] + b"".join(struct.pack("<I", len(text)) + text for text in texts))


def _summary(records: Records, rng: random.Random) -> Records:
    """Leave out the summary or a part of it, as a recorder that was killed does."""
    if rng.random() < 0.5:
        return [(op, bytes(20) if op == FOOTER else data) for op, data in records]
    gone = rng.choice((CHUNK_INDEX, STATISTICS, SCHEMA, CHANNEL, DATA_END, INDEX))
    end = next((i for i, (op, _) in enumerate(records) if op == DATA_END), 0)
    return [record for i, record in enumerate(records) if i <= end or record[0] != gone]


def _repacked(records: Records, rng: random.Random) -> Records:
    i = _one(records, rng, CHUNK)
    parts = _chunk_parts(records[i][1])
    if parts is None:
        return records
    head, _, raw = parts
    return _with_chunk(records, i, head, rng.choice((*_PACK, b"bz2")), raw)


def _chunk_parts(data: bytes) -> tuple[bytes, bytes, bytes] | None:
    """Return the times, the compression and the records of a chunk."""
    if len(data) < 40:
        return None
    (size,) = struct.unpack_from("<I", data, 28)
    kind = data[32 : 32 + size]
    try:
        return data[:16], kind, _UNPACK[kind](data[40 + size :])
    except (KeyError, RuntimeError, ValueError, OSError, EOFError, zstd.ZstdError, MemoryError):
        return None


def _with_chunk(records: Records, i: int, head: bytes, kind: bytes, raw: bytes) -> Records:
    packed = _PACK.get(kind, bytes)(raw)
    data = (
        head
        + struct.pack("<QII", len(raw), zlib.crc32(raw), len(kind))
        + kind
        + struct.pack("<Q", len(packed))
        + packed
    )
    changed = _with(records, i, CHUNK, data)
    return [(op, _resized(old, kind, len(packed), len(raw)) if op == CHUNK_INDEX else old) for op, old in changed]


def _resized(index: bytes, kind: bytes, n_packed: int, n_raw: int) -> bytes:
    """Return the index of a chunk with its compression and sizes."""
    if len(index) < 36:
        return index
    (size,) = struct.unpack_from("<I", index, 32)
    return index[: 36 + size + 8] + struct.pack("<I", len(kind)) + kind + struct.pack("<QQ", n_packed, n_raw)


def _texts(data: bytes, n: int) -> list[bytes]:
    texts, at = [], 0
    for _ in range(n):
        size = struct.unpack_from("<I", data, at)[0] if at + 4 <= len(data) else 0
        texts.append(data[at + 4 : at + 4 + size])
        at += 4 + size
    return texts


def _one(records: Records, rng: random.Random, *ops: int) -> int:
    found = [i for i, (op, _) in enumerate(records) if op in ops]
    return rng.choice(found) if found else rng.randrange(len(records))


def _with(records: Records, i: int, op: int, data: bytes) -> Records:
    return [*records[:i], (op, data), *records[i + 1 :]]
