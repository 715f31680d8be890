"""Changes to ROS 1 bags: fields of records, messages in their chunk, connections, the index; offsets follow or not."""

from __future__ import annotations

import bz2
import random
import struct
from collections.abc import Iterable
from dataclasses import dataclass, replace

import lz4.frame

from tests.fuzz.mutate.havoc import WHOLE, havoc, overwrite_number, reordered
from tests.fuzz.mutate.message import mutate_definition, mutate_message

MAGIC = b"#ROSBAG V2.0\n"
MESSAGE, HEADER, INDEX, CHUNK, CHUNK_INFO, CONNECTION = 2, 3, 4, 5, 6, 7
_PACK = {b"none": bytes, b"bz2": bz2.compress, b"lz4": lz4.frame.compress}
_UNPACK = {b"none": bytes, b"bz2": bz2.decompress, b"lz4": lz4.frame.decompress}


@dataclass(frozen=True)
class Record:
    """Fields of the header in their order, and the data."""

    fields: tuple[tuple[bytes, bytes], ...]
    data: bytes

    def get(self, name: bytes) -> bytes:
        return next((value for key, value in self.fields if key == name), b"")

    def put(self, name: bytes, value: bytes) -> Record:
        return replace(self, fields=tuple((key, value if key == name else old) for key, old in self.fields))

    @property
    def op(self) -> int:
        return self.get(b"op")[0] if self.get(b"op") else -1


def mutate_bag1(content: bytes, rng: random.Random) -> bytes:
    """Change one thing of a ROS 1 bag."""
    records = bag1_records(content[len(MAGIC) :])
    if len(records) < 2 or rng.random() < 0.08:
        return havoc(content, rng)
    step = rng.choice((_messages,) * 6 + (_field, _field, _data, _data, _order, _connection, _repacked))
    changed = step(records, rng)
    return bag1_bytes(changed, offsets=rng.random() < 0.9)


def bag1_records(content: bytes) -> list[Record]:
    """Return the records of a bag's or chunk's content, up to the first that is not whole."""
    records, at = [], 0
    while at + 8 <= len(content):
        (n_header,) = struct.unpack_from("<I", content, at)
        start = at + 4 + n_header
        if start + 4 > len(content):
            break
        (n_data,) = struct.unpack_from("<I", content, start)
        if start + 4 + n_data > len(content):
            break
        records.append(Record(_fields(content[at + 4 : start]), content[start + 4 : start + 4 + n_data]))
        at = start + 4 + n_data
    return records


def bag1_bytes(records: list[Record], *, offsets: bool) -> bytes:
    """Return a bag; where the index and the chunks are is put right, or left as it was."""
    pieces = [_record_bytes(record) for record in records]
    if offsets:
        places, at = [], len(MAGIC)
        for piece in pieces:
            places.append(at)
            at += len(piece)
        chunks = [places[i] for i, record in enumerate(records) if record.op == CHUNK]
        past = [i for i, record in enumerate(records) if record.op in (CHUNK, INDEX)]
        index = places[past[-1] + 1] if past and past[-1] + 1 < len(places) else at
        infos = iter(chunks)
        for i, record in enumerate(records):
            if record.op == HEADER and len(record.get(b"index_pos")) == 8 and record.get(b"index_pos") != bytes(8):
                pieces[i] = _record_bytes(record.put(b"index_pos", struct.pack("<Q", index)))
            if record.op == CHUNK_INFO:
                place = next(infos, None)
                if place is not None and len(record.get(b"chunk_pos")) == 8:
                    pieces[i] = _record_bytes(record.put(b"chunk_pos", struct.pack("<Q", place)))
    return MAGIC + b"".join(pieces)


def _record_bytes(record: Record) -> bytes:
    header = _packed(record.fields)
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(record.data)) + record.data


def _packed(fields: Iterable[tuple[bytes, bytes]]) -> bytes:
    return b"".join(struct.pack("<I", len(key) + 1 + len(value)) + key + b"=" + value for key, value in fields)


def _fields(header: bytes) -> tuple[tuple[bytes, bytes], ...]:
    fields, at = [], 0
    while at + 4 <= len(header):
        (size,) = struct.unpack_from("<I", header, at)
        key, _, value = header[at + 4 : at + 4 + size].partition(b"=")
        fields.append((key, value))
        at += 4 + size
    return tuple(fields)


def _messages(records: list[Record], rng: random.Random) -> list[Record]:
    """Change messages inside the chunk; their places stay where lengths do."""
    i = _one(records, rng, CHUNK)
    unpacked = _unpacked(records[i])
    if unpacked is None:
        return records
    inner = bag1_records(unpacked)
    places = [j for j, record in enumerate(inner) if record.op == MESSAGE]
    if not places:
        return records
    for _ in range(rng.choice((1, 1, 2, 5))):
        j = rng.choice(places)
        data = mutate_message(inner[j].data, rng)
        if rng.random() < 0.8:  # the index says where each message is
            data = data[: len(inner[j].data)].ljust(len(inner[j].data), b"\0")
        inner[j] = replace(inner[j], data=data)
    return _with_chunk(records, i, b"".join(map(_record_bytes, inner)))


def _connection(records: list[Record], rng: random.Random) -> list[Record]:
    """Change a connection in the index: topic, type, definition, digest."""
    i = _one(records, rng, CONNECTION)
    if rng.random() < 0.4:
        topic = rng.choice((b"", b"/", b"scan", b"\xff", b"/tf", b"/map", b"x" * 3000, b"\x1b[2J", b"/scan"))
        return _with(records, i, records[i].put(b"topic", topic))
    inner = dict(_fields(records[i].data))
    if rng.random() < 0.5:
        # Without a digest the definition need not fit it.
        inner |= {b"md5sum": b"", b"message_definition": mutate_definition(inner.get(b"message_definition", b""), rng)}
        return _with(records, i, replace(records[i], data=_packed(inner.items())))
    name = rng.choice((b"type", b"md5sum", b"message_definition", b"topic", b"callerid"))
    old = inner.get(name, b"")
    inner[name] = rng.choice((
        b"", b"sensor_msgs/LaserScan", b"nav_msgs/Odometry", b"tf/tfMessage", b"tf2_msgs/TFMessage", b"*", b"\xff",
        b"a/b/c/d",
        b"float32[] ranges", b"uint8 a\nuint8 a", b"float64[4294967295] a", b"string a=b\n" * 50,
        old[: len(old) // 2], old + old,
        havoc(old, rng), havoc(old, rng),
    ))  # fmt: skip
    return _with(records, i, replace(records[i], data=_packed(inner.items())))


def _field(records: list[Record], rng: random.Random) -> list[Record]:
    """Change, drop, rename or double a field of a record's header."""
    i = rng.randrange(len(records))
    fields = list(records[i].fields)
    if not fields:
        return records
    j = rng.randrange(len(fields))
    key, value = fields[j]
    step = rng.randrange(6)
    if step <= 2:
        fields[j] = (
            key,
            rng.choice(WHOLE).to_bytes(8, "little")[: len(value)] if len(value) <= 8 else havoc(value, rng),
        )
    elif step == 3:
        del fields[j]
    elif step == 4:
        fields[j] = (rng.choice((b"op", b"conn", b"", b"\xff", key + b"_")), value)
    else:
        fields.append((key, havoc(value, rng)))
    return _with(records, i, replace(records[i], fields=tuple(fields)))


def _data(records: list[Record], rng: random.Random) -> list[Record]:
    i = _one(records, rng, INDEX, CHUNK_INFO, CONNECTION, CHUNK)
    return _with(records, i, replace(records[i], data=overwrite_number(records[i].data, rng)))


def _order(records: list[Record], rng: random.Random) -> list[Record]:
    return reordered(records, rng, first=1)


def _repacked(records: list[Record], rng: random.Random) -> list[Record]:
    """Compress the chunk in another way, or say so only."""
    i = _one(records, rng, CHUNK)
    unpacked = _unpacked(records[i])
    if unpacked is None:
        return records
    kind = rng.choice((*_PACK, *_PACK, b"zstd", b"", b"\xff"))
    if kind not in _PACK:
        return _with(records, i, records[i].put(b"compression", kind))
    packed = _PACK[kind](unpacked)
    if rng.random() < 0.3:
        packed = havoc(packed, rng)
    return _with(records, i, replace(records[i].put(b"compression", kind), data=packed))


def _unpacked(chunk: Record) -> bytes | None:
    kind = chunk.get(b"compression")
    if kind not in _UNPACK:
        return None
    try:
        return _UNPACK[kind](chunk.data)
    except (OSError, ValueError, RuntimeError, EOFError, MemoryError):
        return None


def _with_chunk(records: list[Record], i: int, unpacked: bytes) -> list[Record]:
    chunk = records[i].put(b"size", struct.pack("<I", len(unpacked)))
    return _with(records, i, replace(chunk, data=_PACK[chunk.get(b"compression")](unpacked)))


def _one(records: list[Record], rng: random.Random, *ops: int) -> int:
    found = [i for i, record in enumerate(records) if record.op in ops]
    return rng.choice(found) if found else rng.randrange(len(records))


def _with(records: list[Record], i: int, record: Record) -> list[Record]:
    return [*records[:i], record, *records[i + 1 :]]
