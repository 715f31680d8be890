"""Changes to PNG pictures that keep the checksums right: fields, chunks, and the pixels below the compression."""

from __future__ import annotations

import random
import struct
import zlib

from tests.fuzz.mutate.havoc import havoc, reordered

MAGIC = b"\x89PNG\r\n\x1a\n"
_HEADER = struct.Struct(">IIBBBBB")
_SIDES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 16, 100, 1000, 20_001, 65_536, 2**24, 2**31 - 1, 2**31, 2**32 - 1)
EXTRA = (
    (b"tRNS", b"\0\1"), (b"tRNS", b"\0\1\0\2\0\3"), (b"tRNS", b"\0\xff\x80"), (b"tRNS", b""), (b"PLTE", b"\1\2\3" * 4),
    (b"PLTE", b"\1\2"), (b"PLTE", b"\1\2\3" * 300), (b"gAMA", b"\0\0\xb1\x8f"), (b"gAMA", b"\0"), (b"cHRM", b"\0" * 32),
    (b"cHRM", b"\0" * 5), (b"sRGB", b"\0"), (b"sRGB", b""), (b"pHYs", b"\0\0\0\1\0\0\0\1\1"), (b"pHYs", b"\0"),
    (b"tEXt", b"a\0b"), (b"tEXt", b""), (b"tEXt", b"a" * 200), (b"zTXt", b"a\0\0" + zlib.compress(b"x" * 99)),
    (b"zTXt", b"a\0\1x"), (b"zTXt", b"a\0\0" + zlib.compress(bytes(2**21))), (b"iTXt", b"a\0\0\0\0\0b"),
    (b"iTXt", b"a\0\1\0\0\0" + zlib.compress(b"y")), (b"iTXt", b"a\0\1\0\0\0x"), (b"iTXt", b"a"), (b"iCCP", b"a\0\0x"),
    (b"iCCP", b"a\0\0" + zlib.compress(bytes(2**21))), (b"eXIf", b"II*\0\x08\0\0\0"), (b"acTL", b"\0\0\0\2\0\0\0\0"),
    (b"acTL", b"\0\0\0\0\0\0\0\0"), (b"acTL", b"\0"), (b"fcTL", b"\0" * 26), (b"fcTL", b"\0\0\0\1" * 6 + b"\0\0"),
    (b"fdAT", b"\0\0\0\1x"), (b"fdAT", b""), (b"IEND", b""), (b"IEND", b"x"), (b"IDAT", b""), (b"IHDR", b""),
    (b"aaAa", b"?"),
    (b"AAAA", b"?"), (b"\0\0\0\0", b""), (b"bKGD", b"\0"), (b"hIST", b"\0\1"), (b"sBIT", b"\x09"),
)  # fmt: skip

Chunks = list[tuple[bytes, bytes]]


def mutate_png(content: bytes, rng: random.Random) -> bytes:
    """Change one thing of a PNG picture."""
    chunks = png_chunks(content)
    if not chunks:
        return havoc(content, rng)
    step = rng.choice((_field, _field, _field, _pixels, _pixels, _pixels, _extra, _extra, reordered, _inside, _palette))
    changed = png_bytes(step(chunks, rng))
    return _length(changed, rng) if rng.random() < 0.08 else changed


def png_chunks(content: bytes) -> Chunks:
    """Return the chunks of a picture up to the first that is not whole."""
    chunks, at = [], len(MAGIC)
    while at + 8 <= len(content):
        (size,) = struct.unpack_from(">I", content, at)
        if at + 12 + size > len(content):
            break
        chunks.append((content[at + 4 : at + 8], content[at + 8 : at + 8 + size]))
        at += 12 + size
    return chunks


def png_bytes(chunks: Chunks) -> bytes:
    """Return a picture with the checksums that its chunks need."""
    return MAGIC + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)) for kind, data in chunks
    )


def _field(chunks: Chunks, rng: random.Random) -> Chunks:
    """Change width, height, depth, colour, compression, filter or interlacing."""
    kind, data = chunks[0]
    if len(data) != _HEADER.size:
        return chunks
    values = list(_HEADER.unpack(data))
    which = rng.choice((0, 0, 1, 1, 1, 2, 3, 4, 5, 6))
    if which < 2:
        values[which] = rng.choice((*_SIDES, values[which] + 1, max(values[which] - 1, 0), values[which] * 2))
    else:
        values[which] = rng.choice((0, 1, 2, 3, 4, 6, 8, 16, 255))
    return [(kind, _HEADER.pack(*(value % 2**32 if i < 2 else value for i, value in enumerate(values)))), *chunks[1:]]


def _pixels(chunks: Chunks, rng: random.Random) -> Chunks:
    """Change the pixels below the compression: fewer, more, other filters."""
    packed = b"".join(data for kind, data in chunks if kind == b"IDAT")
    try:
        raw = zlib.decompress(packed)
    except zlib.error:
        return chunks
    step = rng.randrange(6)
    if step == 0:
        raw = raw[: rng.randint(0, len(raw))]
    elif step == 1:
        raw += bytes(rng.choice((1, 10, 1000, 100_000)))
    elif step == 2:
        raw = havoc(raw, rng)
    packed = zlib.compress(raw, rng.choice((0, 1, 9)))
    if step == 3:
        packed = packed[: rng.randint(0, len(packed))]
    elif step == 4:
        packed = packed[:-4] + rng.randbytes(4)
    elif step == 5:
        packed = packed + packed
    cut = rng.randint(0, len(packed))
    pieces = [(b"IDAT", packed)] if rng.random() < 0.7 else [(b"IDAT", packed[:cut]), (b"IDAT", packed[cut:])]
    first = next((i for i, (kind, _) in enumerate(chunks) if kind == b"IDAT"), len(chunks))
    rest = [(kind, data) for kind, data in chunks if kind != b"IDAT"]
    return rest[:first] + pieces + rest[first:]


def _extra(chunks: Chunks, rng: random.Random) -> Chunks:
    place = rng.choice((1, 1, len(chunks) - 1, len(chunks), rng.randint(0, len(chunks))))
    return [*chunks[:place], rng.choice(EXTRA), *chunks[place:]]


def _inside(chunks: Chunks, rng: random.Random) -> Chunks:
    i = rng.randrange(len(chunks))
    kind, data = chunks[i]
    return [*chunks[:i], (kind, havoc(data, rng)), *chunks[i + 1 :]]


def _palette(chunks: Chunks, rng: random.Random) -> Chunks:
    """Shorten or lengthen the palette or the transparency."""
    places = [i for i, (kind, _) in enumerate(chunks) if kind in (b"PLTE", b"tRNS")]
    if not places:
        return _extra(chunks, rng)
    i = rng.choice(places)
    kind, data = chunks[i]
    data = data[: rng.randint(0, len(data))] if rng.random() < 0.6 else data * rng.choice((2, 50))
    return [*chunks[:i], (kind, data), *chunks[i + 1 :]]


def _length(content: bytes, rng: random.Random) -> bytes:
    """Change the length that a chunk declares, and nothing else."""
    at = len(MAGIC)
    for _, data in png_chunks(content)[: rng.randint(0, 3)]:
        at += 12 + len(data)
    size = rng.choice((0, 1, 2, 12, 13, 14, 100, 2**31 - 1, 2**31, 2**32 - 1))
    return content[:at] + struct.pack(">I", size) + content[at + 4 :]
